"""The five families of lines on which the cells of a layer end, and vertices' codes.

See `cutting` for what the families are and why they are enough.  Developers: these functions are
compiled into the kernels of other modules, whose cached versions do not notice changes here; delete
this folder's `__pycache__` after editing.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from fields.jit import inlined, parallel_kernel

BAND, COLUMNS, ROWS, RISING, FALLING = range(5)

OUTSIDE = np.int32(-(2**30))
"""Code of a vertex outside the square, in passes that cut the square only."""


@inlined
def levels_between(low, high):
    """How many levels lie strictly between two codes (negative or 0: none), from low // 2 + 1."""
    return (high - 1) // 2 - low // 2


@inlined
def _bend(family, u, v):
    """The denominator of the family's function: by how much a level's lines fan out there."""
    if family == COLUMNS:
        return max(1.0, abs(v))
    if family == ROWS:
        return max(1.0, abs(u))
    return 1.0


@inlined
def _scaled(family, u, v, half):
    """The family's function of (u, v), scaled so that its levels are 0, 1, 2, ..."""
    if family == BAND:
        return 0.5 * (v + 1.0)
    if family == COLUMNS:
        return (u / _bend(family, u, v) + 1.0) * half
    if family == ROWS:
        return (v / _bend(family, u, v) + 1.0) * half
    if family == RISING:
        return (u - v + 2.0) * half
    return (u + v + 2.0) * half


@inlined
def level_value(family, index, half):
    """The value of the unscaled function at a level."""
    if family == BAND:
        return 2.0 * index - 1.0
    if family in (COLUMNS, ROWS):
        return index / half - 1.0
    return index / half - 2.0


@inlined
def offset_from_level(family, u, v, level):
    """A function that is linear on every edge, and zero where the family's equals the level."""
    if family == BAND:
        return v - level
    if family == COLUMNS:
        return u - level * _bend(family, u, v)
    if family == ROWS:
        return v - level * _bend(family, u, v)
    if family == RISING:
        return (u - v) - level
    return (u + v) - level


@inlined
def onto_level(family, u, v, level):
    """(u, v) moved onto the level along one axis.

    The other coordinate is not touched: an edge along a line of an earlier pass stays on it.
    """
    if family == BAND:
        return u, level
    if family == COLUMNS:
        return level * _bend(family, u, v), v
    if family == ROWS:
        return u, level * _bend(family, u, v)
    if family == RISING:
        return u, u - level
    return u, level - u


@parallel_kernel
def classify(points, count, family, levels, half, near, snap, codes):
    """Give every vertex its code; the smallest and largest code."""
    edge_of_square = 1.0 + 3.0 * snap
    low, high = np.int64(2 * levels), np.int64(-1)
    for i in prange(count):
        u, v = points[i, 0], points[i, 1]
        if family >= RISING and max(abs(u), abs(v)) > edge_of_square:
            codes[i] = OUTSIDE
        else:
            s = min(max(_scaled(family, u, v, half), -1.0), np.float64(levels))
            nearest = min(max(np.round(s), 0.0), levels - 1.0)
            if abs(s - nearest) * _bend(family, u, v) <= near:
                code = 2 * np.int64(nearest)
            else:
                code = 2 * np.int64(np.floor(s)) + 1
                code = min(max(code, -1), 2 * levels - 1)
            codes[i] = code
            low = min(low, code)
            high = max(high, code)
    return low, high
