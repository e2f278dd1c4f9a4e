"""Upper bounds of spectral norms of small matrices, rounding included."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel

_U = 2.0**-53


def spectral_norms(matrices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Upper bounds (k,) of the spectral norms of matrices (k, 3, 3), as `spectral_norm`."""
    return np.array([spectral_norm(np.ascontiguousarray(m)) for m in matrices])


@kernel
def spectral_norm(m):
    """An upper bound of the spectral norm of a 3 x 3 matrix, tight to 1e-13 of its size.

    Jacobi rotations of M^T M, then Gershgorin's circles, which bound the largest eigenvalue
    whether or not the rotations converged.  Forming M^T M and fifteen rotations, each orthogonal
    to 4 u, change the eigenvalues by less than 300 u of the largest; 1e-13 is 900 u.
    """
    largest = 0.0
    for i in range(3):
        for j in range(3):
            largest = max(largest, abs(m[i, j]))
    if largest == 0.0:
        return 0.0
    if not largest < np.inf:
        return np.inf
    b = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3):
                total += (m[k, i] / largest) * (m[k, j] / largest)
            b[i, j] = total
    for _ in range(5):
        off = abs(b[0, 1]) + abs(b[0, 2]) + abs(b[1, 2])
        if off <= 1e-17 * (b[0, 0] + b[1, 1] + b[2, 2]):
            break
        for p in range(2):
            for q in range(p + 1, 3):
                _rotate(b, p, q)
    bound = 0.0
    for i in range(3):
        row = b[i, i]
        for j in range(3):
            if j != i:
                row += abs(b[i, j])
        bound = max(bound, row)
    return largest * np.sqrt(bound) * (1.0 + 1e-13)


@kernel
def _rotate(b, p, q):
    """One Jacobi rotation of a symmetric 3 x 3 matrix, which makes entry (p, q) vanish."""
    if b[p, q] == 0.0:
        return
    ratio = (b[q, q] - b[p, p]) / (2.0 * b[p, q])
    t = 1.0 / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
    if ratio < 0.0:
        t = -t
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    r = 3 - p - q
    change = t * b[p, q]
    b[p, p] -= change
    b[q, q] += change
    b[p, q] = 0.0
    b[q, p] = 0.0
    first, second = b[r, p], b[r, q]
    b[r, p] = c * first - s * second
    b[p, r] = b[r, p]
    b[r, q] = s * first + c * second
    b[q, r] = b[r, q]


@kernel
def quick_norm(m):
    """An upper bound of the spectral norm of m: the Frobenius norm of (M^T M)^4, to the 1/8.

    At most 3^(1/16), 7 percent, above it, whatever m is; overflow gives infinity.
    """
    a = m[0, 0] * m[0, 0] + m[1, 0] * m[1, 0] + m[2, 0] * m[2, 0]
    b = m[0, 1] * m[0, 1] + m[1, 1] * m[1, 1] + m[2, 1] * m[2, 1]
    c = m[0, 2] * m[0, 2] + m[1, 2] * m[1, 2] + m[2, 2] * m[2, 2]
    scale = a + b + c
    if not 1e-100 < scale < 1e100:
        return np.sqrt(scale) * (1.0 + 64.0 * _U) if scale >= 1e-100 else 1e-50
    a, b, c = a / scale, b / scale, c / scale
    d = (m[0, 0] * m[0, 1] + m[1, 0] * m[1, 1] + m[2, 0] * m[2, 1]) / scale
    f = (m[0, 1] * m[0, 2] + m[1, 1] * m[1, 2] + m[2, 1] * m[2, 2]) / scale
    g = (m[0, 0] * m[0, 2] + m[1, 0] * m[1, 2] + m[2, 0] * m[2, 2]) / scale
    for _ in range(2):
        aa, bb, cc = a * a + d * d + g * g, b * b + d * d + f * f, c * c + f * f + g * g
        d, f, g = d * (a + b) + f * g, f * (b + c) + d * g, g * (a + c) + d * f
        a, b, c = aa, bb, cc
    squares = a * a + b * b + c * c + 2.0 * (d * d + f * f + g * g)
    return np.sqrt(scale * np.sqrt(np.sqrt(np.sqrt(squares)))) * (1.0 + 64.0 * _U)


def norms_2x2(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Upper bounds (...) of the spectral norms of 2 x 2 matrices (..., 4)."""
    norms = np.empty(linear.shape[:-1])
    _norms_2x2(np.array(linear, order="C").reshape(-1, 4), norms.reshape(-1))
    return norms


@kernel
def _norms_2x2(linear, norms):
    for i in range(len(linear)):
        norms[i] = norm_2x2(linear[i, 0], linear[i, 1], linear[i, 2], linear[i, 3])


@kernel
def norm_2x2(a, b, c, d):
    """An upper bound of the spectral norm of a 2 x 2 matrix: half the sum of two hypotenuses.

    Eight roundings of relative size u, unless squares leave the range of float64: what is too
    small for that counts as 1e-150, what is too large as infinite.
    """
    p, q, r, s = a + d, c - b, a - d, b + c
    total = 0.5 * (np.sqrt(p * p + q * q) + np.sqrt(r * r + s * s))
    return total * (1.0 + 16.0 * _U) + 1e-150
