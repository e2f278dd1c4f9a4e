"""Functions as fields: what they may return, and what a box says of them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields.oracle import enclose_by_lipschitz

POINTS = np.random.default_rng(0).uniform(-2, 2, (50, 3))


def _ball(points):
    return points.norm(dim=-1) - 1


def test_values_come_in_the_dtype_of_the_points():
    """A function that works in float32, as networks do."""
    field = sdf.from_function(lambda p: _ball(p.float()))
    np.testing.assert_allclose(field(POINTS), _ball(torch.from_numpy(POINTS)), atol=1e-6)
    assert field(POINTS).dtype == np.float64
    assert field(torch.from_numpy(POINTS).half()).dtype == torch.float16
    assert field.gradient(POINTS).dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(field.gradient(POINTS), axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("function", "cause"),
    [
        (lambda p: _ball(p) < 0, "real numbers"),
        (lambda p: (_ball(p) * 10).int(), "real numbers"),
        (lambda p: _ball(p) + 0j, "real numbers"),
        (lambda p: p, "must return a tensor of shape"),
        (lambda p: _ball(p)[:-1], "must return a tensor of shape"),
        (lambda p: _ball(p).mean(), "must return a tensor of shape"),
        (lambda p: _ball(p).numpy(), "must return a tensor of shape"),
        (lambda p: None, "must return a tensor of shape"),
    ],
)
def test_what_is_no_field_is_named(function, cause):
    with pytest.raises(InputError, match=cause) as caught:
        sdf.from_function(function, name="mine")(POINTS)
    assert caught.value.argument == "mine"


def test_a_gradient_that_is_cut_off_is_named():
    with pytest.raises(InputError, match="carry no gradient"):
        sdf.from_function(lambda p: _ball(p.detach())).gradient(POINTS)


def test_nan_values_are_passed_on_and_bound_nothing():
    """A call gives what the function gives; whoever prunes by boxes must not trust it."""

    def holed(points):
        return torch.where(points[..., 0] > 0, torch.nan, _ball(points))

    field = sdf.from_function(holed, lipschitz=1.0)
    assert np.isnan(field([1.0, 0, 0]))
    oracle = field.expression.arguments[0].payload
    boxes = np.array([[[0.5, 0, 0], [1, 1, 1]], [[-1, -1, -1], [-0.5, 0, 0]]])
    bounds = enclose_by_lipschitz(oracle, boxes, 1.0)[:, 0]
    np.testing.assert_array_equal(bounds[0], (-np.inf, np.inf))
    assert np.isfinite(bounds[1]).all()
    np.testing.assert_array_equal(oracle.enclose(boxes)[:, 0], bounds)


def test_errors_of_the_function_itself_are_its_own():
    def broken(points):
        raise ZeroDivisionError("in the user's code")

    with pytest.raises(ZeroDivisionError, match="user's code"):
        sdf.from_function(broken)(POINTS)
