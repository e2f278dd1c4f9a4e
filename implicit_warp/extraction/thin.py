"""Parts of a shape, or gaps in it, that pass between the lattice points.

A sheet thinner than a voxel may hold no lattice point, or only some: its mesh would be missing, or
full of holes.  Cells that the surface may enter although their corners are of one sign are looked
into at finer points.  Where an edge of the shape comes out between lattice points, such a cell has
a crossed cell beside it; a cell without one holds a thin part.

Guarantee: what is reported is there: a point of the other sign has been seen, or a point of the
carried surface.  Non-guarantee: a part can be thinner than the finer points are apart, too.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import parallel_kernel
from fields.lattice import crossed_blocks
from implicit_warp.extraction.samples import NUMPY, Sampler
from implicit_warp.extraction.sides import Places

FINER = 4
"""Points along a cell's edge that are looked at, in place of one."""


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
    places, alone = Places(crossed), np.ones(len(doubtful), np.bool_)
    for offset in product((0, -1, 1), repeat=3):
        left = np.flatnonzero(alone)
        alone[left] = places.of(doubtful[left] + np.array(offset)) < 0
    found = doubtful[alone]
    if certain or not len(found):
        return found
    if not sampler.field.tape.calls_oracles:
        found = found[_undecided(sampler, found)]
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


def _undecided(sampler: Sampler, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) whether bounds of the values leave open that the surface enters a cell."""
    lattice = sampler.lattice
    return crossed_blocks(
        sampler.field,
        lattice.origin,
        lattice.voxel,
        cells,
        1,
        level=sampler.level,
        dtype=NUMPY[sampler.dtype],
    )


def _turned(sampler: Sampler, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(m,) whether a finer point in a cell is of another sign than its low corner."""
    axes = [np.linspace(0.0, 1.0, FINER + 1)] * 3
    finer = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    result = np.empty(len(cells), np.bool_)
    at_once = max(1, sampler.batch // len(finer))
    for start in range(0, len(cells), at_once):
        part = cells[start : start + at_once]
        inside = sampler.value_at((part[:, None] + finer).reshape(-1, 3)) < 0
        inside = inside.reshape(len(part), -1)
        result[start : start + at_once] = (inside != inside[:, :1]).any(axis=1)
    return result
