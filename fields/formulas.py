"""Parts of which the formulas of solids are made.

Three ways keep a formula short and its distance true:

* A half-plane: a solid of revolution is its profile in (distance from the axis, height), and
  the nearest point of the surface lies in the half-plane of the point itself.
* Reflections: where a solid is symmetric under a mirror, the nearest point of its surface to a
  point lies on the point's own side, for what crosses the mirror can be reflected back and is
  not longer. So the point is folded to one side and only the surface there is looked at.
* Orthogonal directions: a prism is the product of its profile and an interval, and offsets
  along orthogonal directions add as squares.

Gradients have to be right on the surface itself, where the square of an offset has none.
So what is signed is written as a plane's height where that is the distance, and a square root
only where the nearest point is an edge or a corner.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    clamp,
    length,
    maximum,
    minimum,
    sqrt,
    square,
    where_negative,
)
from fields.operations import Body, Matrix, shortest_turn
from fields.tags import Tags

Pair = tuple[float, float]

ORIGIN = (0.0, 0.0, 0.0)


# --- bodies ---------------------------------------------------------------------------


def exact_body(expression: Expression, low: ArrayLike, high: ArrayLike) -> Body:
    """A true signed distance, within the box from low to high."""
    return Body(expression, Tags.of_distance(_extent(low, high)))


def bounding_body(
    expression: Expression,
    low: ArrayLike,
    high: ArrayLike,
    *,
    exact: bool = False,
    lipschitz: float = 1.0,
    growth: float = 1.0,
) -> Body:
    """A field that is no distance, or is one only if `exact`, within the box."""
    if exact:
        return exact_body(expression, low, high)
    return Body(expression, Tags(False, lipschitz, _extent(low, high), growth))


def _extent(low: ArrayLike, high: ArrayLike) -> np.ndarray:
    return np.stack([np.asarray(low, np.float64), np.asarray(high, np.float64)])


# --- coordinates ----------------------------------------------------------------------


def about(center: ArrayLike) -> tuple[arguments.Vector, Coordinates]:
    """A checked centre, and the coordinates relative to it."""
    x, y, z = arguments.vector("center", center)
    return (x, y, z), (X - x, Y - y, Z - z)


def linear(weights: Sequence[float], point: Sequence[Expression]) -> Expression:
    """The dot product; components with weight 0 do not appear."""
    terms = [float(w) * p for w, p in zip(weights, point, strict=True) if w != 0]
    return sum(terms[1:], start=terms[0]) if terms else 0.0 * X


def along(axis: Matrix, start: Matrix) -> Coordinates:
    """Coordinates with their origin at `start` and their third axis along a unit vector."""
    relative = [q - float(s) for q, s in zip((X, Y, Z), start, strict=True)]
    u, v, w = (linear(column, relative) for column in shortest_turn(tuple(axis)).T)
    return (u, v, w)


def folded(point: tuple[Expression, ...], mirror: Sequence[float]) -> tuple[Expression, ...]:
    """The point itself if mirror . p >= 0, else its reflection; `mirror` is a unit vector."""
    behind = 2.0 * minimum(linear(mirror, point), 0.0)
    return tuple(p - float(m) * behind if m != 0 else p for p, m in zip(point, mirror, strict=True))


def folded_to_sector(u: Expression, v: Expression, sides: int) -> tuple[Expression, Expression]:
    """The point moved by mirrors of a regular polygon to an angle from 0 to pi / sides.

    The mirrors are the lines at multiples of pi / sides; each fold at the middle one of
    those that are left halves what is left, so it takes log2(sides) of them.
    """
    v, left = abs(v), sides
    while left > 1:
        middle = (left + 1) // 2
        angle = middle * math.pi / sides
        u, v = folded((u, v), (math.sin(angle), -math.cos(angle)))
        left = middle
    return u, v


# --- distances in a plane -------------------------------------------------------------


def outside_or_faces(faces: Expression, outside: Expression) -> Expression:
    """`outside` where some face distance is positive, else the largest face distance."""
    return where_negative(-faces, outside, faces)


def box_distance(offsets: tuple[Expression, ...]) -> Expression:
    """The distance to {all offsets <= 0}, for offsets measured along orthogonal axes."""
    return outside_or_faces(
        maximum(*offsets), length(*(maximum(offset, 0.0) for offset in offsets))
    )


def chain_distance(u: Expression, v: Expression, corners: Sequence[Pair]) -> Expression:
    """The distance to a convex polygon, from the part of its border where it is nearest.

    Args:
        u: first coordinate in the plane.
        v: second coordinate.
        corners: of the border, counter-clockwise. The whole border (the first corner again
            at the end), or one side of the mirrors that u and v have been folded by.
    """
    faces, squares = [], []
    for a, b in pairwise(corners):
        size = math.dist(a, b)
        if size == 0:
            continue
        tangent = ((b[0] - a[0]) / size, (b[1] - a[1]) / size)
        relative = (u - float(a[0]), v - float(a[1]))
        face = linear((tangent[1], -tangent[0]), relative)
        faces.append(face)
        squares.append(square(face) + square(beyond(linear(tangent, relative), size)))
    return outside_or_faces(maximum(*faces), sqrt(minimum(*squares)))


def beyond(position: Expression, size: float) -> Expression:
    """How far a position is past the nearer end of [0, size]; 0 between them."""
    return position - clamp(position, 0.0, size)


def pie_distance(
    across: Expression, forward: Expression, radius: float | None, half_angle: float
) -> Expression:
    """The distance to a sector of a disc, with its corner at the origin.

    Args:
        across: distance from the axis of symmetry, not negative.
        forward: position along that axis.
        radius: of the disc; None if it is infinite.
        half_angle: between the axis and each side, in radians, above 0 and below pi.
    """
    sine, cosine = math.sin(half_angle), math.cos(half_angle)
    side = cosine * across - sine * forward
    position = sine * across + cosine * forward
    excess = minimum(position, 0.0) if radius is None else beyond(position, radius)
    # Past its ends the side is as far as its nearer end, with the sign of the sector.
    far = length(side, excess)
    past = -position if radius is None else maximum(-position, position - radius)
    edge = where_negative(past, side, where_negative(side, -far, far))
    return edge if radius is None else maximum(edge, length(across, forward) - radius)


def prism_distance(profile: Expression, height: float) -> Expression:
    """The distance to a profile in x and y that is extruded along z, about z = 0."""
    return box_distance((profile, abs(Z) - height / 2))


def disc_reach(axis: Matrix) -> Matrix:
    """Half the size of the box around a disc of radius 1 whose normal is a unit vector."""
    return np.sqrt(np.maximum(1.0 - np.square(axis), 0.0))
