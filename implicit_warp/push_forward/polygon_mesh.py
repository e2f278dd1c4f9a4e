"""A mesh of convex planar polygons that can be cut: the state of an exact push-forward.

A polygon is a loop of corners; a corner names a vertex and the edge to the next corner's vertex.
Polygons share edges, so an edge that is cut is cut for all of them at once, and what was
watertight stays so.  A vertex made by a cut remembers the two ends of its edge and where it lies
between them, so rest positions and attributes need not be carried along: they are worked out from
those of the given vertices, once, at the end (`Lineage`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.errors import InputError
from implicit_warp.push_forward.lineage import Lineage

_GROWTH = 1.5
"""Factor by which arrays grow: little is copied, little is wasted."""


class PolygonMesh:
    """Triangles to begin with, convex polygons later; arrays with room to grow.

    Only the first `n_...` rows of an array are in use.

    Attributes:
        points: (V, 3) float64 vertex positions, in whatever coordinates the owner works.
        parents, fractions: (V, 2) int32 and (V,) float64 as in `Lineage`, for vertices made by
            cuts; undefined for the given ones.
        codes: (V,) int32 scratch of the cutting passes.
        edges: (E, 2) int32 the ends of every edge.
        slots: (E,) int32 scratch of the cutting passes.
        corner_vertices, corner_edges: (H,) int32; loops lie here, with gaps where polygons were
            replaced, until `compact`.
        starts, lengths: (P,) int32 where each polygon's loop lies.
        sources: (P,) int32 the given triangle that each polygon is a part of.
        pieces: (P,) int32 scratch of the cutting passes.
        n_given: number of vertices that were given.
    """

    def __init__(self, points: NDArray[np.float64], triangles: NDArray[np.int64]) -> None:
        """From points (V, 3) and triangles (F, 3) whose corners are distinct."""
        count = len(triangles)
        ends = np.stack([triangles, np.roll(triangles, -1, 1)], -1).reshape(-1, 2)
        ends.sort(axis=1)
        keys = ends[:, 0] * np.int64(max(len(points), 1)) + ends[:, 1]
        _, first, edge_of_corner = np.unique(keys, return_index=True, return_inverse=True)
        self.n_given = self.n_vertices = len(points)
        self.n_edges, self.n_corners, self.n_polygons = len(first), 3 * count, count
        self.points = np.array(points, dtype=np.float64)
        self.parents = np.empty((len(points), 2), np.int32)
        self.fractions = np.empty(len(points))
        self.codes = np.empty(len(points), np.int32)
        self.edges = ends[first].astype(np.int32)
        self.slots = np.empty(len(first), np.int32)
        self.corner_vertices = triangles.reshape(-1).astype(np.int32)
        self.corner_edges = edge_of_corner.astype(np.int32)
        self.starts = 3 * np.arange(count, dtype=np.int32)
        self.lengths = np.full(count, 3, np.int32)
        self.sources = np.arange(count, dtype=np.int32)
        self.pieces = np.empty(count, np.int32)

    _OF_VERTICES = ("points", "parents", "fractions", "codes")
    _OF_EDGES = ("edges", "slots")
    _OF_CORNERS = ("corner_vertices", "corner_edges")
    _OF_POLYGONS = ("starts", "lengths", "sources", "pieces")

    def make_room(self, vertices: int, edges: int, corners: int, polygons: int) -> None:
        """Let the arrays hold so many rows at least."""
        for names, needed in (
            (self._OF_VERTICES, vertices),
            (self._OF_EDGES, edges),
            (self._OF_CORNERS, corners),
            (self._OF_POLYGONS, polygons),
        ):
            if needed > np.iinfo(np.int32).max:
                raise InputError(
                    "mesh",
                    f"{self.n_given} vertices",
                    f"its image has {needed} corners or more, beyond 32-bit indices",
                    "deform it in parts, simplify it, or use a map of fewer layers",
                )
            for name in names:
                array = getattr(self, name)
                if len(array) < needed:
                    wider = np.empty((int(_GROWTH * needed), *array.shape[1:]), array.dtype)
                    wider[: len(array)] = array
                    setattr(self, name, wider)

    def compact(self) -> None:
        """Close the gaps between loops, and bring them into the order of the polygons again."""
        live = int(self.lengths[: self.n_polygons].sum())
        vertices, edges = np.empty(live, np.int32), np.empty(live, np.int32)
        _pack(
            self.corner_vertices, self.corner_edges, self.starts, self.lengths, self.n_polygons,
            vertices, edges,
        )  # fmt: skip
        self.corner_vertices, self.corner_edges, self.n_corners = vertices, edges, live

    @property
    def lineage(self) -> Lineage:
        """Where every vertex comes from."""
        made = slice(self.n_given, self.n_vertices)
        return Lineage(self.n_given, self.parents[made], self.fractions[made])


@kernel
def _pack(corner_vertices, corner_edges, starts, lengths, count, vertices, edges):
    at = 0
    for p in range(count):
        begin = starts[p]
        starts[p] = at
        for k in range(begin, begin + lengths[p]):
            vertices[at] = corner_vertices[k]
            edges[at] = corner_edges[k]
            at += 1
