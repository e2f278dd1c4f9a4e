"""Cubic splines through samples on a grid, as coefficients of B-splines.

The spline has two continuous derivatives, and its third derivative is continuous at the first and
last inner sample of every line ("not a knot"; de Boor, "A practical guide to splines", 1978).
Guarantee: it goes through the samples, reproduces cubic polynomials, and its error is of fourth
order in the spacing where the function has four continuous derivatives, up to the walls.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FEWEST = 4
"""Samples along an axis that the conditions at both ends need."""


def cubic_coefficients(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Coefficients, two more along each axis than samples, of the samples' dtype."""
    result = values.astype(np.float64)
    for axis in range(values.ndim):
        lines = np.moveaxis(result, axis, 0)
        solved = _line_coefficients(lines.reshape(len(lines), -1))
        result = np.moveaxis(solved.reshape(-1, *lines.shape[1:]), 0, axis)
    return np.ascontiguousarray(result, dtype=values.dtype)


def _line_coefficients(samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """For every column of `(n, m)` samples, `(n + 2, m)`.

    The value at sample i is (c[i] + 4 c[i+1] + c[i+2]) / 6. The third derivative in a cell is a
    third difference, so that it does not jump means that a fourth difference is zero.
    """
    from scipy.linalg import solve_banded

    count = len(samples)
    # Row r, column c of the matrix is bands[4 + r - c, c].
    bands = np.zeros((9, count + 2))
    rows = np.arange(1, count + 1)
    for shift, weight in ((-1, 1 / 6), (0, 4 / 6), (1, 1 / 6)):
        bands[4 - shift, rows + shift] = weight
    columns = np.arange(5)
    fourth_difference = (1.0, -4.0, 6.0, -4.0, 1.0)
    bands[4 - columns, columns] = fourth_difference
    bands[8 - columns, count - 3 + columns] = fourth_difference
    right = np.zeros((count + 2, samples.shape[1]))
    right[1:-1] = samples
    return solve_banded((4, 4), bands, right, overwrite_ab=True, overwrite_b=True)
