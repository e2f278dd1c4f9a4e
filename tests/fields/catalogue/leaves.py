"""Grids of samples."""

from __future__ import annotations

import numpy as np

import fields as sdf
from fields import Field
from tests.fields.catalogue.surface import Surface


def _lattice(low: float, high: float, counts: tuple[int, int, int]) -> np.ndarray:
    axes = [np.linspace(low, high, count) for count in counts]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def sampled(field: Field, counts: tuple[int, int, int], half: float = 1.5, **options) -> Field:
    """A field's samples on the cube of such half edge, as a grid."""
    values = field(_lattice(-half, half, counts))
    return sdf.grid(values, bounds=((-half,) * 3, (half,) * 3), **options)


TORUS = sdf.torus(0.8, 0.4).rotate(30, (1, 2, 3))
NOISE = 0.2 * np.random.default_rng(5).normal(size=(6, 5, 7)) + 0.1
GENTLE = 0.1 * NOISE  # of second derivatives below 10, also as a spline

EXAMPLES: dict[str, Field] = {
    "grid": sampled(TORUS, (17, 19, 13)),
    "grid, cubic": sampled(TORUS, (17, 19, 13), interpolation="cubic"),
    "grid, float32": sdf.grid(
        sdf.sphere(1.0)(_lattice(-1.3, 1.3, (12, 12, 12))).astype(np.float32),
        bounds=((-1.3,) * 3, (1.3,) * 3),
    ),
    "grid, noise up to its walls": sdf.grid(NOISE, spacing=(0.4, 0.5, 0.3), origin=(-1, -1, -0.8)),
    "grid, cubic noise up to its walls": sdf.grid(
        GENTLE, spacing=(0.4, 0.5, 0.3), origin=(-1, -1, -0.8), interpolation="cubic"
    ),
    "grid, constant": sdf.grid(np.full((2, 2, 2), -0.5), bounds=((-1,) * 3, (1,) * 3)),
    "grid in a union, grown": sampled(TORUS, (9, 9, 9)).union(sdf.box(1.0), smooth=0.3).offset(0.1),
    "occupancy": sdf.from_occupancy(
        sdf.sphere(1.0)(_lattice(-1.2, 1.2, (9, 13, 7))) < 0,
        spacing=(0.3, 0.2, 0.4),
        origin=(-1.2,) * 3,
    ),
}

SURFACES: dict[str, Surface] = {}
