"""Where along its lattice edge a vertex is placed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import parallel_kernel
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.samples import Sampler

NEAREST = 1e-2
"""Closest that a vertex comes to an end of its lattice edge, in voxels."""

PRECISION = 1e-3
"""Voxels to which a crossing is found, unless the rounds run out."""


def placed(surface: Surface, sampler: Sampler, rounds: int) -> NDArray[np.float64]:
    """(V, 3) the vertices in index coordinates of the lattice.

    By linear interpolation of the two samples, then by at most so many rounds of the false position
    method (with the Illinois rule) on the field itself: a field that is no distance, or has an edge
    within the voxel, is not linear along the lattice edge. A round evaluates the field once for
    each vertex that is not found to `PRECISION` yet. Never nearer than `NEAREST` to an end.

    A value at infinity, beyond a wall, puts the vertex at the wall whatever is there.
    """
    values = surface.values.astype(np.float64)
    low = np.where(np.isinf(values[:, 1]), 0.0, np.abs(values[:, 0]))
    high = np.where(np.isinf(values[:, 0]), 0.0, np.abs(values[:, 1]))
    fractions = _crossing(np.zeros(len(low)), np.ones(len(low)), low, high)
    if rounds:
        open_ = np.flatnonzero(np.isfinite(values).all(axis=1))
        _polish(surface, sampler, open_, rounds, fractions)
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


def _polish(
    surface: Surface,
    sampler: Sampler,
    open_: NDArray[np.int64],
    rounds: int,
    fractions: NDArray[np.float64],
) -> None:
    """Improve the fractions of some vertices in place."""
    low_ends, axes = surface.low_ends[open_], surface.axes[open_]
    at_a, at_b = np.abs(surface.values[open_].astype(np.float64)).T
    bracket = _Bracket(
        np.zeros(len(open_)),
        np.ones(len(open_)),
        np.ascontiguousarray(at_a),
        np.ascontiguousarray(at_b),
        surface.values[open_, 0] < 0,
        np.zeros(len(open_), np.int8),
    )
    best = fractions[open_]
    for _ in range(rounds):
        points = low_ends.astype(np.float64)
        points[np.arange(len(points)), axes] += best
        value = sampler.value_at(points)
        far = np.abs(value) * (bracket.b - bracket.a) > PRECISION * (bracket.at_a + bracket.at_b)
        _narrow(best, value, *bracket)
        best = _crossing(bracket.a, bracket.b, bracket.at_a, bracket.at_b)
        fractions[open_] = best
        open_, low_ends, axes, best = open_[far], low_ends[far], axes[far], best[far]
        bracket = _Bracket(*(part[far] for part in bracket))
        if not len(open_):
            break


class _Bracket(NamedTuple):
    """Intervals [a, b] that hold a crossing each.

    Attributes:
        a, b: (n,) ends.
        at_a, at_b: (n,) sizes of the values there, which differ in sign.
        inside: (n,) whether the value at a is negative.
        kept: (n,) which end stayed in the last round: 1 for a, 2 for b, 0 at first.
    """

    a: NDArray[np.float64]
    b: NDArray[np.float64]
    at_a: NDArray[np.float64]
    at_b: NDArray[np.float64]
    inside: NDArray[np.bool_]
    kept: NDArray[np.int8]


@parallel_kernel
def _narrow(at, value, a, b, at_a, at_b, inside, kept):
    """Replace one end of every bracket; an end that stays twice counts half (Illinois)."""
    for i in prange(len(at)):
        if (value[i] < 0) == inside[i]:
            a[i], at_a[i] = at[i], abs(value[i])
            if kept[i] == 2:
                at_b[i] *= 0.5
            kept[i] = 2
        else:
            b[i], at_b[i] = at[i], abs(value[i])
            if kept[i] == 1:
                at_a[i] *= 0.5
            kept[i] = 1
