"""What the operations on fields compute, and which facts survive them.

Each rule takes one or more bodies (a formula with its tags) and gives a new one. The
methods of `fields.Field`, and the functions `fields.union`, `fields.translate` and so
on, call these rules; their users' documentation is there. The reasons behind the tags
are here, rule by rule; `fields.tags` defines the terms.

Sets below: A = {a <= 0}, and A + t for the extent of A grown by growth * t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce
from typing import NamedTuple, TypeAlias, Unpack

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
    exp,
    log,
    maximum,
    minimum,
    remap,
)
from fields.joints import Joint, Profile, chosen, with_joints
from fields.tags import (
    EVERYWHERE,
    Tags,
    are_apart,
    deepened,
    hull,
    largest,
    linear_image,
    overlap,
)

Matrix: TypeAlias = NDArray[np.float64]


class Body(NamedTuple):
    """A formula and what is known of it."""

    expression: Expression
    tags: Tags


Rule = Callable[..., Body]

_ROUNDED_UP = 1 + 1e-14
"""For norms that a decomposition computes, to some units in the last place."""

RULES: dict[str, Rule] = {}
"""Every operation on fields by name: the methods that `fields.parse` accepts, and the
list from which the tests draw."""


def rule(function: Rule) -> Rule:
    """Enter a function into `RULES`."""
    RULES[function.__name__] = function
    return function


# --- combinations ---------------------------------------------------------------------


@rule
@with_joints
def union(*bodies: Body, **joint: Unpack[Joint]) -> Body:
    """min(a, b), or with a joint: min(a, b) - material(|a - b|), see `fields.joints`.

    Lipschitz: the gradient is a convex combination of both, so the larger bound holds.
    Exact: the minimum of distances is exact outside, but inside an overlap it measures
    to surface that is no longer there. If the extents are apart there is no overlap,
    and every way from inside one to the surface of the other meets its own first.
    Extent: {min <= t} is the union of A + t and B + t. A joint lies at most its depth
    below the minimum, so it is within the same sets with t + depth in place of t.
    """
    return _folded(bodies, chosen(joint), _union, _soft_union)


@rule
@with_joints
def intersection(*bodies: Body, **joint: Unpack[Joint]) -> Body:
    """max(a, b), or with a joint: max(a, b) + material(|a - b|), see `fields.joints`.

    Lipschitz: as for the union. Exact: never claimed; outside, near an edge where two
    surfaces meet, the maximum is less than the distance.
    Extent: {max <= t} is the intersection of A + t and B + t, and boxes grown on all
    sides overlap in the grown overlap. A joint only adds to the maximum. A field
    whose extent is everything restricts nothing, so its growth does not matter.
    """
    return _folded(bodies, chosen(joint), _intersection, _soft_intersection)


@rule
@with_joints
def difference(*bodies: Body, **joint: Unpack[Joint]) -> Body:
    """max(a, -b): the intersection of the first with the complements of the others."""
    first, *others = bodies
    return intersection(first, *(negate(other) for other in others), **joint)


@rule
def symmetric_difference(*bodies: Body) -> Body:
    """max(min(a, b), -max(a, b)): in a or in b, but not in both.

    Lipschitz: every piece is a or b or a complement. Exact: not claimed, as for the
    difference. Extent: the value is at least min(a, b), so that of the union holds.
    """
    return reduce(_symmetric_difference, bodies)


def _folded(
    bodies: Sequence[Body],
    profile: Profile | None,
    pair: Callable[[Body, Body, Profile | None], Body],
    exponential: Callable[[Sequence[Body], float], Body],
) -> Body:
    """From left to right, but the exponential joint all at once: its order plays no part."""
    if profile is not None and profile.name == "exponential" and len(bodies) > 1:
        return exponential(bodies, profile.size)
    return reduce(lambda a, b: pair(a, b, profile), bodies)


def _union(a: Body, b: Body, profile: Profile | None) -> Body:
    expression, tags = minimum(a.expression, b.expression), _tags_of_union(a.tags, b.tags)
    if profile is None:
        return Body(expression, tags)
    return Body(expression - _material(a, b, profile), deepened(tags, profile.depth))


def _intersection(a: Body, b: Body, profile: Profile | None) -> Body:
    expression, tags = maximum(a.expression, b.expression), _tags_of_intersection(a.tags, b.tags)
    if profile is not None:
        expression = expression + _material(a, b, profile)
    return Body(expression, tags)


def _symmetric_difference(a: Body, b: Body) -> Body:
    either, both = minimum(a.expression, b.expression), maximum(a.expression, b.expression)
    return Body(maximum(either, -both), replace(_tags_of_union(a.tags, b.tags), exact=False))


def _material(a: Body, b: Body, profile: Profile) -> Expression:
    return profile.material(abs(a.expression - b.expression))


def _soft_union(bodies: Sequence[Body], size: float) -> Body:
    tags = reduce(_tags_of_union, (body.tags for body in bodies))
    expression = _soft_minimum([body.expression for body in bodies], size)
    return Body(expression, deepened(tags, size * math.log(len(bodies))))


def _soft_intersection(bodies: Sequence[Body], size: float) -> Body:
    tags = reduce(_tags_of_intersection, (body.tags for body in bodies))
    return Body(-_soft_minimum([-body.expression for body in bodies], size), tags)


def _soft_minimum(values: Sequence[Expression], size: float) -> Expression:
    """-size log(sum of exp(-value / size)), with the least value taken out of the exponentials.

    Its gradient is the mean of all gradients with those exponentials as weights.
    """
    least = minimum(*values)
    total = reduce(lambda a, b: a + b, (exp((least - value) / size) for value in values))
    return least - log(total) * size


def _tags_of_union(a: Tags, b: Tags) -> Tags:
    return Tags(
        exact=a.exact and b.exact and are_apart(a.extent, b.extent),
        lipschitz=largest([a.lipschitz, b.lipschitz]),
        extent=hull(a.extent, b.extent),
        growth=largest([a.growth, b.growth]),
    )


def _tags_of_intersection(a: Tags, b: Tags) -> Tags:
    restricting = [tags for tags in (a, b) if np.isfinite(tags.extent).any()]
    return Tags(
        exact=False,
        lipschitz=largest([a.lipschitz, b.lipschitz]),
        extent=overlap(a.extent, b.extent),
        growth=largest([1.0, *(tags.growth for tags in restricting)]),
    )


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
    return rotated(body, turn)


@rule
def orient(body: Body, axis: str | ArrayLike) -> Body:
    """a(R^T p), for R the shortest turn that sends +z to the axis."""
    return rotated(body, shortest_turn(arguments.direction("axis", axis)))


def rotated(body: Body, turn: Matrix) -> Body:
    """a(R^T p), for R an orthogonal matrix, which may also reflect.

    The box around a rotated cube is wider than the cube by the largest row sum of |R|.

    A distance has growth 1 in any position; other growths take that factor.
    """
    tags = body.tags
    growth = tags.growth
    if growth is not None and not tags.exact:
        growth *= float(np.abs(turn).sum(axis=1).max())
    extent = linear_image(tags.extent, turn)
    expression = remap(body.expression, _linear_coordinates(turn.T))
    return Body(expression, Tags(tags.exact, tags.lipschitz, extent, growth))


def about_axis(
    body: Body,
    axis: Vector,
    origin: Vector,
    change: Callable[[Body], Body],
    towards: Vector | None = None,
) -> Body:
    """A change of a body made in coordinates measured from an origin, with z along an axis.

    Args:
        towards: a direction that x follows as far as it is across the axis; any if None.
    """
    frame, place = axis_frame(axis, towards), np.array(origin)
    local = rotated(translate(body, -place), frame.T)
    return translate(rotated(change(local), frame), place)


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


@rule
def affine(body: Body, linear: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Body:
    """a(M^-1 (p - translation)).

    Lipschitz: times the norm of M^-1. Exact: not claimed. Extent: a point of the box grown by d
    is moved at most d times the largest row sum of |M| farther along an axis than one of the box.
    """
    matrix = _invertible(linear)
    shift = np.array(arguments.vector("translation", translation))
    inverse, tags = np.linalg.inv(matrix), body.tags
    stretch = float(np.linalg.norm(inverse, 2)) * _ROUNDED_UP
    spread = float(np.abs(matrix).sum(axis=1).max())
    expression = remap(body.expression, _linear_coordinates(inverse))
    x, y, z = shift.tolist()
    moved = Tags(
        exact=False,
        lipschitz=None if tags.lipschitz is None else tags.lipschitz * stretch,
        extent=linear_image(tags.extent, matrix) + shift,
        growth=None if tags.growth is None else tags.growth * spread,
    )
    return Body(remap(expression, (X - x, Y - y, Z - z)), moved)


# --- rotation matrices ----------------------------------------------------------------


def _linear_coordinates(matrix: Matrix) -> Coordinates:
    x, y, z = (float(r[0]) * X + float(r[1]) * Y + float(r[2]) * Z for r in matrix)
    return (x, y, z)


def _cross_matrix(axis: ArrayLike) -> Matrix:
    x, y, z = np.asarray(axis, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def axis_frame(axis: ArrayLike, towards: ArrayLike | None = None) -> Matrix:
    """A rotation whose third column is a unit axis, and whose first turns to `towards`.

    Raises:
        InputError: `towards` is along the axis.
    """
    axis = np.asarray(axis, dtype=np.float64)
    direction = np.eye(3)[np.abs(axis).argmin()] if towards is None else np.asarray(towards)
    across = direction - (direction @ axis) * axis
    length = np.linalg.norm(across)
    if length < 1e-6:
        raise InputError(
            "towards", towards, "it is along the axis", "pass a direction across the axis"
        )
    first = across / length
    return np.stack([first, np.cross(axis, first), axis], 1)


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


def _invertible(value: ArrayLike) -> Matrix:
    remedy = "pass a 3x3 matrix, which may shear, stretch, turn and reflect, but not flatten"
    matrix = _matrix("linear", value, remedy)
    with np.errstate(divide="ignore"):
        condition = np.linalg.cond(matrix)
    if not condition < 1 / np.finfo(np.float64).eps:
        raise InputError("linear", value, "it is singular: it flattens space", remedy)
    return matrix


def _matrix(argument: str, value: ArrayLike, remedy: str) -> Matrix:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise InputError(argument, value, "it is not a 3x3 matrix of finite numbers", remedy)
    return matrix


def _rotation_matrix(value: ArrayLike) -> Matrix:
    """A given matrix, checked to 1e-6 (what float32 rounding leaves) and made orthogonal."""
    remedy = "pass a 3x3 rotation matrix, or an angle in degrees and an axis"
    matrix = _matrix("rotation", value, remedy)
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
