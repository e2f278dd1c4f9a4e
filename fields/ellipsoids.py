"""Ellipsoids and superellipsoids.

Neither has a distance in closed form. Quilez's ellipsoid, k0 (k0 - 1) / k1, is no bound either:
it jumps at the centre, and outside its gradient reaches 0.385 (largest / smallest radius)^2.
Here the cheap fields are the gauge of the solid, a norm, which is Lipschitz with a constant that
can be proved; and the ellipsoid has its true distance for those who ask for it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Expression,
    X,
    Y,
    Z,
    length,
    maximum,
    power,
    sqrt,
    square,
)
from fields.formulas import bounding_body, exact_body
from fields.operations import Body
from fields.primitives import primitive

NEWTON_STEPS = 14
"""Enough for 2e-15 of the largest radius at all of 500,000 points, many of them near the
surfaces of centres, for ratios of radii up to 1,000."""

OFF_PLANE = 1e-12
"""Least distance from the plane of the two longer axes, in shortest radii; see below."""


@primitive
def ellipsoid(radii: ArrayLike, exact: bool = False) -> Body:
    """An ellipsoid about the origin, with its axes along x, y and z.

    By default m (|p / radii| - 1), m the smallest radius: of gradient 1 at most, but far from
    the distance where the radii differ much. With `exact`, the true distance, at some 15 times
    the cost: the root t > -m^2 of sum (r p / (t + r^2))^2 = 1 by Newton's iteration, unrolled;
    the distance is then t |p / (t + r^2)|. Right to 1e-12 of the smallest radius for radii of
    ratio up to 1,000.

    Args:
        radii: half the size along each axis, or one radius for a ball.
        exact: the true distance, inside and out, instead of the bound.
    """
    r = np.array(arguments.numbers_or_one("radii", radii))
    if arguments.flag("exact", exact):
        return exact_body(_ellipsoid_distance(r), -r, r)
    least = float(r.min())
    gauge = length(*(p / float(a) for p, a in zip((X, Y, Z), r, strict=True)))
    return bounding_body((gauge - 1.0) * least, -r, r, growth=float(r.max()) / least)


def _ellipsoid_distance(r: np.ndarray) -> Expression:
    """The distance by Lagrange's multiplier.

    The nearest point is r^2 p / (t + r^2), and y = r p / (t + r^2) has norm N(t) = 1. With
    s = t + m^2 nothing cancels near the pole. 1 / N is increasing and concave (Conn, Gould and
    Toint, "Trust-Region Methods", 2000, lemma 7.3.1), so Newton's iteration from the left is
    monotone; N >= 1 where one of the y is 1, which is the start. In the plane of the longer
    axes, inside the curve of centres, the root is the pole itself and the nearest point has
    to be chosen from two: there the point is moved off the plane by 1e-12 m, which changes the
    distance by no more.

    What the iteration leaves, F = N^2 - 1, enters to first order: t^2 |u|^2 + t F is the dual
    value, stationary at the root.
    """
    least = float(r.min())
    above = [float(a * a - least * least) for a in r]
    scaled = [
        float(a) * (maximum(abs(p), OFF_PLANE * least) if a == least else abs(p))
        for p, a in zip((X, Y, Z), r, strict=True)
    ]
    s = maximum(*(c - gap for c, gap in zip(scaled, above, strict=True)))
    for _ in range(NEWTON_STEPS):
        divisors = [s + gap for gap in above]
        y = [c / d for c, d in zip(scaled, divisors, strict=True)]
        squares = [square(component) for component in y]
        total = squares[0] + squares[1] + squares[2]
        slopes = [q / d for q, d in zip(squares, divisors, strict=True)]
        s = s + (sqrt(total) - 1.0) * total / (slopes[0] + slopes[1] + slopes[2])
    y = [c / (s + gap) for c, gap in zip(scaled, above, strict=True)]
    steepness = length(*(component / float(a) for component, a in zip(y, r, strict=True)))
    residual = square(y[0]) + square(y[1]) + square(y[2]) - 1.0
    return (s - least * least) * steepness + residual / (2.0 * steepness)


@primitive
def superellipsoid(radii: ArrayLike, exponent: float, vertical: float | None = None) -> Body:
    """Between a rhombic solid, an ellipsoid and a box: |x/a|^n + |y/b|^n + |z/c|^n <= 1.

    With another exponent m for z it is (|x/a|^n + |y/b|^n)^(m/n) + |z/c|^m <= 1 (Barr,
    "Superquadrics and angle-preserving transformations", 1981). The field is
    min(radii) (N - 1), N the norm whose unit ball this is. A norm's gradient has dual norm 1;
    in Euclid's that is at most 1 for exponents from 2 on, and the factor
    2^(1/n - 1/2) more for each exponent n below 2, as each sees two components.

    Args:
        radii: half the size along each axis, or one for all three.
        exponent: n, at least 1: 1 is a rhombus, 2 an ellipse, large values a box. Below 1
            the solid is not convex, its cusps have no Lipschitz bound, and it is refused.
        vertical: m, at least 1; None for the same as `exponent`.
    """
    r = np.array(arguments.numbers_or_one("radii", radii))
    n = _exponent("exponent", exponent)
    m = n if vertical is None else _exponent("vertical", vertical)
    least = float(r.min())
    x, y, z = (abs(p) / float(a) for p, a in zip((X, Y, Z), r, strict=True))
    gauge = _norm(_norm(x, y, n), z, m)
    steepness = float(np.prod([2 ** max(1 / e - 0.5, 0.0) for e in (n, m)]))
    return bounding_body(
        (gauge - 1.0) * least,
        -r,
        r,
        lipschitz=steepness,
        growth=float(r.max()) / least,
    )


def _exponent(argument: str, value: object) -> float:
    result = arguments.number(argument, value)
    if result < 1:
        raise InputError(
            argument,
            value,
            "below 1 the solid has cusps, at which no Lipschitz bound holds",
            "pass 1 or more",
        )
    return result


def _norm(a: Expression, b: Expression, exponent: float) -> Expression:
    """(a^n + b^n)^(1/n) for a and b that are not negative, scaled so that nothing underflows."""
    largest = maximum(a, b, 1e-30)
    total = power(a / largest, exponent) + power(b / largest, exponent)
    return largest * power(total, 1.0 / exponent)
