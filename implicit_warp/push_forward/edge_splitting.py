"""Splitting the edges that cross the levels of one family, each by itself."""

from __future__ import annotations

import numpy as np
from numba import prange

from fields.jit import inlined, parallel_kernel
from implicit_warp.push_forward.families import (
    OUTSIDE,
    level_value,
    levels_between,
    offset_from_level,
    onto_level,
)

CHUNK = 4096
"""Edges or polygons that one thread takes at a time."""


@parallel_kernel
def count_splits(edges, count, codes, slots):
    """Per chunk, how many vertices its edges get, and how many edges get any.

    slots[e] becomes the number of the edge's new vertices, 0 for most.
    """
    chunks = (count + CHUNK - 1) // CHUNK
    vertices, splits = np.zeros(chunks, np.int64), np.zeros(chunks, np.int64)
    for c in prange(chunks):
        for e in range(c * CHUNK, min(count, (c + 1) * CHUNK)):
            a, b = codes[edges[e, 0]], codes[edges[e, 1]]
            low, high = min(a, b), max(a, b)
            levels = np.int32(0)
            if low != OUTSIDE:
                levels = max(levels, np.int32(levels_between(low, high)))
            slots[e] = levels
            vertices[c] += levels
            splits[c] += levels > 0
    return vertices, splits


@parallel_kernel
def split_edges(
    edges, count, points, parents, fractions, codes, n_vertices, family, half,
    vertex_offsets, slot_offsets, slots, first_vertices,
):  # fmt: skip
    """Make the new vertices and edges.

    slots[e] becomes the edge's place in first_vertices, or -1; edge e has the new vertices
    first_vertices[s] to first_vertices[s + 1], counted from its first end.
    """
    shift = count - n_vertices
    for c in prange(len(vertex_offsets) - 1):
        vertex, slot = n_vertices + vertex_offsets[c], slot_offsets[c]
        for e in range(c * CHUNK, min(count, (c + 1) * CHUNK)):
            levels = slots[e]
            if levels == 0:
                slots[e] = -1
                continue
            slots[e] = slot
            first_vertices[slot] = vertex
            slot += 1
            begin, end = edges[e, 0], edges[e, 1]
            a, b = begin, end
            if _comes_first(points[b], points[a]):
                a, b = b, a
            upwards = codes[begin] < codes[end]
            index = min(codes[begin], codes[end]) // 2 + (1 if upwards else levels)
            edges[e, 1] = vertex
            for j in range(levels):
                level = level_value(family, index, half)
                _place(points, a, b, vertex, family, level, fractions)
                parents[vertex, 0] = a
                parents[vertex, 1] = b
                codes[vertex] = 2 * index
                edges[vertex + shift, 0] = vertex
                edges[vertex + shift, 1] = vertex + 1 if j + 1 < levels else end
                index += 1 if upwards else -1
                vertex += 1
    first_vertices[slot_offsets[-1]] = n_vertices + vertex_offsets[-1]


@inlined
def _comes_first(p, q):
    """Is p before q in lexicographic order?"""
    if p[0] != q[0]:
        return p[0] < q[0]
    if p[1] != q[1]:
        return p[1] < q[1]
    return p[2] < q[2]


@inlined
def _place(points, a, b, vertex, family, level, fractions):
    """Put a vertex where edge (a, b) meets a level."""
    da = offset_from_level(family, points[a, 0], points[a, 1], level)
    db = offset_from_level(family, points[b, 0], points[b, 1], level)
    t = min(max(da / (da - db), 0.0), 1.0)
    u = points[a, 0] + t * (points[b, 0] - points[a, 0])
    v = points[a, 1] + t * (points[b, 1] - points[a, 1])
    u, v = onto_level(family, u, v, level)
    points[vertex, 0] = u
    points[vertex, 1] = v
    points[vertex, 2] = points[a, 2] + t * (points[b, 2] - points[a, 2])
    fractions[vertex] = t
