"""The nearest of many edges, compiled: a search in a tree of boxes.

Edges come in the order of their outlines, so neighbours in the list are neighbours in the plane:
halving the list again and again gives a good tree without any sorting. Node 1 is the root, and
node k has the children 2 k and 2 k + 1.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from fields.jit import inlined, kernel, parallel_kernel

LEAF = 4
"""Edges a leaf."""

_DEPTH = 64
"""Nodes that can wait at a time: one for each level, of which there are fewer than 64."""


@inlined
def _box_gap(box, x, y):
    across = max(box[0] - x, 0.0, x - box[2])
    up = max(box[1] - y, 0.0, y - box[3])
    return math.sqrt(across * across + up * up)


@inlined
def _edge_distance(edge, x, y):
    from_x, from_y = x - edge[0], y - edge[1]
    along = edge[2] * from_x + edge[3] * from_y
    if 0.0 < along < edge[4]:
        return edge[3] * from_x - edge[2] * from_y
    corner = math.sqrt(from_x * from_x + from_y * from_y)
    return -corner if edge[5] * from_x + edge[6] * from_y < 0.0 else corner


@parallel_kernel
def nearest_edges(points, edges, boxes, values, indices):
    """Signed distances and the edges that give them.

    Args:
        points: `(m, 2)`.
        edges: `(n, 7)`: first end, direction, length, bisector.
        boxes: `(2 * leaves, 4)`: minimum and maximum corner of each node; empty ones inverted.
        values: `(m,)`, written.
        indices: `(m,)`, written.
    """
    for i in numba.prange(len(points)):
        values[i], indices[i] = _search(points[i, 0], points[i, 1], edges, boxes)


@kernel
def _search(x, y, edges, boxes):
    leaves = len(boxes) // 2
    waiting = np.empty(_DEPTH, np.int64)
    gaps = np.empty(_DEPTH, np.float64)
    waiting[0], gaps[0], count = 1, 0.0, 1
    best, nearest, index = 0.0, np.inf, 0
    while count > 0:
        count -= 1
        node = waiting[count]
        if gaps[count] >= nearest:
            continue
        if node >= leaves:
            first = (node - leaves) * LEAF
            for edge in range(first, min(first + LEAF, len(edges))):
                value = _edge_distance(edges[edge], x, y)
                if abs(value) < nearest:
                    best, nearest, index = value, abs(value), edge
            continue
        left, right = 2 * node, 2 * node + 1
        left_gap, right_gap = _box_gap(boxes[left], x, y), _box_gap(boxes[right], x, y)
        if left_gap < right_gap:  # the nearer one last, to be taken first
            left, right, left_gap, right_gap = right, left, right_gap, left_gap
        if left_gap < nearest:
            waiting[count], gaps[count] = left, left_gap
            count += 1
        if right_gap < nearest:
            waiting[count], gaps[count] = right, right_gap
            count += 1
    return best, index
