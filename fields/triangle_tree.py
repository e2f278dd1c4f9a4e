"""Nearest triangles and winding numbers of many points, through compiled kernels."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.z_order import sorted_in_space

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Nearest(NamedTuple):
    """The nearest points of a surface.

    Attributes:
        triangle: `(n,)`, on which the nearest point lies; -1 where none is near enough.
        feature: `(n,)`, what of it: 0 the inside, 1 + k the edge from corner k to corner
            k + 1, 4 + k corner k.
        point: `(n, 3)`, NaN where there is none.
    """

    triangle: Integers
    feature: Integers
    point: Floats


class TriangleTree:
    """A tree of boxes around triangles, for questions about many points.

    Args:
        corners: `(f, 3, 3)`, at least one triangle, finite. Triangles without area are fine.
    """

    def __init__(self, corners: Floats) -> None:
        from fields.kernels.triangle_tree import build

        self._order, self._boxes, self._links = build(np.ascontiguousarray(corners))
        self._corners = np.ascontiguousarray(corners[self._order])

    def nearest(self, points: Floats, limit: float = np.inf) -> Nearest:
        """The nearest triangle to each point `(n, 3)` that is nearer than `limit`.

        Float64 throughout: of two triangles whose distances agree to rounding it may take
        either, and no other is nearer.
        """
        from fields.kernels.triangle_tree import nearest

        order = sorted_in_space(points)
        triangle, feature, point = nearest(
            points[order], self._corners, self._boxes, self._links, limit
        )
        back = np.empty_like(order)
        back[order] = np.arange(len(order))
        found = np.where(triangle >= 0, self._order[triangle], -1)
        return Nearest(found[back], feature[back], point[back])

    def winding_number(self, points: Floats) -> Floats:
        """The generalised winding number at points `(n, 3)`; see the kernel's module."""
        from fields.kernels.winding_number import winding_number

        return winding_number(
            np.ascontiguousarray(points), self._corners, self._links, self._clusters
        )

    @cached_property
    def _clusters(self) -> Floats:
        from fields.kernels.winding_number import moments

        return moments(self._corners, self._links)
