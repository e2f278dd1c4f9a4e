"""What the search for edges and corners of a shape knows of the smooth sides that meet there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from implicit_warp.extraction.samples import Sampler

MARGIN = 1e-2
"""Closest that a point comes to the borders of its face or cell, in voxels."""

REACH = 3e-2
"""Voxels beyond those borders from which a point is brought back."""

FARTHEST = 1.0
"""Voxels beyond those borders in which a point may lie at all, where no surface is."""

ROUNDS = 3
"""How often a point is found again from values closer to it."""

_TOLERANCE = 0.05
"""Voxels from the surface within which a point found for an edge or corner is accepted."""

_NEARER = 0.15
"""How far from a point towards a side that side's values are looked at, of the way."""


def within(
    points: NDArray[np.float64], low: NDArray[np.floating], margin: float = MARGIN
) -> NDArray[np.float64]:
    """Points moved into unit cells (or faces) with given low corners, off their borders."""
    return np.clip(points, low + margin, low + 1.0 - margin)


def nearer_values(
    points: NDArray[np.float64],
    sides: NDArray[np.float64],
    slopes: NDArray[np.float64],
    anchors: NDArray[np.float64],
    values: NDArray[np.float64],
    sampler: Sampler,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Planes slope . (x - anchor) + value = 0 of sides, taken anew close to points.

    A plane stays as it was where the place looked at has come to lie on another side.

    Args:
        points: (..., 3) where edges are believed to be.
        sides: (..., 3) a point of each side.
        slopes, anchors, values: (..., 3), (..., 3), (...) the planes known so far, slopes unit.
        sampler: of the field.
    """
    near = points + _NEARER * (sides - points)
    value, gradient = sampler.value_and_gradient(near.reshape(-1, 3))
    size = np.linalg.norm(gradient, axis=1)
    size = np.where(size > 0, size, 1.0)
    gradient = (gradient / size[:, None]).reshape(near.shape)
    same_side = np.einsum("...i,...i->...", gradient, slopes) > 0.5
    return (
        np.where(same_side[..., None], gradient, slopes),
        np.where(same_side[..., None], near, anchors),
        np.where(same_side, (value / size).reshape(values.shape), values),
    )


def on_surface(points: NDArray[np.float64], sampler: Sampler) -> NDArray[np.bool_]:
    """(n,) whether points (n, 3) lie within the tolerance of the surface."""
    value, gradient = sampler.value_and_gradient(points)
    size = np.linalg.norm(gradient, axis=1)
    return np.abs(value) <= _TOLERANCE * np.where(size > 0, size, 1.0)


def units(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors (n, 3) scaled to length one; zero stays zero."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(size > 0, size, 1.0)
