"""Triangles from convex planar polygons, as well shaped as the polygons allow.

Among all triangulations of a polygon the one whose worst triangle is best is found by dynamic
programming over its diagonals, O(n^3) for n corners; n is four or five nearly always.  "Best" is
the ratio of smallest height to longest side, so a corner with a straight angle never becomes a
triangle of its own unless all corners lie on one line.  No corners are added: neighbours keep
fitting together.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import inlined, kernel, parallel_kernel
from implicit_warp.push_forward.polygon_mesh import PolygonMesh

_CHUNK = 4096


def triangulate(mesh: PolygonMesh) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Triangles (F, 3) of all polygons, oriented as they are, and each one's source (F,)."""
    lengths = mesh.lengths[: mesh.n_polygons]
    offsets = np.concatenate([[0], np.cumsum(lengths - 2, dtype=np.int64)])
    faces = np.empty((offsets[-1], 3), np.int64)
    sources = np.empty(offsets[-1], np.int64)
    _triangulate(
        mesh.points, mesh.corner_vertices, mesh.starts, lengths, mesh.sources, offsets, faces,
        sources,
    )  # fmt: skip
    return faces, sources


@parallel_kernel
def _triangulate(
    points, corner_vertices, starts, lengths, polygon_sources, offsets, faces, sources
):
    count = len(lengths)
    for c in prange((count + _CHUNK - 1) // _CHUNK):
        begin, end = c * _CHUNK, min(count, (c + 1) * _CHUNK)
        longest = 3
        for p in range(begin, end):
            longest = max(longest, lengths[p])
        worst, apex = np.empty((longest, longest)), np.empty((longest, longest), np.int32)
        stack = np.empty((longest, 2), np.int32)
        corners = np.empty((longest, 3))
        for p in range(begin, end):
            at, n = offsets[p], lengths[p]
            loop = corner_vertices[starts[p] : starts[p] + n]
            if n == 3:
                faces[at, 0], faces[at, 1], faces[at, 2] = loop[0], loop[1], loop[2]
            else:
                _fetch(points, loop, corners)
                _choose(corners, n, worst, apex)
                _emit(loop, n, apex, stack, faces, at)
            sources[at : at + n - 2] = polygon_sources[p]


@kernel
def _fetch(points, loop, corners):
    """Corner positions, moved and scaled to unit size, so that no product over- or underflows."""
    largest = 0.0
    for k in range(len(loop)):
        for d in range(3):
            corners[k, d] = points[loop[k], d] - points[loop[0], d]
            largest = max(largest, abs(corners[k, d]))
    if largest > 0.0:
        for k in range(len(loop)):
            for d in range(3):
                corners[k, d] /= largest


@kernel
def _choose(corners, n, worst, apex):
    """apex[i, j] = third corner of the triangle on diagonal (i, j), for i < j."""
    for i in range(n - 1):
        worst[i, i + 1] = math.inf
    for width in range(2, n):
        for i in range(n - width):
            j = i + width
            best = -1.0
            for k in range(i + 1, j):
                value = min(worst[i, k], worst[k, j])
                if value > best:
                    value = min(value, _quality(corners[i], corners[k], corners[j]))
                if value > best:
                    best = value
                    apex[i, j] = k
            worst[i, j] = best


@inlined
def _quality(a, b, c):
    """(smallest height / longest side)^2 of a triangle; 0 if its corners coincide."""
    px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    rx, ry, rz = c[0] - b[0], c[1] - b[1], c[2] - b[2]
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    side = max(
        px * px + py * py + pz * pz, max(qx * qx + qy * qy + qz * qz, rx * rx + ry * ry + rz * rz)
    )
    return (nx * nx + ny * ny + nz * nz) / (side * side) if side > 0.0 else 0.0


@kernel
def _emit(loop, n, apex, stack, faces, at):
    stack[0, 0], stack[0, 1] = 0, n - 1
    waiting = 1
    while waiting:
        waiting -= 1
        i, j = stack[waiting, 0], stack[waiting, 1]
        if j - i < 2:
            continue
        k = apex[i, j]
        faces[at, 0], faces[at, 1], faces[at, 2] = loop[i], loop[k], loop[j]
        at += 1
        stack[waiting, 0], stack[waiting, 1] = i, k
        stack[waiting + 1, 0], stack[waiting + 1, 1] = k, j
        waiting += 2
