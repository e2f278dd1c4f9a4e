"""What a fit reports."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True)
class FitReport:
    """What a fit reached, measured on all vertices after the last step.

    Errors are those of the paper's table, times 1000: lengths are scaled so that `height` counts as
    1.4; an error is a mean over all entries of squared differences.

    Attributes:
        status: "reached the goals", "converged", "stopped at the step limit", "stopped at the time
            limit" or "interrupted".
        steps: optimisation steps taken, those before a resumed checkpoint included.
        seconds: wall-clock time of the optimisation, the same.
        vertex_error: over vertices and coordinates, weighted if weights were given; None without
            vertices.
        gradient_error: over faces and the nine entries; None without faces.
        landmark_error: over landmarks and coordinates; None without landmarks.
        loss: the weighted sum of the three that was minimised, times 1000.
        height: length in the user's units that counts as 1.4.
        history: (step, seconds, loss, vertex error, gradient error) at each review, None for an
            error that does not exist.
        relapses: steps at which the loss had risen so much that the best state was taken up again,
            at a lower learning rate.
        seed: of the start.
        options: the options used.
    """

    status: str
    steps: int
    seconds: float
    vertex_error: float | None
    gradient_error: float | None
    landmark_error: float | None
    loss: float
    height: float
    history: list[tuple[int, float, float, float | None, float | None]] = field(repr=False)
    relapses: list[int]
    seed: int
    options: dict[str, Any] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> FitReport:
        """The inverse of `to_dict`."""
        return cls(**{**values, "history": [tuple(row) for row in values["history"]]})

    def __str__(self) -> str:
        named = (
            ("vertices", self.vertex_error),
            ("gradients", self.gradient_error),
            ("landmarks", self.landmark_error),
        )
        errors = ", ".join(f"{name} {value:.3g}" for name, value in named if value is not None)
        return (
            f"{self.status} after {self.steps} steps, {self.seconds:.1f} s; "
            f"squared errors x 1000 at height 1.4: {errors}"
        )
