"""How a surface crosses a cube, for each of the 256 sign patterns of its corners.

Corner (i, j, k) of a cube has index 4 i + 2 j + k, and bit 1 << index of a pattern is set if that
corner is inside.  Edges and faces are numbered in the tables below.

On each face the surface leaves segments between edges whose ends differ in sign.  Where all four
edges do, there are two ways to pair them; here the pair of inside corners is *joined*.  Both
cubes at a face see the same signs, so they agree on its segments, and the segments of a cube close
to loops.  That alone makes every surface watertight, whatever the signs (it is also the choice of
the tables of Lorensen and Cline as scikit-image has them, with which the tests compare).

A loop is filled by a fan around one of its points, chosen so that no diagonal lies in a face of the
cube.  So the triangles do not intersect, wherever on their edges the points are: seen from the
fan's point, the faces of the cube that do not hold it cover each direction once, and the rest of
the loop lies on those.  (And a diagonal in a face could be one of the neighbour's as well.)  The
few patterns of two loops whose fans could meet are covered by tests.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise, product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CORNERS = np.array(list(product((0, 1), repeat=3)), dtype=np.int64)
"""(8, 3) corners in the order of their index."""


def _edges() -> list[tuple[tuple[int, int, int], int]]:
    """Every edge by its low end and its axis; edges 4 a, ..., 4 a + 3 are along axis a."""
    return [
        (tuple(low), axis)
        for axis in range(3)
        for low in product((0, 1), repeat=3)
        if low[axis] == 0
    ]


EDGE_LOW = np.array([low for low, _ in _edges()], dtype=np.int64)
"""(12, 3) the corner at the low end of each edge."""

EDGE_AXIS = np.array([axis for _, axis in _edges()], dtype=np.int64)
"""(12,) the axis along which each edge runs."""

FACE_AXIS = np.array([0, 0, 1, 1, 2, 2])
FACE_SIDE = np.array([0, 1, 0, 1, 0, 1])
"""(6,) the axis across each face, and whether it is the low or the high one."""

EDGE_ENDS = np.stack([EDGE_LOW @ [4, 2, 1], EDGE_LOW @ [4, 2, 1] + np.array([4, 2, 1])[EDGE_AXIS]])
"""(2, 12) corners at the low and the high end of each edge."""


class Loop(NamedTuple):
    """A closed curve in which the surface crosses the faces of a cube.

    Attributes:
        edges: the crossed edges in order, counter-clockwise as seen from outside the solid.
        faces: the face that the step from each edge to the next one lies in.
    """

    edges: tuple[int, ...]
    faces: tuple[int, ...]


@cache
def loops(pattern: int) -> tuple[Loop, ...]:
    """The loops of a sign pattern, 0 to 4 of them."""
    onward: dict[int, tuple[int, int]] = {}
    for face, (corners, edges) in enumerate(face_cycles()):
        inside = [bool(pattern >> corner & 1) for corner in corners]
        # Edge i leads from corner i to the next one, counter-clockwise as seen from outside.
        entries = [i for i in range(4) if inside[(i + 1) % 4] and not inside[i]]
        exits = [i for i in range(4) if inside[i] and not inside[(i + 1) % 4]]
        for entry in entries:
            # Joining the inside: the exit met first when going back from the entry.
            exit_ = next(j % 4 for j in range(entry - 1, entry - 5, -1) if j % 4 in exits)
            onward[edges[entry]] = (edges[exit_], face)
    result = []
    while onward:
        edge = start = min(onward)
        path, faces = [], []
        while not path or edge != start:
            path.append(edge)
            edge, face = onward.pop(edge)
            faces.append(face)
        result.append(Loop(tuple(path), tuple(faces)))
    return tuple(result)


def triangles(loop: Loop) -> list[tuple[int, int, int]]:
    """Edges of a loop, three for each triangle: a fan around one of them, no diagonal in a face."""
    for i in range(len(loop.edges)):
        hub, *others = (*loop.edges[i:], *loop.edges[:i])
        if not any(_share_a_face(hub, other) for other in others[1:-1]):
            return [(hub, *pair) for pair in pairwise(others)]
    raise AssertionError(f"loop {loop.edges} has no such fan")


class Tables(NamedTuple):
    """The 256 patterns as arrays for kernels.

    Attributes:
        n_triangles: (256,)
        triangles: (256, T, 3) edges of each triangle, the first `n_triangles` of them.
        n_loops: (256,)
        loop_length: (256, 4)
        loop_edges: (256, 4, 12) edges of each loop in order.
        loop_faces: (256, 4, 12) the face of the step from each edge to the next.
    """

    n_triangles: NDArray[np.int64]
    triangles: NDArray[np.int64]
    n_loops: NDArray[np.int64]
    loop_length: NDArray[np.int64]
    loop_edges: NDArray[np.int64]
    loop_faces: NDArray[np.int64]


@cache
def tables() -> Tables:
    """The tables, made once."""
    by_pattern = [[t for loop in loops(p) for t in triangles(loop)] for p in range(256)]
    count = np.array([len(found) for found in by_pattern])
    result = Tables(
        count,
        np.zeros((256, count.max(), 3), dtype=np.int64),
        np.array([len(loops(p)) for p in range(256)]),
        *(np.zeros(shape, dtype=np.int64) for shape in ((256, 4), (256, 4, 12), (256, 4, 12))),
    )
    for pattern, found in enumerate(by_pattern):
        result.triangles[pattern, : len(found)] = np.reshape(found, (-1, 3))
        for i, loop in enumerate(loops(pattern)):
            n = len(loop.edges)
            result.loop_length[pattern, i] = n
            result.loop_edges[pattern, i, :n] = loop.edges
            result.loop_faces[pattern, i, :n] = loop.faces
    return result


@cache
def face_cycles() -> list[tuple[list[int], list[int]]]:
    """Corners and edges of each face, counter-clockwise as seen from outside the cube."""
    edge_of = {frozenset(ends): edge for edge, ends in enumerate(EDGE_ENDS.T.tolist())}
    cycles = []
    for axis, side in zip(FACE_AXIS, FACE_SIDE, strict=True):
        b, c = (axis + 1) % 3, (axis + 2) % 3
        square = [(0, 0), (1, 0), (1, 1), (0, 1)]
        corners = []
        for at_b, at_c in square if side else square[::-1]:
            place = [0, 0, 0]
            place[axis], place[b], place[c] = side, at_b, at_c
            corners.append(int(np.dot(place, [4, 2, 1])))
        edges = [edge_of[frozenset((corners[i], corners[(i + 1) % 4]))] for i in range(4)]
        cycles.append((corners, edges))
    return cycles


def _share_a_face(first: int, second: int) -> bool:
    return any(first in edges and second in edges for _, edges in face_cycles())
