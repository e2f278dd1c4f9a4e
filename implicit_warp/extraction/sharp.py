"""Edges and corners of the shape, where plain marching cubes cuts them off.

Where the surface has an edge, the normals at the two crossings of a face of a cell differ.  Then
the point where the edge pierces the face is found, as the common point of the two sides' tangent
lines in the face, and put between the two crossings; in the cell a point on the edge (or at the
corner where edges meet) becomes the hub of a fan over the cell's loop, which now has these points.
Each is found again from the sides' values and gradients close to it, so that curved sides do as
well as flat ones.  (The faces' points are the idea of cubical marching squares, Ho et al. 2005;
the hubs that of extended marching cubes, Kobbelt et al. 2001.)

A convex edge can pass between lattice points, through cells without any that is inside.  So a
point may leave its face or cell, into cells that the surface does not cross otherwise.

Guarantees: a face's point is made once for both of its cells, so the mesh stays watertight and
manifold.  A fan whose hub is strictly inside its cell and whose loop lies on the cell's faces does
not intersect itself and stays in the cell; no triangle of it is without area.  Where points have
left, the faces around are tested exactly, and points that make others intersect are withdrawn.
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
from implicit_warp.extraction.hubs import (
    Loops,
    hubs_of,
    loops_with_points,
    loops_without_points,
    spread,
)
from implicit_warp.extraction.piercing import piercing_points, sharp_segments
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import Occupied, units

_ATTEMPTS = 4
"""How often points that make faces intersect are withdrawn before all that have left are."""


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
    occupied = Occupied(corners)
    segments = sharp_segments(surface, corners, normals)
    piercing, found, left = piercing_points(segments, vertices, normals, occupied, sampler)
    may_leave = np.ones(len(corners), np.bool_)
    blunt = spread(surface, normals)
    for attempt in range(_ATTEMPTS):
        used = found.copy()
        withdrawn = segments.number[~may_leave[segments.cell]]
        used[withdrawn[left[withdrawn]]] = False
        points = np.concatenate([vertices, piercing[used]])
        number = len(vertices) + np.cumsum(used) - 1
        kept = segments.where(used[segments.number])
        edges = loops_with_points(surface, kept, number[kept.number])
        blank = blunt.copy()
        blank[edges.cells] = False
        tips = loops_without_points(surface, np.flatnonzero(blank))
        about = (points, normals, corners, occupied, may_leave, sampler)
        edge_hubs, exact, edge_left = hubs_of(edges, *about)
        tip_hubs, tipped, tip_left = hubs_of(tips, *about)
        loops = edges.joined(tips.where(tipped))
        hubs = np.concatenate([edge_hubs, tip_hubs[tipped]])
        faces, cell_of = _with_fans(surface, loops, len(points))
        everything = np.concatenate([points, hubs])
        roaming = np.concatenate(
            [
                kept.cell[left[kept.number]],
                loops.cells[np.concatenate([edge_left, tip_left[tipped]])],
            ]
        )
        if not len(roaming):
            break
        wrong = _intersecting_cells(everything, faces, cell_of, corners, roaming)
        if not len(wrong):
            break
        may_leave[wrong] = False
        if attempt == _ATTEMPTS - 2:
            may_leave[:] = False
    on_edge = np.concatenate([exact, np.ones(int(tipped.sum()), np.bool_)])
    first = np.arange(len(vertices), len(points))
    return Sharpened(
        everything, faces, np.concatenate([first, len(points) + np.flatnonzero(on_edge)])
    )


def _with_fans(
    surface: Surface, loops: Loops, first_hub: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The faces of all other cells, fans over the loops from their hubs; and the cell of each."""
    plain = np.ones(len(surface.patterns), np.bool_)
    plain[loops.cells] = False
    cell_of = np.repeat(np.arange(len(plain)), np.diff(surface.first_face))
    kept = plain[cell_of]
    place = np.arange(loops.points.shape[1])
    loop, step = np.nonzero(place < loops.length[:, None])
    onward = (step + 1) % loops.length[loop]
    fans = np.stack(
        [first_hub + loop, loops.points[loop, step], loops.points[loop, onward]], axis=1
    )
    return (
        np.concatenate([surface.faces[kept], fans]),
        np.concatenate([cell_of[kept], loops.cells[loop]]),
    )


def _intersecting_cells(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    cell_of: NDArray[np.int64],
    corners: NDArray[np.int64],
    roaming: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Cells that have a part in an intersection, among those around cells with points outside."""
    # A point goes at most one cell far, so its faces meet those of cells up to two cells away.
    around = np.stack(np.meshgrid(*[np.arange(-2, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    reached = Occupied((corners[roaming][:, None] + around).reshape(-1, 3))
    suspect = reached.among(corners)[cell_of]
    tested = faces[suspect]
    used, compact = np.unique(tested, return_inverse=True)
    found = self_intersections(vertices[used], compact.reshape(-1, 3))
    return np.unique(cell_of[suspect][found.pairs])
