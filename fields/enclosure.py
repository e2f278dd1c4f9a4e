"""The box around a field made part of its formula, so that facts about it hold everywhere.

An operation such as a twist is well behaved near the shape only: its gradient grows without bound
away from the axis. What is wanted there is any field that is right about the zero set, positive
outside, and has the same Lipschitz bound. The distance to the box around the shape is one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    length,
    maximum,
    minimum,
    remap,
    where_negative,
)
from fields.operations import Body
from fields.tags import Box, largest

MARGIN = 1 / 64
"""How far around a box a formula is still used as it is, as a part of the box's width: two samples
of a lattice of 128 along it, so that values are interpolated across the surface by one formula."""


def raised(expression: Expression, extent: Box) -> Expression:
    """f in a box, and max(f, d) outside of it, with d the distance to the box.

    For a field whose zero set and inside are in the box: then f is not negative on its sides, so
    the two parts meet without a jump. Sides at infinity play no part.
    """
    beyond = []
    for axis, low, high in zip((X, Y, Z), *extent, strict=True):
        sides = [float(low) - axis] if np.isfinite(low) else []
        sides += [axis - float(high)] if np.isfinite(high) else []
        if sides:
            beyond.append(maximum(0.0, *sides))
    if not beyond:
        return expression
    distance = length(*beyond)
    return where_negative(-distance, maximum(expression, distance), expression)


def widened(extent: Box) -> Box:
    """The box with a margin on all finite sides."""
    with np.errstate(invalid="ignore"):
        margin = MARGIN * (extent[1] - extent[0])
    return np.stack([extent[0] - margin, extent[1] + margin])


def nearest_in(extent: Box) -> Coordinates:
    """The point of a box that is nearest to (x, y, z); a map with Lipschitz constant 1."""
    x, y, z = (_held(axis, low, high) for axis, low, high in zip((X, Y, Z), *extent, strict=True))
    return (x, y, z)


def _held(axis: Expression, low: float, high: float) -> Expression:
    if np.isfinite(low):
        axis = maximum(axis, float(low))
    return minimum(axis, float(high)) if np.isfinite(high) else axis


def confined(expression: Expression, within: Coordinates, extent: Box) -> Expression:
    """f(q), raised to d outside of the extent: points are replaced by points of a region around it.

    Args:
        expression: f; its zero set and inside are in the extent.
        within: q, the nearest point of a convex region that contains the extent.
        extent: d is the distance to this box.

    The zero set and the inside stay: in the extent q is p, and outside of it d > 0.
    Lipschitz: the larger of 1 and the bound of f in the region alone, as q is the projection to a
    convex set, whose constant is 1, and d has constant 1. Growth: 1, as it is at least d.
    """
    return raised(remap(expression, within), extent)


def floored(body: Body) -> Body:
    """The same shape by a field that is nowhere less than the distance to its box.

    A distance is so already. Others are raised to it, and have growth 1 thereby.
    """
    if body.tags.exact:
        return body
    tags = replace(body.tags, lipschitz=largest([1.0, body.tags.lipschitz]), growth=1.0)
    return Body(raised(body.expression, body.tags.extent), tags)
