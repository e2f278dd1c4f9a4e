"""Find the crossed cells of a field by what its values can be on boxes, then by sampling blocks.

Blocks of cells are halved as long as their enclosure (`fields.Field.enclose`) leaves it open
whether the surface meets them.  What is left at the finest size is sampled at all of its points.

Guarantee: no cell is missed whose corners differ in sign.  Where nothing is known of a field, its
enclosures are infinite, and every lattice point is sampled: guessing that a field is a distance
would leave holes.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fields.lattice import sample_blocks
from implicit_warp.extraction.cells import Cells, Found, crossed_cells_of_blocks
from implicit_warp.extraction.cube import CORNERS
from implicit_warp.extraction.samples import NUMPY, CornerSamples, Sampler
from implicit_warp.extraction.thin import lonely_cells

BLOCK = 8
"""Cells along the side of the blocks that are sampled."""

_COARSEST = 8 * BLOCK

_SIDE = 4 * BLOCK
"""Blocks of this size are left to the compiled sampling, which looks at their parts itself."""

_STEEP = 2.0
"""Slope with which thin parts are looked for, at most."""

_AT_ONCE = 4096
"""Blocks that are sampled at a time: 3 million samples."""

_OFFSETS = np.stack(np.meshgrid(*[np.arange(BLOCK + 1)] * 3, indexing="ij"), axis=-1)
_PLACES = _OFFSETS.reshape(-1, 3)


def crossed_cells(sampler: Sampler, doubts: bool = False) -> Found:
    """All cells whose corners differ in sign.

    Args:
        sampler: of the field.
        doubts: are the doubtful cells wanted? They are looked for in fields without oracles only,
            where bounds cost little.
    """
    first, last = sampler.first_cell, sampler.last_cell
    axes = [np.arange(a, b + 1, _COARSEST) for a, b in zip(first, last, strict=True)]
    blocks = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if sampler.field.tape.calls_oracles:
        blocks = undecided_blocks(sampler, blocks, _COARSEST, BLOCK)
        few = len(blocks) * BLOCK**3 < 0.5 * np.prod(last - first + 1.0)
        cells = _without_repetition(sampler, blocks) if few else _by_sampler(sampler, blocks)
        return Found(cells, np.empty((0, 3), np.int64))
    blocks = undecided_blocks(sampler, blocks, _COARSEST, _SIDE)
    side = _SIDE
    while side > BLOCK:
        side //= 2
        blocks = split(blocks, side, last)
    beyond = (blocks < 0).any(axis=1) | (blocks + BLOCK > last).any(axis=1)
    beyond &= sampler.walled
    found = _by_kernel(sampler, blocks[~beyond], doubts)
    if not beyond.any():
        return found
    parts = [found.cells, _by_sampler(sampler, blocks[beyond])]
    return Found(Cells.joined(parts, NUMPY[sampler.dtype]), found.doubtful)


def _by_kernel(sampler: Sampler, blocks: NDArray[np.int64], doubts: bool) -> Found:
    """The crossed cells of blocks within the lattice, all by compiled code; and the doubtful ones,
    without those beside them."""
    found, doubtful, lattice = [], [np.empty((0, 3), np.int64)], sampler.lattice
    lipschitz = _STEEP if sampler.field.lipschitz is None else sampler.field.lipschitz
    # The farthest corner of a cell from where the surface enters it is at most a diagonal away.
    # Fields are rarely as steep as they may be, so no more than `_STEEP` is looked for.
    reach = math.sqrt(3.0) * lattice.voxel * min(lipschitz, _STEEP)
    limits = np.stack([sampler.first_cell, sampler.last_cell])
    for block in np.array_split(blocks, max(1, -(-len(blocks) // _AT_ONCE))):
        sampled = sample_blocks(
            sampler.field,
            lattice.origin,
            lattice.voxel,
            block,
            BLOCK,
            level=sampler.level,
            dtype=NUMPY[sampler.dtype],
        )
        block, values = block[sampled.crossed], sampled.values[sampled.crossed]
        sampler.took(values, _place_in(block))
        values = (values - NUMPY[sampler.dtype](sampler.level)).reshape(-1, *_OFFSETS.shape[:3])
        found.append(crossed_cells_of_blocks(block, values, limits))
        if doubts:
            doubtful.append(lonely_cells(block, values, limits, reach))
    return Found(Cells.joined(found, NUMPY[sampler.dtype]), np.concatenate(doubtful))


def _place_in(blocks: NDArray[np.int64]) -> Callable[[int], NDArray[np.int64]]:
    """From the place of a sample in an array of blocks to its lattice point."""
    return lambda i: blocks[i // len(_PLACES)] + _PLACES[i % len(_PLACES)]


def _by_sampler(sampler: Sampler, blocks: NDArray[np.int64]) -> Cells:
    """The same point by point, for fields of any kind, and beyond the walls."""
    found = []
    limits = np.stack([sampler.first_cell, sampler.last_cell])
    at_once = max(1, sampler.batch // (BLOCK + 1) ** 3)
    for block in np.array_split(blocks, max(1, -(-len(blocks) // at_once))):
        points = np.minimum(block[:, None, None, None] + _OFFSETS, sampler.last_cell + 1)
        values = sampler.at(points.reshape(-1, 3)).reshape(points.shape[:-1])
        found.append(crossed_cells_of_blocks(block, values, limits))
    return Cells.joined(found, NUMPY[sampler.dtype])


def _without_repetition(sampler: Sampler, blocks: NDArray[np.int64]) -> Cells:
    """The same where samples are dear: smaller blocks, and each point once however many have it."""
    finest = BLOCK // 2
    blocks = undecided_blocks(sampler, split(blocks, finest, sampler.last_cell), finest, finest)
    samples, found = CornerSamples(sampler), []
    offsets = np.stack(np.meshgrid(*[np.arange(finest)] * 3, indexing="ij"), axis=-1)
    for block in np.array_split(blocks, max(1, -(-8 * len(blocks) * finest**3 // sampler.batch))):
        cells = (block[:, None] + offsets.reshape(-1, 3)).reshape(-1, 3)
        cells = cells[(cells <= sampler.last_cell).all(axis=1)]
        values = samples.of(cells)
        inside = values < 0
        crossed = inside.any(axis=1) & ~inside.all(axis=1)
        found.append(Cells(cells[crossed], values[crossed]))
    return Cells.joined(found, NUMPY[sampler.dtype])


def undecided_blocks(
    sampler: Sampler, blocks: NDArray[np.int64], side: int, finest: int
) -> NDArray[np.int64]:
    """(n, 3) low corners of the blocks of `finest`^3 cells that the surface may meet.

    Args:
        sampler: of the field.
        blocks: (m, 3) low corners of the blocks to start from.
        side: theirs, in cells.
        finest: side of the blocks to end with.
    """
    while True:
        blocks = blocks[_undecided(sampler, blocks, side)]
        if side == finest:
            return blocks
        side //= 2
        blocks = split(blocks, side, sampler.last_cell)


def split(blocks: NDArray[np.int64], half: int, last: NDArray[np.int64]) -> NDArray[np.int64]:
    """The eight parts, of sides `half`, of every block; those beyond the last cell left out."""
    parts = (blocks[:, None] + half * CORNERS).reshape(-1, 3)
    return parts[(parts <= last).all(axis=1)]


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
