"""Profiles with straight sides, all exact, with tight bounds.

Shapes with mirrors fold the plane onto one piece of it and measure to the few edges there
(`fields.profiles.edges`); the others are polygons.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.errors import InputError
from fields.expression import Expression, X, Y, maximum, minimum, where_negative
from fields.formulas import box_distance
from fields.operations import Body
from fields.primitives import primitive
from fields.profiles.edges import edges_distance, open_edges
from fields.profiles.outline import (
    outline_body,
    outline_distance,
    plane_extent,
    profile_body,
)
from fields.profiles.simple import plane_points, simple_polygon
from fields.tags import Tags

_ORIGIN = (0.0, 0.0)


def pair_or_one(argument: str, value: float | ArrayLike) -> tuple[float, float]:
    """Two positive numbers, or one that is used twice."""
    pair = (value, value) if np.ndim(value) == 0 else value
    return arguments.pair(argument, pair, arguments.positive)


# --- rectangles -----------------------------------------------------------------------


@primitive
def rectangle(size: float | ArrayLike, center: ArrayLike = _ORIGIN) -> Body:
    """A profile: a rectangle with sides along x and y.

    Args:
        size: the full edge length of a square, or two of them.
        center: `(2,)`.
    """
    half = np.array(pair_or_one("size", size)) / 2
    x, y = arguments.pair("center", center)
    offsets = (abs(X - x) - float(half[0]), abs(Y - y) - float(half[1]))
    return profile_body(box_distance(offsets), np.subtract((x, y), half), np.add((x, y), half))


@primitive
def rounded_rectangle(size: float | ArrayLike, radius: float | ArrayLike) -> Body:
    """A profile: a rectangle with round corners, within the rectangle of the same size.

    Args:
        size: the full edge length of a square, or two of them.
        radius: of all corners; or four of them, which may be zero, counter-clockwise from the
            corner at (+x, +y). At most half of the shorter edge.
    """
    half = np.array(pair_or_one("size", size)) / 2
    radii = _corner_radii(radius, float(half.min()))
    corner: Expression | float = radii[0]
    if len(set(radii)) > 1:
        corner = where_negative(
            Y, where_negative(X, radii[2], radii[3]), where_negative(X, radii[1], radii[0])
        )
    offsets = (abs(X) - float(half[0]) + corner, abs(Y) - float(half[1]) + corner)
    return profile_body(box_distance(offsets) - corner, -half, half)


def _corner_radii(radius: float | ArrayLike, most: float) -> list[float]:
    values = np.asarray(radius, dtype=object).reshape(-1).tolist()
    if len(values) not in (1, 4):
        raise InputError(
            "radius", radius, f"{len(values)} radii for four corners", "pass one radius or four"
        )
    check = arguments.positive if len(values) == 1 else arguments.not_negative
    radii = [check("radius", value) for value in values]
    if max(radii) > most:
        raise InputError(
            "radius",
            radius,
            f"it is more than half of the shorter edge, {2 * most:g}",
            "pass a smaller radius or a larger size",
        )
    return radii if len(radii) == 4 else 4 * radii


@primitive
def strip(width: float) -> Body:
    """A profile: all points within width / 2 of the x axis; endless along x.

    Args:
        width: greater than zero.
    """
    half = arguments.positive("width", width) / 2
    return profile_body(abs(Y) - half, (-math.inf, -half), (math.inf, half))


@primitive
def cross(size: float, width: float) -> Body:
    """A profile: a plus sign, two equal bars along x and y.

    Args:
        size: length of the bars.
        width: of the bars; less than their length.
    """
    half = arguments.positive("size", size) / 2
    arm = arguments.positive("width", width) / 2
    if arm >= half:
        raise InputError("width", width, "the bars are as wide as long", "use rectangle(size)")
    x, y = abs(X), abs(Y)
    end = open_edges(np.array([(half, 0.0), (half, arm), (arm, arm)]))
    distance = edges_distance(end, maximum(x, y), minimum(x, y))
    return profile_body(distance, (-half, -half), (half, half))


# --- few corners ----------------------------------------------------------------------


@primitive
def triangle(width: float, height: float) -> Body:
    """A profile: an isosceles triangle with its base below, centred at the origin.

    The corners are (-width/2, -height/2), (width/2, -height/2) and (0, height/2). An equilateral
    one is `regular_polygon(3, radius)`, any other is a `polygon`.

    Args:
        width: of the base.
        height: of the apex over the base.
    """
    w, h = arguments.positive("width", width) / 2, arguments.positive("height", height) / 2
    return _mirrored([(0.0, -h), (w, -h), (0.0, h)])


@primitive
def trapezoid(bottom: float, top: float, height: float) -> Body:
    """A profile: an isosceles trapezoid, centred at the origin.

    Args:
        bottom: length of the side at y = -height/2.
        top: length of the side at y = +height/2.
        height: greater than zero.
    """
    b, t = arguments.positive("bottom", bottom) / 2, arguments.positive("top", top) / 2
    h = arguments.positive("height", height) / 2
    return _mirrored([(0.0, -h), (b, -h), (t, h), (0.0, h)])


def _mirrored(points: list[tuple[float, float]]) -> Body:
    """A shape with the mirror x = 0 from its outline at x >= 0, counter-clockwise."""
    right = np.array(points)
    reach = right.max(axis=0)
    return profile_body(edges_distance(open_edges(right), abs(X), Y), -reach, reach)


@primitive
def rhombus(width: float, height: float) -> Body:
    """A profile: a rhombus with corners on the axes.

    Args:
        width: the diagonal along x.
        height: the diagonal along y.
    """
    w, h = arguments.positive("width", width) / 2, arguments.positive("height", height) / 2
    side = open_edges(np.array([(w, 0.0), (0.0, h)]))
    return profile_body(edges_distance(side, abs(X), abs(Y)), (-w, -h), (w, h))


@primitive
def parallelogram(width: float, height: float, skew: float) -> Body:
    """A profile: a parallelogram with two sides along x, centred at the origin.

    Args:
        width: length of these sides.
        height: distance between them.
        skew: how much farther along +x the upper one lies than the lower one.
    """
    w, h = arguments.positive("width", width) / 2, arguments.positive("height", height) / 2
    s = arguments.number("skew", skew) / 2
    return outline_body([np.array([(-w - s, -h), (w - s, -h), (w + s, h), (s - w, h)])])


# --- regular shapes -------------------------------------------------------------------


@primitive
def regular_polygon(sides: int, radius: float) -> Body:
    """A profile: a regular polygon with one corner on the +x axis.

    Args:
        sides: three or more.
        radius: of the circle through the corners.
    """
    n = arguments.whole("sides", sides, 3)
    r = arguments.positive("radius", radius)
    return _star(n, r, r * math.cos(math.pi / n))


@primitive
def hexagon(width: float) -> Body:
    """A profile: a regular hexagon with two sides square to y, and corners on the x axis.

    Args:
        width: across flats: the distance of opposite sides, as of a nut.
    """
    inner = arguments.positive("width", width) / 2
    return _star(6, inner / math.cos(math.pi / 6), inner)


@primitive
def octagon(width: float) -> Body:
    """A profile: a regular octagon with sides square to x and to y.

    Args:
        width: the distance of opposite sides.
    """
    half = arguments.positive("width", width) / 2
    x, y = abs(X), abs(Y)
    corner = half * math.tan(math.pi / 8)
    end = open_edges(np.array([(half, 0.0), (half, corner), (half / math.sqrt(2),) * 2]))
    distance = edges_distance(end, maximum(x, y), minimum(x, y))
    return profile_body(distance, (-half, -half), (half, half))


@primitive
def star(points: int, radius: float, inner: float) -> Body:
    """A profile: a star with one tip on the +x axis.

    Args:
        points: number of tips, three or more.
        radius: of the circle through the tips.
        inner: radius of the circle through the corners between them; at most what makes a regular
            polygon, radius * cos(pi / points). For a pentagram radius * 0.381966.
    """
    n = arguments.whole("points", points, 3)
    outer = arguments.positive("radius", radius)
    least = arguments.positive("inner", inner)
    if least > outer * math.cos(math.pi / n) * (1 + 1e-12):
        raise InputError(
            "inner",
            inner,
            f"the corners between the tips would be tips, beyond {outer * math.cos(math.pi / n):g}",
            "pass a smaller inner radius, or use a regular_polygon of twice the corners",
        )
    return _star(n, outer, least)


def _star(count: int, outer: float, inner: float) -> Body:
    """The plane is folded into the sector between a tip, on the x axis, and the next corner."""
    x, y = _folded(count)
    step = math.pi / count
    low_corner = (inner * math.cos(step), inner * math.sin(step))
    distance = edges_distance(open_edges(np.array([(outer, 0.0), low_corner])), x, y)
    angles = 2 * step * np.arange(count)
    tips = outer * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return profile_body(distance, tips.min(axis=0), tips.max(axis=0))


def _folded(count: int) -> tuple[Expression, Expression]:
    """(x, y) reflected into the sector of angles from 0 to pi / count.

    After the mirror y = 0, angles are at most `sectors` = count steps of pi / count. The mirror at
    half as many of them, rounded up, turns back what is beyond: each halves the range.
    """
    x, y = X, abs(Y)
    sectors = count
    while sectors > 1:
        sectors = (sectors + 1) // 2
        angle = math.pi * sectors / count
        across_x, across_y = _unit(angle + math.pi / 2)
        beyond = 2 * maximum(across_x * x + across_y * y, 0.0)
        x, y = x - across_x * beyond, y - across_y * beyond
    return x, y


def _unit(angle: float) -> tuple[float, float]:
    """(cos, sin), with 0 for what is 0 but for rounding."""
    x, y = math.cos(angle), math.sin(angle)
    return (0.0 if abs(x) < 1e-15 else x, 0.0 if abs(y) < 1e-15 else y)


# --- any outline ----------------------------------------------------------------------


@primitive
def polygon(points: ArrayLike) -> Body:
    """A profile: any simple polygon, convex or not.

    Up to 16 edges are arithmetic; more are searched in a tree of boxes by a compiled kernel.

    Args:
        points: `(n, 2)`, at least three corners in order, in either direction.

    Raises:
        InputError: equal points in a row; or edges that touch or cross, decided exactly.
    """
    return outline_body([simple_polygon("points", points)])


@primitive
def polyline(points: ArrayLike, width: float) -> Body:
    """A profile: all points within width / 2 of a chain of segments; ends and joints are round.

    A true distance outside. Inside, near a bend or where the chain meets itself, it measures to
    the end of one segment's strip though the surface is farther; so it is not tagged exact.

    Args:
        points: `(n, 2)`, two or more; the chain may cross itself and end where it starts.
        width: greater than zero.
    """
    corners = plane_points("points", points, least=2)
    half = arguments.positive("width", width) / 2
    distance = abs(outline_distance(open_edges(corners))) - half
    extent = plane_extent(corners.min(axis=0) - half, corners.max(axis=0) + half)
    return Body(distance, Tags(exact=False, lipschitz=1.0, extent=extent, growth=1.0))
