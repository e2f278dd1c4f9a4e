"""The multi-resolution hash encoding: features of points, differentiable twice.

Two implementations with one meaning. `encode_in_torch` is plain indexing, for any device and any
number of derivatives; `encode` takes compiled loops where it can, which is on the CPU in float32
and float64, for values and two derivatives by the points, the table or one of each.

Features are continuous, and multilinear in each cell. Their gradient by the points jumps from cell
to cell; second derivatives exist inside cells, and there are those of the trilinear formula (mixed
ones only). Points outside [0, 1]^3 are extrapolated from the outermost cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fields.neural.architecture import HashGrid

FEATURES = 2
"""Numbers a vertex; the paper's choice, and fixed in the kernels."""

PRIMES = (1, 2654435761, 805459861)


@dataclass(frozen=True, slots=True, eq=False)
class Grids:
    """Where each grid's vertices are in the one table of all.

    Attributes:
        resolutions: `(levels,)` cells along an edge.
        offsets: `(levels,)` the first row of each grid.
        masks: `(levels,)` the number of its rows less one where vertices are hashed, a power of two
            less one; -1 where each vertex has a row of its own, x running fastest.
        rows: of the table.
    """

    resolutions: NDArray[np.int64]
    offsets: NDArray[np.int64]
    masks: NDArray[np.int64]
    rows: int

    @staticmethod
    def of(architecture: HashGrid) -> Grids:
        """The layout for an architecture."""
        resolutions = architecture.resolutions
        vertices, most = (resolutions + 1) ** 3, 1 << architecture.log2_table
        sizes = np.minimum(vertices, most)
        ends = np.cumsum(sizes)
        masks = np.where(vertices > most, most - 1, -1)
        return Grids(resolutions, ends - sizes, masks, int(ends[-1]))

    @property
    def arrays(self) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
        """As the kernels take them."""
        return self.resolutions, self.offsets, self.masks


def encode(points: Tensor, table: Tensor, grids: Grids) -> Tensor:
    """Features `(n, 2 levels)` of points `(n, 3)`, by the fastest way there is.

    Args:
        points: in [0, 1]^3.
        table: `(grids.rows, 2)`, in the points' dtype and on their device.
        grids: the layout.
    """
    if points.device.type == "cpu" and points.dtype in (torch.float32, torch.float64):
        return _Encode.apply(points, table, grids).t()
    return encode_in_torch(points, table, grids)


def encode_in_torch(points: Tensor, table: Tensor, grids: Grids) -> Tensor:
    """`encode`, written as indexing: memory and time grow with 8 vertices a point and level."""
    levels = []
    for n, offset, mask in zip(*(array.tolist() for array in grids.arrays), strict=True):
        position = points * n
        cell = position.detach().floor().clamp(0, n - 1)
        within = position - cell
        features = points.new_zeros(len(points), FEATURES)
        for corner in range(8):
            steps = torch.tensor([corner >> axis & 1 for axis in range(3)], device=points.device)
            x, y, z = (cell.long() + steps).unbind(-1)
            if mask < 0:
                row = x + (n + 1) * (y + (n + 1) * z)
            else:
                row = (x ^ (y * PRIMES[1]) ^ (z * PRIMES[2])) & mask
            weight = torch.where(steps == 1, within, 1 - within).prod(dim=-1)
            features = features + weight.unsqueeze(-1) * table[offset + row]
        levels.append(features)
    return torch.cat(levels, dim=-1)


# --- compiled -------------------------------------------------------------------------
#
# With w(x) the trilinear weights, T the table, g a gradient by the features, and D_u the derivative
# along u:
#
#     Encode    (x, T)    -> w T                  its gradients are Scatter and Slope
#     Scatter   (x, g)    -> w^T g
#     Slope     (x, T, g) -> d/dx (g . w T)       linear in T and in g
#
# and, differentiated by u . Slope(x, T, g) = g . D_u(w) T:
#
#     by g: D_u(w) T       by T: D_u(w)^T g       by x: d/dx (g . D_u(w) T)


def _no_directions(points: Tensor) -> NDArray:
    return points.new_empty(0, 3).numpy()


def _arrays(*tensors: Tensor) -> list[NDArray]:
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


def _gathered(points: Tensor, table: Tensor, grids: Grids, along: Tensor | None = None) -> Tensor:
    from fields.neural.hash_kernels import gather

    features = points.new_empty(FEATURES * len(grids.resolutions), len(points))
    directions = _no_directions(points) if along is None else _arrays(along)[0]
    gather(*_arrays(points, table), *grids.arrays, directions, features.numpy())
    return features


def _scattered(points: Tensor, upstream: Tensor, grids: Grids, along: Tensor | None = None):
    from fields.neural.hash_kernels import scatter

    table = points.new_zeros(grids.rows, FEATURES)
    directions = _no_directions(points) if along is None else _arrays(along)[0]
    scatter(*_arrays(points, upstream), *grids.arrays, directions, table.numpy())
    return table


def _sloped(
    points: Tensor, table: Tensor, upstream: Tensor, grids: Grids, along: Tensor | None = None
) -> Tensor:
    from fields.neural.hash_kernels import slope

    slopes = points.new_empty(len(grids.resolutions), len(points), 3)
    directions = _no_directions(points) if along is None else _arrays(along)[0]
    slope(*_arrays(points, table, upstream), *grids.arrays, directions, slopes.numpy())
    return slopes.sum(dim=0)


class _Encode(torch.autograd.Function):
    """Features `(2 levels, n)`."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, grids: Grids) -> Tensor:
        ctx.save_for_backward(points, table)
        ctx.grids = grids
        return _gathered(points, table, grids)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        points, table = ctx.saved_tensors
        by_points = by_table = None
        if ctx.needs_input_grad[0]:
            by_points = _Slope.apply(points, table, upstream, ctx.grids)
        if ctx.needs_input_grad[1]:
            by_table = _Scatter.apply(points, upstream, ctx.grids)
        return by_points, by_table, None


class _Scatter(torch.autograd.Function):
    """The gradient of the features by the table."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, upstream: Tensor, grids: Grids) -> Tensor:
        ctx.save_for_backward(points, upstream)
        ctx.grids = grids
        return _scattered(points, upstream, grids)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, along: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        points, upstream = ctx.saved_tensors
        by_points = by_upstream = None
        if ctx.needs_input_grad[0]:
            by_points = _sloped(points, along, upstream, ctx.grids)
        if ctx.needs_input_grad[1]:
            by_upstream = _gathered(points, along, ctx.grids)
        return by_points, by_upstream, None


class _Slope(torch.autograd.Function):
    """The gradient of the features by the points."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, upstream: Tensor, grids: Grids) -> Tensor:
        ctx.save_for_backward(points, table, upstream)
        ctx.grids = grids
        return _sloped(points, table, upstream, grids)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: Any, along: Tensor
    ) -> tuple[Tensor | None, Tensor | None, Tensor | None, None]:
        points, table, upstream = ctx.saved_tensors
        by_points = by_table = by_upstream = None
        if ctx.needs_input_grad[0]:
            by_points = _sloped(points, table, upstream, ctx.grids, along)
        if ctx.needs_input_grad[1]:
            by_table = _scattered(points, upstream, ctx.grids, along)
        if ctx.needs_input_grad[2]:
            by_upstream = _gathered(points, table, ctx.grids, along)
        return by_points, by_table, by_upstream, None
