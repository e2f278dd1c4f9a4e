"""Cutting a polygon mesh along the lines of one prismatic layer.

In the plane coordinates (u, v) of a layer, the borders of all its cells are level sets of five
scalar functions, in this order (m = max(1, .), h = 2 / (N - 1), t_i the ticks):

    BAND      v                at -1 and 1,
    COLUMNS   u / m(|v|)       at every t_i,
    ROWS      v / m(|u|)       at every t_j,
    RISING    u - v            at every multiple of h,    inside the square only,
    FALLING   u + v            at every multiple of h,    inside the square only.

COLUMNS are the lines u = t_i where |v| <= 1, and the cones' rays above and below, the diagonals
u = +-|v| among them; ROWS likewise to the left and right.  BAND comes first because COLUMNS bend
at |v| = 1; where ROWS bend, at |u| = 1 within the band, COLUMNS have cut.  So every level set is a
straight line within every piece that a pass meets, and BAND beyond the square is the only cut that
is no border of a cell.  Outside its own sectors each function of COLUMNS and ROWS exceeds 1 in
size, beyond its last level, so nothing is cut there.

A pass gives every *vertex* a code: 2 i on level i, 2 i + 1 strictly between levels i and i + 1.
The rest is combinatorial.  Edges whose ends lie strictly on both sides of a level get a vertex on
it; this is decided for each edge by itself, once for all polygons around it.  Polygons are then
split between vertices that lie on the level, never elsewhere.  So pieces fit together whatever the
rounding does.

"On level i" means within `snap` of its lines, a distance in the plane.  Vertices are not moved
there.  A vertex made by a cut gets coordinates that are on the level to the last bit or two, and is
computed from the ends of its edge in lexicographic order of their positions, so that vertices that
coincide without being shared, as along a seam of a texture, still coincide afterwards, bit for bit.

A border between the square and the outside is an edge of both; RISING and FALLING reach it only at
vertices of the square mesh, which COLUMNS and ROWS have put there, within `snap`.  They use a
wider tolerance, so such an edge is never cut again.

All loops count, add up and fill: they run in parallel, in chunks of fixed size, and the result does
not depend on the number of threads.
"""

from __future__ import annotations

import numpy as np

from implicit_warp.push_forward.edge_splitting import count_splits, split_edges
from implicit_warp.push_forward.families import (
    BAND,
    COLUMNS,
    FALLING,
    RISING,
    ROWS,
    classify,
    levels_between,
)
from implicit_warp.push_forward.polygon_mesh import PolygonMesh
from implicit_warp.push_forward.polygon_splitting import count_pieces, split_polygons

SNAP = 1e-12
"""How near a vertex is on a line, relative to the larger of the square (size 1) and the mesh: a
thousand times the rounding of some thirty layers, and a thousandth of what anyone could see."""

_DIAGONAL_SLACK = 16.0  # sum of the snaps that a vertex of the square mesh has met before, doubled


def cut_layer(mesh: PolygonMesh, resolution: int) -> int:
    """Cut all polygons so that each lies in one closed cell of the layer, to `SNAP`.

    Args:
        mesh: its points are in the layer's coordinates (u, v, w); changed in place.
        resolution: N of the layer's square mesh.

    Returns:
        The number of polygons that would have to be cut but were left whole, because rounding had
        bent them so far that a level met them more than twice.
    """
    half = 0.5 * (resolution - 1)
    snap = SNAP * max(1.0, _largest(mesh.points[: mesh.n_vertices]))
    # Of each family: how many levels there are, and how near is on one, in units of their distance.
    diagonals = 2 * resolution - 1, _DIAGONAL_SLACK * half * snap
    passes = {
        BAND: (2, 0.5 * snap),
        COLUMNS: (resolution, half * snap),
        ROWS: (resolution, half * snap),
        RISING: diagonals,
        FALLING: diagonals,
    }
    uncut = sum(_cut(mesh, family, *what, half, snap) for family, what in passes.items())
    mesh.compact()
    return uncut


def _largest(points: np.ndarray) -> float:
    return max(float(points.max(initial=0.0)), -float(points.min(initial=0.0)))


def _cut(mesh: PolygonMesh, family: int, levels: int, near: float, half: float, snap: float) -> int:
    """One pass; the number of polygons left uncut."""
    n_vertices, n_edges, n_polygons = mesh.n_vertices, mesh.n_edges, mesh.n_polygons
    low, high = classify(mesh.points, n_vertices, family, levels, half, near, snap, mesh.codes)
    if levels_between(low, high) <= 0:
        return 0
    new_vertices, edges_hit = count_splits(mesh.edges, n_edges, mesh.codes, mesh.slots)
    vertex_offsets, slot_offsets = _offsets(new_vertices), _offsets(edges_hit)
    first_vertices = np.empty(slot_offsets[-1] + 1, np.int32)
    mesh.make_room(n_vertices + vertex_offsets[-1], n_edges + vertex_offsets[-1], 0, 0)
    split_edges(
        mesh.edges, n_edges, mesh.points, mesh.parents, mesh.fractions, mesh.codes, n_vertices,
        family, half, vertex_offsets, slot_offsets, mesh.slots, first_vertices,
    )  # fmt: skip
    mesh.n_vertices += vertex_offsets[-1]
    mesh.n_edges += vertex_offsets[-1]

    # A split edge keeps its first part; its other parts have the ids of the vertices they begin at,
    # shifted by this.
    shift = n_edges - n_vertices
    counts = count_pieces(
        mesh.corner_vertices, mesh.corner_edges, mesh.starts, mesh.lengths, n_polygons, mesh.codes,
        mesh.slots, first_vertices, mesh.pieces,
    )  # fmt: skip
    polygons, corners, longest, uncut = counts.T
    polygon_offsets, corner_offsets = _offsets(polygons), _offsets(corners)
    mesh.make_room(
        0,
        mesh.n_edges + polygon_offsets[-1],
        mesh.n_corners + corner_offsets[-1],
        n_polygons + polygon_offsets[-1],
    )
    split_polygons(
        mesh.corner_vertices, mesh.corner_edges, mesh.starts, mesh.lengths, mesh.sources,
        n_polygons, mesh.n_corners, mesh.edges, mesh.n_edges, mesh.codes, mesh.slots,
        first_vertices, shift, mesh.pieces, polygon_offsets, corner_offsets, longest,
    )  # fmt: skip
    # Each additional polygon comes with the edge that parts it from the one below.
    mesh.n_polygons += polygon_offsets[-1]
    mesh.n_edges += polygon_offsets[-1]
    mesh.n_corners += corner_offsets[-1]
    return int(uncut.sum())


def _offsets(counts: np.ndarray) -> np.ndarray:
    return np.concatenate([[0], np.cumsum(counts)])
