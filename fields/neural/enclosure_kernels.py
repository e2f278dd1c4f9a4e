"""Compiled loops: the features of hash grids on boxes (see `fields.neural.enclosure`).

A feature is multilinear in each cell. So on a box, it and its deviation from any linear function
are extreme at the box's corners or where its edges, faces or inside meet grid planes, grid lines or
grid vertices: on each axis the two ends and the planes between are visited, in all combinations.
That costs as much as there are grid vertices in the box, and 8 visits at least.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from fields.jit import kernel, parallel_kernel
from fields.neural.hash_kernels import PRIME_Y, PRIME_Z


@kernel
def _vertex(table, feature, x, y, z, n, offset, mask):
    if mask < 0:
        return table[offset + x + (n + 1) * (y + (n + 1) * z), feature]
    return table[offset + ((x ^ (y * PRIME_Y) ^ (z * PRIME_Z)) & mask), feature]


@kernel
def _interpolated(table, feature, x, y, z, n, offset, mask):
    """A feature at a position counted in cells of its grid."""
    i, j, k = min(int(x), n - 1), min(int(y), n - 1), min(int(z), n - 1)
    x, y, z = x - i, y - j, z - k
    total = 0.0
    for corner in range(8):
        a, b, c = corner & 1, (corner >> 1) & 1, corner >> 2
        weight = (x if a else 1 - x) * (y if b else 1 - y) * (z if c else 1 - z)
        if weight != 0:
            total += weight * _vertex(table, feature, i + a, j + b, k + c, n, offset, mask)
    return total


@kernel
def _stops(low, high, n):
    """Both ends of a side of the box, and the grid planes between them, counted in cells."""
    low, high = min(max(low, 0.0), 1.0) * n, min(max(high, 0.0), 1.0) * n
    first, last = int(np.floor(low)) + 1, int(np.ceil(high)) - 1
    stops = np.empty(max(0, last - first + 1) + 2)
    stops[0], stops[-1] = low, high
    for s in range(1, len(stops) - 1):
        stops[s] = first + s - 1
    return stops


@parallel_kernel
def fit_features(low, high, table, resolutions, offsets, masks, mid, slope, rad):
    """For boxes in [0, 1]^3: feature = mid + slope . (x - centre) +- rad.

    The slopes are the means of those of the box's edges.
    """
    for box in prange(len(low)):
        centre = (low[box] + high[box]) / 2
        for column in range(2 * len(resolutions)):
            level, feature = column // 2, column % 2
            n, offset, mask = resolutions[level], offsets[level], masks[level]
            xs, ys, zs = (
                _stops(low[box, 0], high[box, 0], n),
                _stops(low[box, 1], high[box, 1], n),
                _stops(low[box, 2], high[box, 2], n),
            )
            values = np.empty((len(xs), len(ys), len(zs)))
            for i in range(len(xs)):
                for j in range(len(ys)):
                    for k in range(len(zs)):
                        values[i, j, k] = _interpolated(
                            table, feature, xs[i], ys[j], zs[k], n, offset, mask
                        )
            a, b, c = 0.0, 0.0, 0.0
            for s in (0, -1):
                for t in (0, -1):
                    a += values[-1, s, t] - values[0, s, t]
                    b += values[s, -1, t] - values[s, 0, t]
                    c += values[s, t, -1] - values[s, t, 0]
            a *= n / (4 * (xs[-1] - xs[0])) if xs[-1] > xs[0] else 0.0
            b *= n / (4 * (ys[-1] - ys[0])) if ys[-1] > ys[0] else 0.0
            c *= n / (4 * (zs[-1] - zs[0])) if zs[-1] > zs[0] else 0.0
            least, most = np.inf, -np.inf
            for i in range(len(xs)):
                for j in range(len(ys)):
                    for k in range(len(zs)):
                        deviation = (
                            values[i, j, k]
                            - a * (xs[i] / n - centre[0])
                            - b * (ys[j] / n - centre[1])
                            - c * (zs[k] / n - centre[2])
                        )
                        least, most = min(least, deviation), max(most, deviation)
            slope[box, 0, column], slope[box, 1, column], slope[box, 2, column] = a, b, c
            mid[box, column], rad[box, column] = (least + most) / 2, (most - least) / 2


@kernel
def _cells(low, high, n):
    """The first and last cell that a side of the box meets."""
    first = min(max(int(np.floor(low * n)), 0), n - 1)
    return first, max(first, min(int(np.ceil(high * n)) - 1, n - 1))


@parallel_kernel
def feature_derivatives(low, high, table, resolutions, offsets, masks, least, most):
    """For boxes in [0, 1]^3: the range of each partial derivative of each feature.

    A derivative is constant along its own axis in each cell, and bilinear in the two others.
    """
    for box in prange(len(low)):
        for column in range(2 * len(resolutions)):
            level, feature = column // 2, column % 2
            n, offset, mask = resolutions[level], offsets[level], masks[level]
            for axis in range(3):
                second, third = (axis + 1) % 3, (axis + 2) % 3
                first_cell, last_cell = _cells(low[box, axis], high[box, axis], n)
                ss = _stops(low[box, second], high[box, second], n)
                ts = _stops(low[box, third], high[box, third], n)
                start, end = np.empty(3), np.empty(3)
                lowest, highest = np.inf, -np.inf
                for cell in range(first_cell, last_cell + 1):
                    start[axis], end[axis] = cell, cell + 1
                    for s in ss:
                        start[second] = end[second] = s
                        for t in ts:
                            start[third] = end[third] = t
                            change = n * (
                                _interpolated(
                                    table, feature, end[0], end[1], end[2], n, offset, mask
                                )
                                - _interpolated(
                                    table, feature, start[0], start[1], start[2], n, offset, mask
                                )
                            )
                            lowest, highest = min(lowest, change), max(highest, change)
                least[box, axis, column], most[box, axis, column] = lowest, highest
