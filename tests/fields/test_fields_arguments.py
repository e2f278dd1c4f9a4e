"""Points at the edge of the package: what is accepted, and what the refusal says."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError

FIELD = sdf.sphere(1.0)


@pytest.mark.parametrize(
    ("points", "cause"),
    [
        (np.zeros((5, 2)), "last axis"),
        (np.zeros(()), "last axis"),
        (torch.zeros((3, 4)), "last axis"),
        ([[0, 0, 0], [1, 1]], "real numbers"),
        ([["a", "b", "c"]], "real numbers"),
        (None, "real numbers"),
        (np.zeros((2, 3), dtype=bool), "real numbers"),
        (torch.zeros((2, 3), dtype=torch.bool), "real numbers"),
        (np.zeros((2, 3), dtype=complex), "real numbers"),
        (torch.zeros((2, 3), dtype=torch.complex64), "real numbers"),
    ],
)
def test_points_of_the_wrong_kind_are_refused(points, cause):
    for evaluate in (FIELD, FIELD.gradient):
        with pytest.raises(InputError, match=cause) as caught:
            evaluate(points)
        assert caught.value.argument == "points"


@pytest.mark.parametrize("kind", [np.asarray, torch.tensor])
def test_points_that_are_not_finite_are_counted_and_the_first_is_shown(kind):
    points = np.zeros((4, 5, 3))
    points[2, 3, 1] = np.nan
    points[3, 0, 0] = np.inf
    points[3, 0, 1] = np.nan
    with pytest.raises(InputError, match=r"2 of 20 points .* first at index \(2, 3\)"):
        FIELD(kind(points))


def test_numbers_of_any_kind_are_read():
    np.testing.assert_array_equal(FIELD(np.array([[2, 0, 0]], dtype=np.uint8)), [1.0])
    np.testing.assert_array_equal(FIELD([(0, 3, 0)]), [2.0])
    assert FIELD(torch.tensor([0, 0, 4])).dtype == torch.float64
    assert FIELD(np.zeros(3, dtype=np.float16)).dtype == np.float64
    assert FIELD(np.zeros((2, 3), dtype=">f4")).dtype == np.float32


def test_strided_and_read_only_arrays_are_read():
    array = np.arange(24, dtype=np.float64).reshape(4, 6)[::-1, ::-2]
    array.setflags(write=False)
    expected = np.linalg.norm(array, axis=-1) - 1
    np.testing.assert_allclose(FIELD(array), expected)


def test_points_are_left_as_they_are():
    points = torch.ones((2, 3), requires_grad=True)
    FIELD.gradient(points)
    assert points.grad is None
    array = np.ones((2, 3))
    FIELD.gradient(array)
    np.testing.assert_array_equal(array, 1)


def test_half_precision_tensors_keep_their_dtype():
    assert FIELD(torch.zeros((2, 3), dtype=torch.bfloat16)).dtype == torch.bfloat16
