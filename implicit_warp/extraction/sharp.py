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
from implicit_warp.extraction.doubled import Doubled, doubled_edges, traced
from implicit_warp.extraction.hubs import hubs_of
from implicit_warp.extraction.piercing import piercing_points, sharp_cells, sharp_segments
from implicit_warp.extraction.rings import Rings, rings_of, with_points
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import Places, units

_DOUBLINGS = 4
"""How often more lattice edges are looked for that are crossed twice."""

_ATTEMPTS = 4
"""How often hubs that make faces intersect are withdrawn before all that have left are."""


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
    refused = np.empty((0, 3), np.int64)
    for attempt in range(_ATTEMPTS):
        last = attempt == _ATTEMPTS - 1
        found = _find_edges(
            surface, corners, vertices, normals, np.flatnonzero(sharp), refused, last, sampler
        )
        may_leave = np.full(len(found.corners), not last) & (Places(refused).of(found.corners) < 0)
        about = (found.points, found.normals, found.corners, may_leave, sampler)
        hubs, exact, left = hubs_of(found.rings, *about)
        blank = tip.copy()
        blank[found.rings.cells[found.rings.cells < len(tip)]] = False
        tips = rings_of(surface, np.flatnonzero(blank))
        tip_hubs, tipped, tip_left = hubs_of(tips, *about)
        rings = found.rings.joined(tips.where(tipped))
        points = np.concatenate([found.points, hubs, tip_hubs[tipped]])
        faces, cell_of = _with_fans(surface, rings, len(found.points))
        unproved = _several(rings.cells)
        unproved |= np.concatenate([left, tip_left[tipped]])
        wrong = np.concatenate(
            [
                _intersecting_cells(
                    sampler.lattice.origin + sampler.lattice.voxel * points,  # as they will be
                    faces,
                    cell_of,
                    found.corners,
                    np.unique(rings.cells[unproved]),
                ),
                _torn_cells(rings, len(vertices), found.first_piercing),
            ]
        )
        if not len(wrong):
            break
        refused = np.concatenate([refused, found.corners[wrong]])
    on_edge = np.concatenate([exact, np.ones(int(tipped.sum()), np.bool_)])
    piercing = np.arange(found.first_piercing, len(found.points))
    return _without_unused(
        points, faces, np.concatenate([piercing, len(found.points) + np.flatnonzero(on_edge)])
    )


def _torn_cells(rings: Rings, first: int, end: int) -> NDArray[np.int64]:
    """Cells around doubled lattice edges whose crossings follow each other in more than two rings.

    The two are then joined on more than one face, by an edge that more than two faces of the mesh
    share.
    """
    place = np.arange(rings.points.shape[1])
    row, step = np.nonzero(place < rings.length[:, None])
    a = rings.points[row, step]
    b = rings.points[row, (step + 1) % rings.length[row]]
    joined = (a >= first) & (a < end) & (b >= first) & (b < end) & (a != b)
    edge = (a - first) // 2
    joined &= edge == (b - first) // 2
    times = np.bincount(edge[joined], minlength=(end - first) // 2)
    return np.unique(rings.cells[row[joined][times[edge[joined]] > 2]])


def _several(cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which entries occur more than once."""
    _, number, count = np.unique(cells, return_inverse=True, return_counts=True)
    return count[number.reshape(-1)] > 1


def _without_unused(
    points: NDArray[np.float64], faces: NDArray[np.int64], on_edges: NDArray[np.int64]
) -> Sharpened:
    """Crossings of doubled edges that were dropped again are no vertices."""
    used = np.zeros(len(points), np.bool_)
    used[faces] = True
    number = np.cumsum(used) - 1
    return Sharpened(points[used], number[faces], number[on_edges[used[on_edges]]])


class _Edges(NamedTuple):
    """Rings of cells with all points on edges of the shape.

    Attributes:
        corners: (n + m, 3) the crossed cells, and those that only doubled lattice edges cross.
        points: (p, 3) crossings, of doubled edges too, then piercing points.
        normals: (c, 3) unit, at the crossings.
        rings: of the cells at edges.
        first_piercing: the first point that is no crossing.
    """

    corners: NDArray[np.int64]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    rings: Rings
    first_piercing: int


def _find_edges(
    surface: Surface,
    corners: NDArray[np.int64],
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    cells: NDArray[np.int64],
    refused: NDArray[np.int64],
    no_doubling: bool,
    sampler: Sampler,
) -> _Edges:
    """Look for piercing points, and for doubled lattice edges until no more turn up."""
    places, plain = Places(corners), rings_of(surface, cells)
    doubled, rings, everywhere = Doubled.none(), plain, corners
    points, at_points = vertices, normals
    for attempt in range(_DOUBLINGS + 1):
        segments = sharp_segments(rings, everywhere, at_points)
        piercing = piercing_points(segments, points, at_points, sampler)
        if no_doubling or attempt == _DOUBLINGS:
            break
        more = doubled.joined(doubled_edges(piercing, sampler))
        crossings = more.crossings()
        slopes = units(sampler.value_and_gradient(crossings)[1])
        at_all = np.concatenate([normals, slopes])
        trace = traced(surface, corners, places, more, at_all, refused)
        if len(trace.doubled.low) == len(doubled.low):
            break
        everywhere, around, doubled = trace
        points, at_points = np.concatenate([vertices, crossings]), at_all
        rings = plain.where(~np.isin(plain.cells, around.cells)).joined(around)
    kept = segments.where(piercing.found[segments.number])
    number = len(points) + np.cumsum(piercing.found) - 1
    rings = with_points(rings, kept.row, kept.step, number[kept.number])
    return _Edges(
        everywhere,
        np.concatenate([points, piercing.points[piercing.found]]),
        at_points,
        rings,
        len(points),
    )


def _with_fans(
    surface: Surface, rings: Rings, first_hub: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The faces of all other cells, fans over the loops from their hubs; and the cell of each."""
    plain = np.ones(len(surface.patterns), np.bool_)
    plain[rings.cells[rings.cells < len(plain)]] = False
    cell_of = np.repeat(np.arange(len(plain)), np.diff(surface.first_face))
    kept = plain[cell_of]
    place = np.arange(rings.points.shape[1])
    loop, step = np.nonzero(place < rings.length[:, None])
    onward = (step + 1) % rings.length[loop]
    fans = np.stack(
        [first_hub + loop, rings.points[loop, step], rings.points[loop, onward]], axis=1
    )
    return (
        np.concatenate([surface.faces[kept], fans]),
        np.concatenate([cell_of[kept], rings.cells[loop]]),
    )


def _intersecting_cells(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    cell_of: NDArray[np.int64],
    corners: NDArray[np.int64],
    roaming: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Cells that have a part in an intersection, among those around cells with points outside."""
    # A hub goes at most one cell far, so its faces meet those of cells up to two cells away.
    if not len(roaming):
        return roaming
    around = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    reached = Places((corners[roaming][:, None] + around).reshape(-1, 3))
    suspect = (reached.of(corners) >= 0)[cell_of]
    tested = faces[suspect]
    used, compact = np.unique(tested, return_inverse=True)
    found = self_intersections(vertices[used], compact.reshape(-1, 3))
    return np.unique(cell_of[suspect][found.pairs])
