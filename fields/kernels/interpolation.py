"""Splines on grids: their values at points, and bounds on their slope.

A spline of degree 1 or 3 on samples is a sum of products of B-splines, one factor an axis. In
the cell (i, j, k) it depends on the degree + 1 coefficients an axis from (i, j, k) on, in an array
of `cells + degree` coefficients an axis.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from fields.jit import inlined, kernel, parallel_kernel, point_kernel


@inlined
def _cell(x, origin, inverse_spacing, cells):
    """The cell of a coordinate, and where in it; coordinates outside are in the last one."""
    t = (x - origin) * inverse_spacing
    i = min(max(math.floor(t), 0), cells - 1)
    return i, t - i


@point_kernel
def linear(points, coefficients, origin, inverse_spacing):
    """Values `(n,)` of a spline of degree 1 at points `(n, 3)`."""
    nx, ny, nz = coefficients.shape
    values = np.empty(len(points))
    for p in numba.prange(len(points)):
        i, u = _cell(points[p, 0], origin[0], inverse_spacing[0], nx - 1)
        j, v = _cell(points[p, 1], origin[1], inverse_spacing[1], ny - 1)
        k, w = _cell(points[p, 2], origin[2], inverse_spacing[2], nz - 1)
        total = 0.0
        for a in range(2):
            for b in range(2):
                along = (
                    coefficients[i + a, j + b, k] * (1 - w) + coefficients[i + a, j + b, k + 1] * w
                )
                total += along * (u if a else 1 - u) * (v if b else 1 - v)
        values[p] = total
    return values


@inlined
def _weights(u):
    """The four cubic B-splines that are not zero in a cell."""
    s = 1 - u
    return (
        s * s * s / 6,
        (4 - 6 * u * u + 3 * u * u * u) / 6,
        (4 - 6 * s * s + 3 * s * s * s) / 6,
        u * u * u / 6,
    )


@point_kernel
def cubic(points, coefficients, origin, inverse_spacing):
    """Values `(n,)` of a spline of degree 3 at points `(n, 3)`."""
    nx, ny, nz = coefficients.shape
    values = np.empty(len(points))
    for p in numba.prange(len(points)):
        i, u = _cell(points[p, 0], origin[0], inverse_spacing[0], nx - 3)
        j, v = _cell(points[p, 1], origin[1], inverse_spacing[1], ny - 3)
        k, w = _cell(points[p, 2], origin[2], inverse_spacing[2], nz - 3)
        across, along, up = _weights(u), _weights(v), _weights(w)
        total = 0.0
        for a in range(4):
            row = 0.0
            for b in range(4):
                c = coefficients[i + a, j + b]
                row += along[b] * (
                    up[0] * c[k] + up[1] * c[k + 1] + up[2] * c[k + 2] + up[3] * c[k + 3]
                )
            total += across[a] * row
        values[p] = total
    return values


@parallel_kernel
def bounds_linear(coefficients, inverse_spacing):
    """In each cell the least and largest value of a spline of degree 1, and its steepest slope.

    Values lie between those at the eight corners. Each component of the gradient is linear in each
    of the other two coordinates, so its norm, a convex function, is largest at a corner too.
    """
    nx, ny, nz = coefficients.shape
    least = np.empty((nx - 1, ny - 1, nz - 1), coefficients.dtype)
    most, steepest = np.empty_like(least), np.empty_like(least)
    for i in numba.prange(nx - 1):
        for j in range(ny - 1):
            for k in range(nz - 1):
                low, high, square = np.inf, -np.inf, 0.0
                for a in range(2):
                    for b in range(2):
                        for c in range(2):
                            here = coefficients[i + a, j + b, k + c]
                            low, high = min(low, here), max(high, here)
                            # Across the cell, whichever side of it this corner is on.
                            dx = here - coefficients[i + 1 - a, j + b, k + c]
                            dy = here - coefficients[i + a, j + 1 - b, k + c]
                            dz = here - coefficients[i + a, j + b, k + 1 - c]
                            dx, dy = dx * inverse_spacing[0], dy * inverse_spacing[1]
                            dz = dz * inverse_spacing[2]
                            square = max(square, dx * dx + dy * dy + dz * dz)
                least[i, j, k], most[i, j, k] = low, high
                steepest[i, j, k] = math.sqrt(square)
    return least, most, steepest


@kernel
def _to_bernstein(c, stride):
    """Turn four B-spline coefficients of each line along one axis into Bernstein's, in place.

    `c` holds the 64 coefficients of a cell, `stride` apart along the axis.
    """
    for line in range(16):
        i = line // stride * stride * 4 + line % stride
        a, b, d, e = c[i], c[i + stride], c[i + 2 * stride], c[i + 3 * stride]
        c[i] = (a + 4 * b + d) / 6
        c[i + stride] = (2 * b + d) / 3
        c[i + 2 * stride] = (b + 2 * d) / 3
        c[i + 3 * stride] = (b + 4 * d + e) / 6


@kernel
def _largest_step(c, stride):
    """The largest difference of neighbours along one axis, of 64 coefficients."""
    largest = 0.0
    for line in range(16):
        i = line // stride * stride * 4 + line % stride
        for step in range(3):
            largest = max(largest, abs(c[i + (step + 1) * stride] - c[i + step * stride]))
    return largest


@parallel_kernel
def bounds_cubic(coefficients, inverse_spacing):
    """In each cell bounds on the values of a spline of degree 3, and on its slope.

    Values lie between the least and the largest Bernstein coefficient of the cell's polynomial.
    Those of its derivative along an axis are three times the differences along it, and bound each
    component of the gradient by itself.
    """
    nx, ny, nz = coefficients.shape
    least = np.empty((nx - 3, ny - 3, nz - 3), coefficients.dtype)
    most, steepest = np.empty_like(least), np.empty_like(least)
    for i in numba.prange(nx - 3):
        c = np.empty(64)
        for j in range(ny - 3):
            for k in range(nz - 3):
                for n in range(64):
                    c[n] = coefficients[i + n // 16, j + n // 4 % 4, k + n % 4]
                square, low, high = 0.0, np.inf, -np.inf
                for axis in range(3):
                    _to_bernstein(c, 16 >> 2 * axis)
                for axis in range(3):
                    slope = 3 * _largest_step(c, 16 >> 2 * axis) * inverse_spacing[axis]
                    square += slope * slope
                for n in range(64):
                    low, high = min(low, c[n]), max(high, c[n])
                least[i, j, k], most[i, j, k] = low, high
                steepest[i, j, k] = math.sqrt(square)
    return least, most, steepest
