"""The hubs of fans over the rings of cells."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.piercing import ANGLE
from implicit_warp.extraction.rings import Rings
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sides import (
    FARTHEST,
    REACH,
    ROUNDS,
    nearer_values,
    on_surface,
    units,
    within,
)


class _Sides(NamedTuple):
    """The smooth pieces of the surface that meet in cells: arcs of their rings between edges.

    Attributes:
        ring: (s,) the ring.
        middle: (s, 3) mean of the arc's crossings.
        normal: (s, 3) unit, their mean normal.
        borders: (r,) how many edges of the shape each ring crosses.
    """

    ring: NDArray[np.int64]
    middle: NDArray[np.float64]
    normal: NDArray[np.float64]
    borders: NDArray[np.int64]


def _sides(
    rings: Rings,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    piercing: NDArray[np.bool_],
) -> _Sides:
    """Arcs between piercing points, and between crossings with normals that differ where there is
    none; every crossing by itself on rings that cross less than two edges."""
    count = int(rings.length.sum())
    arc, vertex = np.empty(count, np.int64), np.empty(count, np.int64)
    ring, borders = np.empty(count, np.int64), np.zeros(len(rings.length), np.int64)
    cosine = math.cos(math.radians(ANGLE))
    found, arcs = _find_arcs(
        rings.length, rings.points, normals, piercing, cosine, arc, ring, vertex, borders
    )
    arc, ring, vertex = arc[:found], ring[:found], vertex[:found]
    size = np.bincount(arc, minlength=arcs)
    mean = [np.bincount(arc, points[vertex, k], arcs) / size for k in range(3)]
    normal = [np.bincount(arc, normals[vertex, k], arcs) for k in range(3)]
    of_arc = np.zeros(arcs, np.int64)
    of_arc[arc] = ring
    return _Sides(of_arc, np.stack(mean, axis=1), units(np.stack(normal, axis=1)), borders)


@kernel
def _find_arcs(length, points, normals, piercing, cosine, arc, ring, vertex, borders):
    found, arcs = 0, 0
    splits = np.empty(64, np.bool_)
    for i in range(len(length)):
        n = length[i]
        start = 0
        for j in range(n):  # is there an edge of the shape between this point and the one before?
            a, b = points[i, j - 1 if j else n - 1], points[i, j]
            if piercing[a]:
                splits[j] = False  # the piercing point itself was counted
            elif piercing[b]:
                splits[j] = True
            else:
                dot = 0.0
                for k in range(3):
                    dot += normals[a, k] * normals[b, k]
                splits[j] = dot < cosine
            borders[i] += np.int64(splits[j])
            if splits[j]:
                start = j
        open_ = False
        for j in range(n):
            at = (start + j) % n
            if open_ and (splits[at] or borders[i] < 2):
                arcs += 1
                open_ = False
            if not piercing[points[i, at]]:
                arc[found], ring[found], vertex[found] = arcs, i, points[i, at]
                found += 1
                open_ = True
        arcs += np.int64(open_)
    return found, arcs


def hubs_of(
    rings: Rings,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    piercing: NDArray[np.bool_],
    corners: NDArray[np.int64],
    may_leave: NDArray[np.bool_],
    sampler: Sampler,
) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
    """A point for the hub of the fan over each ring.

    It is the point nearest to the mean of the piercing points (of all points, if there are none)
    that lies on all of the sides' planes, in the sense of least squares; where that fails, it is
    that mean, moved into the cell.

    Args:
        rings: c of them.
        points: (p, 3) crossings and piercing points.
        normals: (p, 3) unit, at the crossings.
        piercing: (p,) which are no crossings but piercing points.
        corners: (c, 3) low corner of the cell of each ring.
        may_leave: (c,) whether the hub may lie outside, at a corner or a tip of the shape.
        sampler: of the field.

    Returns:
        (c, 3) points; (c,) whether each lies on an edge or corner of the shape; (c,) whether it has
        left its cell.
    """
    sides = _sides(rings, points, normals, piercing)
    low = corners.astype(np.float64)
    used = rings.points >= 0
    pierced = used & piercing[rings.points]
    chosen = np.where(pierced.any(axis=1, keepdims=True), pierced, used)
    weights = chosen / chosen.sum(axis=1, keepdims=True)
    middle = within(np.einsum("cl,cli->ci", weights, points[rings.points]), low)
    hubs = middle
    slopes, anchors, values = sides.normal, sides.middle, np.zeros(len(sides.ring))
    for round_ in range(1 + ROUNDS):
        if round_:
            slopes, anchors, values = nearer_values(
                hubs[sides.ring], sides.middle, slopes, anchors, values, sampler
            )
        apart = np.einsum("si,si->s", slopes, hubs[sides.ring] - anchors) + values
        moved = hubs - _least_squares(sides.ring, slopes, apart, len(rings.cells))
        hubs = within(moved, low, -FARTHEST)
    outside = np.abs(hubs - low - 0.5).max(axis=1, initial=0.0) - 0.5
    near = outside < REACH
    hubs = np.where(near[:, None], within(hubs, low), hubs)
    corner = (sides.borders > 2) | ~pierced.any(axis=1)
    sound = (near | (corner & may_leave)) & on_surface(hubs, sampler)
    middle[~sound] = _nearer_surface(middle[~sound], low[~sound], sampler)
    return np.where(sound[:, None], hubs, middle), sound, sound & ~near


def _nearer_surface(
    points: NDArray[np.float64], low: NDArray[np.float64], sampler: Sampler
) -> NDArray[np.float64]:
    """Points moved towards the surface along the gradient, within their cells."""
    value, gradient = sampler.value_and_gradient(points)
    size = np.maximum((gradient**2).sum(axis=1), np.finfo(np.float64).tiny)
    return within(points - (value / size)[:, None] * gradient, low)


def _least_squares(
    ring: NDArray[np.int64], slopes: NDArray[np.float64], apart: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """(count, 3) the shortest steps that best undo distances `apart` along unit `slopes`.

    Directions in which the sides of a ring hardly differ are left out: along an edge a point may
    stay where it is.
    """
    matrix = np.zeros((count, 3, 3))
    np.add.at(matrix, ring, slopes[:, :, None] * slopes[:, None, :])
    right = np.zeros((count, 3))
    np.add.at(right, ring, slopes * apart[:, None])
    size, direction = np.linalg.eigh(matrix)
    weak = size < 0.01 * size[:, -1:]
    inverse = np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, size))
    return np.einsum("cij,cj,ckj,ck->ci", direction, inverse, direction, right)
