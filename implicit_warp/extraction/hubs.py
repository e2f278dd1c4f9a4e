"""Loops of cells with points on the edges of the shape, and the hubs of the fans over them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.cube import tables
from implicit_warp.extraction.piercing import ANGLE, Segments
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import (
    FARTHEST,
    REACH,
    ROUNDS,
    Occupied,
    nearer_values,
    on_surface,
    units,
    within,
)


class Loops(NamedTuple):
    """Closed polygons on the faces of cells.

    Attributes:
        cells: (c,) the cell of each.
        length: (c,) number of points.
        points: (c, L) vertices in order, -1 beyond the length.
    """

    cells: NDArray[np.int64]
    length: NDArray[np.int64]
    points: NDArray[np.int64]

    def where(self, chosen: NDArray[np.bool_]) -> Loops:
        """Some of the loops."""
        return Loops(*(column[chosen] for column in self))

    def joined(self, other: Loops) -> Loops:
        """These and others."""
        return Loops(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))


def loops_with_points(surface: Surface, segments: Segments, on_faces: NDArray[np.int64]) -> Loops:
    """The loops of all cells with piercing points, which are put into their places."""
    cells, row = np.unique(segments.cell, return_inverse=True)
    inserted = np.full((len(cells), 12), -1, np.int64)
    inserted[row, segments.step] = on_faces
    return _fill(surface, cells, inserted)


def loops_without_points(surface: Surface, cells: NDArray[np.int64]) -> Loops:
    """The loops of some cells as they are."""
    return _fill(surface, cells, np.full((len(cells), 12), -1, np.int64))


def _fill(surface: Surface, cells: NDArray[np.int64], inserted: NDArray[np.int64]) -> Loops:
    t = tables()
    points, length = np.full((len(cells), 24), -1, np.int64), np.zeros(len(cells), np.int64)
    _fill_loops(
        surface.patterns[cells], surface.cell_edges[cells], inserted, t.loop_length, t.loop_edges,
        points, length,
    )  # fmt: skip
    return Loops(cells, length, points)


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


def spread(surface: Surface, normals: NDArray[np.float64]) -> NDArray[np.bool_]:
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


def _sides(loops: Loops, points: NDArray[np.float64], normals: NDArray[np.float64]) -> _Sides:
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
    return _Sides(of_arc, np.stack(mean, axis=1), units(np.stack(normal, axis=1)))


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


def hubs_of(
    loops: Loops,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    corners: NDArray[np.int64],
    occupied: Occupied,
    may_leave: NDArray[np.bool_],
    sampler: Sampler,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """A point for the hub of the fan over each loop.

    It is the point nearest to the mean of the piercing points (of all points, if there are none)
    that lies on all of the sides' planes, in the sense of least squares; where that fails, it is
    that mean, moved into the cell.

    Args:
        loops: one a cell.
        points: (p, 3) crossings and piercing points.
        normals: (v, 3) unit, at the crossings, which come first.
        corners: (n, 3) low corners of all crossed cells.
        occupied: the same as a set.
        may_leave: (n,) cells whose hub may lie in a cell that is not crossed.
        sampler: of the field.

    Returns:
        (c, 3) points; (c,) whether each lies on an edge or corner of the shape; (c,) whether it has
        left its cell.
    """
    sides = _sides(loops, points, normals)
    low = corners[loops.cells].astype(np.float64)
    piercing = loops.points >= len(normals)
    chosen = np.where(piercing.any(axis=1, keepdims=True), piercing, loops.points >= 0)
    weights = chosen / chosen.sum(axis=1, keepdims=True)
    middle = within(np.einsum("cl,cli->ci", weights, points[loops.points]), low)
    hubs = middle
    slopes, anchors, values = sides.normal, sides.middle, np.zeros(len(sides.loop))
    for round_ in range(1 + ROUNDS):
        if round_:
            slopes, anchors, values = nearer_values(
                hubs[sides.loop], sides.middle, slopes, anchors, values, sampler
            )
        apart = np.einsum("si,si->s", slopes, hubs[sides.loop] - anchors) + values
        moved = hubs - _least_squares(sides.loop, slopes, apart, len(loops.cells))
        hubs = within(moved, low, -FARTHEST)
    outside = np.abs(hubs - low - 0.5).max(axis=1, initial=0.0) - 0.5
    near = outside < REACH
    hubs = np.where(near[:, None], within(hubs, low), hubs)
    free = ~near & may_leave[loops.cells] & ~occupied.among(np.floor(hubs).astype(np.int64))
    sound = (near | free) & on_surface(hubs, sampler)
    return np.where(sound[:, None], hubs, middle), sound, sound & free


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
