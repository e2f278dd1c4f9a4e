"""Parts of a shape, or gaps in it, that pass between the lattice points.

A sheet thinner than a voxel may hold no lattice point, or only some: its mesh would be missing, or
full of holes.  Cells that the surface may enter although their corners are of one sign are looked
into at finer points.  Where an edge of the shape comes out between lattice points, such a cell has
a crossed cell beside it; a cell without one holds a thin part.

Guarantee: what is reported is there: a point of the other sign has been seen, or a point of the
carried surface.  Non-guarantees: a part can be thinner than the finer points are apart, too; and
cells are passed over that the surface enters only if the field is steeper in them than at their
corners and middle.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import parallel_kernel
from fields.lattice import sample_blocks
from implicit_warp.extraction.cube import CORNERS
from implicit_warp.extraction.names import Names
from implicit_warp.extraction.samples import NUMPY, Sampler

FINER = 4
"""Points along a cell's edge that are looked at, in place of one."""

_CLOSE = 1.25 * math.sqrt(0.75)
"""Voxels from a cell's middle to the surface, as the steepness tells, up to which the cell is
looked into: half a diagonal and some more."""

_AT_ONCE = 1 << 14
"""Cells looked into at a time, with 125 values each."""


def thin_cells(
    sampler: Sampler, crossed: NDArray[np.int64], doubtful: NDArray[np.int64], certain: bool
) -> NDArray[np.int64]:
    """(t, 3) uncrossed cells that hold a thin part.

    Args:
        sampler: of the field.
        crossed: (n, 3) all crossed cells.
        doubtful: (m, 3) cells that the surface may enter.
        certain: is it known to enter the doubtful ones?
    """
    places, alone = Names(crossed), np.ones(len(doubtful), np.bool_)
    for offset in product((0, -1, 1), repeat=3):
        left = np.flatnonzero(alone)
        alone[left] = places.of(doubtful[left] + np.array(offset)) < 0
    found = doubtful[alone]
    if certain or not len(found):
        return found
    found = found[_close(sampler, found)]
    return found[_turned(sampler, found)]


def lonely_cells(
    block_corners: NDArray[np.int64],
    values: NDArray[np.floating],
    limits: NDArray[np.int64],
    reach: float,
) -> NDArray[np.int64]:
    """(m, 3) uncrossed cells of sampled blocks without a crossed neighbour in their block.

    Args:
        block_corners: (n, 3) lattice index of each block's first point.
        values: (n, m, m, m) samples minus level.
        limits: (2, 3) first and last cell; cells outside are left out.
        reach: the surface does not enter a cell with a corner whose value is farther from zero.
    """
    count = np.zeros(len(values), np.int64)
    _find_lonely(block_corners, values, limits, reach, count, count, np.empty((0, 3), np.int64), 0)
    first = np.concatenate([[0], np.cumsum(count)])
    cells = np.empty((int(first[-1]), 3), np.int64)
    _find_lonely(block_corners, values, limits, reach, count, first, cells, 1)
    return cells


@parallel_kernel
def _find_lonely(block_corners, values, limits, reach, count, first, cells, fill):
    """Count the lonely cells of every block, or fill them in."""
    size = values.shape[1] - 1
    zero = values.dtype.type(0.0)
    for b in prange(len(values)):
        block = values[b]
        found = 0
        for i in range(size):
            for j in range(size):
                for k in range(size):
                    x = block_corners[b, 0] + i
                    y = block_corners[b, 1] + j
                    z = block_corners[b, 2] + k
                    if x > limits[1, 0] or y > limits[1, 1] or z > limits[1, 2]:
                        continue
                    farthest = zero
                    for c in range(8):
                        at = block[i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1)]
                        farthest = max(farthest, abs(at))
                    if farthest > reach:
                        continue
                    # The corners of all neighbours, as far as they are in the block.
                    inside = block[i, j, k] < zero
                    alike = True
                    for p in range(max(i - 1, 0), min(i + 3, size + 1)):
                        for q in range(max(j - 1, 0), min(j + 3, size + 1)):
                            for r in range(max(k - 1, 0), min(k + 3, size + 1)):
                                alike &= (block[p, q, r] < zero) == inside
                    if not alike:
                        continue
                    if fill:
                        cells[first[b] + found, 0] = x
                        cells[first[b] + found, 1] = y
                        cells[first[b] + found, 2] = z
                    found += 1
        if not fill:
            count[b] = found


def _close(sampler: Sampler, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) whether the surface is near enough to enter a cell, by how steep the field is there."""
    places = np.concatenate([[[0.5] * 3], CORNERS])
    result = np.empty(len(cells), np.bool_)
    at_once = max(1, sampler.batch // len(places))
    for start in range(0, len(cells), at_once):
        part = cells[start : start + at_once]
        value, slope = sampler.value_and_gradient((part[:, None] + places).reshape(-1, 3))
        steepness = np.linalg.norm(slope, axis=1).reshape(len(part), -1).max(axis=1)
        middle = np.abs(value.reshape(len(part), -1)[:, 0])
        result[start : start + at_once] = middle <= _CLOSE * steepness
    return result


def _turned(sampler: Sampler, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) whether a finer point in a cell is of another sign than its low corner."""
    lattice, oracles = sampler.lattice, sampler.field.tape.calls_oracles
    result = np.zeros(len(cells), np.bool_)
    finer = np.stack(np.meshgrid(*[np.arange(FINER + 1) / FINER] * 3, indexing="ij"), axis=-1)
    finer = finer.reshape(-1, 3)
    at_once = max(1, sampler.batch // len(finer)) if oracles else _AT_ONCE
    for start in range(0, len(cells), at_once):
        part = cells[start : start + at_once]
        looked_at = np.arange(start, start + len(part))
        if oracles:
            values = sampler.value_at((part[:, None] + finer).reshape(-1, 3))
        else:
            sampled = sample_blocks(
                sampler.field,
                lattice.origin,
                lattice.voxel / FINER,
                FINER * part,
                FINER,
                level=sampler.level,
                dtype=NUMPY[sampler.dtype],
            )
            looked_at, part = looked_at[sampled.crossed], part[sampled.crossed]
            values = sampled.values[sampled.crossed]
            sampler.took(values, lambda i: part[i // len(finer)] + finer[i % len(finer)])  # noqa: B023
            values = values - NUMPY[sampler.dtype](sampler.level)
        inside = values.reshape(-1, len(finer)) < 0
        result[looked_at] = (inside != inside[:, :1]).any(axis=1)
    return result
