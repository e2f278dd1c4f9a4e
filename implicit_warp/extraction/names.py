"""Rows of integers that are numbered in the order in which they are entered."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import inlined, kernel, parallel_kernel


class Names:
    """A table from rows of integers, all of one length, to their numbers 0, 1, 2, ..."""

    def __init__(self, rows: NDArray[np.int64] | None = None) -> None:
        self._rows: NDArray[np.int64] | None = None
        self._size = 0
        self._slots = np.full(1 << 10, -1, np.int64)
        if rows is not None:
            self.enter(rows)

    def of(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) the numbers of rows (n, k); -1 for those not entered."""
        if self._rows is None:
            return np.full(len(rows), -1, np.int64)
        return _find(rows, self._rows, self._slots)

    def enter(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n,) new numbers of rows (n, k). A row that is entered again keeps its first number."""
        end = self._size + len(rows)
        if self._rows is None or end > len(self._rows):
            grown = np.empty((max(2 * end, 1 << 8), rows.shape[1]), np.int64)
            if self._rows is not None:
                grown[: self._size] = self._rows[: self._size]
            self._rows = grown
        self._rows[self._size : end] = rows
        if 2 * end > len(self._slots):
            self._slots = np.full(1 << (4 * end).bit_length(), -1, np.int64)
            _enter(self._rows, 0, end, self._slots)
        else:
            _enter(self._rows, self._size, end, self._slots)
        numbers, self._size = np.arange(self._size, end), end
        return numbers


@inlined
def _start(row):
    """A well-mixed number from a row (FNV-1a on 64-bit words, finished by a multiplication)."""
    mixed = np.uint64(14695981039346656037)
    for value in row:
        mixed = (mixed ^ np.uint64(value)) * np.uint64(1099511628211)
        mixed ^= mixed >> np.uint64(32)
    return np.int64((mixed * np.uint64(11400714819323198485)) >> np.uint64(17))


@parallel_kernel
def _find(rows, known, slots):
    mask = len(slots) - 1
    numbers = np.full(len(rows), -1)
    for i in prange(len(rows)):
        at = _start(rows[i]) & mask
        while slots[at] >= 0:
            same = True
            for k in range(rows.shape[1]):
                if known[slots[at], k] != rows[i, k]:
                    same = False
                    break
            if same:
                numbers[i] = slots[at]
                break
            at = (at + 1) & mask
    return numbers


@kernel
def _enter(known, begin, end, slots):
    mask = len(slots) - 1
    for i in range(begin, end):
        at = _start(known[i]) & mask
        while slots[at] >= 0:
            at = (at + 1) & mask
        slots[at] = i
