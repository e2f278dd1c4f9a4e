"""Samples of a field at lattice points: checked, counted, and each taken once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray

from fields import Field
from fields.jit import inlined, kernel, parallel_kernel
from implicit_warp.errors import InputError
from implicit_warp.extraction.cube import CORNERS
from implicit_warp.extraction.lattice import Lattice

NUMPY = {torch.float32: np.float32, torch.float64: np.float64}


@dataclass(eq=False)
class Sampler:
    """A field on a lattice, minus the level.

    Args:
        field: what is sampled, without gradients.
        lattice: where.
        level: the value that separates inside from outside, exact in `dtype`.
        dtype: torch.float32 or torch.float64, of points and values.
        batch: points a call of the field.
        walled: are points beyond the lattice outside, at infinity? Else nobody asks for them.

    Attributes:
        count: samples taken so far.
        lowest, highest: range of the values seen so far (of the field itself).
    """

    field: Field
    lattice: Lattice
    level: float
    dtype: torch.dtype
    batch: int
    walled: bool
    count: int = dataclasses.field(default=0, init=False)
    lowest: float = dataclasses.field(default=math.inf, init=False)
    highest: float = dataclasses.field(default=-math.inf, init=False)

    @property
    def first_cell(self) -> NDArray[np.int64]:
        """(3,) the lowest cell: one beyond the lattice if it is walled."""
        return np.full(3, -1 if self.walled else 0)

    @property
    def last_cell(self) -> NDArray[np.int64]:
        """(3,) the highest cell."""
        return np.array(self.lattice.shape) - (1 if self.walled else 2)

    def at(self, indices: NDArray[np.int64]) -> NDArray[np.floating]:
        """(n,) values minus level at lattice points (n, 3); infinite beyond the walls."""
        values = np.full(len(indices), np.inf, NUMPY[self.dtype])
        if self.walled:
            within = ((indices >= 0) & (indices < self.lattice.shape)).all(axis=1)
            values[within] = self._at_lattice(indices[within])
        else:
            values[:] = self._at_lattice(indices)
        return values

    def _at_lattice(self, indices: NDArray[np.int64]) -> NDArray[np.floating]:
        parts = [
            self.evaluate(self.lattice.origin + self.lattice.voxel * indices[b : b + self.batch])
            for b in range(0, len(indices), self.batch)
        ]
        return np.concatenate([np.empty(0, NUMPY[self.dtype]), *parts])

    def evaluate(self, points: NDArray[np.float64]) -> NDArray[np.floating]:
        """(n,) values minus level at points (n, 3), in one call of the field.

        Raises:
            InputError: a value is NaN or infinite, or there is not one a point.
        """
        with torch.no_grad():
            values = self.field.evaluate(torch.from_numpy(points).to(self.dtype))
        result = values.cpu().numpy()
        if result.shape != (len(points),):
            raise InputError(
                "field",
                self.field,
                f"it gave values of shape {result.shape} for points of shape {points.shape}",
                "Return one value a point",
            )
        self._note(result, lambda i: points[i])
        return result - NUMPY[self.dtype](self.level)

    def took(self, values: NDArray[np.floating], index: Callable[[int], NDArray[np.int64]]) -> None:
        """Take note of values of the field that were computed elsewhere.

        Args:
            values: of the field itself, of any shape.
            index: the lattice point of a value, by its place in the flattened array.

        Raises:
            InputError: a value is NaN or infinite.
        """
        lattice = self.lattice
        self._note(values.reshape(-1), lambda i: lattice.origin + lattice.voxel * index(i))

    def _note(
        self, values: NDArray[np.floating], place: Callable[[int], NDArray[np.float64]]
    ) -> None:
        finite = np.isfinite(values)
        if not finite.all():
            first = int(np.flatnonzero(~finite)[0])
            raise InputError(
                "field",
                self.field,
                f"{int((~finite).sum())} of {len(values)} values in one batch are NaN or infinite, "
                f"the first at {place(first).tolist()}",
                "Mend the field there, or choose bounds that leave the place out",
            )
        self.count += len(values)
        if len(values):
            self.lowest = min(self.lowest, float(values.min()))
            self.highest = max(self.highest, float(values.max()))

    def value_at(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) values minus level at points (n, 3) in index coordinates of the lattice."""
        points = self.lattice.origin + self.lattice.voxel * places
        batches = range(0, len(points), self.batch)
        parts = [self.evaluate(points[b : b + self.batch]) for b in batches]
        return np.concatenate([np.empty(0), *parts])

    def value_and_gradient(
        self, places: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) values minus level, and (n, 3) gradients, at points (n, 3) in index coordinates.

        Both are in units of a voxel where the field is a distance.
        """
        points = self.lattice.origin + self.lattice.voxel * places
        values, gradients = np.empty(len(points)), np.empty((len(points), 3))
        for b in range(0, len(points), self.batch):
            at = torch.from_numpy(points[b : b + self.batch]).to(self.dtype)
            value, gradient = self.field.value_and_gradient(at)
            values[b : b + self.batch] = value.numpy()
            gradients[b : b + self.batch] = gradient.numpy()
        self.count += len(points)
        return (values - self.level) / self.lattice.voxel, gradients


@inlined
def hashed(key):
    """A well-mixed non-negative number from a key (Fibonacci hashing)."""
    return np.int64((np.uint64(key) * np.uint64(11400714819323198485)) >> np.uint64(17))


class CornerSamples:
    """The corners of cells and larger blocks, each lattice point sampled once and remembered.

    Memory grows with the number of points asked for.
    """

    def __init__(self, sampler: Sampler) -> None:
        self._sampler = sampler
        # Keys count from one point beyond the lattice on every side.
        self._extent = np.array(sampler.lattice.shape) + 4
        self._size = 0
        self._slots = np.full(1 << 12, -1, np.int64)
        self._values = np.empty(1 << 12, NUMPY[sampler.dtype])

    def of(self, corners: NDArray[np.int64], size: int = 1) -> NDArray[np.floating]:
        """(n, 8) values at the corners of blocks with low corners (n, 3) and sides of `size` cells.

        Beyond the last point of the lattice (plus one, if it is walled) a block is cut off.
        """
        last = self._sampler.last_cell + 1
        # At most eight new points a block; the table stays less than half full.
        while 2 * (self._size + 8 * len(corners)) > len(self._slots):
            self._slots, self._values = _grown(self._slots, self._values)
        places = np.empty((len(corners), 8), np.int64)
        fresh, count = np.empty((8 * len(corners), 3), np.int64), 0
        count = _find(corners, size, last, self._extent, self._slots, places, fresh)
        fresh = fresh[:count]
        self._size += count
        values = self._sampler.at(fresh)
        _store(fresh, values, self._extent, self._slots, self._values)
        return self._values[places]


@kernel
def _key(x, y, z, extent):
    return ((x + 2) * extent[1] + (y + 2)) * extent[2] + (z + 2)


@kernel
def _find(corners, size, last, extent, slots, places, fresh):
    """Find or enter the eight corners of every block; what is new goes to `fresh`."""
    mask = len(slots) - 1
    count = 0
    for i in range(len(corners)):
        for c in range(8):
            x = min(corners[i, 0] + size * CORNERS[c, 0], last[0])
            y = min(corners[i, 1] + size * CORNERS[c, 1], last[1])
            z = min(corners[i, 2] + size * CORNERS[c, 2], last[2])
            key = _key(x, y, z, extent)
            at = hashed(key) & mask
            while slots[at] >= 0 and slots[at] != key:
                at = (at + 1) & mask
            if slots[at] < 0:
                slots[at] = key
                fresh[count, 0] = x
                fresh[count, 1] = y
                fresh[count, 2] = z
                count += 1
            places[i, c] = at
    return count


@parallel_kernel
def _store(points, values, extent, slots, table):
    mask = len(slots) - 1
    for i in prange(len(points)):
        key = _key(points[i, 0], points[i, 1], points[i, 2], extent)
        at = hashed(key) & mask
        while slots[at] != key:
            at = (at + 1) & mask
        table[at] = values[i]


@kernel
def _grown(slots, values):
    """The same table with twice the room."""
    new_slots = np.full(2 * len(slots), -1, np.int64)
    new_values = np.empty(2 * len(slots), values.dtype)
    mask = len(new_slots) - 1
    for i in range(len(slots)):
        if slots[i] >= 0:
            at = hashed(slots[i]) & mask
            while new_slots[at] >= 0:
                at = (at + 1) & mask
            new_slots[at] = slots[i]
            new_values[at] = values[i]
    return new_slots, new_values
