"""Pairs of faces whose boxes overlap, by a tree of boxes over a space-filling curve.

Faces are sorted along a Morton curve, packed in that order into leaves of `LEAF` faces, and
the leaves are the bottom row of a complete binary tree stored like a heap (node k has
children 2 k and 2 k + 1). A leaf needs to be tested only against leaves to its right; these
are exactly the subtrees that hang to the right of its path to the root, so no pair is seen
twice and nothing has to be filtered out afterwards.

Boxes are closed: faces that merely touch are candidates.

For developers: Numba's cache of a compiled function does not notice changes in functions of
other modules. After editing `predicates` or `pair_filter`, delete this folder's `__pycache__`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import kernel, parallel_kernel
from implicit_warp.checking.pair_filter import CLEAR, pair_verdict

LEAF = 4
_CELLS = 2**21 - 1  # 21 bits a coordinate fill the 63 bits of a Morton code


def morton_order(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.int64]:
    """Permutation that sorts boxes by the Morton code of their centres."""
    origin = low.min(axis=0)
    extent = high.max(axis=0) - origin
    # An extent whose reciprocal overflows sorts nothing.
    scale = _CELLS / np.where(extent > 1e-300, extent, 1.0)
    return np.argsort(_morton_codes(low, high, origin, scale), kind="stable")


@kernel
def face_boxes(vertices, faces, chosen):
    """Lower and upper corners, each `(n, 3)`, of the axis-aligned boxes of chosen faces `(n,)`."""
    low = np.empty((len(chosen), 3))
    high = np.empty((len(chosen), 3))
    for i in range(len(chosen)):
        f = chosen[i]
        for k in range(3):
            x = vertices[faces[f, 0], k]
            y = vertices[faces[f, 1], k]
            z = vertices[faces[f, 2], k]
            low[i, k] = min(x, y, z)
            high[i, k] = max(x, y, z)
    return low, high


@kernel
def _spread(x):
    """Insert two zero bits after each of 21 bits."""
    x = (x | (x << 32)) & 0x1F00000000FFFF
    x = (x | (x << 16)) & 0x1F0000FF0000FF
    x = (x | (x << 8)) & 0x100F00F00F00F00F
    x = (x | (x << 4)) & 0x10C30C30C30C30C3
    x = (x | (x << 2)) & 0x1249249249249249
    return x


@kernel
def _morton_codes(low, high, origin, scale):
    codes = np.empty(len(low), np.int64)
    for f in range(len(low)):
        code = 0
        for k in range(3):
            centre = 0.5 * (low[f, k] + high[f, k])
            cell = np.int64((centre - origin[k]) * scale[k])
            code |= _spread(min(max(cell, 0), _CELLS)) << k
        codes[f] = code
    return codes


@kernel
def build_tree(low, high):
    """Node boxes `(2 m, 6)`, lower then upper corner, of sorted face boxes; m leaves."""
    n = len(low)
    leaves = 1
    while leaves * LEAF < n:
        leaves *= 2
    nodes = np.empty((2 * leaves, 6))
    nodes[:, :3] = np.inf
    nodes[:, 3:] = -np.inf
    for f in range(n):
        node = leaves + f // LEAF
        for k in range(3):
            nodes[node, k] = min(nodes[node, k], low[f, k])
            nodes[node, 3 + k] = max(nodes[node, 3 + k], high[f, k])
    for node in range(leaves - 1, 0, -1):
        for k in range(3):
            nodes[node, k] = min(nodes[2 * node, k], nodes[2 * node + 1, k])
            nodes[node, 3 + k] = max(nodes[2 * node, 3 + k], nodes[2 * node + 1, 3 + k])
    return nodes


@dataclass(frozen=True)
class BoxTree:
    """Faces in the order of a space-filling curve, their boxes, and the tree above them.

    Attributes:
        faces: `(F,)` the faces by number, in the order of the curve.
        low: `(F, 3)` lower corners of their boxes, in that order.
        high: `(F, 3)` upper corners.
        nodes: as from `build_tree`.
    """

    faces: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    nodes: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        vertices: NDArray[np.float64],
        faces: NDArray[np.int64],
        chosen: NDArray[np.int64],
    ) -> BoxTree:
        """The tree of the faces numbered by `chosen`, one or more of `faces` `(F, 3)`."""
        low, high = face_boxes(vertices, faces, chosen)
        order = morton_order(low, high)
        low, high = low[order], high[order]
        return cls(chosen[order], low, high, build_tree(low, high))


@kernel
def _boxes_apart(low, high, f, g):
    return (
        low[f, 0] > high[g, 0]
        or low[g, 0] > high[f, 0]
        or low[f, 1] > high[g, 1]
        or low[g, 1] > high[f, 1]
        or low[f, 2] > high[g, 2]
        or low[g, 2] > high[f, 2]
    )


@kernel
def _nodes_apart(nodes, m, n):
    return (
        nodes[m, 0] > nodes[n, 3]
        or nodes[n, 0] > nodes[m, 3]
        or nodes[m, 1] > nodes[n, 4]
        or nodes[n, 1] > nodes[m, 4]
        or nodes[m, 2] > nodes[n, 5]
        or nodes[n, 2] > nodes[m, 5]
    )


@kernel
def faces_over(nodes, low, high, points):
    """Pairs (point, box) of all boxes that the vertical half-line up from a point meets, `(n, 2)`.

    `points` is `(P, 3)`; boxes are numbered in the order of the tree.
    """
    leaves = len(nodes) // 2
    stack = np.empty(64, np.int64)
    found = np.empty((16, 2), np.int64)
    count = 0
    for p in range(len(points)):
        x, y, z = points[p]
        stack[0] = 1
        depth = 1
        while depth > 0:
            depth -= 1
            node = stack[depth]
            if (
                not (nodes[node, 0] <= x <= nodes[node, 3])
                or not (nodes[node, 1] <= y <= nodes[node, 4])
                or nodes[node, 5] < z
            ):
                continue
            if node < leaves:
                stack[depth] = 2 * node
                stack[depth + 1] = 2 * node + 1
                depth += 2
                continue
            begin = (node - leaves) * LEAF
            for f in range(begin, min(begin + LEAF, len(low))):
                if (
                    low[f, 0] <= x <= high[f, 0]
                    and low[f, 1] <= y <= high[f, 1]
                    and z <= high[f, 2]
                ):
                    if count == len(found):
                        larger = np.empty((2 * count, 2), np.int64)
                        larger[:count] = found
                        found = larger
                    found[count, 0] = p
                    found[count, 1] = f
                    count += 1
    return found[:count]


@parallel_kernel
def scan_pairs(vertices, faces, order, low, high, nodes, offsets, pairs, verdicts, limit):
    """Judge all overlapping pairs and record those that are not certainly clear.

    `order`, `low`, `high` and `nodes` are what a `BoxTree` holds; pairs are of faces by number.

    The leaves are split into `len(offsets) - 1` chunks, worked on in parallel. Chunk c
    writes into the slots `offsets[c]` to `offsets[c + 1]` of `pairs (n, 2)` and `verdicts
    (n,)`, goes on counting when these are full, and stops at `limit`.

    Returns the records found and the pairs judged, one entry each a chunk.
    """
    n = len(order)
    leaves = len(nodes) // 2
    used_leaves = (n + LEAF - 1) // LEAF
    chunks = len(offsets) - 1
    found = np.zeros(chunks, np.int64)
    judged = np.zeros(chunks, np.int64)
    for chunk in prange(chunks):
        stack = np.empty(64, np.int64)
        count = 0
        tests = 0
        for leaf in range(chunk * used_leaves // chunks, (chunk + 1) * used_leaves // chunks):
            if count > limit:
                break
            home = leaves + leaf
            begin = leaf * LEAF
            end = min(begin + LEAF, n)
            stack[0] = home
            depth = 1
            path = home
            while True:
                while depth > 0 and count <= limit:
                    depth -= 1
                    node = stack[depth]
                    if _nodes_apart(nodes, home, node):
                        continue
                    if node < leaves:
                        stack[depth] = 2 * node
                        stack[depth + 1] = 2 * node + 1
                        depth += 2
                        continue
                    other = (node - leaves) * LEAF
                    for f in range(begin, end):
                        for g in range(max(other, f + 1), min(other + LEAF, n)):
                            if _boxes_apart(low, high, f, g):
                                continue
                            tests += 1
                            verdict = pair_verdict(vertices, faces, order[f], order[g])
                            if verdict == CLEAR:
                                continue
                            slot = offsets[chunk] + count
                            if slot < offsets[chunk + 1]:
                                pairs[slot, 0] = order[f]
                                pairs[slot, 1] = order[g]
                                verdicts[slot] = verdict
                            count += 1
                # Climb to the next ancestor with a sibling on its right.
                while path > 1 and path % 2 == 1:
                    path //= 2
                if path <= 1 or count > limit:
                    break
                stack[0] = path + 1
                depth = 1
                path //= 2
        found[chunk] = count
        judged[chunk] = tests
    return found, judged
