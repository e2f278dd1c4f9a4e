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
    constant,
    length,
    maximum,
    minimum,
    remap,
)
from fields.operations import Body
from fields.tags import Box, largest

MARGIN = 1 / 64
"""How far around a box a formula is still used as it is, as a part of the box's width: two samples
of a lattice of 128 along it, so that values are interpolated across the surface by one formula."""


def outside(extent: Box) -> Expression:
    """The distance to a box, 0 in it. Sides at infinity play no part."""
    beyond = []
    for axis, low, high in zip((X, Y, Z), *extent, strict=True):
        sides = [low - axis] if np.isfinite(low) else []
        sides += [axis - high] if np.isfinite(high) else []
        if sides:
            beyond.append(maximum(0.0, *sides))
    return length(*beyond) if beyond else constant(0.0)


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
    """max(f(q), d): a field whose points are replaced by points of a region around its extent.

    Args:
        expression: f; its zero set and inside are in the extent.
        within: q, the nearest point of a convex region that contains the extent.
        extent: d is the distance to this box.

    The zero set and the inside stay: in the extent q is p and d is 0, and outside d > 0.
    Lipschitz: the larger of 1 and the bound of f in the region alone, as q is the projection to a
    convex set, whose constant is 1, and d has constant 1. Growth: 1, as it is at least d.
    """
    return maximum(remap(expression, within), outside(extent))


def floored(body: Body) -> Body:
    """The same shape by a field that is nowhere less than the distance to its box.

    A distance is so already. Others become max(a, d), and have growth 1 thereby.
    """
    if body.tags.exact:
        return body
    tags = replace(body.tags, lipschitz=largest([1.0, body.tags.lipschitz]), growth=1.0)
    return Body(maximum(body.expression, outside(body.tags.extent)), tags)
