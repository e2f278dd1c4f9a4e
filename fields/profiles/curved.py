"""Profiles with round sides, all exact, with tight bounds.

The formulas are those collected by Inigo Quilez ("2D distance functions",
https://iquilezles.org/articles/distfunctions2d/) unless a shape says otherwise, arranged so that
no root is taken on a surface.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Expression,
    X,
    Y,
    clamp,
    length,
    maximum,
    minimum,
    power,
    sqrt,
    square,
    where_negative,
)
from fields.operations import Body
from fields.primitives import primitive
from fields.profiles.edges import edges_distance, open_edges
from fields.profiles.outline import profile_body

_ORIGIN = (0.0, 0.0)


@primitive
def circle(radius: float, center: ArrayLike = _ORIGIN) -> Body:
    """A profile: a disc.

    Args:
        radius: greater than zero.
        center: `(2,)`.
    """
    r = arguments.positive("radius", radius)
    x, y = arguments.pair("center", center)
    return profile_body(length(X - x, Y - y) - r, (x - r, y - r), (x + r, y + r))


@primitive
def ring(radius: float, width: float) -> Body:
    """A profile: all points within width / 2 of a circle.

    Args:
        radius: of the circle in the middle.
        width: from the inner to the outer rim; less than 2 * radius.
    """
    r, half = _band(radius, width)
    reach = r + half
    distance = abs(length(X, Y) - r) - half
    return profile_body(distance, (-reach, -reach), (reach, reach))


@primitive
def arc(radius: float, width: float, degrees: float) -> Body:
    """A profile: a piece of a ring with round ends, symmetric about the +x axis.

    Args:
        radius: of the circle in the middle.
        width: from the inner to the outer rim; less than 2 * radius.
        degrees: the angle between the centres of the ends, below 360 by so much that the round
            ends do not meet.
    """
    r, half = _band(radius, width)
    half_angle = _half_angle(degrees)
    end_x, end_y = r * math.cos(half_angle), r * math.sin(half_angle)
    if half_angle > math.pi / 2 and end_y <= half:
        raise InputError("degrees", degrees, "the round ends meet", "pass less, or use ring")
    x, y = X, abs(Y)
    beyond = end_x * y - end_y * x
    middle = where_negative(beyond, abs(length(x, y) - r), length(x - end_x, y - end_y))
    top = (r if half_angle >= math.pi / 2 else end_y) + half
    return profile_body(middle - half, (end_x - half, -top), (r + half, top))


def _band(radius: float, width: float) -> tuple[float, float]:
    r, half = arguments.positive("radius", radius), arguments.positive("width", width) / 2
    if half >= r:
        raise InputError(
            "width", width, f"it closes the hole of radius = {r:g}", "pass width < 2 * radius"
        )
    return r, half


def _half_angle(degrees: float) -> float:
    angle = arguments.positive("degrees", degrees)
    if angle >= 360:
        raise InputError(
            "degrees", degrees, "that is a full turn or more", "pass less than 360, or use a circle"
        )
    return math.radians(angle / 2)


@primitive
def pie(radius: float, degrees: float) -> Body:
    """A profile: a sector of a disc, symmetric about the +x axis.

    Args:
        radius: greater than zero.
        degrees: the angle at the origin, below 360.
    """
    r = arguments.positive("radius", radius)
    half_angle = _half_angle(degrees)
    tip_x, tip_y = r * math.cos(half_angle), r * math.sin(half_angle)
    x, y = X, abs(Y)
    side = edges_distance(open_edges(np.array([(tip_x, tip_y), (0.0, 0.0)])), x, y)
    top = r if half_angle >= math.pi / 2 else tip_y
    return profile_body(maximum(length(x, y) - r, side), (min(tip_x, 0.0), -top), (r, top))


@primitive
def vesica(width: float, height: float) -> Body:
    """A profile: a lens, what two equal discs have in common, with its tips on the y axis.

    Args:
        width: across the middle; less than the height.
        height: from tip to tip.
    """
    w, h = arguments.positive("width", width) / 2, arguments.positive("height", height) / 2
    if w >= h:
        raise InputError("width", width, "it is not below the height", "turn it by rotate(90)")
    radius, shift = (h * h / w + w) / 2, (h * h / w - w) / 2
    x, y = abs(X), abs(Y)
    # Beyond the line from a disc's centre, (-shift, 0), through the tip, the tip is nearest.
    beyond = shift * y - h * (x + shift)
    distance = where_negative(-beyond, length(x, y - h), length(x + shift, y) - radius)
    return profile_body(distance, (-w, -h), (w, h))


@primitive
def moon(radius: float, bite: float, distance: float) -> Body:
    """A profile: a disc without another one, whose centre is at (distance, 0).

    Args:
        radius: of the disc, centred at the origin.
        bite: radius of the other disc.
        distance: between the centres; so that the two circles cross.
    """
    r, b = arguments.positive("radius", radius), arguments.positive("bite", bite)
    d = arguments.positive("distance", distance)
    if not abs(r - b) < d < r + b:
        raise InputError(
            "distance",
            distance,
            "the circles do not cross",
            f"pass more than {abs(r - b):g} and less than {r + b:g}",
        )
    tip_x = (r * r - b * b + d * d) / (2 * d)
    tip_y = math.sqrt(r * r - tip_x * tip_x)
    x, y = X, abs(Y)
    # The tip is nearest to what lies on the bitten side of both rays that run through it from the
    # centres: neither circle's nearest point is part of the outline there.
    past_disc = tip_x * y - tip_y * x
    past_bite = (tip_x - d) * y - tip_y * (x - d)
    rims = maximum(length(x, y) - r, b - length(x - d, y))
    tip = length(x - tip_x, y - tip_y)
    expression = where_negative(maximum(past_disc, past_bite), tip, rims)
    top = r if tip_x >= 0 else tip_y
    return profile_body(expression, (-r, -top), (tip_x, top))


@primitive
def line(a: ArrayLike, b: ArrayLike, width: float) -> Body:
    """A profile: all points within width / 2 of the segment from a to b.

    Args:
        a: `(2,)`, centre of one round end.
        b: `(2,)`, centre of the other; must differ from a.
        width: greater than zero.
    """
    start, end = np.array(arguments.pair("a", a)), np.array(arguments.pair("b", b))
    half = arguments.positive("width", width) / 2
    if (start == end).all():
        raise InputError(
            "b", b, "it equals a, so there is no direction", "use circle(width / 2, a)"
        )
    along_x, along_y = (end - start).tolist()
    x, y = X - float(start[0]), Y - float(start[1])
    t = clamp((along_x * x + along_y * y) / (along_x**2 + along_y**2), 0.0, 1.0)
    distance = length(x - t * along_x, y - t * along_y) - half
    return profile_body(distance, np.minimum(start, end) - half, np.maximum(start, end) + half)


@primitive
def uneven_capsule(bottom: float, top: float, height: float) -> Body:
    """A profile: two discs on the y axis and what is between their common tangents.

    Args:
        bottom: radius of the disc about (0, -height/2).
        top: radius of the disc about (0, height/2).
        height: between the centres; more than the difference of the radii.
    """
    low, high = arguments.positive("bottom", bottom), arguments.positive("top", top)
    h = arguments.positive("height", height)
    if h <= abs(low - high):
        raise InputError(
            "height", height, "one disc is inside the other", "use circle, or a larger height"
        )
    rise = (low - high) / h
    across = math.sqrt(1 - rise * rise)
    x, y = abs(X), Y + h / 2
    # The tangent's normal is (across, rise): how far along it, from the lower disc's foot.
    along = across * y - rise * x
    above_end = where_negative(
        across * h - along, length(x, y - h) - high, across * x + rise * y - low
    )
    expression = where_negative(along, length(x, y) - low, above_end)
    reach = max(low, high)
    ends = (min(-h / 2 - low, h / 2 - high), max(h / 2 + high, low - h / 2))
    return profile_body(expression, (-reach, ends[0]), (reach, ends[1]))


# --- the ellipse ----------------------------------------------------------------------

_NEWTON_STEPS = 7
"""From the start below the error at least halves in one step and squares in the others."""

_LEAST = 1e-14
"""Of the short radius: what stands for a zero distance from the long axis."""


@primitive
def ellipse(radii: ArrayLike) -> Body:
    """A profile: an ellipse, as a true distance.

    The foot of the perpendicular solves |n(s)| = 1 for n = (a x / (s + a^2 - b^2), b y / s), with a
    the long and b the short radius; the distance is (s - b^2) |(x / (s + a^2 - b^2), y / s)|
    (Eberly, "Distance from a point to an ellipse"). 1 / |n| is concave and increasing in s, so
    Newton's method from the left approaches the root from there, without safeguards; the start is
    the largest of lower bounds, one of which holds at the ends of the inner ridge.

    Args:
        radii: `(2,)`, along x and along y.
    """
    rx, ry = arguments.pair("radii", radii, arguments.positive)
    if rx == ry:
        distance = length(X, Y) - rx
    elif rx > ry:
        distance = _ellipse_distance(abs(X), abs(Y), rx, ry)
    else:
        distance = _ellipse_distance(abs(Y), abs(X), ry, rx)
    return profile_body(distance, (-rx, -ry), (rx, ry))


def _ellipse_distance(x: Expression, y: Expression, a: float, b: float) -> Expression:
    """For x, y >= 0 and a > b."""
    y = maximum(y, _LEAST * b)
    between = a * a - b * b
    ax, by = a * x, b * y
    # s^2 (s + e) >= b^2 y^2 between / 2 at the root, for e = between - a x where it is positive.
    ridge = square(by) * (between / 4)
    excess = maximum(between - ax, _LEAST * between)
    s = maximum(maximum(by, ax - between), minimum(power(ridge, 1 / 3), sqrt(ridge / excess)))
    for _ in range(_NEWTON_STEPS):
        u2, v2 = square(ax / (s + between)), square(by / s)
        n = sqrt(u2 + v2)
        s = s + square(n) * (n - 1) / (u2 / (s + between) + v2 / s)
    return (s - b * b) * length(x / (s + between), y / s)
