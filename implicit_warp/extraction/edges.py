"""The search for edges of a shape, in all rounds of which what was found stays known.

Some of what is found has to be taken back again (`sharp`), a little at a time and somewhere else
each time.  So every point is looked for once, and keeps its number from one round to the next:
rounds after the first one cost little more than what differs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.doubled import Doubled, doubled_edges, traced
from implicit_warp.extraction.hubs import hubs_of
from implicit_warp.extraction.names import Names
from implicit_warp.extraction.piercing import Segments, piercing_points, sharp_segments
from implicit_warp.extraction.rings import Rings, rings_of, with_points
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import units

_DOUBLINGS = 4
"""How often a round looks for more lattice edges that are crossed twice."""


class Edges(NamedTuple):
    """Rings of cells with all points on edges of the shape.

    Attributes:
        corners: (n + m, 3) the crossed cells, and those that only doubled lattice edges cross.
        rings: of the cells at edges; points by their numbers in the finder.
    """

    corners: NDArray[np.int64]
    rings: Rings


class EdgeFinder:
    """Finds points on edges of a shape, and remembers them.

    Attributes:
        points: (p, 3) crossings of lattice edges, the surface's own first, and piercing points.
        normals: (p, 3) unit, at crossings; zero at piercing points.
        doubled: (p,) the number of the doubled lattice edge that a point is a crossing of, else -1.
        piercing: (p,) whether it is a piercing point.
    """

    def __init__(
        self,
        surface: Surface,
        corners: NDArray[np.int64],
        vertices: NDArray[np.float64],
        normals: NDArray[np.float64],
        cells: NDArray[np.int64],
        sampler: Sampler,
    ) -> None:
        """Args:
        surface: of the crossed cells.
        corners: (n, 3) their low corners.
        vertices: (v, 3) the surface's crossings.
        normals: (v, 3) unit, there.
        cells: those at edges, as far as the crossings show.
        sampler: of the field.
        """
        self.points, self.normals = vertices, normals
        self.doubled = np.full(len(vertices), -1)
        self.piercing = np.zeros(len(vertices), np.bool_)
        self._surface, self._corners, self._sampler = surface, corners, sampler
        self._places, self._plain = Names(corners), rings_of(surface, cells)
        self._edges, self._first_of_edge = Doubled.none(), np.empty(0, np.int64)
        self._segments, self._point_of = Names(), np.empty(0, np.int64)  # -1: none

    def edges(self, refused: NDArray[np.int64], no_doubling: bool) -> Edges:
        """All edges, but no doubled lattice edges around the cells with low corners (r, 3)."""
        for attempt in range(_DOUBLINGS + 1):
            corners, rings = self._corners, self._plain
            if len(self._edges.low) and not no_doubling:
                numbered = (self._edges, self._first_of_edge, self.normals)
                corners, around = traced(self._surface, corners, self._places, *numbered, refused)
                rings = rings.where(~np.isin(rings.cells, around.cells)).joined(around)
            segments = sharp_segments(rings, corners, self.normals)
            last = no_doubling or attempt == _DOUBLINGS
            points, more = self._looked_up(segments, look_for_doubled=not last)
            if not more:
                break
        kept = points >= 0
        rings = with_points(rings, segments.row[kept], segments.step[kept], points[kept])
        return Edges(corners, rings)

    def chains(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """(m, 3) the cells around all doubled edges that hang together with some at cells (n, 3).

        Doubled edges hang together where they share a cell.
        """
        around, cell = np.unique(self._edges.cells().reshape(-1, 3), axis=0, return_inverse=True)
        edge = np.repeat(np.arange(len(self._edges.low)), 4)
        count = len(self._edges.low) + len(around)
        links = (np.ones(len(edge)), (edge, len(self._edges.low) + cell.reshape(-1)))
        _, part = connected_components(coo_array(links, shape=(count, count)), directed=False)
        part = part[len(self._edges.low) :]
        return around[np.isin(part, part[Names(cells).of(around) >= 0])]

    def _looked_up(
        self, segments: Segments, look_for_doubled: bool
    ) -> tuple[NDArray[np.int64], bool]:
        """(s,) the piercing point of each segment or -1, and whether doubled edges turned up."""
        names = np.concatenate([np.sort(segments.ends, axis=1), segments.face], axis=1)
        place, more = self._segments.of(names), False
        fresh = place < 0
        if fresh.any():
            new = segments.where(fresh)
            _, first, number = np.unique(new.number, return_index=True, return_inverse=True)
            new = new._replace(number=number.reshape(-1))
            found = piercing_points(new, self.points, self.normals, self._sampler)
            point = np.where(found.found, len(self.points) + np.cumsum(found.found) - 1, -1)
            place[fresh] = self._segments.enter(names[fresh][first])[new.number]
            self._point_of = np.concatenate([self._point_of, point])
            added = found.points[found.found]
            self._append(added, np.zeros_like(added), np.full(len(added), -1))
            if look_for_doubled:
                more = self._double(doubled_edges(found, self._sampler))
        return self._point_of[place], more

    def _double(self, found: Doubled) -> bool:
        """Enter doubled edges; returns whether any is new."""
        before = len(self._edges.low)
        self._edges = self._edges.joined(found)
        new = self._edges.where(np.arange(len(self._edges.low)) >= before)
        crossings = new.crossings()
        edge = before + np.arange(len(new.low))
        first = len(self.points) + 2 * np.arange(len(new.low))
        self._first_of_edge = np.concatenate([self._first_of_edge, first])
        slopes = units(self._sampler.value_and_gradient(crossings)[1])
        self._append(crossings, slopes, np.repeat(edge, 2))
        return len(new.low) > 0

    def _append(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        doubled: NDArray[np.int64],
    ) -> None:
        self.points = np.concatenate([self.points, points])
        self.normals = np.concatenate([self.normals, normals])
        self.doubled = np.concatenate([self.doubled, doubled])
        self.piercing = np.concatenate([self.piercing, doubled < 0])


class HubFinder:
    """Finds the hubs of rings, and remembers them.

    Attributes:
        points: (h, 3) the hubs.
        on_edge: (h,) whether each is on an edge or corner of the shape.
        left: (h,) whether it has left its cell.
        corners: (h, 3) low corner of its cell.
    """

    def __init__(self, finder: EdgeFinder, sampler: Sampler) -> None:
        self._finder, self._sampler = finder, sampler
        self._rings = Names()
        self.points, self.corners = np.empty((0, 3)), np.empty((0, 3), np.int64)
        self.on_edge, self.left = np.empty(0, np.bool_), np.empty(0, np.bool_)

    def of(self, edges: Edges, may_leave: NDArray[np.bool_]) -> NDArray[np.int64]:
        """(c,) the numbers of the rings' hubs, the same for the same ring.

        Args:
            edges: c rings.
            may_leave: (c,) whether the hub may lie outside of its cell, at a corner or tip.
        """
        rings, low = edges.rings, edges.corners[edges.rings.cells]
        content = np.concatenate([low, may_leave[:, None], rings.points], axis=1)
        place = self._rings.of(content)
        fresh = place < 0
        if fresh.any():
            place[fresh] = self._rings.enter(content[fresh])
            hubs = hubs_of(
                rings.where(fresh),
                self._finder.points,
                self._finder.normals,
                self._finder.piercing,
                low[fresh],
                may_leave[fresh],
                self._sampler,
            )
            self.points = np.concatenate([self.points, hubs[0]])
            self.on_edge = np.concatenate([self.on_edge, hubs[1]])
            self.left = np.concatenate([self.left, hubs[2]])
            self.corners = np.concatenate([self.corners, low[fresh]])
        return place
