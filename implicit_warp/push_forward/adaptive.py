"""Dividing a mesh until its flat faces follow the image of the surface, for any map.

Faces are divided at the midpoints of edges, by the longest-edge rule (Rivara 1984): a face that is
divided at all is divided at its longest edge first.  That bounds how thin faces can get, and fits
neighbours together: an edge is divided for all its faces or for none.  What lies where is decided
at rest; the midpoint's image is the map of the midpoint at rest.

Edges are told apart by the *positions* of their ends, so that vertices that coincide without being
shared, as along a seam of a texture, go on coinciding.

Guarantee: when it ends, every edge's midpoint and every face's centroid has its image within the
tolerance of the flat edge or face; with `until_clean`, the exact test finds no self-intersection.
Non-guarantee: between those samples the image may be farther off, and without `until_clean` faces
may intersect.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking import analyse, self_intersections
from implicit_warp.errors import InputError
from implicit_warp.maps import Map
from implicit_warp.mesh_files import merge_equal_vertices
from implicit_warp.push_forward.lineage import Lineage

RELATIVE_TOLERANCE = 1e-3
"""Default tolerance, as a part of the image's diagonal."""

_MOST_FACES = 20_000_000
_CLEANING_ROUNDS = 8
_SHARPER = 0.25  # times the tolerance, for faces found intersecting

Indices = NDArray[np.int64]


@dataclass(eq=False)
class Subdivision:
    """A mesh and its image while it is divided.

    Attributes:
        rest, images: (V, 3) vertices and their images.
        places: (V,) equal for vertices at the same place.
        faces: (F, 3).
        sources: (F,) the given face that each is a part of.
        tolerances: (F,) what is asked of each face.
        unproven: (F,) is the face still to be looked at?
        lineage: where the vertices come from.
        largest_error: the largest error of a face that was accepted.
        rounds: how often faces were divided.
    """

    rest: NDArray[np.float64]
    images: NDArray[np.float64]
    places: Indices
    faces: Indices
    sources: Indices
    tolerances: NDArray[np.float64]
    unproven: NDArray[np.bool_]
    lineage: Lineage
    largest_error: float = 0.0
    rounds: int = 0

    @property
    def next_place(self) -> int:
        """A number above all places."""
        return int(self.places.max(initial=-1)) + 1


def divide_and_push(
    points: NDArray[np.float64],
    faces: Indices,
    map_: Map,
    tolerance: float | None,
    *,
    until_clean: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Subdivision, float]:
    """Divide until all samples are within the tolerance; and until nothing intersects, if asked.

    Args:
        points: (V, 3).
        faces: (F, 3), with three distinct corners each.
        map_: any map.
        tolerance: distance in the units of the image; `RELATIVE_TOLERANCE` if None.
        until_clean: go on dividing faces that intersect others.
        progress: called with the faces that meet their tolerance and all faces.

    Returns:
        The result, and the tolerance used.

    Raises:
        InputError: the tolerance is not positive or so small that faces become too many;
            `until_clean` and the given mesh intersects itself, or rounds run out.
    """
    images = map_(points)
    if tolerance is None:
        used = images[faces].reshape(-1, 3)
        diagonal = float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0
        tolerance = RELATIVE_TOLERANCE * diagonal or 1.0  # a single point is flat enough
    if until_clean:
        _refuse_unclean(points, faces)
    state = Subdivision(
        points,
        images,
        _places(points),
        faces,
        np.arange(len(faces)),
        np.full(len(faces), tolerance),
        np.ones(len(faces), dtype=bool),
        Lineage(len(points), np.empty((0, 2), np.int64), np.empty(0)),
    )
    _divide_until_flat(state, map_, progress)
    if until_clean:
        _divide_until_clean(state, map_, progress)
    return state, tolerance


def _refuse_unclean(points: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    """Raise if no division can make the image clean, because the mesh is not."""
    for bad, what in (
        (_faces_in_contact(points, faces), "intersect already, and so will their images"),
        (analyse(points, faces).zero_area_faces, "have no area, and their parts will overlap"),
    ):
        if len(bad):
            raise InputError(
                "until_clean",
                True,
                f"{len(bad)} faces of the given mesh {what}",
                "repair it first, or leave until_clean out",
            )


class _Edges:
    """The edges of a mesh, one for all sides between the same two places.

    Attributes:
        of_sides: (F, 3) the edge of each face's side from corner k to corner k + 1.
        ends: (E, 2) the vertices at the ends of one side along each edge.
    """

    def __init__(self, state: Subdivision) -> None:
        sides = np.stack([state.faces, np.roll(state.faces, -1, 1)], -1).reshape(-1, 2)
        keys = np.sort(state.places[sides], axis=1) @ [state.next_place, 1]
        _, first, of_sides = np.unique(keys, return_index=True, return_inverse=True)
        self.of_sides = of_sides.reshape(-1, 3)
        self.ends = sides[first]

    def longest_side(self, state: Subdivision) -> Indices:
        """(F,) the number of each face's longest side, as its image is."""
        lengths = _distances(*state.images[self.ends.T])
        return np.argmax(lengths[self.of_sides], axis=1)


def _divide_until_flat(state: Subdivision, map_: Map, progress) -> None:
    while state.unproven.any():
        edges = _Edges(state)
        marked = _judge(state, map_, edges)
        if progress is not None:
            progress(int((~state.unproven).sum()), len(state.faces))
        if marked.any():
            _divide(state, map_, edges, marked)


def _divide_until_clean(state: Subdivision, map_: Map, progress) -> None:
    rounds = 0
    while len(touching := _faces_in_contact(state.images, state.faces)):
        if rounds == _CLEANING_ROUNDS:
            raise InputError(
                "until_clean",
                True,
                f"after {rounds} rounds {len(touching)} faces still intersect others",
                'use method="exact" if the map allows it, or a mesh with wider gaps',
            )
        rounds += 1
        state.tolerances[touching] *= _SHARPER
        # Divide them in any case: samples may happen to be right as they are.
        edges = _Edges(state)
        marked = np.zeros(len(edges.ends), dtype=bool)
        marked[edges.of_sides[touching]] = True
        _divide(state, map_, edges, marked)
        _divide_until_flat(state, map_, progress)


def _judge(state: Subdivision, map_: Map, edges: _Edges) -> NDArray[np.bool_]:
    """Settle the unproven faces that are flat enough; mark edges (E,) so that the others divide.

    A face fails where an edge's midpoint or its own centroid is farther off than its tolerance.
    """
    asked = np.flatnonzero(state.unproven)
    sides, tolerances = edges.of_sides[asked], state.tolerances[asked]
    wanted = np.unique(sides)
    ends = edges.ends[wanted]
    off = np.zeros(len(edges.ends))
    off[wanted] = _distances(map_(_middle(state.rest, ends)), _middle(state.images, ends))
    corners = state.faces[asked]
    off_centre = _distances(
        map_(state.rest[corners].mean(axis=1)), state.images[corners].mean(axis=1)
    )
    bent = off[sides] > tolerances[:, None]
    bulging = off_centre > tolerances
    failed = bent.any(axis=1) | bulging
    worst = np.maximum(off[sides].max(axis=1), off_centre)[~failed]
    state.largest_error = max(state.largest_error, float(worst.max(initial=0.0)))
    state.unproven[asked] = failed
    marked = np.zeros(len(edges.ends), dtype=bool)
    marked[sides[bent]] = True
    longest = edges.longest_side(state)[asked]
    marked[sides[bulging, longest[bulging]]] = True
    return marked


def _divide(state: Subdivision, map_: Map, edges: _Edges, marked: NDArray[np.bool_]) -> None:
    """Divide the marked edges (E,), and with them the longest side of every face they bound."""
    longest = edges.longest_side(state)
    while True:
        divided = marked[edges.of_sides].any(axis=1)
        wanted = edges.of_sides[divided, longest[divided]]
        if marked[wanted].all():
            break
        marked[wanted] = True

    split = marked[edges.of_sides]
    if len(state.faces) + split.sum() > _MOST_FACES:
        raise InputError(
            "tolerance",
            float(state.tolerances.min()),
            f"more than {_MOST_FACES} faces would be needed",
            "allow a larger tolerance",
        )
    middles = _make_midpoints(state, map_, edges, marked)
    turn = (longest[divided, None] + np.arange(3)) % 3
    rows = np.flatnonzero(divided)[:, None]
    # From here on side 0, from a to b, is the longest, and c the corner across.
    a, b, c = state.faces[rows, turn].T
    on_ab, on_bc, on_ca = middles[rows, turn].T
    two, three = on_bc >= 0, on_ca >= 0
    parts = [
        (np.ones_like(two), (a, on_ab, np.where(three, on_ca, c))),
        (three, (on_ab, c, on_ca)),
        (np.ones_like(two), (on_ab, b, np.where(two, on_bc, c))),
        (two, (on_ab, on_bc, c)),
    ]
    faces = np.concatenate([np.stack(corners, -1)[there] for there, corners in parts])
    parents = np.concatenate([rows[there, 0] for there, _ in parts])
    kept = ~divided
    state.faces = np.concatenate([state.faces[kept], faces])
    state.sources = np.concatenate([state.sources[kept], state.sources[parents]])
    state.tolerances = np.concatenate([state.tolerances[kept], state.tolerances[parents]])
    state.unproven = np.concatenate([state.unproven[kept], np.ones(len(parents), dtype=bool)])
    state.rounds += 1


def _make_midpoints(
    state: Subdivision, map_: Map, edges: _Edges, marked: NDArray[np.bool_]
) -> Indices:
    """Add the midpoints of the marked edges; (F, 3) the one of each side, -1 where there is none.

    Vertices that coincide without being shared get midpoints that do.
    """
    count = len(state.rest)
    sides = np.stack([state.faces, np.roll(state.faces, -1, 1)], -1)
    split = marked[edges.of_sides]
    keys = np.sort(sides[split], axis=1) @ [count, 1]
    _, first, of_sides = np.unique(keys, return_index=True, return_inverse=True)
    ends = sides[split][first]
    middles = np.full(split.shape, -1)
    middles[split] = count + of_sides
    rest = _middle(state.rest, ends)
    state.rest = np.concatenate([state.rest, rest])
    state.images = np.concatenate([state.images, map_(rest)])
    state.places = np.concatenate([state.places, state.next_place + edges.of_sides[split][first]])
    state.lineage = Lineage(
        state.lineage.n_given,
        np.concatenate([state.lineage.parents, ends]),
        np.concatenate([state.lineage.fractions, np.full(len(ends), 0.5)]),
    )
    return middles


def _middle(points: NDArray[np.float64], ends: Indices) -> NDArray[np.float64]:
    return 0.5 * (points[ends[:, 0]] + points[ends[:, 1]])


def _distances(p: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.norm(p - q, axis=1)


def _places(points: NDArray[np.float64]) -> Indices:
    """(V,) the same number for vertices at the same place."""
    return merge_equal_vertices(points, np.arange(len(points)))[1]


def _faces_in_contact(points: NDArray[np.float64], faces: Indices) -> Indices:
    """Faces that intersect another; coinciding vertices count as one."""
    found = self_intersections(*merge_equal_vertices(points, faces))
    return np.unique(found.pairs)
