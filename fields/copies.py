"""Operations that make several copies of a shape, or of a half of it; see `fields.operations`.

Folding space so that one copy serves for all is what makes such operations cheap, and what makes
them wrong: the nearest copy need not be the one in whose cell a point lies, and then the field
jumps at the border of two cells. Here a point sees all the copies in a *window* around it, which
slides with the point by whole copies, and whose size follows from the shape's bounds:

* No copy outside of the window reaches nearer than a number c > 0 to the point (its *reach*). Every
  copy's field is made at least the distance to its own box (`floored`), so it is at least c there.
* Hence min(window, c) = min(all copies, c): the value does not depend on the window, so it has no
  jumps, and the Lipschitz bound of the copies holds across all borders.
* Far from all copies the distance to the box around them takes over, if that is larger.

So the zero set is exactly that of the union of all copies, overlapping or not, and so are the
values up to c; beyond, they are lower bounds of it. None of these operations is injective as a map
of space, except `mirror`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.enclosure import floored, raised
from fields.errors import InputError
from fields.expression import (
    Coordinates,
    Expression,
    Operand,
    X,
    Y,
    Z,
    atan2,
    clamp,
    cos,
    floor,
    minimum,
    modulo,
    remap,
    sin,
)
from fields.operations import Body, about_axis, rotated, rule, translate
from fields.tags import Box, Tags, hull, linear_image, overlap

LIMIT = 1000
"""The most copies that one point may have to see."""

_ORIGIN = (0.0, 0.0, 0.0)


class _Window(NamedTuple):
    """The copies that a point has to see, of a row of equidistant ones.

    Attributes:
        first: the index of the first of them.
        size: how many they are.
        reach: the least distance to any other copy.
    """

    first: Operand
    size: int
    reach: float


def _window(position: Expression, step: float, low: float, high: float, count: int | None):
    """The window on a row of copies, numbered from 0, or on both sides of 0 if it has no end.

    Copy i covers [i * step + low, i * step + high]; its middle is i * step + middle. The size + 1
    nearest middles are at most (size + 1) / 2 steps away, so all others cover nothing within
    (size * step - width) / 2. A window one larger than would do for that to be positive makes it
    more than half a step.
    """
    width, middle = high - low, (low + high) / 2
    size = math.floor(width / step) + 2
    if count is not None and count <= size:
        return _Window(0.0, count, math.inf)
    first: Expression = floor((position - middle) / step + (1 - size / 2))
    if count is not None:
        first = clamp(first, 0.0, float(count - size))
    return _Window(first, size, (size * step - width) / 2)


def _united(
    body: Body, places: Sequence[Coordinates], reach: float, extent: Box, argument: str, value
) -> Body:
    """The union of copies of a floored body seen at several places; see the module's docstring.

    Lipschitz: that of the body, as its copies are moved rigidly; or 1, that of the distance to the
    extent. Growth: 1, as every copy is at least the distance to its box, all the more to the
    extent, and so is the distance that replaces them where they are cut off at the reach.
    """
    if len(places) > LIMIT:
        raise InputError(
            argument,
            value,
            f"{len(places)} copies overlap at one point, judged by the field's bounds",
            "space them wider, or make fewer",
        )
    expression = minimum(*(remap(body.expression, place) for place in places))
    if math.isfinite(reach):
        expression = raised(minimum(expression, reach), extent)
    return Body(expression, Tags(False, body.tags.lipschitz, extent, 1.0))


# --- rows -----------------------------------------------------------------------------


@rule
def repeat(
    body: Body,
    spacing: float | ArrayLike,
    count: int | ArrayLike | None = None,
    mirrored: bool = False,
) -> Body:
    """The union of a(p - i * spacing), for all whole i, or for `count` of them about the origin.

    `mirrored`: every second copy along each axis is reflected in its own middle plane. See the
    module for windows and tags.
    """
    steps = arguments.numbers_or_one("spacing", spacing, arguments.not_negative)
    if not any(steps):
        raise InputError("spacing", spacing, "all copies are in one place", "pass a positive one")
    counts = (None,) * 3 if count is None else arguments.numbers_or_one("count", count, _whole)
    body = floored(body)
    extent, reach = body.tags.extent.copy(), math.inf
    choices: list[list[Expression]] = []
    for axis, (coordinate, step, n) in enumerate(zip((X, Y, Z), steps, counts, strict=True)):
        if step == 0:
            choices.append([coordinate])
            continue
        low, high = _sides(body.tags.extent[:, axis], "xyz"[axis], "spacing", spacing)
        if mirrored:
            low, high = min(low, -high), max(high, -low)
        lead = math.inf if n is None else (n - 1) / 2 * step
        extent[:, axis] = low - lead, high + lead
        position = coordinate if n is None else coordinate + lead
        first, size, seen = _window(position, step, low, high, None if n is None else int(n))
        reach = min(reach, seen)
        indices = [first + j for j in range(size)]
        choices.append(
            [
                (position - i * step) * (1 - 2 * modulo(i, 2.0))
                if mirrored
                else position - i * step
                for i in indices
            ]
        )
    return _united(body, list(product(*choices)), reach, extent, "spacing", spacing)


@rule
def linear_array(body: Body, count: int, offset: ArrayLike) -> Body:
    """The union of a(p - i * offset), i = 0, ..., count - 1.

    See the module for windows and tags.
    """
    n = arguments.whole("count", count)
    by = np.array(arguments.vector("offset", offset))
    step = float(np.linalg.norm(by))
    if step == 0:
        raise InputError("offset", offset, "all copies are in one place", "pass another vector")
    if n == 1:
        return body
    body = floored(body)
    along = by / step
    # The box's range along the offset; other directions need not be bounded.
    ends = linear_image(body.tags.extent, np.stack([along] * 3))[:, 0]
    low, high = _sides(ends, "the offset", "offset", offset)
    position = sum((float(c) * axis for c, axis in zip(along, (X, Y, Z), strict=True)), start=0.0)
    first, size, reach = _window(position, step, low, high, n)
    places = []
    for j in range(size):
        x, y, z = (axis - (first + j) * float(c) for c, axis in zip(by, (X, Y, Z), strict=True))
        places.append((x, y, z))
    extent = hull(body.tags.extent, body.tags.extent + (n - 1) * by)
    return _united(body, places, reach, extent, "offset", offset)


def _sides(ends: np.ndarray, direction: str, argument: str, value: object) -> tuple[float, float]:
    low, high = (float(end) for end in ends)
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InputError(
            argument,
            value,
            f"the field has no bounds along {direction}, so every copy may be everywhere",
            "intersect it with a box first",
        )
    return low, high


def _whole(argument: str, value: object) -> float:
    return float(arguments.whole(argument, value))


# --- circles --------------------------------------------------------------------------


@rule
def circular_array(body: Body, count: int, axis: str | ArrayLike = "z") -> Body:
    """The union of `count` copies turned about an axis through the origin by equal angles.

    The window is one of angles. A shape whose box keeps at least r from the axis and spans an
    angle w about it leaves, outside of a window of m copies an angle t apart, at least
    r sin(min((m t - w) / 2, 90 degrees)) between the point and any other copy: the distance from a
    ray to points no nearer than r to its origin that far from it in angle. If the box meets the
    axis, all copies are seen.
    """
    n = arguments.whole("count", count)
    if n == 1:
        return body
    about = arguments.direction("axis", axis)
    return about_axis(floored(body), about, _ORIGIN, lambda local: _around(local, n, count))


def _around(body: Body, n: int, count: int) -> Body:
    turn = 2 * math.pi / n
    turns = [_about_z(turn * i) for i in range(n)]
    extent = body.tags.extent
    for matrix in turns:
        extent = hull(extent, linear_image(body.tags.extent, matrix))
    nearest, middle, width = _polar_range(body.tags.extent)
    size = math.floor(width / turn) + 2
    if size >= n:
        places = [_turned_back(matrix[0, 0], matrix[1, 0]) for matrix in turns]
        return _united(body, places, math.inf, extent, "count", count)
    cosine, sine = math.cos(middle), math.sin(middle)
    angle = atan2(cosine * Y - sine * X, cosine * X + sine * Y)
    first = floor(angle / turn + (1 - size / 2))
    angles = [(first + j) * turn for j in range(size)]
    reach = nearest * math.sin(min((size * turn - width) / 2, math.pi / 2))
    return _united(
        body, [_turned_back(cos(a), sin(a)) for a in angles], reach, extent, "count", count
    )


def _polar_range(extent: Box) -> tuple[float, float, float]:
    """Of a box about the z axis: its distance from the axis, and its angles' middle and width."""
    (x0, y0), (x1, y1) = extent[:, :2].tolist()
    nearest = math.hypot(max(x0, -x1, 0.0), max(y0, -y1, 0.0))
    if nearest == 0 or not np.isfinite(extent[:, :2]).all():
        return 0.0, 0.0, 2 * math.pi
    middle = math.atan2((y0 + y1) / 2, (x0 + x1) / 2)
    corners = [math.atan2(y, x) - middle for x in (x0, x1) for y in (y0, y1)]
    # A box that leaves the axis out is seen under less than half a turn.
    widest = max(abs(math.remainder(corner, 2 * math.pi)) for corner in corners)
    return nearest, middle, 2 * widest


def _about_z(angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _turned_back(cosine: Operand, sine: Operand) -> Coordinates:
    return (cosine * X + sine * Y, cosine * Y - sine * X, Z)


# --- reflections ----------------------------------------------------------------------


@rule
def mirror(body: Body, axis: str | ArrayLike = "x", point: ArrayLike = _ORIGIN) -> Body:
    """a(p - 2 n (n . (p - point))): a motion, so every tag survives."""
    n = np.array(arguments.direction("axis", axis))
    place = np.array(arguments.vector("point", point))
    return translate(rotated(translate(body, -place), np.eye(3) - 2 * np.outer(n, n)), place)


@rule
def symmetry(body: Body, axis: str | ArrayLike = "x", point: ArrayLike = _ORIGIN) -> Body:
    """a(x, y, |z|) in a frame with z along the axis: the half in front of a plane, and its image.

    Lipschitz: folding has constant 1. Exact: only if the field is, and all of its extent is in
    front of the plane: then neither part's nearest surface is the other's. Extent: that part of it
    in front, and its image.
    """
    about = arguments.direction("axis", axis)
    return about_axis(body, about, arguments.vector("point", point), _folded)


def _folded(body: Body) -> Body:
    tags = body.tags
    front = np.array([[-np.inf, -np.inf, 0.0], [np.inf, np.inf, np.inf]])
    extent = overlap(tags.extent, front)
    height = max(float(extent[1, 2]), 0.0)
    extent[:, 2] = -height, height
    exact = tags.exact and bool(tags.extent[0, 2] > 0)
    return Body(
        remap(body.expression, (X, Y, abs(Z))), Tags(exact, tags.lipschitz, extent, tags.growth)
    )
