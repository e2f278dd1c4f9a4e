"""Outlines of any number of edges as fields."""

from __future__ import annotations

from weakref import WeakValueDictionary

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from fields.expression import Expression, X, Y, call, constant
from fields.operations import Body
from fields.oracle import Boxes, enclose_by_lipschitz
from fields.profiles.edges import Edges, Points, closed_edges, edges_distance, joined
from fields.tags import EVERYWHERE, Box, Tags

FEW = 16
"""Up to so many edges are arithmetic, some 25 operations each; more are searched.

The search is faster from 4 edges on, as long as torch does the arithmetic; but what is arithmetic
can be compiled into one kernel with the rest of a scene, and be written as a shader."""


def outline_body(contours: list[Points]) -> Body:
    """The exact distance to polygons that do not cross, with the inside on the left of their edges.

    They may touch in points, where the sum of the normals at either still tells the sides apart.
    """
    edges = joined([closed_edges(points) for points in contours])
    extent = plane_extent(edges.start.min(axis=0), edges.start.max(axis=0))
    return Body(outline_distance(edges), Tags.of_distance(extent))


def plane_extent(low: ArrayLike, high: ArrayLike) -> Box:
    """The extent of a profile with corners `(2,)`: unbounded in z."""
    extent = EVERYWHERE.copy()
    extent[0, :2], extent[1, :2] = low, high
    return extent


def profile_body(expression: Expression, low: ArrayLike, high: ArrayLike) -> Body:
    """An exact profile with corners `(2,)` of its bounds."""
    return Body(expression, Tags.of_distance(plane_extent(low, high)))


def outline_distance(edges: Edges) -> Expression:
    """The signed distance to edges at (x, y)."""
    if len(edges.start) <= FEW:
        return edges_distance(edges)
    (value,) = call(_outline_oracle(edges), (X, Y, constant(0.0)))
    return value


class OutlineOracle:
    """The signed distance to many edges, as a leaf of the expression graph.

    The nearest edge is searched on the CPU in float64. Where gradients are wanted, the distance to
    that edge is then computed by torch operations, so it can be differentiated any number of times.
    """

    name = "outline"
    outputs = 1

    def __init__(self, edges: Edges) -> None:
        self.edges = edges
        self._rows = np.ascontiguousarray(np.column_stack(edges))
        self._boxes = _tree(self._rows)

    def __call__(self, points: Tensor) -> Tensor:
        """Signed distances `(..., 1)` at points `(..., 3)`, whose z plays no part."""
        values, indices = self._nearest(points)
        if torch.is_grad_enabled() and points.requires_grad:
            return self._distance(points, indices).unsqueeze(-1)
        return values.to(points).view(points.shape[:-1]).unsqueeze(-1)

    def enclose(self, boxes: Boxes) -> np.ndarray:
        """A distance changes by at most one a unit of distance."""
        flat = boxes.copy()
        flat[:, :, 2] = 0.0
        return enclose_by_lipschitz(self, flat, 1.0)

    def _nearest(self, points: Tensor) -> tuple[Tensor, Tensor]:
        from fields.profiles.outline_kernel import nearest_edges

        plane = points.detach()[..., :2].to("cpu", torch.float64).reshape(-1, 2).contiguous()
        values, indices = plane.new_empty(len(plane)), torch.empty(len(plane), dtype=torch.int64)
        nearest_edges(plane.numpy(), self._rows, self._boxes, values.numpy(), indices.numpy())
        return values, indices

    def _distance(self, points: Tensor, indices: Tensor) -> Tensor:
        rows = torch.from_numpy(self._rows)[indices].to(points).view(*points.shape[:-1], 7)
        start_x, start_y, along_x, along_y, extent, bisector_x, bisector_y = rows.unbind(-1)
        from_x, from_y = points[..., 0] - start_x, points[..., 1] - start_y
        along = along_x * from_x + along_y * from_y
        is_beside = (along > 0) & (along < extent)
        squared = from_x.square() + from_y.square()
        # Where the corner is not used, or is the point itself, its root is kept away from 0.
        is_corner = ~is_beside & (squared > 0)
        corner = torch.where(is_corner, squared, 1).sqrt() * is_corner
        sign = torch.where(bisector_x * from_x + bisector_y * from_y < 0, -1.0, 1.0)
        return torch.where(is_beside, along_y * from_x - along_x * from_y, sign * corner)


_oracles: WeakValueDictionary[bytes, OutlineOracle] = WeakValueDictionary()


def _outline_oracle(edges: Edges) -> OutlineOracle:
    """One oracle for equal edges, so that equal outlines are the same leaf."""
    key = np.column_stack(edges).tobytes()
    oracle = _oracles.get(key)
    if oracle is None:
        oracle = _oracles.setdefault(key, OutlineOracle(edges))
    return oracle


def _tree(rows: np.ndarray) -> np.ndarray:
    """The boxes `(2 * leaves, 4)` of the tree that `outline_kernel` searches."""
    from fields.profiles.outline_kernel import LEAF

    leaves = 1 << max(0, (-(-len(rows) // LEAF) - 1).bit_length())
    ends = rows[:, :2] + rows[:, 4:5] * rows[:, 2:4]
    low = np.full((leaves * LEAF, 2), np.inf)
    high = np.full((leaves * LEAF, 2), -np.inf)
    low[: len(rows)] = np.minimum(rows[:, :2], ends)
    high[: len(rows)] = np.maximum(rows[:, :2], ends)
    boxes = np.empty((2 * leaves, 4))
    boxes[leaves:, :2] = low.reshape(leaves, LEAF, 2).min(axis=1)
    boxes[leaves:, 2:] = high.reshape(leaves, LEAF, 2).max(axis=1)
    width = leaves
    while width > 1:
        children = boxes[width : 2 * width].reshape(width // 2, 2, 4)
        boxes[width // 2 : width, :2] = children[:, :, :2].min(axis=1)
        boxes[width // 2 : width, 2:] = children[:, :, 2:].max(axis=1)
        width //= 2
    boxes[0] = boxes[-1]
    return boxes
