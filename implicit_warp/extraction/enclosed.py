"""Find the crossed cells of a field by what its values can be on boxes, then by sampling blocks.

Blocks of cells are halved as long as their enclosure (`fields.Field.enclose`) leaves it open
whether the surface meets them.  What is left at the finest size is sampled at all of its points.

Guarantee: no cell is missed whose corners differ in sign.  Where nothing is known of a field, its
enclosures are infinite, and every lattice point is sampled: guessing that a field is a distance
would leave holes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from implicit_warp.extraction.cells import Cells, crossed_cells_of_blocks
from implicit_warp.extraction.cube import CORNERS
from implicit_warp.extraction.samples import NUMPY, Sampler

BLOCK = 8
"""Cells along the side of the blocks that are sampled."""

_COARSEST = 8 * BLOCK

_OFFSETS = np.stack(np.meshgrid(*[np.arange(BLOCK + 1)] * 3, indexing="ij"), axis=-1)


def crossed_cells(sampler: Sampler) -> Cells:
    """All cells whose corners differ in sign."""
    found = []
    beyond = np.stack([sampler.first_cell, sampler.last_cell])
    blocks = undecided_blocks(sampler, BLOCK)
    at_once = max(1, sampler.batch // (BLOCK + 1) ** 3)
    for block in np.array_split(blocks, max(1, -(-len(blocks) // at_once))):
        points = block[:, None, None, None] + _OFFSETS
        points = np.minimum(points, sampler.last_cell + 1)
        values = sampler.at(points.reshape(-1, 3)).reshape(points.shape[:-1])
        found.append(crossed_cells_of_blocks(block, values, beyond))
    return Cells.joined(found, NUMPY[sampler.dtype])


def undecided_blocks(sampler: Sampler, size: int) -> NDArray[np.int64]:
    """(n, 3) low corners of the blocks of `size`^3 cells that the surface may meet."""
    first, last = sampler.first_cell, sampler.last_cell
    axes = [np.arange(a, b + 1, _COARSEST) for a, b in zip(first, last, strict=True)]
    blocks = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    side = _COARSEST
    while True:
        blocks = blocks[_undecided(sampler, blocks, side)]
        if side == size:
            return blocks
        side //= 2
        blocks = (blocks[:, None] + side * CORNERS).reshape(-1, 3)
        blocks = blocks[(blocks <= last).all(axis=1)]


def _undecided(sampler: Sampler, blocks: NDArray[np.int64], side: int) -> NDArray[np.bool_]:
    lattice = sampler.lattice
    end = np.minimum(blocks + side, sampler.last_cell + 1)
    boxes = lattice.origin + lattice.voxel * np.stack([blocks, end], axis=1)
    # Lattice points are rounded to the samples' dtype before the field sees them.
    slack = np.finfo(NUMPY[sampler.dtype]).eps * np.abs(boxes).max(axis=(1, 2), initial=0.0)
    boxes[:, 0] -= slack[:, None]
    boxes[:, 1] += slack[:, None]
    low, high = sampler.field.enclose(boxes, NUMPY[sampler.dtype]).T
    undecided = (low <= sampler.level) & (high >= sampler.level)
    if sampler.walled:  # beyond the walls all is outside, so an inside block there is crossed
        cut = (blocks < 0).any(axis=1) | (end > np.array(lattice.shape) - 1).any(axis=1)
        undecided |= cut & (low <= sampler.level)
    return undecided
