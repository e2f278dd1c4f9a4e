"""Removing the contacts that the rounding of coordinates makes.

The exact image has pieces of all sizes: where a crease passes a vertex of the mesh at a distance of
1e-9, it cuts off a piece of that size.  In float64 that is far above rounding.  In the float32 of
an STL file such pieces collapse, or turn over and cut their neighbours.  Here coordinates are
rounded first, and then, as long as the exact test finds contacts or faces of no area, the shortest
edges of the faces concerned are collapsed.

An edge is collapsed only if that keeps the surface's topology (the link condition: the ends have no
common neighbour but the apexes of the edge's faces) and turns no other face over.  The ends may be
some units of rounding apart, more of them from round to round (`_REACHES`).  What cannot be removed
that way is left, and counted.

Nothing moves beyond that: away from contacts the mesh is the rounded image, vertex by vertex.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking import self_intersections
from implicit_warp.mesh_files import merge_equal_vertices

_REACHES = (16.0, 16.0, 16.0, 64.0, 64.0, 256.0, 256.0, 1024.0, 1024.0)
"""How many units of rounding long an edge may be that is collapsed, from round to round."""

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Settled:
    """A mesh with rounded coordinates.

    Attributes:
        points: (V, 3) float64 that hold values of the precision asked for; all vertices given.
        faces: (F, 3).
        kept_faces: (F,) which of the given faces they are.
        kept_vertices: the given vertices that were not merged into another.
        collapsed: number of edges collapsed.
        contacts: pairs of faces that still intersect, and faces of no area.
    """

    points: NDArray[np.float64]
    faces: Indices
    kept_faces: Indices
    kept_vertices: Indices
    collapsed: int
    contacts: int


def settle(
    points: NDArray[np.float64], rest: NDArray[np.float64], faces: Indices, precision: str
) -> Settled:
    """Round coordinates, and collapse short edges until no contact is left.

    Args:
        points: (V, 3) vertices of the image.
        rest: (V, 3) where they come from.
        faces: (F, 3) with distinct corners.
        precision: "float32" or "float64".
    """
    state = _Collapsing(points, rest, faces, np.dtype(precision))
    concerned, contacts = state.find_contacts()
    for reach in _REACHES:
        if not contacts:
            break
        if state.collapse_at(concerned, reach):
            concerned, contacts = state.find_contacts()
    return Settled(
        points=state.positions[state.place_of_vertex],
        faces=state.faces[state.alive],
        kept_faces=np.flatnonzero(state.alive),
        kept_vertices=np.flatnonzero(~state.merged),
        collapsed=state.collapsed,
        contacts=contacts,
    )


class _Collapsing:
    """The mesh while edges are collapsed.

    Topology is that of *places*: vertices that coincide both at rest and as images, as along seams
    of a texture, are one place and move together.
    """

    def __init__(
        self,
        points: NDArray[np.float64],
        rest: NDArray[np.float64],
        faces: Indices,
        precision: np.dtype,
    ) -> None:
        rows = np.arange(len(points))
        at_image, at_rest = (merge_equal_vertices(p, rows)[1] for p in (points, rest))
        _, first, self.place_of_vertex = np.unique(
            at_image * np.int64(len(points)) + at_rest, return_index=True, return_inverse=True
        )
        self.positions = points[first].astype(precision).astype(np.float64)
        self.unit = float(np.finfo(precision).eps) * float(np.abs(self.positions).max(initial=0.0))
        self.faces = faces.copy()
        self.alive = np.ones(len(faces), dtype=bool)
        self.merged = np.zeros(len(points), dtype=bool)
        self.collapsed = 0

    def find_contacts(self) -> tuple[Indices, int]:
        """Faces in contact with others or of no area, and the number of such pairs and faces."""
        alive = np.flatnonzero(self.alive)
        triangles = self.place_of_vertex[self.faces[alive]]
        found = self_intersections(self.positions, triangles)
        a, b, c = (self.positions[triangles[:, k]] for k in range(3))
        flat = np.flatnonzero(~np.cross(b - a, c - a).any(axis=1))
        return alive[np.union1d(found.pairs, flat)], len(found) + len(flat)

    def collapse_at(self, concerned: Indices, reach: float) -> int:
        """Collapse the shortest edge of each face, where allowed; how many were."""
        self._index_faces()
        triangles = self.place_of_vertex[self.faces[concerned]]
        sides = np.stack([triangles, np.roll(triangles, -1, 1)], -1)
        ends = self.positions[sides]
        lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=-1)
        shortest = np.argmin(lengths, axis=1)
        rows = np.arange(len(concerned))
        lengths, sides = lengths[rows, shortest], sides[rows, shortest]
        before = self.collapsed
        for i in np.argsort(lengths, kind="stable"):
            if lengths[i] > reach * self.unit:
                break
            a, b = (int(p) for p in sides[i])
            if not self._collapse(a, b):
                self._collapse(b, a)
        return self.collapsed - before

    def _index_faces(self) -> None:
        alive = np.flatnonzero(self.alive)
        corners = self.place_of_vertex[self.faces[alive]].ravel()
        order = np.argsort(corners, kind="stable")
        self._bounds = np.searchsorted(corners[order], np.arange(len(self.positions) + 1))
        self._sorted_faces = alive[order // 3]
        self._around: dict[int, set[int]] = {}

    def _faces_at(self, place: int) -> set[int]:
        if place not in self._around:
            begin, end = self._bounds[place : place + 2]
            self._around[place] = set(self._sorted_faces[begin:end].tolist())
        return self._around[place]

    def _corners(self, face: int) -> list[int]:
        return self.place_of_vertex[self.faces[face]].tolist()

    def _neighbours(self, place: int) -> set[int]:
        return {p for f in self._faces_at(place) for p in self._corners(f)} - {place}

    def _collapse(self, gone: int, stays: int) -> bool:
        """Merge one place into another, if they share an edge and no harm is done."""
        around_gone, near_gone = self._faces_at(gone), self._neighbours(gone)
        near_stays = self._neighbours(stays)
        on_edge = around_gone & self._faces_at(stays)
        apexes = {p for f in on_edge for p in self._corners(f)} - {gone, stays}
        inside = all(len(self._faces_at(p) & around_gone) == 2 for p in near_gone)
        common, all_near = near_gone & near_stays, (near_gone | near_stays) - {gone, stays}
        if not on_edge or not inside or common != apexes or len(apexes) != 2 or len(all_near) < 3:
            return False
        others = around_gone - on_edge
        if self._turns_over(others, gone, stays):
            return False
        self._merge_vertices(gone, stays, on_edge, others)
        self.alive[list(on_edge)] = False
        self._around[stays] = (self._faces_at(stays) | others) - on_edge
        self._around[gone] = set()
        for p in apexes:
            self._around[p] = self._faces_at(p) - on_edge
        self.collapsed += 1
        return True

    def _turns_over(self, faces: set[int], gone: int, stays: int) -> bool:
        """Would a face that has an area now get one that faces the other way, or none?"""
        now = np.array([self._corners(f) for f in faces])
        then = np.where(now == gone, stays, now)
        before, after = (
            np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
            for p in (self.positions[now], self.positions[then])
        )
        return bool(((before * after).sum(1) <= 0.0)[before.any(axis=1)].any())

    def _merge_vertices(self, gone: int, stays: int, on_edge: set[int], others: set[int]) -> None:
        """Replace the vertices at a place: by those across the edge, where the surface knows one;
        the others, beyond a seam, only move."""
        partner = {}
        for f in on_edge:
            at = dict(zip(self._corners(f), self.faces[f].tolist(), strict=True))
            partner[at[gone]] = at[stays]
        for f in others:
            self.faces[f] = [partner.get(v, v) for v in self.faces[f].tolist()]
            self.place_of_vertex[[v for v in self.faces[f] if self.place_of_vertex[v] == gone]] = (
                stays
            )
        self.merged[list(partner)] = True
        self.place_of_vertex[list(partner)] = stays
