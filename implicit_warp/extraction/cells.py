"""Cells that the surface crosses, and the mesh they make.

A search (`enclosed`, `nearby`, `guided`) finds the cells whose corners differ in sign and hands
them over with the values at their corners.  Here they become a mesh: a vertex for every crossed
lattice edge, named by that edge, and the triangles of `cube.tables`.

Every crossed edge lies in exactly four cells that are crossed too, so a search that missed none has
each edge four times.  That is counted, and is the proof that the mesh is watertight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import inlined, kernel, parallel_kernel
from implicit_warp.extraction.cube import EDGE_AXIS, EDGE_ENDS, EDGE_LOW, tables


class Cells(NamedTuple):
    """Crossed cells.

    Attributes:
        corners: (n, 3) int64, lattice index of each cell's low corner.
        values: (n, 8) field minus level at the corners, in the order of `cube.CORNERS`; negative
            is inside, and infinite means beyond the walls of the lattice.
    """

    corners: NDArray[np.int64]
    values: NDArray[np.floating]

    @staticmethod
    def joined(parts: list[Cells], dtype: type) -> Cells:
        """All cells of several lists."""
        none = Cells(np.empty((0, 3), np.int64), np.empty((0, 8), dtype))
        return Cells(*(np.concatenate(column) for column in zip(none, *parts, strict=True)))


class Found(NamedTuple):
    """What a search found.

    Attributes:
        cells: the crossed cells.
        doubtful: (m, 3) cells that are not crossed, but that the surface may enter.
        certain: is it known to enter them?
    """

    cells: Cells
    doubtful: NDArray[np.int64]
    certain: bool = False


class Surface(NamedTuple):
    """A mesh whose vertices are still crossings of lattice edges.

    Attributes:
        low_ends: (V, 3) int64, the lattice point at the low end of each vertex's edge.
        axes: (V,) the axis along which that edge runs.
        values: (V, 2) at the low and the high end.
        faces: (F, 3) int64, outward.
        uses: (V,) in how many cells the edge was met; 4 if the search was complete.
        cell_edges: (n, 12) the vertex on each edge of each cell, -1 where there is none.
        patterns: (n,) the sign pattern of each cell.
        first_face: (n + 1,) where the faces of each cell begin.
    """

    low_ends: NDArray[np.int64]
    axes: NDArray[np.int64]
    values: NDArray[np.floating]
    faces: NDArray[np.int64]
    uses: NDArray[np.int64]
    cell_edges: NDArray[np.int32]
    patterns: NDArray[np.uint8]
    first_face: NDArray[np.int64]


def march(cells: Cells) -> Surface:
    """The triangles of crossed cells, joined where they name the same lattice edge."""
    corners, values = cells
    low = corners.min(axis=0, initial=0)
    extent = corners.max(axis=0, initial=0) - low + 2  # lattice points of the cells' box
    patterns, n_edges, n_faces = _patterns(values, tables().n_triangles)
    low_ends, axes, ends, uses, cell_edges = _name_edges(
        corners - low, values, patterns, extent, int(n_edges.sum())
    )
    first_face = np.concatenate([[0], np.cumsum(n_faces)])
    faces = np.empty((int(first_face[-1]), 3), np.int64)
    _fill_faces(patterns, cell_edges, first_face, tables().triangles, faces)
    return Surface(low_ends + low, axes, ends, faces, uses, cell_edges, patterns, first_face)


def crossed_cells_of_blocks(
    block_corners: NDArray[np.int64], values: NDArray[np.floating], beyond: NDArray[np.int64]
) -> Cells:
    """The crossed cells in blocks of samples.

    Args:
        block_corners: (n, 3) lattice index of each block's first point.
        values: (n, m, m, m) samples minus level.
        beyond: (2, 3) first and last lattice cell; cells outside are left out.
    """
    count = np.zeros(len(values), np.int64)
    nothing = Cells(np.empty((0, 3), np.int64), np.empty((0, 8), values.dtype))
    _gather_blocks(block_corners, values, beyond, count, count, *nothing, False)
    first = np.concatenate([[0], np.cumsum(count)])
    cells = Cells(
        np.empty((int(first[-1]), 3), np.int64), np.empty((int(first[-1]), 8), values.dtype)
    )
    _gather_blocks(block_corners, values, beyond, count, first, *cells, True)
    return cells


def middles(cells: Cells) -> NDArray[np.float64]:
    """(n, 3) a point near the surface in each cell, in index coordinates of the lattice.

    The mean of the points where its edges are crossed, by linear interpolation.
    """
    points = np.empty((len(cells.corners), 3))
    _middles(*cells, points)
    return points


@parallel_kernel
def _middles(corners, values, points):
    for i in prange(len(corners)):
        crossings = 0
        x = y = z = 0.0
        for e in range(12):
            low, high = values[i, EDGE_ENDS[0, e]], values[i, EDGE_ENDS[1, e]]
            if (low < 0) == (high < 0):
                continue
            crossings += 1
            # One end may be infinite, beyond a wall: then the crossing is at the other.
            share = abs(low) / (abs(low) + abs(high)) if np.isfinite(low + high) else 0.5
            x += EDGE_LOW[e, 0] + (share if EDGE_AXIS[e] == 0 else 0.0)
            y += EDGE_LOW[e, 1] + (share if EDGE_AXIS[e] == 1 else 0.0)
            z += EDGE_LOW[e, 2] + (share if EDGE_AXIS[e] == 2 else 0.0)
        points[i, 0] = corners[i, 0] + x / crossings
        points[i, 1] = corners[i, 1] + y / crossings
        points[i, 2] = corners[i, 2] + z / crossings


@inlined
def _pattern(values, zero):
    """The sign pattern of eight values."""
    pattern = 0
    for c in range(8):
        pattern |= np.int64(values[c] < zero) << c
    return pattern


@parallel_kernel
def _gather_blocks(block_corners, values, beyond, count, first, corners, corner_values, fill):
    """Count the crossed cells of every block, or fill them in."""
    size = values.shape[1] - 1
    zero = values.dtype.type(0.0)
    for b in prange(len(values)):
        block = values[b]
        found = 0
        for i in range(size):
            for j in range(size):
                for k in range(size):
                    inside = 0
                    for c in range(8):
                        inside += np.int64(
                            block[i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1)] < zero
                        )
                    if inside == 0 or inside == 8:
                        continue
                    x = block_corners[b, 0] + i
                    y = block_corners[b, 1] + j
                    z = block_corners[b, 2] + k
                    if x < beyond[0, 0] or y < beyond[0, 1] or z < beyond[0, 2]:
                        continue
                    if x > beyond[1, 0] or y > beyond[1, 1] or z > beyond[1, 2]:
                        continue
                    if fill:
                        at = first[b] + found
                        corners[at, 0] = x
                        corners[at, 1] = y
                        corners[at, 2] = z
                        for c in range(8):
                            corner_values[at, c] = block[
                                i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1)
                            ]
                    found += 1
        if not fill:
            count[b] = found


@parallel_kernel
def _patterns(values, n_triangles):
    """Sign pattern, number of crossed edges and number of triangles of every cell."""
    n = len(values)
    patterns = np.empty(n, np.uint8)
    n_edges, n_faces = np.empty(n, np.int64), np.empty(n, np.int64)
    zero = values.dtype.type(0.0)
    for i in prange(n):
        pattern = _pattern(values[i], zero)
        patterns[i] = pattern
        crossed = 0
        for e in range(12):
            crossed += ((pattern >> EDGE_ENDS[0, e]) ^ (pattern >> EDGE_ENDS[1, e])) & 1
        n_edges[i] = crossed
        n_faces[i] = n_triangles[pattern]
    return patterns, n_edges, n_faces


@kernel
def _by_first_axis(corners, planes):
    """The order of cells by their first index, and where each index begins (counting sort)."""
    first = np.zeros(planes + 2, np.int64)
    for i in range(len(corners)):
        first[corners[i, 0] + 2] += 1
    for x in range(planes):
        first[x + 2] += first[x + 1]
    order = np.empty(len(corners), np.int64)
    for i in range(len(corners)):
        order[first[corners[i, 0] + 1]] = i
        first[corners[i, 0] + 1] += 1
    return order, first


@kernel
def _name_edges(corners, values, patterns, extent, most):
    """Give every crossed edge a number; cells are visited plane by plane along the first axis.

    Two planes of lattice points remember the number of the edges that begin there: the planes at
    the two ends of the cells at hand. A number from before the cells next to a plane is stale.
    """
    order, first = _by_first_axis(corners, extent[0])
    numbers = np.full((2, extent[1] * extent[2] * 3), -1, np.int32)
    valid = np.zeros(2, np.int64)  # the smallest number in each plane that is not stale
    capacity = most // 4 + 64
    low_ends, axes = np.empty((capacity, 3), np.int64), np.empty(capacity, np.int64)
    ends, uses = np.empty((capacity, 2), values.dtype), np.empty(capacity, np.int64)
    cell_edges = np.full((len(corners), 12), -1, np.int32)
    found = 0
    for plane in range(extent[0]):
        valid[(plane + 1) & 1] = found
        for index in range(first[plane], first[plane + 1]):
            i = order[index]
            pattern = np.int64(patterns[i])
            for e in range(12):
                low, high = EDGE_ENDS[0, e], EDGE_ENDS[1, e]
                if not ((pattern >> low) ^ (pattern >> high)) & 1:
                    continue
                x = corners[i, 0] + EDGE_LOW[e, 0]
                y = corners[i, 1] + EDGE_LOW[e, 1]
                z = corners[i, 2] + EDGE_LOW[e, 2]
                at = (y * extent[2] + z) * 3 + EDGE_AXIS[e]
                vertex = np.int64(numbers[x & 1, at])
                if vertex < valid[x & 1]:
                    if found == capacity:  # an incomplete search meets edges less than four times
                        capacity *= 2
                        axes, uses = longer(axes, capacity), longer(uses, capacity)
                        low_ends, ends = taller(low_ends, capacity), taller(ends, capacity)
                    vertex = found
                    found += 1
                    numbers[x & 1, at] = vertex
                    low_ends[vertex, 0] = x
                    low_ends[vertex, 1] = y
                    low_ends[vertex, 2] = z
                    axes[vertex] = EDGE_AXIS[e]
                    ends[vertex, 0] = values[i, low]
                    ends[vertex, 1] = values[i, high]
                    uses[vertex] = 0
                uses[vertex] += 1
                cell_edges[i, e] = vertex
    return low_ends[:found], axes[:found], ends[:found], uses[:found], cell_edges


@kernel
def longer(array, size):
    """The same entries with more room."""
    result = np.empty(size, array.dtype)
    result[: len(array)] = array
    return result


@kernel
def taller(array, size):
    """The same rows with more room."""
    result = np.empty((size, array.shape[1]), array.dtype)
    result[: len(array)] = array
    return result


@parallel_kernel
def _fill_faces(patterns, cell_edges, first_face, triangles, faces):
    for i in prange(len(patterns)):
        start = first_face[i]
        for t in range(first_face[i + 1] - start):
            for v in range(3):
                faces[start + t, v] = cell_edges[i, triangles[patterns[i], t, v]]
