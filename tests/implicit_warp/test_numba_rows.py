"""Vector instructions on rows of six numbers, against the same in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from implicit_warp.numba_rows import add_to_row, apply_row, apply_row_and_keep, subtract_four

KINDS = pytest.mark.parametrize("kind", [np.float32, np.float64])


@njit
def applied(table, rows, x, y, images):
    for i in range(len(rows)):
        apply_row(table, 6 * rows[i], x[i], y[i], images, 2 * i)


@njit
def applied_and_kept(table, rows, x, y, images, linear):
    for i in range(len(rows)):
        apply_row_and_keep(table, 6 * rows[i], x[i], y[i], images, 2 * i, linear, 4 * i)


@njit
def added(table, rows, linear, x, y):
    for i in range(len(rows)):
        add_to_row(table, 6 * rows[i], linear, 4 * i, x[i], y[i])


@njit
def subtracted(numbers, to, factor, start):
    subtract_four(numbers, to, factor, numbers, start)


@KINDS
def test_rows_are_applied_and_kept(kind, rng):
    table, rows = rng.normal(size=(9, 6)).astype(kind), rng.integers(0, 9, 200)
    x, y = rng.normal(size=(2, 200)).astype(kind)
    images, linear = np.full(402, np.nan, kind), np.full(801, np.nan, kind)
    applied_and_kept(table.ravel(), rows, x, y, images, linear)
    alone = np.full(402, np.nan, kind)
    applied(table.ravel(), rows, x, y, alone)
    np.testing.assert_array_equal(alone, images)
    a = table[rows]
    expected = a[:, [0, 2]] * x[:, None] + a[:, [1, 3]] * y[:, None] + a[:, 4:]
    sizes = np.abs(a).sum(1, keepdims=True) * (1 + np.hypot(x, y))[:, None]
    # Two products and two sums, in any order, fused or not.
    assert (np.abs(images[:400].reshape(-1, 2) - expected) <= 4 * np.finfo(kind).eps * sizes).all()
    assert (linear[:800].reshape(-1, 4) == a[:, :4]).all()
    # Not a number further than they were asked to.
    assert np.isnan(images[400:]).all()
    assert np.isnan(linear[800:]).all()


@KINDS
def test_many_points_add_to_one_row(kind, rng):
    table, rows = rng.normal(size=(5, 6)).astype(kind), rng.integers(0, 5, 300)
    linear = rng.normal(size=(300, 4)).astype(kind)
    x, y = rng.normal(size=(2, 300)).astype(kind)
    expected = table.copy()
    for row, four, p, q in zip(rows, linear, x, y, strict=True):
        expected[row] += np.array([*four, p, q], kind)
    flat = table.ravel()
    added(flat, rows, linear.ravel(), x, y)
    assert (flat.reshape(5, 6) == expected).all()


@KINDS
@pytest.mark.parametrize(("to", "start"), [(0, 4), (9, 0), (3, 8), (2, 4), (5, 5)])
def test_a_multiple_of_four_numbers_is_subtracted_also_where_they_overlap(kind, to, start, rng):
    numbers, factor = rng.normal(size=13).astype(kind), kind(rng.normal())
    expected = numbers.copy()
    expected[to : to + 4] -= factor * numbers[start : start + 4]
    size = np.abs(numbers).max() * (1 + np.abs(factor))
    subtracted(numbers, to, factor, start)
    # Rounded once where product and difference are fused, else twice.
    assert (np.abs(numbers - expected) <= np.finfo(kind).eps * size).all()
    others = np.delete(np.arange(13), range(to, to + 4))
    assert (numbers[others] == expected[others]).all()


def test_an_array_that_is_not_contiguous_is_refused():
    with pytest.raises(TypingError, match="contiguous"):
        added(np.zeros(24)[::2], np.zeros(1, np.int64), np.zeros(4), np.zeros(1), np.zeros(1))
    with pytest.raises(TypingError, match="one type"):
        added(np.zeros(12), np.zeros(1, np.int64), np.zeros(4, np.float32), *np.zeros((2, 1)))
