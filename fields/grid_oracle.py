"""A spline through samples on a grid, as a leaf of the expression graph."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fields.oracle import Boxes
from fields.spline import cubic_coefficients

Floats = NDArray[np.floating]

_WIDE = 3
"""Blocks an axis that are looked up to enclose a box; more are tighter and slower."""


class GridOracle:
    """Interpolates samples within their box; outside, the outermost polynomials go on.

    Without gradients and on the CPU it is evaluated by compiled loops, else in torch; both agree
    to rounding. Gradients of any order are those of the spline.

    Args:
        samples: `(nx, ny, nz)`, float32 or float64, finite; not copied.
        origin: `(3,)`, place of the first sample.
        spacing: `(3,)`, positive.
        degree: 1 or 3, of the spline.
    """

    name = "grid"
    outputs = 1

    def __init__(
        self,
        samples: Floats,
        origin: NDArray[np.float64],
        spacing: NDArray[np.float64],
        degree: int,
    ) -> None:
        self.samples, self.origin, self.spacing, self.degree = samples, origin, spacing, degree
        self.box = np.stack([origin, origin + spacing * (np.array(samples.shape) - 1)])
        self._coefficients = samples if degree == 1 else cubic_coefficients(samples)
        self._tensors: dict[tuple[torch.dtype, torch.device], Tensor] = {}

    def __call__(self, points: Tensor) -> Tensor:
        """Values `(..., 1)` at points `(..., 3)`."""
        flat = points.reshape(-1, 3)
        differentiated = torch.is_grad_enabled() and points.requires_grad
        if differentiated or points.device.type != "cpu":
            values = self._in_torch(flat)
        else:
            values = torch.from_numpy(self._compiled(flat.detach().double().numpy())).to(points)
        return values.view(*points.shape[:-1], 1)

    def _compiled(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        from fields.kernels.interpolation import cubic, linear

        function = linear if self.degree == 1 else cubic
        return function(
            np.ascontiguousarray(points), self._coefficients, self.origin, 1.0 / self.spacing
        )

    def _in_torch(self, points: Tensor) -> Tensor:
        coefficients = self._coefficients_like(points)
        sizes = coefficients.shape
        indices, weights = [], []
        for axis in range(3):
            t = (points[:, axis] - float(self.origin[axis])) / float(self.spacing[axis])
            last = sizes[axis] - self.degree - 1
            cell = t.detach().nan_to_num().floor().clamp(0, last)
            weights.append(_weights(t - cell, self.degree))
            offsets = torch.arange(self.degree + 1, device=points.device)
            indices.append(cell.long()[:, None] + offsets)
        i, j, k = indices
        rows = (i[:, :, None] * sizes[1] + j[:, None, :]) * sizes[2]
        around = coefficients.reshape(-1)[rows[:, :, :, None] + k[:, None, None, :]]
        for weight in reversed(weights):
            around = (around * weight.view(len(points), *[1] * (around.ndim - 2), -1)).sum(-1)
        return around

    def _coefficients_like(self, points: Tensor) -> Tensor:
        key = (points.dtype, points.device)
        if key not in self._tensors:
            self._tensors[key] = torch.from_numpy(self._coefficients).to(points)
        return self._tensors[key]

    # --- bounds ---

    @cached_property
    def _cells(self) -> tuple[Floats, Floats, Floats]:
        """Bounds on the values in each cell, least and largest, and on the slope."""
        from fields.kernels.interpolation import bounds_cubic, bounds_linear

        function = bounds_linear if self.degree == 1 else bounds_cubic
        least, most, steepest = function(self._coefficients, 1.0 / self.spacing)
        # Sums of up to 64 terms in float64, then rounded to the samples' own precision.
        rounding = 4 * float(np.finfo(least.dtype).eps) + 1e-13
        margin = rounding * float(np.abs(self._coefficients).max())
        return least - margin, most + margin, steepest * (1 + rounding)

    @cached_property
    def steepest(self) -> float:
        """A bound on the norm of the gradient; attained if the degree is 1."""
        return float(self._cells[2].max())

    @cached_property
    def cell_bounds(self) -> list[tuple[Floats, Floats]]:
        """Bounds on the values in each cell, then in blocks of 2, 4, 8 ... cells an axis."""
        least, most, _ = self._cells
        levels = [(least, most)]
        while max(least.shape) > 1:
            least, most = _halved(least, np.minimum), _halved(most, np.maximum)
            levels.append((least, most))
        return levels

    @property
    def least_on_walls(self) -> float:
        """A lower bound on the values in the cells at the walls of the box."""
        least = self.cell_bounds[0][0]
        return min(float(np.take(least, (0, -1), axis).min()) for axis in range(3))

    def enclose(self, boxes: Boxes) -> NDArray[np.float64]:
        """By the bounds of the cells that a box meets, taken in blocks if they are many.

        Boxes are cut off at the box of the samples: points beyond are not asked for.
        """
        cells = np.array(self.cell_bounds[0][0].shape)
        place = (boxes - self.origin) / self.spacing
        slack = 1e-9 + 1e-15 * np.abs(boxes / self.spacing)
        first = np.clip(np.floor(place[:, 0] - slack[:, 0]), 0, cells - 1).astype(np.int64)
        last = np.clip(np.floor(place[:, 1] + slack[:, 1]), 0, cells - 1).astype(np.int64)
        widest = (last - first).max(axis=1).clip(1)
        # m cells in a row meet at most (m - 2) // b + 2 blocks of b = 2**level, here <= _WIDE.
        level = np.ceil(np.log2(widest / (_WIDE - 1))).clip(0).astype(np.int64)
        bounds = np.empty((len(boxes), 1, 2))
        for number in np.unique(level):
            rows = level == number
            bounds[rows, 0] = self._range(number, first[rows] >> number, last[rows] >> number)
        return bounds

    def _range(
        self, level: int, first: NDArray[np.int64], last: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        least, most = self.cell_bounds[level]
        low, high = np.full(len(first), np.inf), np.full(len(first), -np.inf)
        for step in np.ndindex(_WIDE, _WIDE, _WIDE):
            block = tuple(np.minimum(first + step, last).T)
            low, high = np.minimum(low, least[block]), np.maximum(high, most[block])
        return np.stack([low, high], axis=1)


def _weights(u: Tensor, degree: int) -> Tensor:
    """The B-splines that are not zero in a cell, `(n, degree + 1)`, at `u` from 0 to 1 in it."""
    s = 1 - u
    if degree == 1:
        return torch.stack([s, u], dim=1)
    middle = [(4 - 6 * t * t + 3 * t * t * t) / 6 for t in (u, s)]
    return torch.stack([s * s * s / 6, *middle, u * u * u / 6], dim=1)


def _halved(values: Floats, function: np.ufunc) -> Floats:
    """The least or largest in blocks of two an axis; an odd one at the end stays alone."""
    for axis in range(3):
        values = function.reduceat(values, np.arange(0, values.shape[axis], 2), axis=axis)
    return values
