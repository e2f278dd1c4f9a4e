"""How good a learned field is, beside the one it was learned from; on points of its own."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from fields.field import Field
from fields.neural.samples import Cube, surface_points, units

NEAR = 0.01
"""Points near the surface are within this fraction of the diagonal."""

_SEED = 9_176
"""Of the points measured on; not an option, so that figures compare."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Figures of a learned field; lengths as fractions of the diagonal of the true bounds.

    Attributes:
        near_error: mean absolute error of the values, at points up to 1 % of the diagonal off the
            surface.
        box_error: the same, at uniform points of the true bounds.
        largest_error: the largest of both.
        normal_error: mean angle, in degrees, between the gradients at points of the true surface.
        chamfer: half the sum of the two mean distances between the surfaces: from points of the
            learned one to the true one, and from points of the true one to the learned one, the
            latter along the learned gradient.
        points: how many of each kind were drawn.
    """

    near_error: float
    box_error: float
    largest_error: float
    normal_error: float
    chamfer: float
    points: int

    def to_dict(self) -> dict[str, float | int]:
        """Plain values for JSON."""
        return asdict(self)


def measure(learned: Field, source: Field, cube: Cube, points: int = 10_000) -> Accuracy:
    """Compare a learned field with the exact one.

    Raises:
        InputError: one of them has no surface in the box.
    """
    rng = np.random.default_rng(_SEED)
    surface, gradients = surface_points(source, cube, points, rng)
    normals = units(gradients)
    offsets = rng.uniform(-NEAR, NEAR, (points, 1)) * cube.diagonal
    bounds = source.bounds
    near = surface + offsets * normals
    inside = rng.uniform(bounds[0], bounds[1], (points, 3))
    errors = [np.abs(learned(where) - source(where)) / cube.diagonal for where in (near, inside)]
    found, _ = surface_points(learned, cube, points, rng)
    gap = np.abs(source(found)).mean() + _way_to_surface(learned, surface).mean()
    return Accuracy(
        near_error=float(errors[0].mean()),
        box_error=float(errors[1].mean()),
        largest_error=float(max(error.max() for error in errors)),
        normal_error=_mean_angle(learned.gradient(surface), normals),
        chamfer=float(gap / 2 / cube.diagonal),
        points=points,
    )


def _way_to_surface(field: Field, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far points move by Newton's method along the gradient; no less than their distance."""
    moved = points
    for _ in range(3):
        values, gradient = field.value_and_gradient(moved)
        squared = np.maximum((gradient**2).sum(axis=1), 1e-12)
        moved = moved - (values / squared)[:, None] * gradient
    return np.linalg.norm(moved - points, axis=1)


def _mean_angle(gradient: NDArray[np.float64], normals: NDArray[np.float64]) -> float:
    cosine = (units(gradient) * normals).sum(axis=1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean())
