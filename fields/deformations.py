"""Twist, taper, shear and bends as operations on fields: a(f^-1(p)), written as expressions.

f is the map of the same name in `implicit_warp`, with the same parameters (a radial bend has none);
it works in coordinates with z along an axis, and there the formulas below are.
`implicit_warp.deform` uses these operations for those maps, so that a deformed CSG scene stays one
expression.

A pulled-back field is as steep as the field times the stretch of f^-1, which for a twist, a taper
and a bend grows without bound. All that is wanted of the field far away is that it is positive, so
it is *confined* to a region around the image of the field's bounds (`fields.enclosure`): within, it
is a(f^-1(p)) exactly. A field without bounds across the axis is pulled back as it is, and has no
Lipschitz bound then.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.enclosure import MARGIN, confined, floored, raised
from fields.errors import InputError
from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    atan2,
    clamp,
    cos,
    length,
    maximum,
    minimum,
    remap,
    sin,
    square,
    where_negative,
)
from fields.operations import Body, about_axis, axis_frame, rule
from fields.tags import EVERYWHERE, Box, Tags

_Range: TypeAlias = "tuple[float, float] | None"

_ORIGIN = (0.0, 0.0, 0.0)


@rule
def twist(
    body: Body,
    degrees: float,
    axis: str | ArrayLike = "z",
    origin: ArrayLike = _ORIGIN,
    between: ArrayLike | None = None,
) -> Body:
    """a(Q(-angle(z)) (x, y), z): see `_twisted`."""
    rate = math.radians(arguments.number("degrees", degrees))
    acting = None if between is None else arguments.interval("between", between)
    about, place = arguments.direction("axis", axis), arguments.vector("origin", origin)
    if rate == 0:
        return body
    return about_axis(body, about, place, lambda local: _twisted(local, rate, acting))


def _twisted(body: Body, rate: float, between: _Range) -> Body:
    """Every plane across z is turned as a whole, so a point keeps its distance r from z.

    Lipschitz: the Jacobian is a rotation times [[1, 0], [s, 1]] in the plane of the axis and the
    circle, s = rate * r, whose larger singular value is (s + sqrt(s^2 + 4)) / 2. In the region
    r is at most that of the box's corners, and the margin.
    """
    angle = _along(between) * rate
    c, s = cos(angle), sin(angle)
    pulled = remap(body.expression, (c * X + s * Y, c * Y - s * X, Z))
    reach = _reach(body.tags.extent)
    image = body.tags.extent.copy()
    image[:, :2] = [[-reach] * 2, [reach] * 2]
    shear = abs(rate) * reach * (1 + 2 * MARGIN)
    return _confined_to_cylinder(body, pulled, image, reach, 0.5 * (shear + math.hypot(shear, 2)))


@rule
def taper(
    body: Body,
    factors: ArrayLike,
    axis: str | ArrayLike = "z",
    origin: ArrayLike = _ORIGIN,
    between: ArrayLike = (0.0, 1.0),
) -> Body:
    """a(x / s(z), y / s(z), z): see `_tapered`."""
    ends = arguments.pair("factors", factors, arguments.positive)
    acting = arguments.interval("between", between)
    about, place = arguments.direction("axis", axis), arguments.vector("origin", origin)
    return about_axis(body, about, place, lambda local: _tapered(local, ends, acting))


def _tapered(body: Body, ends: tuple[float, float], between: tuple[float, float]) -> Body:
    """s runs from one factor to the other on the range, and stays so beyond it.

    Lipschitz: the inverse's Jacobian is 1 / s across the plane of the axis and the point, and
    [[1 / s, q], [0, 1]] in it, q = s' r / s^2. Both grow as s falls, so its least value in the
    region counts; the norm of the matrix is half the sum of the lengths of (1 / s + 1, q) and
    (1 / s - 1, q).
    """
    low, high = between
    share = clamp((Z - low) / (high - low), 0.0, 1.0)
    scale = (1 - share) * ends[0] + share * ends[1]
    pulled = remap(body.expression, (X / scale, Y / scale, Z))
    image = body.tags.extent.copy()
    at_ends = np.interp(image[:, 2], between, ends)
    image[0, :2] = (image[0, :2] * at_ends[:, None]).min(axis=0)
    image[1, :2] = (image[1, :2] * at_ends[:, None]).max(axis=0)
    reach = _reach(image)
    most = 1 / min(ends)
    slope = abs(ends[1] - ends[0]) / (high - low) * reach * (1 + 2 * MARGIN) * most * most
    stretch = max(most, 0.5 * (math.hypot(most + 1, slope) + math.hypot(most - 1, slope)))
    return _confined_to_cylinder(body, pulled, image, reach, stretch)


def _confined_to_cylinder(
    body: Body, pulled: Expression, image: Box, reach: float, stretch: float
) -> Body:
    """A pulled-back field on the cylinder of radius `reach` about z and a margin around it."""
    if not math.isfinite(reach):
        return Body(pulled, Tags(False, None, EVERYWHERE, 1.0))
    radius = reach * (1 + 2 * MARGIN)
    inwards = radius / maximum(length(X, Y), radius) if radius > 0 else 0.0
    within: Coordinates = (X * inwards, Y * inwards, Z)
    steepest = body.tags.lipschitz
    lipschitz = None if steepest is None else max(steepest * stretch, 1.0)
    return Body(confined(pulled, within, image), Tags(False, lipschitz, image, 1.0))


@rule
def shear(
    body: Body,
    slope: float,
    axis: str | ArrayLike = "z",
    towards: str | ArrayLike = "x",
    origin: ArrayLike = _ORIGIN,
    between: ArrayLike | None = None,
) -> Body:
    """a(x - slope * along(z), y, z): see `_sheared`."""
    rate = arguments.number("slope", slope)
    acting = None if between is None else arguments.interval("between", between)
    about, place = arguments.direction("axis", axis), arguments.vector("origin", origin)
    leaning = arguments.direction("towards", towards)
    if rate == 0:
        return body
    return about_axis(body, about, place, lambda local: _sheared(local, rate, acting), leaning)


def _sheared(body: Body, slope: float, between: _Range) -> Body:
    """Lipschitz: the inverse's Jacobian is [[1, -slope], [0, 1]] on the range, see `_twisted`.

    Growth: a point of the grown box may be slid by slope * t more than one of the box. A distance
    at most t is in a ball, not in a box, but the sum holds for it as well.
    """
    pulled = remap(body.expression, (X - _along(between) * slope, Y, Z))
    tags = body.tags
    heights = tags.extent[:, 2]
    slid = slope * (heights if between is None else np.clip(heights, *between) - between[0])
    extent = tags.extent.copy()
    extent[:, 0] += [slid.min(), slid.max()]
    stretch = 0.5 * (abs(slope) + math.hypot(slope, 2))
    lipschitz = None if tags.lipschitz is None else tags.lipschitz * stretch
    growth = None if tags.growth is None else tags.growth * (1 + abs(slope))
    return Body(pulled, Tags(False, lipschitz, extent, growth))


@rule
def bend_radial(
    body: Body,
    height: float,
    between: ArrayLike = (0.0, 1.0),
    axis: str | ArrayLike = "z",
    origin: ArrayLike = _ORIGIN,
) -> Body:
    """a(x, y, z - height * share(r)), r the distance from the axis: see `_dished`."""
    rise = arguments.number("height", height)
    acting = arguments.interval("between", between)
    if acting[0] < 0:
        raise InputError(
            "between", between, "it starts below 0, and is a range of distances from the axis",
            "pass (inner, outer) with 0 <= inner < outer",
        )  # fmt: skip
    about, place = arguments.direction("axis", axis), arguments.vector("origin", origin)
    if rise == 0:
        return body
    return about_axis(body, about, place, lambda local: _dished(local, rise, acting))


def _dished(body: Body, rise: float, between: tuple[float, float]) -> Body:
    """Cylinders about z are slid along it; share(r) runs from 0 to 1 on the range.

    Lipschitz: the Jacobian is [[1, 0], [s, 1]] in the plane of the axis and the point, where s is
    rise / (outer - inner) on the range, as for a shear (`_sheared`, for the growth, too).
    """
    inner, outer = between
    share = clamp((length(X, Y) - inner) / (outer - inner), 0.0, 1.0)
    pulled = remap(body.expression, (X, Y, Z - rise * share))
    tags, extent = body.tags, body.tags.extent.copy()
    nearest = math.hypot(*np.clip(0.0, *extent[:, :2]))
    slid = rise * np.interp([nearest, _reach(extent)], between, (0.0, 1.0))
    extent[:, 2] += [slid.min(), slid.max()]
    slope = abs(rise) / (outer - inner)
    stretch = 0.5 * (slope + math.hypot(slope, 2))
    lipschitz = None if tags.lipschitz is None else tags.lipschitz * stretch
    growth = None if tags.growth is None else tags.growth * (1 + slope)
    return Body(pulled, Tags(False, lipschitz, extent, growth))


@rule
def bend(
    body: Body,
    degrees: float,
    axis: str | ArrayLike = "z",
    origin: ArrayLike = _ORIGIN,
    between: ArrayLike = (0.0, 1.0),
    towards: str | ArrayLike | None = None,
) -> Body:
    """a with the axis bent into an arc on the range, and straight beyond it: see `_bent`."""
    angle = arguments.number("degrees", degrees)
    if not 0 < abs(angle) < 360:
        raise InputError(
            "degrees", degrees, "a bend turns by more than nothing and less than a full turn",
            "pass an angle in degrees",
        )  # fmt: skip
    acting = arguments.interval("between", between)
    about, place = arguments.direction("axis", axis), arguments.vector("origin", origin)
    toward = None if towards is None else arguments.direction("towards", towards)
    # The shape leans to +x; a negative angle leans it the other way.
    inwards = math.copysign(1.0, angle) * axis_frame(about, toward)[:, 0]
    arc = _Arc(math.radians(abs(angle)), *acting)
    return about_axis(body, about, place, lambda local: _bent(local, arc, degrees), inwards)


class _Arc(NamedTuple):
    """The arc that the axis becomes: of the given angle, about (radius, low) in (x, z)."""

    angle: float
    low: float
    high: float

    @property
    def radius(self) -> float:
        return (self.high - self.low) / self.angle


def _bent(body: Body, arc: _Arc, degrees: object) -> Body:
    """The pull-back (`_unbent`), cut off at half of the depth d = `_clearance` below.

    The bent shape leaves free the line of centres and, opposite to the arc, the half plane from it
    to which both sides of the bend are equally near: there f^-1 is torn. No point of either lies
    nearer to the shape at rest than d, in the coordinates that f^-1 gives it from either side, so
    the field, made at least the distance to its box, is at least d there. Cut off at d / 2 it is
    constant about the tear, and so it is continuous.
    Lipschitz: f^-1 is rigid, but on the arc, where it stretches by radius / rho along circles at
    rho from the centres. Where the field is less than d / 2, rho is more than its least value in
    the box less d / 2.
    """
    extent = body.tags.extent
    clearance = _clearance(extent, arc, degrees)
    nearest = arc.radius - float(extent[1, 0])
    pulled = remap(floored(body).expression, _unbent(arc))
    image = _bent_box(extent, arc)
    expression = raised(minimum(pulled, clearance / 2), image)
    steepest = floored(body).tags.lipschitz
    stretch = max(1.0, arc.radius / (nearest - clearance / 2))
    lipschitz = None if steepest is None else max(steepest * stretch, 1.0)
    return Body(expression, Tags(False, lipschitz, image, 1.0))


def _clearance(extent: Box, arc: _Arc, degrees: object) -> float:
    """How far a box is from the centres and from the planes where the ends of a strong bend meet.

    Raises:
        InputError: it is not bounded, or reaches them, so that space would be folded in it.
    """
    (_, low), (x, high) = extent[:, [0, 2]].tolist()
    remedy = "bend it less, along a longer range, or intersect it with a smaller box first"
    if not np.isfinite(extent[:, [0, 2]]).all():
        cause = "the field has no bounds along the axis or across it, in the plane of the bend"
        raise InputError("degrees", degrees, cause, remedy)
    clear = arc.radius - x
    if clear <= 0:
        cause = (
            f"space would fold: the arc's centre is {arc.radius:.4g} from the axis, and the "
            f"field's bounds reach {x:.4g} towards it"
        )
        raise InputError("degrees", degrees, cause, remedy)
    wedge = math.pi - arc.angle / 2
    if wedge < math.pi / 2:
        beyond = max(arc.low - low, high - arc.high)
        apart = clear * math.sin(wedge) - beyond * math.cos(wedge)
        if apart <= 0:
            cause = "space would fold: the straight ends beyond the arc run into each other"
            raise InputError("degrees", degrees, cause, remedy)
        clear = min(clear, apart)
    return clear


def _unbent(arc: _Arc) -> Coordinates:
    """f^-1: polar angle and distance about the centres on the arc, rigid motions beyond it.

    `implicit_warp.bend` derives it; x on the arc is written so that nothing cancels in weak bends.
    """
    k, half = 1 / arc.radius, arc.angle / 2
    up = Z - arc.low
    ahead, across = 1 - k * X, k * up
    c, s = math.cos(half), math.sin(half)
    phi = atan2(c * across - s * ahead, c * ahead + s * across) + half
    rho = length(ahead, across)
    on_arc = (2 * X - k * (square(X) + square(up))) / (1 + rho)
    c, s = math.cos(arc.angle), math.sin(arc.angle)
    u, w = X - 2 * math.sin(half) ** 2 / k, up - s / k
    x = _piece(phi, arc, X, on_arc, c * u - s * w)
    z = _piece(phi, arc, Z, arc.low + phi / k, arc.high + s * u + c * w)
    return (x, Y, z)


def _piece(
    phi: Expression, arc: _Arc, before: Expression, on_arc: Expression, after: Expression
) -> Expression:
    return where_negative(phi, before, where_negative(arc.angle - phi, after, on_arc))


def _bent_box(extent: Box, arc: _Arc) -> Box:
    """The box around the image of a box: extremes are at its corners, at the ends of the arc, and
    where the arc is level or upright."""
    low, high = extent[:, 2].tolist()
    turns = [arc.low + q * (math.pi / 2) * arc.radius for q in range(4)]
    heights = [low, high, *(z for z in (*turns, arc.high) if low < z < high and z <= arc.high)]
    points = np.array([_bent_point(x, z, arc) for x in extent[:, 0].tolist() for z in heights])
    image = extent.copy()
    image[:, [0, 2]] = points.min(axis=0), points.max(axis=0)
    return image


def _bent_point(x: float, z: float, arc: _Arc) -> tuple[float, float]:
    held = min(max(z, arc.low), arc.high)
    phi = (held - arc.low) / arc.radius
    c, s = math.cos(phi), math.sin(phi)
    rho = arc.radius - x
    return arc.radius - rho * c + (z - held) * s, arc.low + rho * s + (z - held) * c


# --- what the maps about an axis share ------------------------------------------------


def _along(between: _Range) -> Expression:
    """How far z is along the range."""
    return Z if between is None else clamp(Z, *between) - between[0]


def _reach(extent: Box) -> float:
    """The largest distance of a box from the z axis."""
    return math.hypot(*np.abs(extent[:, :2]).max(axis=0))
