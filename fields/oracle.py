"""Opaque leaves of the expression graph.

An oracle is a function of points that the graph does not look into: a mesh, a grid,
a neural network, the inverse of a warp. It takes part in an expression like any other
operation, and is called once per evaluation however often its outputs are used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fields.errors import InputError

Boxes = NDArray[np.float64]
"""Boxes `(n, 2, 3)`, rows minimum and maximum."""


@runtime_checkable
class Oracle(Protocol):
    """A vectorised function of points with one or more outputs.

    Two oracles are the same leaf only if they are the same object, and an oracle must
    return the same values for the same points as long as a field that uses it lives.

    Attributes:
        name: a short word for `repr`, such as "mesh" or "twist".
        outputs: how many numbers it returns for a point.
    """

    name: str
    outputs: int

    def __call__(self, points: Tensor) -> Tensor:
        """Values `(..., outputs)` at points `(..., 3)`, in the points' dtype and device.

        Must be differentiable by autograd if gradients of the field are to be taken.
        """
        ...

    def enclose(self, boxes: Boxes) -> NDArray[np.float64] | None:
        """What the outputs can be on each of n boxes: `(n, outputs, 2)`, lower and upper bounds.

        Rigorous, rounding included. None if nothing is known; single bounds may be infinite.
        """
        ...


@runtime_checkable
class DifferentiatedOracle(Oracle, Protocol):
    """An oracle that computes its derivatives along with its values, sooner than autograd could."""

    def value_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Values `(n, outputs)` and Jacobians `(n, outputs, 3)` at points `(n, 3)`; no graph."""
        ...


def enclose_by_lipschitz(oracle: Oracle, boxes: Boxes, lipschitz: float) -> NDArray[np.float64]:
    """`Oracle.enclose` for one whose every output changes by at most so much a unit of distance.

    The value at a box's centre, give or take the way to its corners. The value is computed in
    float64, and 1e-9 of it (or of the box's distance from the origin) is allowed for its rounding.
    Where it is NaN nothing is known.
    """
    centres = 0.5 * (boxes[:, 0] + boxes[:, 1])
    with torch.no_grad():
        values = oracle(torch.from_numpy(centres)).to("cpu", torch.float64).numpy()
    reach = lipschitz * np.linalg.norm(boxes[:, 1] - centres, axis=1)
    rounding = np.maximum(np.abs(values), lipschitz * np.linalg.norm(centres, axis=1)[:, None])
    margin = (reach * (1 + 1e-9))[:, None] + 1e-9 * rounding
    bounds = np.stack([values - margin, values + margin], axis=-1)
    return np.where(np.isnan(bounds), (-np.inf, np.inf), bounds)


@dataclass(frozen=True, eq=False, slots=True)
class FunctionOracle:
    """A plain torch function as an oracle.

    Values in another floating dtype than the points', such as those of a network in float32, are
    converted.

    Args:
        function: maps points `(..., 3)` to `(..., outputs)`; with one output it may
            also return `(...)`.
        name: a short word for `repr`.
        outputs: how many numbers it returns for a point.
        lipschitz: a bound on the change of each output a unit of distance; None if unknown.
    """

    function: Callable[[Tensor], Tensor]
    name: str
    outputs: int = 1
    lipschitz: float | None = None

    def __call__(self, points: Tensor) -> Tensor:
        """Values `(..., outputs)` at points `(..., 3)`.

        Raises:
            InputError: the function returned numbers that are not real.
        """
        values = self.function(points)
        if isinstance(values, Tensor) and values.dtype != points.dtype:
            if not values.is_floating_point():
                raise InputError(
                    self.name,
                    values.dtype,
                    "the function must return real numbers",
                    "convert them to the points' dtype; for a mask, use fields.from_occupancy",
                )
            values = values.to(points.dtype)
        if self.outputs == 1 and isinstance(values, Tensor) and values.shape == points.shape[:-1]:
            return values.unsqueeze(-1)
        return values

    def enclose(self, boxes: Boxes) -> NDArray[np.float64] | None:
        """By the Lipschitz bound, if there is one."""
        if self.lipschitz is None:
            return None
        return enclose_by_lipschitz(self, boxes, self.lipschitz)
