"""Nearest triangles and winding numbers of many points, through compiled kernels."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

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

        order = _along_a_curve(points)
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


def _along_a_curve(points: Floats) -> Integers:
    """An order of points in which neighbours are near each other: Morton's, 1024 cells a side."""
    if len(points) < 2:
        return np.arange(len(points))
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.where(high > low, high - low, 1.0) / 1023
    cells = np.nan_to_num((points - low) / step).clip(0, 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for axis, cell in enumerate(cells.T):
        # Two zeros between every two of ten bits, by halves.
        for shift, mask in ((16, 0x30000FF), (8, 0x300F00F), (4, 0x30C30C3), (2, 0x9249249)):
            cell = (cell | cell << shift) & mask
        code |= cell << axis
    return np.argsort(code)
