"""What the operations on fields compute, and which facts survive them.

Each rule takes one or more bodies (a formula with its tags) and gives a new one. The
methods of `fields.Field`, and the functions `fields.union`, `fields.translate` and so
on, call these rules; their users' documentation is there. The reasons behind the tags
are here, rule by rule; `fields.tags` defines the terms.

Sets below: A = {a <= 0}, and A + t for the extent of A grown by growth * t.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.arguments import Vector
from fields.errors import InputError
from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    maximum,
    minimum,
    remap,
    square,
)
from fields.tags import EVERYWHERE, Tags, are_apart, grown, hull, largest, linear_image, overlap

Matrix: TypeAlias = NDArray[np.float64]


class Body(NamedTuple):
    """A formula and what is known of it."""

    expression: Expression
    tags: Tags


Rule = Callable[..., Body]

RULES: dict[str, Rule] = {}
"""Every operation on fields by name: the methods that `fields.parse` accepts, and the
list from which the tests draw."""


def rule(function: Rule) -> Rule:
    """Enter a function into `RULES`."""
    RULES[function.__name__] = function
    return function


# --- combinations ---------------------------------------------------------------------


@rule
def union(*bodies: Body, smooth: float = 0.0) -> Body:
    """min(a, b), or with a blend radius k: min(a, b) - max(k - |a - b|, 0)**2 / (4 k).

    Lipschitz: the gradient is a convex combination of both, so the larger bound holds.
    Exact: the minimum of distances is exact outside, but inside an overlap it measures
    to surface that is no longer there. If the extents are apart there is no overlap,
    and every way from inside one to the surface of the other meets its own first.
    Extent: {min <= t} is the union of A + t and B + t. The blend lies at most k/4 below
    the minimum, so it is within the same sets with t + k/4 in place of t.
    """
    radius = arguments.not_negative("smooth", smooth)
    return reduce(lambda a, b: _union(a, b, radius), bodies)


def _union(a: Body, b: Body, radius: float) -> Body:
    growth = largest([a.tags.growth, b.tags.growth])
    extent = hull(a.tags.extent, b.tags.extent)
    if radius == 0:
        expression = minimum(a.expression, b.expression)
        exact = a.tags.exact and b.tags.exact and are_apart(a.tags.extent, b.tags.extent)
    else:
        expression = minimum(a.expression, b.expression) - _bulge(a, b, radius)
        exact = False
        extent = EVERYWHERE if growth is None else grown(extent, growth * radius / 4)
    lipschitz = largest([a.tags.lipschitz, b.tags.lipschitz])
    return Body(expression, Tags(exact, lipschitz, extent, growth))


@rule
def intersection(*bodies: Body, smooth: float = 0.0) -> Body:
    """max(a, b), or with a blend radius k: max(a, b) + max(k - |a - b|, 0)**2 / (4 k).

    Lipschitz: as for the union. Exact: never claimed; outside, near an edge where two
    surfaces meet, the maximum is less than the distance.
    Extent: {max <= t} is the intersection of A + t and B + t, and boxes grown on all
    sides overlap in the grown overlap. The blend only adds to the maximum. A field
    whose extent is everything restricts nothing, so its growth does not matter.
    """
    radius = arguments.not_negative("smooth", smooth)
    return reduce(lambda a, b: _intersection(a, b, radius), bodies)


def _intersection(a: Body, b: Body, radius: float) -> Body:
    expression = maximum(a.expression, b.expression)
    if radius > 0:
        expression = expression + _bulge(a, b, radius)
    restricting = [tags for tags in (a.tags, b.tags) if np.isfinite(tags.extent).any()]
    return Body(
        expression,
        Tags(
            exact=False,
            lipschitz=largest([a.tags.lipschitz, b.tags.lipschitz]),
            extent=overlap(a.tags.extent, b.tags.extent),
            growth=largest([1.0, *(tags.growth for tags in restricting)]),
        ),
    )


@rule
def difference(*bodies: Body, smooth: float = 0.0) -> Body:
    """max(a, -b): the intersection of the first with the complements of the others."""
    first, *others = bodies
    return intersection(first, *(negate(other) for other in others), smooth=smooth)


def _bulge(a: Body, b: Body, radius: float) -> Expression:
    # With d = a - b and |d| < k the blended gradient is (1/2 - d/2k) grad a
    # + (1/2 + d/2k) grad b: weights in [0, 1] that sum to 1, and 0 or 1 at |d| = k.
    nearness = maximum(radius - abs(a.expression - b.expression), 0.0)
    return square(nearness) * (0.25 / radius)


@rule
def negate(body: Body) -> Body:
    """-a. A distance stays one; the inside is now the outside, hence unbounded."""
    tags = Tags(body.tags.exact, body.tags.lipschitz, EVERYWHERE, growth=1.0)
    return Body(-body.expression, tags)


# --- motions --------------------------------------------------------------------------


@rule
def translate(body: Body, offset: ArrayLike) -> Body:
    """a(p - offset). Every tag survives; the extent moves along."""
    x, y, z = arguments.vector("offset", offset)
    extent = body.tags.extent + np.array([x, y, z])
    tags = Tags(body.tags.exact, body.tags.lipschitz, extent, body.tags.growth)
    return Body(remap(body.expression, (X - x, Y - y, Z - z)), tags)


@rule
def rotate(body: Body, rotation: float | ArrayLike, axis: str | ArrayLike = "z") -> Body:
    """a(R^T p), for R a turn by so many degrees about an axis, or a rotation matrix."""
    if np.ndim(rotation) == 0:
        turn = _turn(arguments.number("rotation", rotation), arguments.direction("axis", axis))
    else:
        turn = _rotation_matrix(rotation)
    return _rotated(body, turn)


@rule
def orient(body: Body, axis: str | ArrayLike) -> Body:
    """a(R^T p), for R the shortest turn that sends +z to the axis."""
    return _rotated(body, shortest_turn(arguments.direction("axis", axis)))


def _rotated(body: Body, turn: Matrix) -> Body:
    """The box around a rotated cube is wider than the cube by the largest row sum of |R|.

    A distance has growth 1 in any position; other growths take that factor.
    """
    tags = body.tags
    growth = tags.growth
    if growth is not None and not tags.exact:
        growth *= float(np.abs(turn).sum(axis=1).max())
    extent = linear_image(tags.extent, turn)
    expression = remap(body.expression, _linear_coordinates(turn.T))
    return Body(expression, Tags(tags.exact, tags.lipschitz, extent, growth))


@rule
def scale(body: Body, factor: float | ArrayLike) -> Body:
    """m a(p / factor), m the smallest of the three factors.

    The gradient is m S^-1 grad a, no longer than grad a. A uniform scale keeps a
    distance a distance; others do not. {m a(p / s) <= t} is the image of {a <= t / m},
    so growth takes the factor max(s) / m.
    """
    factors = arguments.numbers_or_one("factor", factor)
    least, most = min(factors), max(factors)
    x, y, z = factors
    tags = Tags(
        exact=body.tags.exact and least == most,
        lipschitz=body.tags.lipschitz,
        extent=body.tags.extent * np.array(factors),
        growth=None if body.tags.growth is None else body.tags.growth * most / least,
    )
    return Body(remap(body.expression, (X / x, Y / y, Z / z)) * least, tags)


# --- thickness ------------------------------------------------------------------------


@rule
def offset(body: Body, distance: float) -> Body:
    """a - distance: the level set a = distance becomes the surface.

    Exact: not claimed. Growing an exact distance leaves it exact outside the new
    surface; inside, beyond a concave part, it measures to surface that has merged away.
    Extent: grows by growth * distance. Shrinking by r leaves points of depth r, which
    are r / lipschitz away from the old surface, hence from the extent's sides.
    """
    amount = arguments.number("distance", distance)
    tags = body.tags
    extent, growth = tags.extent, tags.growth
    if amount > 0:
        extent = EVERYWHERE if growth is None else grown(extent, growth * amount)
    elif amount < 0 and tags.lipschitz:
        extent = grown(extent, amount / tags.lipschitz)
        growth = None if growth is None else max(growth, 1 / tags.lipschitz)
    exact = tags.exact and amount == 0
    return Body(body.expression - amount, Tags(exact, tags.lipschitz, extent, growth))


@rule
def shell(body: Body, thickness: float) -> Body:
    """|a| - thickness / 2: the points with |a| <= thickness / 2.

    Exact: not claimed, for the reason given for the offset.
    """
    half = arguments.positive("thickness", thickness) / 2
    tags = body.tags
    extent = EVERYWHERE if tags.growth is None else grown(tags.extent, tags.growth * half)
    return Body(abs(body.expression) - half, Tags(False, tags.lipschitz, extent, tags.growth))


# --- rotation matrices ----------------------------------------------------------------


def _linear_coordinates(matrix: Matrix) -> Coordinates:
    x, y, z = (float(r[0]) * X + float(r[1]) * Y + float(r[2]) * Z for r in matrix)
    return (x, y, z)


def _cross_matrix(axis: ArrayLike) -> Matrix:
    x, y, z = np.asarray(axis, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _turn(degrees: float, axis: Vector) -> Matrix:
    """Rodrigues' formula; quarter turns about x, y or z are exact permutations."""
    quarters, rest = divmod(degrees, 90.0)
    sine, cosine = math.sin(math.radians(rest)), math.cos(math.radians(rest))
    for _ in range(int(quarters % 4)):
        sine, cosine = cosine, -sine
    cross = _cross_matrix(axis)
    return np.eye(3) + sine * cross + (1 - cosine) * (cross @ cross)


def shortest_turn(target: Vector) -> Matrix:
    """The rotation by the least angle that sends +z to a unit vector.

    I + K + K^2 / (1 + c), with K the cross product with z x target and c = target . z.
    """
    x, y, z = target
    sine_squared = x * x + y * y
    if z < 0 and sine_squared == 0:
        return np.diag([1.0, -1.0, -1.0])
    cross = _cross_matrix((-y, x, 0.0))
    # Near -z the divisor 1 + c is written sin^2 / (1 - c), which does not cancel.
    divisor = 1 + z if z >= 0 else sine_squared / (1 - z)
    return np.eye(3) + cross + cross @ cross / divisor


def _rotation_matrix(value: ArrayLike) -> Matrix:
    """A given matrix, checked to 1e-6 (what float32 rounding leaves) and made orthogonal."""
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    remedy = "pass a 3x3 rotation matrix, or an angle in degrees and an axis"
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise InputError("rotation", value, "it is not a 3x3 matrix of finite numbers", remedy)
    error = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if error > 1e-6 or np.linalg.det(matrix) < 0:
        cause = (
            "it reflects" if error <= 1e-6 else f"R R^T differs from the identity by {error:.1e}"
        )
        raise InputError("rotation", value, cause, remedy)
    if error > 0:
        left, _, right = np.linalg.svd(matrix)
        matrix = left @ right
    return matrix
