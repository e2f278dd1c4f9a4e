"""Vertices with equal coordinates, found exactly and in linear time by hashing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel


def first_of_equal(vertices: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each vertex `(V, 3)`, the first one whose coordinates are equal bit for bit, `(V,)`.

    A vertex that repeats no earlier one gives itself. -0.0 equals 0.0; a NaN equals a NaN of the
    same bits, so that a file's corners can be told apart whatever they hold.
    """
    bits = (np.asarray(vertices, dtype=np.float64) + 0.0).view(np.uint64)
    slots = 1 << max(4, int(np.ceil(np.log2(max(len(bits), 1) * 2))))
    return _first_of_equal(bits.reshape(-1, 3), slots)


@kernel
def _first_of_equal(bits, slots):
    """Open addressing with linear probing; `slots` is a power of two, at least twice `len(bits)`.

    A slot holds one more than a vertex index, or zero while it is empty.
    """
    table = np.zeros(slots, np.int64)
    first = np.empty(len(bits), np.int64)
    mask = np.uint64(slots - 1)
    for v in range(len(bits)):
        hashed = np.uint64(0)
        for k in range(3):
            hashed = (hashed ^ bits[v, k]) * np.uint64(0x9E3779B97F4A7C15)
            hashed ^= hashed >> np.uint64(29)
        slot = hashed & mask
        while True:
            found = table[slot] - 1
            if found < 0:
                table[slot] = v + 1
                first[v] = v
                break
            if (
                bits[found, 0] == bits[v, 0]
                and bits[found, 1] == bits[v, 1]
                and bits[found, 2] == bits[v, 2]
            ):
                first[v] = found
                break
            slot = (slot + np.uint64(1)) & mask
    return first
