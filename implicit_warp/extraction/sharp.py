"""Edges and corners of the shape, where plain marching cubes cuts them off.

Where the surface has an edge, the normals at the two crossings of a face of a cell differ.  Then
the point where the edge pierces the face is found, as the common point of the two sides' tangent
lines in the face, and put between the two crossings; in the cell a point on the edge (or at the
corner where edges meet) becomes the hub of a fan over the cell's loop, which now has these points.
Each is found again from the sides' values and gradients close to it, so that curved sides do as
well as flat ones.  (The faces' points are the idea of cubical marching squares, Ho et al. 2005;
the hubs that of extended marching cubes, Kobbelt et al. 2001.)

An edge can pass between lattice points where their signs do not show it; `doubled` finds that.

The hub at a corner or a tip may lie outside of its cell, since those can come out of a cell's face
without crossing any lattice edge.

Guarantees: a face's point is made once for both of its cells, so the mesh stays watertight and
manifold.  A fan whose hub is strictly inside its cell and whose loop lies on the cell's faces does
not intersect itself and stays in the cell; no triangle of it is without area.  Where hubs have
left, the faces around are tested exactly, and hubs that make faces intersect are withdrawn.
Non-guarantees: cells with more than one loop stay as they are, and so do the faces between two
cells of which one is such a cell.  Edges of angles below `piercing.ANGLE` are left rounded off.
Two edges that pass through one face of a cell are not seen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking.self_intersection import self_intersections
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.edges import EdgeFinder, Edges, HubFinder
from implicit_warp.extraction.names import Names
from implicit_warp.extraction.piercing import sharp_cells
from implicit_warp.extraction.rings import Rings, rings_of
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import units

_ATTEMPTS = 12
"""How often hubs and doubled edges that make faces intersect are withdrawn, before all are."""

_PATIENCE = 1
"""Attempts after which chains of doubled edges are withdrawn as a whole: a chain that lost a part
can make faces intersect at its new ends, again and again."""


class Sharpened(NamedTuple):
    """A mesh with edges and corners.

    Attributes:
        vertices: (V, 3) in index coordinates; those of the plain mesh come first.
        faces: (F, 3) int64.
        on_edges: (K,) vertices on edges and corners of the shape.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    on_edges: NDArray[np.int64]


def sharpened(
    surface: Surface,
    corners: NDArray[np.int64],
    vertices: NDArray[np.float64],
    sampler: Sampler,
) -> Sharpened:
    """The mesh with points on the edges and corners of the shape.

    Args:
        surface: of the crossed cells.
        corners: (n, 3) low corners of the crossed cells.
        vertices: (V, 3) where its vertices are, in index coordinates.
        sampler: of the field.
    """
    normals = units(sampler.value_and_gradient(vertices)[1])
    sharp, tip = sharp_cells(surface, normals)
    finder = EdgeFinder(surface, corners, vertices, normals, np.flatnonzero(sharp), sampler)
    hubs = HubFinder(finder, sampler)
    refused = wrong = np.empty((0, 3), np.int64)
    before = np.empty(0, np.int64)
    for attempt in range(_ATTEMPTS):
        last = attempt == _ATTEMPTS - 1
        edges = finder.edges(refused, no_doubling=last)
        blank = tip.copy()
        blank[edges.rings.cells[edges.rings.cells < len(tip)]] = False
        tips = Edges(edges.corners, rings_of(surface, np.flatnonzero(blank)))
        of_edge = hubs.of(edges, _may_leave(edges, refused, last))
        of_tip = hubs.of(tips, _may_leave(tips, refused, last))
        tipped = hubs.on_edge[of_tip]
        rings, hub = (
            edges.rings.joined(tips.rings.where(tipped)),
            np.append(of_edge, of_tip[tipped]),
        )
        points = np.concatenate([finder.points, hubs.points[hub]])
        fans = _Fans(surface, rings, len(finder.points))
        if attempt:
            suspect = np.concatenate([hubs.corners[np.setxor1d(hub, before)], wrong])
        else:
            suspect = edges.corners[rings.cells[_several(rings.cells) | hubs.left[hub]]]
        before = hub
        found = [
            _intersecting_cells(
                sampler.lattice.origin + sampler.lattice.voxel * points,  # as they will be
                fans,
                edges.corners,
                suspect,
            ),
            _torn_cells(rings, finder.doubled),
        ]
        wrong = edges.corners[np.concatenate(found)]
        if not len(wrong):
            break
        refused = np.concatenate([refused, wrong])
        if attempt >= _PATIENCE:
            refused = np.concatenate([refused, finder.chains(_neighbourhoods(wrong, 1))])
    on_edge = np.append(finder.piercing, hubs.on_edge[hub])
    return _without_unused(points, fans.of_cells(np.ones(len(edges.corners), np.bool_))[0], on_edge)


def _may_leave(edges: Edges, refused: NDArray[np.int64], last: bool) -> NDArray[np.bool_]:
    """(c,) the rings whose hubs may lie outside of their cells."""
    return (Names(refused).of(edges.corners[edges.rings.cells]) < 0) & (not last)


def _neighbourhoods(cells: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    """(m, 3) the cells at most `reach` cells away from some (n, 3), some more than once."""
    steps = np.stack(np.meshgrid(*[np.arange(-reach, reach + 1)] * 3, indexing="ij"), axis=-1)
    return (cells[:, None] + steps.reshape(-1, 3)).reshape(-1, 3)


def _torn_cells(rings: Rings, doubled: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cells around doubled lattice edges whose crossings follow each other in more than two rings.

    The two are then joined on more than one face, by an edge that more than two faces of the mesh
    share.

    Args:
        rings: of the cells.
        doubled: (p,) the number of the doubled edge that a point is a crossing of, else -1.
    """
    place = np.arange(rings.points.shape[1])
    row, step = np.nonzero(place < rings.length[:, None])
    a = rings.points[row, step]
    b = rings.points[row, (step + 1) % rings.length[row]]
    edge = doubled[a]
    joined = (edge >= 0) & (edge == doubled[b]) & (a != b)
    times = np.bincount(edge[joined], minlength=1)
    return np.unique(rings.cells[row[joined][times[edge[joined]] > 2]])


def _several(cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which entries occur more than once."""
    _, number, count = np.unique(cells, return_inverse=True, return_counts=True)
    return count[number.reshape(-1)] > 1


def _without_unused(
    points: NDArray[np.float64], faces: NDArray[np.int64], on_edges: NDArray[np.bool_]
) -> Sharpened:
    """Points of rings that were withdrawn again are no vertices."""
    kept, faces, number = _compact(points, faces)
    return Sharpened(kept, faces, number[on_edges & (number >= 0)])


def _compact(
    points: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """The points that faces use, the faces by these, and the new numbers of all points or -1."""
    used = np.zeros(len(points), np.bool_)
    used[faces] = True
    number = np.where(used, np.cumsum(used) - 1, -1)
    return points[used], number[faces], number


class _Fans:
    """Faces: fans over the rings from their hubs, and those of all cells without rings."""

    def __init__(self, surface: Surface, rings: Rings, first_hub: int) -> None:
        self._surface, self._rings, self._first_hub = surface, rings, first_hub
        self._plain = np.ones(len(surface.patterns), np.bool_)
        self._plain[rings.cells[rings.cells < len(self._plain)]] = False

    def of_cells(self, chosen: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(f, 3) the faces of the chosen cells, and (f,) the cell of each."""
        plain = np.flatnonzero(self._plain & chosen[: len(self._plain)])
        first = self._surface.first_face
        count = first[plain + 1] - first[plain]
        kept = np.arange(int(count.sum())) + np.repeat(
            first[plain] - np.cumsum(count) + count, count
        )
        rows = np.flatnonzero(chosen[self._rings.cells])
        rings = self._rings.where(rows)
        place = np.arange(rings.points.shape[1])
        loop, step = np.nonzero(place < rings.length[:, None])
        onward = (step + 1) % rings.length[loop]
        corners = [
            self._first_hub + rows[loop],
            rings.points[loop, step],
            rings.points[loop, onward],
        ]
        return (
            np.concatenate([self._surface.faces[kept], np.stack(corners, axis=1)]),
            np.concatenate([np.repeat(plain, count), rings.cells[loop]]),
        )


def _intersecting_cells(
    vertices: NDArray[np.float64],
    fans: _Fans,
    corners: NDArray[np.int64],
    around: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Cells that have a part in an intersection, near to cells with low corners (r, 3)."""
    if not len(around):
        return np.empty(0, np.int64)
    # A hub goes at most one cell far, so its faces meet those of cells up to two cells away.
    reached = Names(_neighbourhoods(np.unique(around, axis=0), 2))
    faces, cell_of = fans.of_cells(reached.of(corners) >= 0)
    found = self_intersections(*_compact(vertices, faces)[:2])
    return np.unique(cell_of[found.pairs])
