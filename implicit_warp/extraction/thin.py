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
from numpy.typing import NDArray

from fields.lattice import crossed_blocks
from implicit_warp.extraction.cube import CORNERS
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
    return found if certain or not len(found) else found[_turned(sampler, found)]


def doubtful_cells(sampler: Sampler, blocks: NDArray[np.int64], side: int) -> NDArray[np.int64]:
    """(m, 3) cells, among those of blocks with a given side, that bounds leave undecided."""
    lattice = sampler.lattice
    while side > 1:
        side //= 2
        blocks = (blocks[:, None] + side * CORNERS).reshape(-1, 3)
        blocks = blocks[(blocks <= sampler.last_cell).all(axis=1)]
        undecided = crossed_blocks(
            sampler.field,
            lattice.origin,
            lattice.voxel,
            blocks,
            side,
            level=sampler.level,
            dtype=NUMPY[sampler.dtype],
        )
        blocks = blocks[undecided]
    return blocks


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
