"""Numbers of rows of integers, against a dictionary."""

from __future__ import annotations

import numpy as np

from implicit_warp.extraction.names import Names


def test_rows_are_numbered_as_by_a_dictionary(rng):
    names, plain = Names(), {}
    for size in (0, 1, 700, 40, 5000, 3):
        rows = np.unique(rng.integers(-40, 40, (size, 3)), axis=0)
        rng.shuffle(rows)
        expected = np.array([plain.get(tuple(row), -1) for row in rows.tolist()], np.int64)
        np.testing.assert_array_equal(names.of(rows), expected)
        fresh = rows[expected < 0]
        plain.update({tuple(row): len(plain) + k for k, row in enumerate(fresh.tolist())})
        np.testing.assert_array_equal(
            names.enter(fresh), np.arange(len(plain) - len(fresh), len(plain))
        )
    everything = np.array(list(plain))
    np.testing.assert_array_equal(names.of(everything), np.arange(len(plain)))


def test_a_row_entered_twice_keeps_its_first_number():
    names = Names(np.array([[3, 1], [4, 1], [3, 1]]))
    np.testing.assert_array_equal(names.of(np.array([[4, 1], [3, 1], [1, 3]])), [1, 0, -1])
