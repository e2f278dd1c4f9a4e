"""Solids of revolution with round parts, as true signed distances.

Each is a profile of a few arcs and lines in the half-plane (distance from the axis, height):
the plane is cut into the regions whose nearest point lies on each of them. Profiles of balls
that touch from inside are exact inside as well, for every inner point lies in such a ball, on
the radius to where it touches. Sources: Inigo Quilez, "3D SDFs" and "2D SDFs",
https://iquilezles.org/articles/distfunctions/ and .../distfunctions2d/. Angles are in degrees.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.errors import InputError
from fields.expression import X, Y, Z, length, maximum, where_negative
from fields.formulas import (
    along,
    bounding_body,
    box_distance,
    chain_distance,
    disc_reach,
    exact_body,
    outside_or_faces,
    pie_distance,
)
from fields.operations import Body, Matrix
from fields.primitives import primitive


@primitive
def rounded_cylinder(radius: float, height: float, rounding: float) -> Body:
    """A cylinder about the z axis whose rims are rounded off.

    Args:
        radius: of the cylinder.
        height: full length along z, centred at the origin.
        rounding: radius of the rims; at most `radius` and half of `height`.
    """
    r = arguments.positive("radius", radius)
    h = arguments.positive("height", height) / 2
    k = arguments.positive("rounding", rounding)
    if k > min(r, h):
        raise InputError(
            "rounding",
            rounding,
            f"it is more than radius = {r:g} or height / 2 = {h:g}",
            "pass a smaller one",
        )
    distance = box_distance((length(X, Y) - (r - k), abs(Z) - (h - k))) - k
    return exact_body(distance, (-r, -r, -h), (r, r, h))


@primitive
def capped_cone(a: ArrayLike, b: ArrayLike, radius_a: float, radius_b: float) -> Body:
    """A cone cut off (a frustum) between two points; with equal radii, a cylinder.

    Args:
        a: `(3,)`, centre of one flat end.
        b: `(3,)`, centre of the other; must differ from a.
        radius_a: at a; zero for an apex.
        radius_b: at b; zero for an apex, but not both.
    """
    start, axis, size = _segment(a, b)
    first = arguments.not_negative("radius_a", radius_a)
    last = arguments.not_negative("radius_b", radius_b)
    if first == last == 0:
        raise InputError("radius_b", radius_b, "both radii are zero", "pass a positive one")
    u, v, w = along(axis, start)
    profile = ((0.0, 0.0), (first, 0.0), (last, size), (0.0, size))
    ends = np.stack([start, start + size * axis])
    reach = disc_reach(axis) * np.array([[first], [last]])
    distance = chain_distance(length(u, v), w, profile)
    return exact_body(distance, (ends - reach).min(axis=0), (ends + reach).max(axis=0))


@primitive
def rounded_cone(a: ArrayLike, b: ArrayLike, radius_a: float, radius_b: float) -> Body:
    """The hull of two balls: a cone with round ends.

    Args:
        a: `(3,)`, centre of one ball.
        b: `(3,)`, centre of the other, farther away than the radii differ.
        radius_a: greater than zero.
        radius_b: greater than zero.
    """
    start, axis, size = _segment(a, b)
    first = arguments.positive("radius_a", radius_a)
    last = arguments.positive("radius_b", radius_b)
    if size <= abs(first - last):
        raise InputError(
            "b",
            b,
            f"it is {size:g} from a, so that one ball holds the other",
            "use sphere for the larger one, or move b farther away than the radii differ",
        )
    u, v, w = along(axis, start)
    across = length(u, v)
    # The common tangent leans by the sine of the half angle; its normals at the two balls
    # bound the regions.
    sine = (first - last) / size
    cosine = math.sqrt(1 - sine * sine)
    position = cosine * w - sine * across
    side = cosine * across + sine * w - first
    far = length(across, w - size) - last
    near = length(across, w) - first
    distance = where_negative(position, near, where_negative(cosine * size - position, far, side))
    ends = np.stack([start, start + size * axis])
    reach = np.array([[first], [last]])
    return exact_body(distance, (ends - reach).min(axis=0), (ends + reach).max(axis=0))


def _segment(a: ArrayLike, b: ArrayLike) -> tuple[Matrix, Matrix, float]:
    """The first point, the unit vector towards the second, and the distance between them."""
    start, end = (np.array(arguments.vector(*item)) for item in (("a", a), ("b", b)))
    size = float(np.linalg.norm(end - start))
    if size == 0:
        raise InputError("b", b, "it equals a, so there is no axis", "pass another point")
    return start, (end - start) / size, size


@primitive
def infinite_cone(angle: float) -> Body:
    """A solid cone without end about the z axis, apex at the origin, open upwards.

    Args:
        angle: full opening in degrees, above 0 and below 360; above 180 it is all but a cone
            around -z.
    """
    half = math.radians(arguments.between("angle", angle, 0, 360)) / 2
    bottom = 0.0 if half <= math.pi / 2 else -math.inf
    distance = pie_distance(length(X, Y), Z, None, half)
    return exact_body(distance, (-math.inf, -math.inf, bottom), (math.inf,) * 3)


@primitive
def solid_angle(radius: float, angle: float) -> Body:
    """What a cone with its apex at the centre, about +z, cuts out of a ball.

    Args:
        radius: of the ball about the origin.
        angle: full opening in degrees, above 0 and below 360.
    """
    r = arguments.positive("radius", radius)
    half = math.radians(arguments.between("angle", angle, 0, 360)) / 2
    side = r * math.sin(min(half, math.pi / 2))
    bottom = r * min(math.cos(half), 0.0)
    return exact_body(
        pie_distance(length(X, Y), Z, r, half), (-side, -side, bottom), (side, side, r)
    )


# --- parts of balls -------------------------------------------------------------------


@primitive
def cut_sphere(radius: float, height: float) -> Body:
    """The part of a ball about the origin that is above z = height.

    Args:
        radius: of the ball.
        height: of the cut, between -radius and radius.
    """
    r = arguments.positive("radius", radius)
    h = arguments.between("height", height, -r, r)
    rim = math.sqrt(r * r - h * h)
    across = length(X, Y)
    ball, cut = length(X, Y, Z) - r, h - Z
    below_disc = maximum(across - rim, Z - h)
    beside = where_negative(h * across - rim * Z, ball, length(across - rim, Z - h))
    distance = outside_or_faces(maximum(ball, cut), where_negative(below_disc, cut, beside))
    reach = r if h <= 0 else rim
    return exact_body(distance, (-reach, -reach, h), (reach, reach, r))


@primitive
def cut_hollow_sphere(radius: float, height: float, thickness: float) -> Body:
    """A bowl with a round rim: the part of a thin sphere that is below z = height.

    It is all that is within thickness / 2 of the part of the sphere. Exact, unless the rims
    close the opening: then it is so outside only.

    Args:
        radius: of the sphere half-way through the wall, about the origin.
        height: of the rim's centre, between -radius and radius.
        thickness: of the wall, less than twice the radius.
    """
    r = arguments.positive("radius", radius)
    h = arguments.between("height", height, -r, r)
    half = arguments.between("thickness", thickness, 0, 2 * r) / 2
    rim = math.sqrt(r * r - h * h)
    across = length(X, Y)
    wall = abs(length(X, Y, Z) - r)
    distance = where_negative(rim * Z - h * across, wall, length(across - rim, Z - h)) - half
    reach = (r if h >= 0 else rim) + half
    return bounding_body(
        distance,
        (-reach, -reach, -r - half),
        (reach, reach, h + half),
        exact=half <= (rim if h > 0 else r),
    )


@primitive
def death_star(radius: float, bite: float, distance: float) -> Body:
    """A ball about the origin without another ball above it.

    Args:
        radius: of the ball that is left.
        bite: radius of the ball that is taken away.
        distance: of the two centres, along +z; the spheres must cross.
    """
    r = arguments.positive("radius", radius)
    k = arguments.positive("bite", bite)
    d = arguments.positive("distance", distance)
    if not abs(r - k) < d < r + k:
        raise InputError(
            "distance",
            distance,
            f"spheres of radius {r:g} and {k:g} at this distance do not cross",
            f"pass more than {abs(r - k):g} and less than {r + k:g}",
        )
    height = (r * r - k * k + d * d) / (2 * d)
    rim = math.sqrt(r * r - height * height)
    across = length(X, Y)
    ball = length(X, Y, Z) - r
    hollow = k - length(X, Y, Z - d)
    # Outside, the larger of the two is right if its foot is on the solid, else the rim is.
    edge = length(across - rim, Z - height)
    to_ball = where_negative(rim * Z - height * across, ball, edge)
    to_hollow = where_negative(across * (d - height) - rim * (d - Z), hollow, edge)
    outside = where_negative(ball - hollow, to_hollow, to_ball)
    reach = r if height >= 0 else rim
    return exact_body(
        outside_or_faces(maximum(ball, hollow), outside),
        (-reach, -reach, -r),
        (reach, reach, height),
    )


@primitive
def lens(diameter: float, thickness: float) -> Body:
    """What two equal balls have in common, with its rim in the plane z = 0.

    Args:
        diameter: of the rim.
        thickness: along z, less than `diameter`.
    """
    w = arguments.positive("diameter", diameter) / 2
    h = arguments.between("thickness", thickness, 0, 2 * w) / 2
    depth = (w * w - h * h) / (2 * h)
    across, up = length(X, Y), abs(Z)
    cap = length(across, up + depth) - (depth + h)
    rim = length(across - w, Z)
    distance = where_negative(depth * across - w * (up + depth), cap, rim)
    return exact_body(distance, (-w, -w, -h), (w, w, h))


@primitive
def spindle(height: float, width: float) -> Body:
    """A lemon: an arc of a circle turned about its chord, which lies on the z axis.

    Args:
        height: from tip to tip, along z.
        width: across the middle, less than `height`.
    """
    h = arguments.positive("height", height) / 2
    w = arguments.between("width", width, 0, 2 * h) / 2
    depth = (h * h - w * w) / (2 * w)
    across, up = length(X, Y), abs(Z)
    side = length(across + depth, Z) - (depth + w)
    tip = length(across, up - h)
    distance = where_negative(depth * up - h * (across + depth), side, tip)
    return exact_body(distance, (-w, -w, -h), (w, w, h))


@primitive
def egg(radius: float, top_radius: float, height: float) -> Body:
    """An egg, blunt end down: two balls, and the arc that touches both from outside.

    The arc leaves the lower ball at its equator, with its centre on the other side of the axis.

    Args:
        radius: of the lower ball, about the origin.
        top_radius: of the upper ball, less than `radius`.
        height: of the upper ball's centre above the lower one's; more than the radii differ.
    """
    r = arguments.positive("radius", radius)
    k = arguments.between("top_radius", top_radius, 0, r)
    h = arguments.positive("height", height)
    if h <= r - k:
        raise InputError(
            "height", height, "the upper ball lies in the lower one", f"pass more than {r - k:g}"
        )
    # Its centre (-depth, 0) is as far from both balls' far sides.
    depth = (h * h - (r - k) ** 2) / (2 * (r - k))
    across = length(X, Y)
    bottom = length(X, Y, Z) - r
    top = length(X, Y, Z - h) - k
    side = length(across + depth, Z) - (depth + r)
    upper = where_negative(depth * Z - h * (across + depth), side, top)
    return exact_body(where_negative(Z, bottom, upper), (-r, -r, -r), (r, r, h + k))
