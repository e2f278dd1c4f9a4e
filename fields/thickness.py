"""Operations that change how thick a field's shape is, rule by rule; see `fields.operations`."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.expression import (
    Expression,
    X,
    Y,
    Z,
    clamp,
    constant,
    floor,
    maximum,
    minimum,
    remap,
    where_negative,
)
from fields.operations import Body, rule
from fields.tags import EVERYWHERE, Tags, deepened, grown


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
    if amount > 0:
        tags = deepened(tags, amount)
    elif amount < 0:
        extent, growth = tags.extent, tags.growth
        if tags.lipschitz:
            extent = grown(extent, amount / tags.lipschitz)
            growth = None if growth is None else max(growth, 1 / tags.lipschitz)
        tags = Tags(False, tags.lipschitz, extent, growth)
    return Body(body.expression - amount, tags)


@rule
def shell(body: Body, thickness: float) -> Body:
    """|a| - thickness / 2: the points with |a| <= thickness / 2.

    Exact: not claimed, for the reason given for the offset.
    """
    half = arguments.positive("thickness", thickness) / 2
    return Body(abs(body.expression) - half, deepened(body.tags, half))


@rule
def hollow(body: Body, thickness: float) -> Body:
    """|a + thickness / 2| - thickness / 2 = max(a, -a - thickness): a wall inwards.

    Exact: not claimed, for the reason given for the offset. Extent: the value is at least a.
    """
    half = arguments.positive("thickness", thickness) / 2
    tags = body.tags
    return Body(
        abs(body.expression + half) - half, Tags(False, tags.lipschitz, tags.extent, tags.growth)
    )


@rule
def onion(body: Body, thickness: float, layers: int, gap: float | None = None) -> Body:
    """The distance of a from the nearest of the middles of the walls, less thickness / 2.

    The middles are a = -(thickness / 2 + i (thickness + gap)), i = 0, ..., layers - 1.
    Lipschitz: the distance from a set of numbers has constant 1, also where the nearest one
    changes. Exact: not claimed. Extent: the outermost wall is reached first, so the value is at
    least a.
    """
    wall = arguments.positive("thickness", thickness)
    count = arguments.whole("layers", layers)
    period = wall + (wall if gap is None else arguments.positive("gap", gap))
    depth = -body.expression - wall / 2
    nearest = clamp(floor(depth / period + 0.5), 0.0, float(count - 1))
    tags = Tags(False, body.tags.lipschitz, body.tags.extent, body.tags.growth)
    return Body(abs(depth - nearest * period) - wall / 2, tags)


@rule
def elongate(body: Body, size: float | ArrayLike) -> Body:
    """a(p - clamp(p, -h, h)), h = size / 2; where all three sizes count, deeper in the middle.

    Lipschitz: p - clamp(p) has constant 1. With all of h > 0 the value would be constant in the
    box |p| <= h, and zero all over it if the surface passes through the origin; so there the
    distance to the box's sides is taken off it (added, if the origin is not inside), which has
    constant 1 and vanishes at the sides (Quilez's corrected version).
    Exact: not claimed; along one axis it is exact outside of a convex shape, but the distance
    inside measures within one cross-section.
    Extent: {.. <= t} is A + t and [-h, h], added.
    """
    sizes = arguments.numbers_or_one("size", size, arguments.not_negative)
    if not any(sizes):
        return body
    half = np.array(sizes) / 2
    axes = [(axis, float(h)) for axis, h in zip((X, Y, Z), half, strict=True)]
    x, y, z = (axis - clamp(axis, -h, h) if h else axis for axis, h in axes)
    expression = remap(body.expression, (x, y, z))
    tags, lipschitz = body.tags, body.tags.lipschitz
    if all(sizes):
        expression = expression + _signed_depth(body.expression, axes)
        lipschitz = None if lipschitz is None else max(lipschitz, 1.0)
    extent = tags.extent + np.stack([-half, half])
    return Body(expression, Tags(False, lipschitz, extent, tags.growth))


def _signed_depth(expression: Expression, axes: list[tuple[Expression, float]]) -> Expression:
    """The distance to the sides of a box, in it; its sign is that of the field at the origin."""
    depth = minimum(maximum(*(abs(axis) - h for axis, h in axes)), 0.0)
    origin = constant(0.0)
    return where_negative(remap(expression, (origin, origin, origin)), depth, -depth)


@rule
def displace(body: Body, amount: Body, limit: float | None = None) -> Body:
    """a - amount, with the amount clamped to [-limit, limit].

    Lipschitz: the sum of both. Extent: {a - amount <= t} is within A + (t + limit); nothing
    bounds it without a limit.
    """
    outward, extent = amount.expression, EVERYWHERE
    if limit is not None:
        most = arguments.positive("limit", limit)
        outward = clamp(outward, -most, most)
        extent = deepened(body.tags, most).extent
    known = body.tags.lipschitz is not None and amount.tags.lipschitz is not None
    lipschitz = body.tags.lipschitz + amount.tags.lipschitz if known else None
    return Body(body.expression - outward, Tags(False, lipschitz, extent, body.tags.growth))
