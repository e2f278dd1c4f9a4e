"""Places along Morton's Z-order curve: neighbours on it are mostly neighbours in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_POINTS_BITS = 10

_HALVES = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)
"""How far the upper half of each run of bits moves up, and where the bits then are."""


def z_order(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) keys of cells (n, 3), whole numbers from 0 to below 2**21: their bits, interleaved."""
    keys = np.zeros(len(cells), np.int64)
    for axis in range(3):
        bits = cells[:, axis]
        for shift, mask in _HALVES:
            bits = (bits | bits << shift) & mask
        keys |= bits << (2 - axis)
    return keys


def sorted_in_space(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) an order of points (n, 3) in which neighbours are near each other."""
    if len(points) < 2:
        return np.arange(len(points))
    low, high = points.min(axis=0), points.max(axis=0)
    most = (1 << _POINTS_BITS) - 1
    step = np.where(high > low, high - low, 1.0) / most
    cells = np.nan_to_num((points - low) / step).clip(0, most).astype(np.int64)
    return np.argsort(z_order(cells), kind="stable")
