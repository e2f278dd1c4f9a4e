"""What a method of the comparison is, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from implicit_warp.maps import Map

Trace = list[tuple[float, float, float]]
"""(seconds of CPU, vertex error, gradient error), errors times 1000."""


@dataclass(frozen=True)
class Body:
    """A mesh: (V, 3) vertices and (F, 3) faces."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


@dataclass(frozen=True)
class Fitted:
    """A deformed body.

    Attributes:
        vertices: (V, 3) the source's vertices, deformed.
        map: of space, if the method gives one.
        parameters: how many numbers were fitted.
        steps: optimisation steps.
        trace: errors while fitting.
    """

    vertices: NDArray[np.float64]
    map: Map | None
    parameters: int
    steps: int
    trace: Trace = field(default_factory=list)


class Method(Protocol):
    """Fits one body to another of the same connectivity."""

    def __call__(
        self,
        source: NDArray[np.float64],
        target: NDArray[np.float64],
        faces: NDArray[np.int64],
        *,
        height: float,
        seconds: float,
        seed: int = 0,
    ) -> Fitted:
        """Args:
        source, target: (V, 3) vertices.
        faces: (F, 3) of both.
        height: length that counts as 1.4 in errors.
        seconds: of CPU time, that an iterative method may take.
        seed: of everything random.
        """
