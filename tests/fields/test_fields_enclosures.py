"""Bounds on boxes: nothing that can be computed, or is exactly true, is ever outside of them."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields import expression as ex
from fields.expression import OPERATIONS, X, Y, Z
from fields.oracle import FunctionOracle
from tests.fields.random_expressions import (
    all_finite,
    exact_value,
    points_in,
    random_boxes,
    random_expression,
)

DTYPES = (np.float32, np.float64)


def _assert_inside(field: sdf.Field, boxes: np.ndarray, points: np.ndarray, dtype: type) -> float:
    """Values by both evaluators are within the bounds; returns the share of finite bounds.

    Points where an intermediate result is not finite are left out: nothing is said of them.
    """
    bounds = field.enclose(boxes, dtype)
    with torch.no_grad():
        regular = all_finite(field.expression, torch.from_numpy(points))
    assert not np.isnan(bounds).any()
    for name in ("torch", "numba"):
        with sdf.back_end(name), torch.no_grad():
            values = field.evaluate(torch.from_numpy(points)).numpy()
        below = values < bounds[:, None, 0]
        above = values > bounds[:, None, 1]
        outside = (below | above) & regular
        assert not outside.any(), (field, points[outside][0], values[outside][0])
    return float(np.isfinite(bounds).all(axis=1).mean())


@pytest.mark.parametrize("dtype", DTYPES)
def test_inclusion_on_the_catalogue(example, rng, dtype):
    boxes = random_boxes(rng, 200, dtype)
    assert _assert_inside(example, boxes, points_in(rng, boxes, 20, dtype), dtype) == 1


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("oracles", [False, True])
def test_inclusion_on_random_expressions(rng, dtype, oracles):
    shares = []
    for _ in range(30):
        field = sdf.Field(random_expression(rng, int(rng.integers(1, 60)), oracles=oracles))
        boxes = random_boxes(rng, 40, dtype)
        shares.append(_assert_inside(field, boxes, points_in(rng, boxes, 10, dtype), dtype))
    assert np.mean(shares) > 0.5


@pytest.mark.statistical
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("oracles", [False, True])
def test_inclusion_on_a_million_random_triples(rng, dtype, oracles):
    """1,250 expressions x 40 boxes x 20 points, four times: 4 million in all, two evaluators."""
    for _ in range(1_250):
        field = sdf.Field(random_expression(rng, int(rng.integers(1, 80)), oracles=oracles))
        boxes = random_boxes(rng, 40, dtype)
        _assert_inside(field, boxes, points_in(rng, boxes, 20, dtype), dtype)


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_on_boxes_at_its_special_places(name, rng):
    """Boxes whose sides are zeros, ones, multiples of pi / 2 and the like."""
    arity = OPERATIONS[name].arity
    special = np.array([0, 1, -1, 0.5, 2, -2, 3, -3, 1e-30, np.pi / 2, -np.pi, 2 * np.pi, 40, -40])
    sides = np.sort(rng.choice(special, (600, 2, 3)), axis=1)
    for dtype in DTYPES:
        boxes = sides.astype(dtype).astype(np.float64)
        field = sdf.Field(ex.apply(name, *(X, Y, Z)[:arity]))
        _assert_inside(field, boxes, points_in(rng, boxes, 10, dtype), dtype)


def test_exact_values_are_inside(rng):
    """Beside 60-digit arithmetic: the bounds hold for the formula, not only for its rounding."""
    for _ in range(25):
        root = random_expression(rng, int(rng.integers(1, 25)))
        field = sdf.Field(root)
        boxes = random_boxes(rng, 6, np.float64)
        points = points_in(rng, boxes, 3, np.float64)
        for dtype in DTYPES:
            bounds = field.enclose(boxes, dtype)
            rounding = field.rounding(boxes, dtype)
            with sdf.back_end("torch"):
                computed = field.evaluate(torch.from_numpy(points.astype(dtype))).numpy()
            for box in range(len(boxes)):
                for k in range(3):
                    try:
                        exact = exact_value(root, points[box, k])
                    except ZeroDivisionError:
                        continue
                    assert bounds[box, 0] <= exact <= bounds[box, 1]
                    at = points[box, k]
                    if np.isfinite(computed[box, k]) and (at == at.astype(dtype)).all():
                        error = abs(mpmath.mpf(float(computed[box, k])) - exact)
                        assert error <= rounding[box]


# --- sharpness ---


def test_bounds_shrink_with_the_box(example, rng):
    """The width goes down with the box's, to rounding, and by the Lipschitz bound at least."""
    if example.lipschitz is None:
        pytest.skip("it claims no Lipschitz bound")
    centres = rng.uniform(-2, 2, (300, 1, 3))
    for half in (0.5, 0.05, 5e-4):
        bounds = example.enclose(np.concatenate([centres - half, centres + half], axis=1))
        allowed = 2 * example.lipschitz * half * np.sqrt(3) + 1e-7
        assert ((bounds[:, 1] - bounds[:, 0]) <= allowed * 1.001).all()


def test_some_bounds_are_the_very_range():
    box = [[1.0, -2, 0], [2.0, 3, 0.5]]
    for root, expected in (
        (X * X, (1, 4)),
        (Y * Y, (0, 9)),
        (ex.square(Y), (0, 9)),
        (abs(Y), (0, 3)),
        (X - X, (0, 0)),
        (ex.sin(2 * Y), (-1, 1)),
        (ex.cos(Z), (np.cos(0.5), 1)),
        (ex.sqrt(Y), (0, np.sqrt(3))),
        (ex.power(X, 2.0), (1, 4)),
        (ex.atan2(Z, X), (0, np.arctan2(0.5, 1))),
        (ex.modulo(X - 0.75, 2.0), (0.25, 1.25)),
        (ex.length(X, Y), (1, np.sqrt(13))),
        (ex.minimum(X, Y), (-2, 2)),
        (ex.where_negative(Y - 5, X, Y), (1, 2)),
    ):
        np.testing.assert_allclose(sdf.Field(root).enclose(box), expected, atol=1e-14)


def test_the_lipschitz_bound_makes_them_tighter():
    """A box of the size of a smooth union, where interval arithmetic loses how parts correlate."""
    shape = sdf.sphere(0.7).union(sdf.box(0.5).rotate(30, (1, 2, 3)), smooth=0.4)
    boxes = np.array([[[0.4, 0.4, 0.4], [0.5, 0.5, 0.5]]])
    plain = sdf.Field(shape.expression).enclose(boxes)
    tight = shape.enclose(boxes)
    assert (tight[:, 1] - tight[:, 0] < 0.8 * (plain[:, 1] - plain[:, 0])).all()


def test_rounding_is_a_few_units_for_simple_fields():
    field = sdf.sphere(1, (0.1, 0.2, 0.3))
    box = [[0.5, 0.5, 0.5], [0.6, 0.6, 0.6]]
    assert 1e-9 < field.rounding(box) < 2e-6
    assert field.rounding(box, np.float64) < 1e-14


def test_infinite_boxes_and_points_are_bounded():
    everywhere = [[-np.inf] * 3, [np.inf] * 3]
    assert sdf.sphere(1).enclose(everywhere).tolist()[1] == np.inf
    assert sdf.sphere(1).enclose(everywhere)[0] == pytest.approx(-1)
    low, high = sdf.Field(X / Y).enclose([[1, -1, 0], [2, 1, 0]])
    assert (low, high) == (-np.inf, np.inf)
    assert sdf.Field(ex.exp(X)).enclose([[1000, 0, 0], [2000, 0, 0]])[1] == np.inf


# --- oracles ---


def test_an_oracle_that_knows_nothing_leaves_the_lipschitz_bound():
    loose = sdf.from_function(lambda p: p.norm(dim=-1) - 1)
    assert loose.enclose([[0, 0, 0], [1, 1, 1]]).tolist() == [-np.inf, np.inf]
    warped = sdf.sphere(1).remap(lambda p: p * 1.0, lipschitz=1.0)
    low, high = warped.enclose([[2, 0, 0], [2.2, 0.2, 0.2]])
    assert 0.8 < low < 1.0
    assert 1.2 < high < 1.5


def test_bounds_of_an_oracle_are_used():
    oracle = FunctionOracle(lambda p: torch.sin(p.sum(dim=-1)), "wave", lipschitz=3**0.5)
    (wave,) = ex.call(oracle)
    field = sdf.Field(ex.maximum(wave, Z - 0.5) + X)
    low, high = field.enclose([[0, 0, 0], [0.1, 0.1, 0.1]])
    assert -0.2 < low <= 0 <= high < 0.6


# --- bad input ---


@pytest.mark.parametrize(
    "boxes",
    [[0, 1], [[0, 0, 0], [1, 1, float("nan")]], [[0, 0, 0], [1, 1, -1]], [["a"]], np.zeros((2, 2))],
)
def test_boxes_that_are_none(boxes):
    with pytest.raises(InputError, match="two rows of three numbers"):
        sdf.sphere(1).enclose(boxes)


@pytest.mark.parametrize("dtype", [np.float16, int, "complex64", "no dtype"])
def test_dtypes_that_are_none(dtype):
    with pytest.raises(InputError, match="float32 or float64"):
        sdf.sphere(1).enclose([[0, 0, 0], [1, 1, 1]], dtype)


def test_shapes_of_boxes():
    boxes = np.zeros((4, 5, 2, 3))
    assert sdf.sphere(1).enclose(boxes).shape == (4, 5, 2)
    assert sdf.sphere(1).rounding(boxes).shape == (4, 5)
    assert sdf.sphere(1).enclose(boxes[:0]).shape == (0, 5, 2)
    assert sdf.sphere(1).enclose([[0, 0, 0], [1, 1, 1]]).shape == (2,)
