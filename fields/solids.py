"""What is made of profiles along the z axis: the rules, and which tags survive.

A profile is a body whose formula does not depend on z. Below, a is its formula, S = {a <= 0} its
shape in the plane, L its Lipschitz bound, and rho the largest distance from the origin to a corner
of its bounds. All of these solids end at z = -height/2 and height/2, and from there on the formula
in the plane stays as it is at that end: so its z-derivative is zero where the distance to the end
counts, and both can be put together as the distances of a box (`fields.formulas`).

Turning or scaling the plane with z adds to the gradient of a what a does along these motions, which
for a distance is small however far out the point is: with q the nearest point of the surface and
a g = p - q, the derivative along a turn, p x g, is q x g, and a - p . g is -q . g; both are at most
rho. A field with a Lipschitz bound that is no distance has no such limit far away; it is therefore
confined: beyond the circle of radius rho its value is that of the nearest point on the circle plus
the distance to it.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Literal, NamedTuple, get_args

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Expression,
    X,
    Y,
    Z,
    clamp,
    constant,
    cos,
    length,
    maximum,
    remap,
    sin,
    square,
)
from fields.formulas import box_distance
from fields.operations import Body, rule
from fields.tags import EVERYWHERE, Box, Tags, hull, largest
from fields.tape import Tape, coordinates_used

Ease = Literal["linear", "smooth"]

_STEEPEST = {"linear": 1.0, "smooth": 1.5}
"""The largest slope of each easing, for a rise by 1 over a length of 1."""

_SAMPLES = 129
"""Along each side of the square on which two profiles are compared."""


def is_profile(expression: Expression) -> bool:
    """Does the formula not depend on z? Exact for what it is written in, oracles included."""
    return 2 not in coordinates_used(expression)


def checked_profile(body: Body) -> Body:
    """The body, if it is a profile."""
    if not is_profile(body.expression):
        raise InputError(
            "field",
            body.expression,
            "it depends on z, so it is not a profile",
            "start from a circle, polygon, text, ...; or cut a profile out of it by slice(z)",
        )
    return body


def bounded_profile(body: Body) -> Body:
    """The body, if it is a profile with bounds in x and y."""
    if not np.isfinite(checked_profile(body).tags.extent[:, :2]).all():
        raise InputError(
            "field",
            body.expression,
            "the profile has no bounds in x and y",
            "intersect it with a rectangle or a circle",
        )
    return body


def reach_of(extent: Box) -> float:
    """The largest distance of a corner of the bounds in x and y from the z axis.

    1, which is as true, if they are nothing but the axis itself: nothing is divided by 0.
    """
    return float(np.hypot(*np.abs(extent[:, :2]).max(axis=0))) or 1.0


# --- one section ----------------------------------------------------------------------


@rule
def extrude(body: Body, height: float) -> Body:
    """The box distance of a and |z| - height/2, which are measured along orthogonal directions.

    Exact if a is: outside, the nearest point of the prism is found in both separately; inside, the
    nearest of side and ends is. Lipschitz: in (a, z) the box distance has a gradient of norm 1.
    """
    half = arguments.positive("height", height) / 2
    tags = checked_profile(body).tags
    restricts = np.isfinite(tags.extent).any()
    result = Tags(
        exact=tags.exact,
        lipschitz=largest([1.0, tags.lipschitz]),
        extent=_between(tags.extent, -half, half),
        growth=largest([1.0, tags.growth]) if restricts else 1.0,
    )
    return Body(box_distance((body.expression, abs(Z) - half)), result)


@rule
def twist_extrude(body: Body, height: float, degrees: float, top: float = 1.0) -> Body:
    """s a(T p / s), with T the turn by -w z and s the scale, both linear in z.

    Lipschitz: the plane's part is the gradient of a; the z-derivative is at most
    |ds/dz| |a - p . g| + w s |p x g|, bounded as the module's docstring says: for a distance by
    rho |ds/dz| + rho w max(s). Extent: the disc about the axis. Growth: s a(p / s) <= t means for a
    distance, and for a confined field, that p is within s rho + t of the axis.
    """
    turn = math.radians(arguments.number("degrees", degrees))
    return _scaled_and_turned(body, height, turn, top)


@rule
def taper_extrude(body: Body, height: float, top: float) -> Body:
    """s a(p / s), with s linear in z from 1 to top; see `twist_extrude`."""
    return _scaled_and_turned(body, height, 0.0, top)


def _scaled_and_turned(body: Body, height: float, turn: float, top: float) -> Body:
    tall, last = arguments.positive("height", height), arguments.positive("top", top)
    section = _section(bounded_profile(body))
    inside = clamp(Z, -tall / 2, tall / 2)
    scale = 1.0 if last == 1 else 1 + (inside + tall / 2) * ((last - 1) / tall)
    x, y = X, Y
    if turn != 0:
        angle = inside * (turn / tall)
        x, y = cos(angle) * X + sin(angle) * Y, cos(angle) * Y - sin(angle) * X
    a = remap(section.expression, (x / scale, y / scale, Z)) * scale
    lipschitz = None
    if section.slope is not None:
        along = abs(last - 1) / tall * section.stretch + abs(turn) / tall * section.turn * max(
            1.0, last
        )
        lipschitz = max(1.0, math.hypot(section.slope, along))
    extent, growth = body.tags.extent, body.tags.growth
    if turn != 0 or growth is None:
        extent = np.array([[-section.reach] * 3, [section.reach] * 3])
        growth = 1.0 if lipschitz else None if growth is None else math.sqrt(2) * growth
    with np.errstate(invalid="ignore"):
        extent = _between(hull(extent, extent * last), -tall / 2, tall / 2)
    tags = Tags(False, lipschitz, extent, largest([1.0, growth]))
    return Body(box_distance((a, abs(Z) - tall / 2)), tags)


class _Section(NamedTuple):
    """A profile under motions of its plane.

    Attributes:
        expression: its formula, confined if it is not exact.
        reach: rho.
        slope: bound on the gradient; None if unknown.
        turn: bound on the derivative along a turn by one radian about the origin.
        stretch: bound on |a - p . g|, the derivative of s a(p / s) by s.
    """

    expression: Expression
    reach: float
    slope: float | None
    turn: float
    stretch: float


def _section(body: Body) -> _Section:
    """Confined: in the circle |p x g| <= rho L and |a - p . g| <= |a(0)| + 2 rho L. Outside, the
    gradient is 1 along the radius and at most L rho / r across, and a - p . g is the value on the
    circle less rho."""
    reach, lipschitz = reach_of(body.tags.extent), body.tags.lipschitz
    if body.tags.exact:
        return _Section(body.expression, reach, 1.0, reach, reach)
    if lipschitz is None:
        return _Section(body.expression, reach, None, 0.0, 0.0)
    middle = abs(float(Tape(body.expression).evaluate(torch.zeros(3, dtype=torch.float64))))
    return _Section(
        confined(body.expression, reach),
        reach,
        math.hypot(1.0, lipschitz),
        lipschitz * reach,
        middle + lipschitz * reach + max(lipschitz, 1.0) * reach,
    )


def confined(expression: Expression, reach: float) -> Expression:
    """The values of the nearest points of a disc about the origin plus the distance to it."""
    radius = length(X, Y)
    factor = reach / maximum(radius, reach)
    return remap(expression, (X * factor, Y * factor, Z)) + maximum(radius - reach, 0.0)


def _between(extent: Box, low: float, high: float) -> Box:
    result = extent.copy()
    result[:, 2] = low, high
    return result


# --- several sections -----------------------------------------------------------------


@rule
def extrude_to(body: Body, other: Body, height: float, ease: Ease = "linear") -> Body:
    """The loft of two profiles, centred."""
    half = arguments.positive("height", height) / 2
    return loft(body, other, heights=(-half, half), ease=ease)


@rule
def loft(*bodies: Body, heights: ArrayLike, ease: Ease = "linear") -> Body:
    """(1 - w) a + w b between neighbours, with w rising from 0 to 1 between their heights.

    Lipschitz: in the plane the gradient is a mean of both; the z-derivative is dw/dz (b - a). For
    distances |b - a| is largest in the box around both shapes: outside of both shapes it is at
    most their Hausdorff distance, which is attained at a point of a shape, where it is no more
    than |b - a|; and inside one of them the point is in the box. Confined fields take all values
    of b - a in the disc. There it is sampled, and what it can rise between samples is added.
    Growth: where the mean is at most t, one of them is.
    """
    levels = _levels(heights, len(bodies))
    if ease not in get_args(Ease):
        raise InputError("ease", ease, "there is no such easing", "use 'linear' or 'smooth'")
    tags = [bounded_profile(body).tags for body in bodies]
    extent = tags[0].extent
    for other in tags[1:]:
        extent = hull(extent, other.extent)
    lipschitz = largest([1.0, *(item.lipschitz for item in tags)])
    sections = [body.expression for body in bodies]
    box = extent[:, :2]
    if lipschitz is not None and not all(item.exact for item in tags):
        reach = reach_of(extent)
        sections = [confined(section, reach) for section in sections]
        lipschitz = math.hypot(1.0, lipschitz)
        box = np.array([[-reach] * 2, [reach] * 2])
    value, slope = sections[0], lipschitz
    for i in range(1, len(sections)):
        rise = levels[i] - levels[i - 1]
        step = clamp((Z - levels[i - 1]) / rise, 0.0, 1.0)
        weight = step if ease == "linear" else square(step) * (3 - 2 * step)
        value = value + weight * (sections[i] - sections[i - 1])
        if lipschitz is not None and slope is not None:
            apart = _largest_difference(sections[i - 1], sections[i], box, lipschitz)
            slope = max(slope, math.hypot(lipschitz, _STEEPEST[ease] * apart / rise))
    ends = maximum(Z - levels[-1], levels[0] - Z)
    growth = largest([1.0, *(item.growth for item in tags)])
    result = Tags(False, slope, _between(extent, levels[0], levels[-1]), growth)
    return Body(box_distance((value, ends)), result)


def _levels(heights: ArrayLike, count: int) -> list[float]:
    values = np.asarray(heights, dtype=object).reshape(-1).tolist()
    levels = [arguments.number("heights", value) for value in values]
    if len(levels) != count or count < 2:
        raise InputError(
            "heights",
            heights,
            f"{len(levels)} heights for {count} profiles",
            "pass two or more profiles, and one height for each",
        )
    if any(upper <= lower for lower, upper in pairwise(levels)):
        raise InputError("heights", heights, "they do not rise", "pass them from low to high")
    return levels


def _largest_difference(
    first: Expression, second: Expression, box: NDArray[np.float64], lipschitz: float
) -> float:
    """A bound on |first - second| over a box in the plane, both with this Lipschitz bound."""
    axes = [torch.linspace(*box[:, i].tolist(), _SAMPLES, dtype=torch.float64) for i in range(2)]
    points = torch.cartesian_prod(*axes, torch.zeros(1, dtype=torch.float64))
    with torch.no_grad():
        values = [Tape(section).evaluate(points) for section in (first, second)]
    cell = np.ptp(box, axis=0) / (_SAMPLES - 1)
    return float((values[0] - values[1]).abs().max()) + lipschitz * float(np.hypot(*cell))


# --- the way back ---------------------------------------------------------------------


@rule
def slice(body: Body, z: float) -> Body:
    """a(x, y, z0) for all z. Exact only if a does not depend on z: in the plane the surface may be
    farther than in space. The bounds in x and y hold for every cut."""
    height = arguments.number("z", z)
    tags = body.tags
    extent = _between(tags.extent, EVERYWHERE[0, 2], EVERYWHERE[1, 2])
    exact = tags.exact and is_profile(body.expression)
    expression = remap(body.expression, (X, Y, constant(height)))
    return Body(expression, Tags(exact, tags.lipschitz, extent, tags.growth))
