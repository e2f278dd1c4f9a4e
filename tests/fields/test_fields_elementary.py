"""The compiled elementary functions beside 60-digit arithmetic."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import fields as sdf
from fields import expression as ex
from fields.expression import X, Y


def _units_in_the_last_place(found: np.ndarray, expected: list[mpmath.mpf]) -> float:
    worst = 0.0
    for value, exact in zip(found, expected, strict=True):
        spacing = float(np.spacing(np.abs(found.dtype.type(float(exact)))))
        worst = max(worst, float(abs(mpmath.mpf(float(value)) - exact) / spacing))
    return worst


def _wide(rng, n, low, high):
    """Numbers of both signs, of all sizes from 10**low to 10**high."""
    return rng.choice([-1.0, 1.0], n) * 10 ** rng.uniform(low, high, n)


def _angles(rng, n):
    near_multiples = np.arange(-n // 8, n // 8) * (np.pi / 2) * (1 + rng.normal(size=n // 4) * 1e-9)
    return np.concatenate(
        [
            rng.uniform(-7, 7, n // 4),
            _wide(rng, n // 4, -9, 5.9),
            near_multiples,
            _wide(rng, n // 4, 6, 15),
        ]
    )


def _sizes(rng, n):
    """Of all sizes, and next to 1."""
    near_one = 1 + rng.normal(size=n // 2) * 10 ** rng.uniform(-7, -1, n // 2)
    return np.concatenate([10 ** rng.uniform(-37, 37, n // 2), near_one])


CASES = {
    "sin": (ex.sin(X), mpmath.sin, lambda rng, n: (_angles(rng, n),)),
    "cos": (ex.cos(X), mpmath.cos, lambda rng, n: (_angles(rng, n),)),
    "exp": (ex.exp(X), mpmath.exp, lambda rng, n: (rng.uniform(-86, 87, n),)),
    "log": (ex.log(X), mpmath.log, lambda rng, n: (_sizes(rng, n),)),
    "atan2": (
        ex.atan2(Y, X),
        mpmath.atan2,
        lambda rng, n: (_wide(rng, n, -3, 3), _wide(rng, n, -3, 3)),
    ),
    "power": (
        ex.power(X, Y),
        mpmath.power,
        lambda rng, n: (10 ** rng.uniform(-6, 6, n), rng.uniform(-6, 6, n)),
    ),
}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", CASES)
def test_errors_in_units_in_the_last_place(name, dtype, rng):
    """The figures of the module's docstring: 0.51 for float32, 1 or 2 for float64."""
    form, exactly, draw = CASES[name]
    arguments = [argument.astype(dtype) for argument in draw(rng, 400)]
    points = np.zeros((len(arguments[0]), 3), dtype)
    # atan2 takes y first.
    columns = [1, 0] if name == "atan2" else [0, 1]
    for column, argument in zip(columns, arguments, strict=False):
        points[:, column] = argument
    with sdf.back_end("numba"):
        found = sdf.Field(form)(points)
    with mpmath.workdps(60):
        expected = [
            exactly(*map(mpmath.mpf, map(float, row))) for row in zip(*arguments, strict=True)
        ]
        worst = _units_in_the_last_place(found, expected)
    assert worst < (0.51 if dtype == np.float32 else 2 if name == "atan2" else 1)


def test_the_ends_of_the_range():
    x = np.array([709.782, 710.0, -708.0, -745.0, -746.0, -1e300, 1e300])
    points = np.zeros((len(x), 3))
    points[:, 0] = x
    with sdf.back_end("numba"), np.errstate(over="ignore"):
        np.testing.assert_allclose(sdf.Field(ex.exp(X))(points), np.exp(x), rtol=1e-15)
        tiny = np.finfo(np.float64).tiny
        points[:, 0] = [tiny, tiny / 8, 0.0, -1.0, 1.0, np.finfo(np.float64).max, 2.0]
        expected = np.log(np.maximum(points[:, 0], tiny))
        np.testing.assert_allclose(sdf.Field(ex.log(X))(points), expected, rtol=1e-15)
