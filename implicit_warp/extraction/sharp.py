"""Edges and corners of the shape, where plain marching cubes cuts them off.

Where the surface has an edge, the normals at the two crossings of a face of a cell differ.  Then
the point where the edge pierces the face is found, as the common point of the two sides' tangent
lines in the face, and put between the two crossings; in the cell a point on the edge (or at the
corner where edges meet) becomes the hub of a fan over the cell's loop, which now has these points.
Each is found again from the sides' values and gradients close to it, so that curved sides do as
well as flat ones.  (The faces' points are the idea of cubical marching squares, Ho et al. 2005;
the hubs that of extended marching cubes, Kobbelt et al. 2001.)

Guarantees: a face's point is made once for both of its cells, so the mesh stays watertight and
manifold.  The hub lies strictly inside its cell and the loop on the cell's faces, so the fan does
not intersect itself, and stays in the cell; no triangle of it is without area.
Non-guarantees: cells with more than one loop, and faces between two of which one is such a cell,
stay as they are.  Edges of angles below `ANGLE` are left rounded off.  Two edges that pass through
one face of a cell are not seen.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.cells import Surface, longer, taller
from implicit_warp.extraction.cube import FACE_AXIS, FACE_SIDE, Tables, tables
from implicit_warp.extraction.samples import Sampler

ANGLE = 20.0
"""Degrees between the normals of two crossings from which there is an edge between them."""

MARGIN = 1e-2
"""Closest that a point comes to the borders of its face or cell, in voxels."""

_REACH = 3e-2
"""Voxels beyond those borders from which a point is brought back; from further off it is none."""

_TOLERANCE = 0.05
"""Voxels from the surface within which a point found for an edge or corner is accepted."""

_ROUNDS = 3
_NEARER = 0.15
"""How far from a point towards the sides their values are looked at, of the way."""


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


class _Segments(NamedTuple):
    """Steps of loops from one crossing to the next, across an edge of the shape.

    Attributes:
        cell: (s,) the cell.
        step: (s,) the place of the step in the cell's loop.
        start, end: (s,) vertices.
        face: (s, 4) axis across the face, and its lattice place.
    """

    cell: NDArray[np.int64]
    step: NDArray[np.int64]
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    face: NDArray[np.int64]


class _Loops(NamedTuple):
    """Closed polygons on the faces of cells.

    Attributes:
        cells: (c,) the cell of each.
        length: (c,) number of points.
        points: (c, L) vertices in order, -1 beyond the length.
    """

    cells: NDArray[np.int64]
    length: NDArray[np.int64]
    points: NDArray[np.int64]


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
    normals = _units(sampler.value_and_gradient(vertices)[1])
    segments, face_of = _shared(_sharp_segments(surface, corners, normals))
    piercing, found = _piercing_points(segments, face_of, vertices, normals, sampler)
    segments = _Segments(*(column[found[face_of]] for column in segments))
    number = len(vertices) + np.cumsum(found) - 1
    on_faces = number[face_of[found[face_of]]]
    points = np.concatenate([vertices, piercing[found]])

    edges = _loops(surface, segments, on_faces)
    edge_hubs, exact = _hubs(edges, points, normals, corners, sampler)
    blank = np.ones(len(corners), np.bool_)
    blank[edges.cells] = False
    tips = _loops_without(surface, np.flatnonzero(blank & _spread(surface, normals)))
    tip_hubs, tipped = _hubs(tips, points, normals, corners, sampler)
    tips = _Loops(*(column[tipped] for column in tips))

    hubs = np.concatenate([edge_hubs, tip_hubs[tipped]])
    loops = _Loops(*(np.concatenate(pair) for pair in zip(edges, tips, strict=True)))
    exact = np.concatenate([exact, np.ones(len(tips.cells), np.bool_)])
    return Sharpened(
        np.concatenate([points, hubs]),
        _with_fans(surface, loops, len(points)),
        np.concatenate(
            [np.arange(len(vertices), len(points)), len(points) + np.flatnonzero(exact)]
        ),
    )


# --- where edges pass through faces -----------------------------------------------------------


def _sharp_segments(
    surface: Surface, corners: NDArray[np.int64], normals: NDArray[np.float64]
) -> _Segments:
    """The steps of the loops of cells with a single one, between normals that differ.

    Faces that a loop passes twice are left out: a point put into one of the two steps there could
    come to lie beyond the other.
    """
    found = _find_segments(
        surface.patterns,
        surface.cell_edges,
        corners,
        normals,
        math.cos(math.radians(ANGLE)),
        *_table_parts(tables()),
    )
    return _Segments(*found)


def _table_parts(t: Tables) -> tuple[NDArray[np.int64], ...]:
    return t.n_loops, t.loop_length, t.loop_edges, t.loop_faces


@kernel
def _find_segments(
    patterns, cell_edges, corners, normals, cosine, n_loops, loop_length, loop_edges, loop_faces
):
    capacity = 1024
    cell, step = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    start, end = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    face = np.empty((capacity, 4), np.int64)
    count = 0
    for i in range(len(patterns)):
        pattern = patterns[i]
        if n_loops[pattern] != 1:
            continue
        length = loop_length[pattern, 0]
        for j in range(length):
            a = cell_edges[i, loop_edges[pattern, 0, j]]
            b = cell_edges[i, loop_edges[pattern, 0, (j + 1) % length]]
            across = loop_faces[pattern, 0, j]
            dot = 0.0
            for k in range(3):
                dot += normals[a, k] * normals[b, k]
            passes = 0
            for k in range(length):
                passes += np.int64(loop_faces[pattern, 0, k] == across)
            if dot >= cosine or passes != 1:
                continue
            if count == capacity:
                capacity *= 2
                cell, step = longer(cell, capacity), longer(step, capacity)
                start, end = longer(start, capacity), longer(end, capacity)
                face = taller(face, capacity)
            cell[count], step[count] = i, j
            start[count], end[count] = a, b
            face[count, 0] = FACE_AXIS[across]
            for k in range(3):
                face[count, 1 + k] = corners[i, k]
            face[count, 1 + FACE_AXIS[across]] += FACE_SIDE[across]
            count += 1
    return cell[:count], step[:count], start[:count], end[:count], face[:count]


def _shared(segments: _Segments) -> tuple[_Segments, NDArray[np.int64]]:
    """The segments that both cells of their face have, and the number of that face."""
    _, face_of, count = np.unique(segments.face, axis=0, return_inverse=True, return_counts=True)
    face_of = face_of.reshape(-1)
    twice = count[face_of] == 2
    renumbered = np.cumsum(count == 2) - 1
    return _Segments(*(column[twice] for column in segments)), renumbered[face_of[twice]]


def _piercing_points(
    segments: _Segments,
    face_of: NDArray[np.int64],
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    sampler: Sampler,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(f, 3) the point in each face where the edge passes, and (f,) whether there is one."""
    _, first = np.unique(face_of, return_index=True)
    axis, low = segments.face[first, 0], segments.face[first, 1:]
    plane = np.stack([(axis + 1) % 3, (axis + 2) % 3], axis=1)
    rows = np.arange(len(first))
    ends = np.stack([segments.start[first], segments.end[first]], axis=1)
    sides = vertices[ends]  # (f, 2, 3)
    # Each side's line in the face: slope . (q - anchor) + value = 0.
    slopes, anchors = normals[ends], sides
    values = np.zeros(ends.shape)
    points, sound = sides.mean(axis=1), np.ones(len(first), np.bool_)
    for round_ in range(1 + _ROUNDS):
        if round_:
            near = points[:, None] + _NEARER * (sides - points[:, None])
            value, slope = _side_values(near, slopes, sampler)
            keep = value.mask
            anchors = np.where(keep[..., None], anchors, near)
            slopes = np.where(keep[..., None], slopes, slope)
            values = np.where(keep, values, value.data)
        flat = np.take_along_axis(slopes, plane[:, None], axis=2)
        right = np.einsum("fsi,fsi->fs", flat, np.take_along_axis(anchors, plane[:, None], axis=2))
        determinant = flat[:, 0, 0] * flat[:, 1, 1] - flat[:, 0, 1] * flat[:, 1, 0]
        size = np.linalg.norm(flat, axis=2).prod(axis=1)
        sound &= np.abs(determinant) > 0.1 * size
        safe = np.where(np.abs(determinant) > 0.1 * size, determinant, 1.0)
        right = right - values
        solved = np.stack(
            [
                (right[:, 0] * flat[:, 1, 1] - right[:, 1] * flat[:, 0, 1]) / safe,
                (right[:, 1] * flat[:, 0, 0] - right[:, 0] * flat[:, 1, 0]) / safe,
            ],
            axis=1,
        )
        solved = np.where(sound[:, None], solved, points[rows[:, None], plane])
        borders = low[rows[:, None], plane]
        outside = np.abs(solved - borders - 0.5).max(axis=1, initial=0.0) - 0.5
        sound &= outside < _REACH
        points[rows[:, None], plane] = np.clip(solved, borders + MARGIN, borders + 1.0 - MARGIN)
    return points, sound & _on_surface(points, sampler)


def _side_values(
    near: NDArray[np.float64], slopes: NDArray[np.float64], sampler: Sampler
) -> tuple[np.ma.MaskedArray, NDArray[np.float64]]:
    """Values in units of length, masked where a point has come to lie on another side, and the unit
    gradients, at points (f, s, 3) close to sides with known unit normals."""
    value, gradient = sampler.value_and_gradient(near.reshape(-1, 3))
    size = np.linalg.norm(gradient, axis=1)
    safe = np.where(size > 0, size, 1.0)
    gradient = (gradient / safe[:, None]).reshape(near.shape)
    other_side = np.einsum("fsi,fsi->fs", gradient, slopes) < 0.5
    return np.ma.array((value / safe).reshape(near.shape[:2]), mask=other_side), gradient


def _on_surface(points: NDArray[np.float64], sampler: Sampler) -> NDArray[np.bool_]:
    value, gradient = sampler.value_and_gradient(points)
    size = np.linalg.norm(gradient, axis=1)
    return np.abs(value) <= _TOLERANCE * np.where(size > 0, size, 1.0)


# --- loops and their hubs ---------------------------------------------------------------------


def _loops(surface: Surface, segments: _Segments, on_faces: NDArray[np.int64]) -> _Loops:
    """The loops of all cells with piercing points, which are put into their places."""
    cells, row = np.unique(segments.cell, return_inverse=True)
    inserted = np.full((len(cells), 12), -1, np.int64)
    inserted[row, segments.step] = on_faces
    return _loops_with(surface, cells, inserted)


def _loops_without(surface: Surface, cells: NDArray[np.int64]) -> _Loops:
    return _loops_with(surface, cells, np.full((len(cells), 12), -1, np.int64))


def _loops_with(surface: Surface, cells: NDArray[np.int64], inserted: NDArray[np.int64]) -> _Loops:
    t = tables()
    points, length = np.full((len(cells), 24), -1, np.int64), np.zeros(len(cells), np.int64)
    _fill_loops(
        surface.patterns[cells], surface.cell_edges[cells], inserted, t.loop_length, t.loop_edges,
        points, length,
    )  # fmt: skip
    return _Loops(cells, length, points)


@kernel
def _fill_loops(patterns, cell_edges, inserted, loop_length, loop_edges, points, length):
    for i in range(len(patterns)):
        n = 0
        for j in range(loop_length[patterns[i], 0]):
            points[i, n] = cell_edges[i, loop_edges[patterns[i], 0, j]]
            n += 1
            if inserted[i, j] >= 0:
                points[i, n] = inserted[i, j]
                n += 1
        length[i] = n


def _spread(surface: Surface, normals: NDArray[np.float64]) -> NDArray[np.bool_]:
    """(n,) whether the normals in a cell with one loop differ so much that it may hold a tip."""
    single = tables().n_loops[surface.patterns] == 1
    result = np.zeros(len(single), np.bool_)
    _find_spread(surface.cell_edges, single, normals, math.cos(math.radians(2.5 * ANGLE)), result)
    return result


@kernel
def _find_spread(cell_edges, single, normals, cosine, result):
    for i in range(len(cell_edges)):
        if not single[i]:
            continue
        for e in range(12):
            for f in range(e):
                a, b = cell_edges[i, e], cell_edges[i, f]
                if a >= 0 and b >= 0:
                    dot = 0.0
                    for k in range(3):
                        dot += normals[a, k] * normals[b, k]
                    result[i] |= dot < cosine


class _Sides(NamedTuple):
    """The smooth pieces of the surface that meet in cells: arcs of their loops between edges.

    Attributes:
        loop: (s,) the loop.
        middle: (s, 3) mean of the arc's crossings.
        normal: (s, 3) unit, their mean normal.
    """

    loop: NDArray[np.int64]
    middle: NDArray[np.float64]
    normal: NDArray[np.float64]


def _sides(loops: _Loops, points: NDArray[np.float64], normals: NDArray[np.float64]) -> _Sides:
    """Arcs between piercing points; every crossing by itself where there are less than two."""
    count = int(loops.length.sum())
    arc = np.empty(count, np.int64)
    loop, vertex = np.empty(count, np.int64), np.empty(count, np.int64)
    found, arcs = _find_arcs(loops.length, loops.points, len(normals), arc, loop, vertex)
    arc, loop, vertex = arc[:found], loop[:found], vertex[:found]
    size = np.bincount(arc, minlength=arcs)
    mean = [np.bincount(arc, points[vertex, k], arcs) / size for k in range(3)]
    normal = [np.bincount(arc, normals[vertex, k], arcs) for k in range(3)]
    of_arc = np.zeros(arcs, np.int64)
    of_arc[arc] = loop
    return _Sides(of_arc, np.stack(mean, axis=1), _units(np.stack(normal, axis=1)))


@kernel
def _find_arcs(length, points, n_crossings, arc, loop, vertex):
    found, arcs = 0, 0
    for i in range(len(length)):
        n = length[i]
        piercings, start = 0, 0
        for j in range(n):
            if points[i, j] >= n_crossings:
                piercings += 1
                start = j
        open_ = False
        for j in range(n):
            p = points[i, (start + j) % n]
            if p >= n_crossings:
                arcs += np.int64(open_)
                open_ = False
                continue
            arc[found], loop[found], vertex[found] = arcs, i, p
            found += 1
            open_ = True
            if piercings < 2:
                arcs += 1
                open_ = False
        arcs += np.int64(open_)
    return found, arcs


def _hubs(
    loops: _Loops,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    corners: NDArray[np.int64],
    sampler: Sampler,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """(c, 3) a point strictly inside each cell, and (c,) whether it lies on the shape's edge.

    It is the point nearest to the mean of the piercing points (of all points, if there are none)
    that lies on all of the sides' planes, in the sense of least squares; where that fails, it is
    that mean, moved off the cell's border.
    """
    sides = _sides(loops, points, normals)
    at, low = len(loops.cells), corners[loops.cells].astype(np.float64)
    present = loops.points >= 0
    piercing = loops.points >= len(normals)
    chosen = np.where(piercing.any(axis=1, keepdims=True), piercing, present)
    weights = chosen / np.maximum(chosen.sum(axis=1, keepdims=True), 1)
    middle = np.einsum("cl,cli->ci", weights, points[loops.points])
    # A single piercing point lies on the cell's border: the edge goes on just inside.
    middle = np.clip(middle, low + MARGIN, low + 1.0 - MARGIN)
    hubs, sound = middle.copy(), np.ones(at, np.bool_)
    slopes, anchors, values = sides.normal, sides.middle, np.zeros(len(sides.loop))
    for round_ in range(1 + _ROUNDS):
        if round_:
            near = hubs[sides.loop] + _NEARER * (sides.middle - hubs[sides.loop])
            value, slope = _side_values(near[:, None], slopes[:, None], sampler)
            keep = value.mask[:, 0]
            anchors = np.where(keep[:, None], anchors, near)
            slopes = np.where(keep[:, None], slopes, slope[:, 0])
            values = np.where(keep, values, value.data[:, 0])
        apart = np.einsum("si,si->s", slopes, hubs[sides.loop] - anchors) + values
        moved = hubs - _least_squares(sides.loop, slopes, apart, at)
        outside = np.abs(moved - low - 0.5).max(axis=1, initial=0.0) - 0.5
        sound &= outside < _REACH
        hubs = np.where(sound[:, None], np.clip(moved, low + MARGIN, low + 1.0 - MARGIN), middle)
    sound &= _on_surface(hubs, sampler)
    return np.where(sound[:, None], hubs, middle), sound


def _least_squares(
    loop: NDArray[np.int64], slopes: NDArray[np.float64], apart: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """(count, 3) the shortest steps that best undo distances `apart` along unit `slopes`.

    Directions in which the sides of a loop hardly differ are left out: along an edge a point may
    stay where it is.
    """
    matrix = np.zeros((count, 3, 3))
    np.add.at(matrix, loop, slopes[:, :, None] * slopes[:, None, :])
    right = np.zeros((count, 3))
    np.add.at(right, loop, slopes * apart[:, None])
    size, direction = np.linalg.eigh(matrix)
    weak = size < 0.01 * size[:, -1:]
    inverse = np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, size))
    return np.einsum("cij,cj,ckj,ck->ci", direction, inverse, direction, right)


def _with_fans(surface: Surface, loops: _Loops, first_hub: int) -> NDArray[np.int64]:
    """The faces of all other cells, and fans over the loops from their hubs."""
    plain = np.ones(len(surface.patterns), np.bool_)
    plain[loops.cells] = False
    kept = np.repeat(plain, np.diff(surface.first_face))
    place = np.arange(loops.points.shape[1])
    loop, step = np.nonzero(place < loops.length[:, None])
    onward = (step + 1) % loops.length[loop]
    fans = np.stack(
        [first_hub + loop, loops.points[loop, step], loops.points[loop, onward]], axis=1
    )
    return np.concatenate([surface.faces[kept], fans])


def _units(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(size > 0, size, 1.0)
