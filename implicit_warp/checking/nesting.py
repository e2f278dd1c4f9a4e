"""Which components lie inside which others, and whether they face the right way there.

A closed surface that lies inside an even number of others bounds matter from outside, so its
volume must be positive; inside an odd number it bounds a cavity, so it must be negative. A
component that is negative where it should be positive is *inside out*; one that is positive where
it should be negative is *misnested*: a solid inside a solid, whose matter would count twice.

Containment is decided exactly: a half-line from a vertex of the component crosses the other
surface an odd number of times if it is inside. The half-line runs along z and is moved aside by
(e, e^2, 0) for an e smaller than any number (simulation of simplicity, Edelsbrunner and Muecke
1990), so that it never meets an edge or a corner. Signs come from the float filter, and from
integers where it is unsure.

Non-guarantee: a component that is open, has coordinates that are not finite, encloses no volume,
or intersects another component is neither inside nor outside; it is left undecided. So is what
lies in the box round all such components but the last sort: it may be inside one with a hole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.checking import exact
from implicit_warp.checking.box_tree import BoxTree, faces_over
from implicit_warp.checking.predicates import finite_or_zero, orient2d, orient3d, unit_scaled
from implicit_warp.checking.self_intersection import SelfIntersections
from implicit_warp.checking.topology import Indices, Topology

UNDECIDED = -1

_MISSED, _CROSSED, _UNSURE = range(3)


@dataclass(frozen=True, eq=False)
class Nesting:
    """How the components of one mesh lie in each other; components are those of `Topology`.

    Attributes:
        depth: `(C,)` the number of components that each one lies inside; `UNDECIDED` (-1) where
            that has no answer.
        inside_out_components: outer surfaces (even depth) with negative volume.
        misnested_components: surfaces inside an odd number of others with positive volume.
    """

    depth: Indices
    inside_out_components: Indices
    misnested_components: Indices


def nesting(
    vertices: NDArray[np.float64],
    faces: Indices,
    topology: Topology,
    intersections: SelfIntersections,
) -> Nesting:
    """How the components of a mesh lie in each other, from what is known of it already."""
    signs = topology.component_signs
    depth = np.full(len(signs), UNDECIDED, dtype=np.int64)
    closed = signs != 0
    decidable = closed.copy()
    if intersections.complete:
        sides = topology.component_of_face[intersections.pairs]
        decidable[np.setdiff1d(sides[sides[:, 0] != sides[:, 1]], [-1])] = False
    else:
        decidable[:] = False
    inner = np.flatnonzero(decidable)
    if len(inner):
        labels = topology.component_of_face
        # Labels start at 0, or at -1 where faces were left out: so count from the last.
        first_faces = np.unique(labels, return_index=True)[1][inner - len(signs)]
        starts = faces[first_faces, 0]
        known = ~_in_box_of(vertices, faces[(labels < 0) | ~closed[labels]], starts)
        inner, starts = inner[known], starts[known]
        depth[inner] = _depths(vertices, faces, labels, inner, starts, closed)
    return Nesting(
        depth=depth,
        inside_out_components=np.flatnonzero((depth >= 0) & (depth % 2 == 0) & (signs < 0)),
        misnested_components=np.flatnonzero((depth >= 0) & (depth % 2 == 1) & (signs > 0)),
    )


def _depths(
    vertices: NDArray[np.float64],
    faces: Indices,
    component_of_face: Indices,
    inner: Indices,
    starts: Indices,
    closed: NDArray[np.bool_],
) -> Indices:
    """For each component of `inner` `(n,)`, the number of closed ones that it lies inside.

    `starts` `(n,)` is a vertex of each.
    """
    if np.count_nonzero(closed) < 2:
        return np.zeros(len(inner), dtype=np.int64)
    kept = np.flatnonzero((component_of_face >= 0) & closed[component_of_face])
    scaled, _ = unit_scaled(finite_or_zero(vertices, np.isfinite(vertices).all(axis=1)))
    tree = BoxTree.of(scaled, faces, kept)
    hits = faces_over(tree.nodes, tree.low, tree.high, scaled[starts])
    point, face = hits[:, 0], tree.faces[hits[:, 1]]
    foreign = component_of_face[face] != inner[point]
    point, face = point[foreign], face[foreign]
    verdicts = _crossings(scaled, faces, starts[point], face)
    unsure = np.flatnonzero(verdicts == _UNSURE)
    if len(unsure):
        verdicts[unsure] = _crossings_exactly(vertices, starts[point[unsure]], faces[face[unsure]])
    crossed = verdicts == _CROSSED
    pairs, counts = np.unique(
        np.column_stack([point[crossed], component_of_face[face[crossed]]]),
        axis=0,
        return_counts=True,
    )
    return np.bincount(pairs[counts % 2 == 1, 0], minlength=len(inner))


def _in_box_of(vertices: NDArray[np.float64], faces: Indices, points: Indices) -> NDArray[np.bool_]:
    """Which vertices `(n,)` lie in the box round the finite vertices of some faces."""
    used = vertices[np.unique(faces)]
    used = used[np.isfinite(used).all(axis=1)]
    if not len(used):
        return np.zeros(len(points), dtype=bool)
    places = vertices[points]
    return ((places >= used.min(axis=0)) & (places <= used.max(axis=0))).all(axis=1)


@kernel
def _crossings(v, faces, starts, hit_faces):
    """Whether the half-line up from vertex `starts[i]` crosses face `hit_faces[i]`, `(n,)`."""
    verdicts = np.empty(len(starts), np.int8)
    for i in range(len(starts)):
        p = starts[i]
        a, b, c = faces[hit_faces[i], 0], faces[hit_faces[i], 1], faces[hit_faces[i], 2]
        ab = orient2d(v, a, b, p, 0, 1)
        bc = orient2d(v, b, c, p, 0, 1)
        ca = orient2d(v, c, a, p, 0, 1)
        if min(ab, bc, ca) < 0 and max(ab, bc, ca) > 0:
            verdicts[i] = _MISSED
            continue
        above = orient3d(v, a, b, c, p) * ab
        if ab == 0 or bc == 0 or ca == 0 or above == 0:
            verdicts[i] = _UNSURE
        else:
            verdicts[i] = _CROSSED if above > 0 else _MISSED
    return verdicts


def _crossings_exactly(
    vertices: NDArray[np.float64], starts: Indices, triangles: Indices
) -> list[int]:
    """The same by integers, from the coordinates as given."""
    used, indices = np.unique(np.column_stack([starts, triangles]), return_inverse=True)
    points = exact.integer_points(vertices[used])
    verdicts = []
    for row in indices.reshape(-1, 4).tolist():
        p, a, b, c = (points[i] for i in row)
        turns = {_turn_beside(s, e, p) for s, e in ((a, b), (b, c), (c, a))}
        # A face that is vertical is met by no half-line beside its plane.
        inside = len(turns) == 1 and exact.orient2d(a, b, c, axis=2) != 0
        above = inside and exact.orient3d(a, b, c, p) * turns.pop() > 0
        verdicts.append(_CROSSED if above else _MISSED)
    return verdicts


def _turn_beside(s: exact.Point, e: exact.Point, p: exact.Point) -> int:
    """Turn s -> e -> p seen from above, with p moved by (e, e^2); 0 only if s and e coincide."""
    return exact.orient2d(s, e, p, axis=2) or exact.sign(s[1] - e[1]) or exact.sign(e[0] - s[0])
