"""Straight edges in a row, and their signed distance as an expression.

For each edge: if the foot of the perpendicular is on it, the signed distance to its line, else the
distance to its first end, with the sign of the bisector of both normals there. The nearest of all
is the signed distance. An edge's second end is the first of the next, so nothing is missed. At a
convex corner the points nearest to it are outside and at a reflex one inside; the bisector says
the same and, unlike a constant, cannot be wrong by rounding where two edges are nearly in line.
On an edge itself nothing is rooted, so gradients are right on the surface too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.expression import Expression, X, Y, length, minimum, where_negative

Points = NDArray[np.float64]
"""Points of the plane `(n, 2)`."""


class Edges(NamedTuple):
    """Edges with the inside on their left.

    Attributes:
        start: `(n, 2)`, the first end of each.
        direction: `(n, 2)`, unit vectors.
        extent: `(n,)`, lengths. The last end of an open chain is an edge of length 0.
        bisector: `(n, 2)`, sums of the outward normals before and after the first end.
    """

    start: Points
    direction: Points
    extent: NDArray[np.float64]
    bisector: Points


def closed_edges(points: Points) -> Edges:
    """The edges of a polygon, counter-clockwise around the inside, without repeated points."""
    along = np.roll(points, -1, axis=0) - points
    extent = np.hypot(*along.T)
    direction = along / extent[:, None]
    normal = _outward(direction)
    return Edges(points, direction, extent, normal + np.roll(normal, 1, axis=0))


def open_edges(points: Points) -> Edges:
    """The edges of a chain, and an edge of length 0 at its end."""
    along = np.diff(points, axis=0)
    extent = np.hypot(*along.T)
    direction = along / extent[:, None]
    normal = _outward(direction)
    bisector = np.concatenate([normal[:1], normal[1:] + normal[:-1], normal[-1:]])
    direction = np.concatenate([direction, direction[-1:]])
    return Edges(points, direction, np.append(extent, 0.0), bisector)


def joined(parts: list[Edges]) -> Edges:
    """The edges of all parts."""
    return Edges(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _outward(direction: Points) -> Points:
    return np.stack([direction[:, 1], -direction[:, 0]], axis=1)


def edges_distance(edges: Edges, x: Expression = X, y: Expression = Y) -> Expression:
    """The signed distance to edges, for coordinates that may be folded by symmetries.

    Of an open chain it is the distance to the shape that mirrors complete, if the coordinates are
    folded by these mirrors, the chain's ends lie on them and nothing else does: what is nearest to
    a point is then on the point's own side of every mirror.
    """
    rows = zip(*(column.tolist() for column in edges), strict=True)
    values = [_one_distance(row, x, y) for row in rows]
    best, nearest = values[0], abs(values[0])
    for value in values[1:]:
        size = abs(value)
        best = where_negative(size - nearest, value, best)
        nearest = minimum(nearest, size)
    return best


def _one_distance(
    row: tuple[list[float], list[float], float, list[float]], x: Expression, y: Expression
) -> Expression:
    (start_x, start_y), (along_x, along_y), extent, (bisector_x, bisector_y) = row
    from_x, from_y = x - start_x, y - start_y
    to_corner = length(from_x, from_y)
    corner = where_negative(bisector_x * from_x + bisector_y * from_y, -to_corner, to_corner)
    if extent == 0:
        return corner
    beside = abs(along_x * from_x + along_y * from_y - extent / 2) - extent / 2
    return where_negative(beside, along_y * from_x - along_x * from_y, corner)
