"""Where along its lattice edge a vertex is placed."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import parallel_kernel
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.samples import Sampler

NEAREST = 1e-2
"""Closest that a vertex comes to an end of its lattice edge, in voxels."""


def placed(surface: Surface, sampler: Sampler, steps: int) -> NDArray[np.float64]:
    """(V, 3) the vertices in index coordinates of the lattice.

    By linear interpolation of the two samples, then by `steps` rounds of the false position method
    (with the Illinois rule) on the field itself: a field that is no distance, or has an edge within
    the voxel, is not linear along the lattice edge.  Never nearer than `NEAREST` to an end.

    A value at infinity, beyond a wall, puts the vertex at the wall whatever is there.
    """
    values = surface.values.astype(np.float64)
    low = np.where(np.isinf(values[:, 1]), 0.0, np.abs(values[:, 0]))
    high = np.where(np.isinf(values[:, 0]), 0.0, np.abs(values[:, 1]))
    fractions = _crossing(np.zeros(len(low)), np.ones(len(low)), low, high)
    open_ = np.isfinite(values).all(axis=1)
    if steps and open_.any():
        fractions[open_] = _polished(surface, sampler, open_, steps)
    points = surface.low_ends.astype(np.float64)
    points[np.arange(len(points)), surface.axes] += np.clip(fractions, NEAREST, 1.0 - NEAREST)
    return points


def _crossing(a, b, at_a, at_b) -> NDArray[np.float64]:
    """Where a line from |value| `at_a` at a to `at_b` at b, of the other sign, is zero."""
    # Scaled first, so that neither huge nor tiny values over- or underflow in the sum.
    limits = np.finfo(np.float64)
    scale = np.clip(np.maximum(at_a, at_b), limits.tiny, limits.max)
    at_a, at_b = np.minimum(at_a, scale) / scale, np.minimum(at_b, scale) / scale
    return a + (b - a) * (at_a / (at_a + at_b))


def _polished(
    surface: Surface, sampler: Sampler, which: NDArray[np.bool_], steps: int
) -> NDArray[np.float64]:
    low_ends, axes = surface.low_ends[which], surface.axes[which]
    at_a = np.abs(surface.values[which, 0].astype(np.float64))
    at_b = np.abs(surface.values[which, 1].astype(np.float64))
    starts_inside = surface.values[which, 0] < 0
    a, b = np.zeros(len(axes)), np.ones(len(axes))
    rows = np.arange(len(axes))
    kept = np.zeros(len(axes), np.int8)  # which end stayed in the last round
    best = _crossing(a, b, at_a, at_b)
    for _ in range(steps):
        points = low_ends.astype(np.float64)
        points[rows, axes] += best
        value = sampler.value_at(points)
        same_as_a = (value < 0) == starts_inside
        size = np.abs(value)
        _narrow(best, size, same_as_a, a, b, at_a, at_b, kept)
        best = _crossing(a, b, at_a, at_b)
    return best


@parallel_kernel
def _narrow(at, size, same_as_a, a, b, at_a, at_b, kept):
    """Replace one end of every bracket; an end that stays twice counts half (Illinois)."""
    for i in prange(len(at)):
        if same_as_a[i]:
            a[i], at_a[i] = at[i], size[i]
            if kept[i] == 2:
                at_b[i] *= 0.5
            kept[i] = 2
        else:
            b[i], at_b[i] = at[i], size[i]
            if kept[i] == 1:
                at_a[i] *= 0.5
            kept[i] = 1
