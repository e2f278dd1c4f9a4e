"""Orientation signs that are never wrong: certain in float64, or reported as unsure.

Each function evaluates a determinant in float64 together with a bound on its rounding
error and returns its sign when the determinant exceeds the bound, else `UNSURE` (0). The
caller then finds a certain answer another way, in the end with the integers of `exact`.

Error bounds. With u = 2^-53, and differences that are themselves rounded, Shewchuk
(Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates, 1997)
proves |error| <= (3 + 16 u) u P for the 2 x 2 and (7 + 56 u) u P for the 3 x 3
determinant, where P is the same sum with absolute values, as computed. The proof supposes
that nothing over- or underflows. Points are therefore first scaled by a power of two to
|coordinate| <= 1 (`unit_scaled`): nothing can overflow then, and each of the fewer than 40
operations that may underflow, the scaling itself included, adds at most 2^-1074, amplified
by factors that stay below 2^6. `UNDERFLOW` = 2^-1000 covers their sum with room to spare.

Guarantee: a sign that is returned is the sign of the exact determinant of the points before
scaling. NaN never yields a sign.
Non-guarantee: exact zeros are not recognised; they are unsure like all near-zeros.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel

UNIT_ROUNDOFF = 2.0**-53
UNDERFLOW = 2.0**-1000
UNSURE = 0

_BOUND_2D = (3.0 + 16.0 * UNIT_ROUNDOFF) * UNIT_ROUNDOFF
_BOUND_3D = (7.0 + 56.0 * UNIT_ROUNDOFF) * UNIT_ROUNDOFF
# n . (x - p): one rounding each for difference and product and two for the sums leave a
# relative error of (1 + u)^4 - 1 < 4.1 u on every term; the bound is summed from computed
# terms, which are each within 3 u of the true ones. Twice the sum is beyond doubt.
_BOUND_SIDE = 8.0 * UNIT_ROUNDOFF


def finite_or_zero(points: NDArray[np.float64], finite: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The points `(n, 3)`, with zeros in the rows that are not flagged; no copy if all are."""
    return points if finite.all() else np.where(finite[:, None], points, 0.0)


def unit_scaled(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Scale finite points by a power of two so that the largest |coordinate| is in [1/2, 1).

    Returns the scaled points `(n, 3)` and the exponent e with `points = scaled * 2**e`,
    exactly but for coordinates below 2^-1022 of the largest one, which round.
    """
    largest = float(np.abs(points).max()) if points.size else 0.0
    exponent = int(np.frexp(largest)[1])
    return np.ldexp(points, -exponent), exponent


@kernel
def orient3d(v, a, b, c, d):
    """Certain sign of det[a - d, b - d, c - d], or 0 when unsure.

    `v` is the `(n, 3)` array of unit-scaled vertices, the rest are row indices. Positive
    when d lies below the plane through a, b, c that are counter-clockwise seen from above.
    """
    adx = v[a, 0] - v[d, 0]
    ady = v[a, 1] - v[d, 1]
    adz = v[a, 2] - v[d, 2]
    bdx = v[b, 0] - v[d, 0]
    bdy = v[b, 1] - v[d, 1]
    bdz = v[b, 2] - v[d, 2]
    cdx = v[c, 0] - v[d, 0]
    cdy = v[c, 1] - v[d, 1]
    cdz = v[c, 2] - v[d, 2]
    bc = bdx * cdy
    cb = cdx * bdy
    ca = cdx * ady
    ac = adx * cdy
    ab = adx * bdy
    ba = bdx * ady
    det = adz * (bc - cb) + bdz * (ca - ac) + cdz * (ab - ba)
    permanent = (
        (abs(bc) + abs(cb)) * abs(adz)
        + (abs(ca) + abs(ac)) * abs(bdz)
        + (abs(ab) + abs(ba)) * abs(cdz)
    )
    bound = _BOUND_3D * permanent + UNDERFLOW
    if det > bound:
        return 1
    if det < -bound:
        return -1
    return UNSURE


@kernel
def orient2d(v, a, b, c, i, j):
    """Certain sign of the turn a -> b -> c projected onto coordinates (i, j), or 0."""
    left = (v[a, i] - v[c, i]) * (v[b, j] - v[c, j])
    right = (v[a, j] - v[c, j]) * (v[b, i] - v[c, i])
    det = left - right
    bound = _BOUND_2D * (abs(left) + abs(right)) + UNDERFLOW
    if det > bound:
        return 1
    if det < -bound:
        return -1
    return UNSURE


@kernel
def side_of_plane(v, p, n0, n1, n2, x):
    """Certain sign of n . (x - p) for any float normal with |n_k| <= 2^5, or 0.

    The normal counts as exactly the floats it is given as, so any guess at a separating
    plane can be used: a wrong guess separates nothing, a lucky one proves separation.
    """
    a = n0 * (v[x, 0] - v[p, 0])
    b = n1 * (v[x, 1] - v[p, 1])
    c = n2 * (v[x, 2] - v[p, 2])
    total = a + b + c
    bound = _BOUND_SIDE * (abs(a) + abs(b) + abs(c)) + UNDERFLOW
    if total > bound:
        return 1
    if total < -bound:
        return -1
    return UNSURE


@kernel
def has_area(v, a, b, c):
    """Whether three points are certainly not on one line: then some projection has an area."""
    return (
        orient2d(v, a, b, c, 0, 1) != 0
        or orient2d(v, a, b, c, 1, 2) != 0
        or orient2d(v, a, b, c, 2, 0) != 0
    )


@kernel
def certainly_not_collinear(v, faces):
    """Flag the faces `(F, 3)` whose area is certainly not zero, from unit-scaled points.

    A triangle has zero area exactly when all three coordinate projections have. False means
    unsure, not degenerate. NaN coordinates give False.
    """
    sure = np.empty(len(faces), np.bool_)
    for f in range(len(faces)):
        sure[f] = has_area(v, faces[f, 0], faces[f, 1], faces[f, 2])
    return sure
