"""Opaque leaves of the expression graph.

An oracle is a function of points that the graph does not look into: a mesh, a grid,
a neural network, the inverse of a warp. It takes part in an expression like any other
operation, and is called once per evaluation however often its outputs are used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import Tensor


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


@dataclass(frozen=True, eq=False, slots=True)
class FunctionOracle:
    """A plain torch function as an oracle.

    Args:
        function: maps points `(..., 3)` to `(..., outputs)`; with one output it may
            also return `(...)`.
        name: a short word for `repr`.
        outputs: how many numbers it returns for a point.
    """

    function: Callable[[Tensor], Tensor]
    name: str
    outputs: int = 1

    def __call__(self, points: Tensor) -> Tensor:
        """Values `(..., outputs)` at points `(..., 3)`."""
        values = self.function(points)
        if self.outputs == 1 and isinstance(values, Tensor) and values.shape == points.shape[:-1]:
            return values.unsqueeze(-1)
        return values
