"""Operations that turn one field into another, the same everywhere or along a direction."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike

from fields import arguments
from fields.enclosure import confined, nearest_in, widened
from fields.errors import InputError
from fields.expression import Expression, X, Y, Z, clamp, length
from fields.operations import Body, rule
from fields.tags import Box, Tags, hull, largest
from fields.tape import Tape

_ORIGIN = (0.0, 0.0, 0.0)


@rule
def morph(a: Body, b: Body, share: float) -> Body:
    """(1 - share) a + share b.

    Lipschitz: the same mean of both bounds. Exact: not claimed, but for the ends.
    Extent: the mean is at least the lesser of both, so that of the union holds.
    """
    t = arguments.number("share", share)
    if not 0 <= t <= 1:
        raise InputError(
            "share", share, "it is no part of 1", "pass 0 for the first, 1 for the other"
        )
    if t == 0 or t == 1:
        return b if t else a
    known = a.tags.lipschitz is not None and b.tags.lipschitz is not None
    lipschitz = (1 - t) * a.tags.lipschitz + t * b.tags.lipschitz if known else None
    return Body(_mean(a, b, t), _of_either(a, b, lipschitz))


@rule
def transition_linear(a: Body, b: Body, start: ArrayLike, end: ArrayLike) -> Body:
    """(1 - t) a + t b, with t from 0 to 1 along the way from one point to another.

    See `_varying` for the tags.
    """
    first, last = (np.array(arguments.vector(*item)) for item in (("start", start), ("end", end)))
    way = last - first
    squared = float(way @ way)
    if squared == 0:
        raise InputError("end", end, "it equals start", "pass two points")
    t = sum(
        (
            (axis - float(s)) * (float(w) / squared)
            for axis, s, w in zip((X, Y, Z), first, way, strict=True)
        ),
        start=0.0,
    )
    return _varying(a, b, clamp(t, 0.0, 1.0), squared**-0.5)


@rule
def transition_radial(
    a: Body, b: Body, inner: float, outer: float, axis: str | ArrayLike = "z"
) -> Body:
    """(1 - t) a + t b, with t from 0 to 1 between two distances from an axis through the origin.

    See `_varying` for the tags.
    """
    low = arguments.not_negative("inner", inner)
    high = arguments.positive("outer", outer)
    if high <= low:
        raise InputError("outer", outer, f"it is not beyond inner = {low:g}", "pass inner < outer")
    x, y, z = arguments.direction("axis", axis)
    along = x * X + y * Y + z * Z
    radius = length(X - x * along, Y - y * along, Z - z * along)
    return _varying(a, b, clamp((radius - low) / (high - low), 0.0, 1.0), 1 / (high - low))


def _varying(a: Body, b: Body, t: Expression, steepness: float) -> Body:
    """(1 - t) a + t b for a share t in [0, 1] whose gradient is no longer than `steepness`.

    Lipschitz: the larger of both, and steepness * |b - a|. That difference may grow for ever, so
    the field is confined to the region around both boxes, where it is at most that at the middle
    and, to any other point, the sum of both bounds times the distance. Without bounds there is no
    constant.
    Extent: as for `morph`.
    """
    expression, tags = _mean(a, b, t), _of_either(a, b, None)
    steepest = largest([a.tags.lipschitz, b.tags.lipschitz])
    if tags.bounds is None or steepest is None:
        return Body(expression, tags)
    region = widened(tags.extent)
    half = float(np.linalg.norm(region[1] - region[0])) / 2
    apart = abs(_at_middle(a.expression - b.expression, region))
    apart += (a.tags.lipschitz + b.tags.lipschitz) * half
    lipschitz = max(steepest + steepness * apart, 1.0)
    inside = confined(expression, nearest_in(region), tags.extent)
    return Body(inside, Tags(False, lipschitz, tags.extent, 1.0))


def _at_middle(expression: Expression, region: Box) -> float:
    with torch.no_grad():
        return float(Tape(expression).evaluate(torch.from_numpy(region.mean(axis=0))))


def _mean(a: Body, b: Body, t: Expression | float) -> Expression:
    return a.expression * (1 - t) + b.expression * t


def _of_either(a: Body, b: Body, lipschitz: float | None) -> Tags:
    growth = largest([a.tags.growth, b.tags.growth])
    return Tags(False, lipschitz, hull(a.tags.extent, b.tags.extent), growth)
