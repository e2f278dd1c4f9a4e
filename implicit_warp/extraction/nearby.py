"""Find the crossed cells of a field with a Lipschitz bound by halving blocks.

A value v at a point rules out the surface within |v| / L of it.  A block of cells is left alone if
the balls about its corners cover it: one reaches through the whole block, or all reach its centre.
Only corners are sampled, and they are lattice points that are used again down to the cells: little
more is sampled than the corners of cells near the surface.  For fields whose evaluation is the
cost, such as the distance to a mesh.

Guarantee: no cell is missed whose corners differ in sign, given that the bound is true.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from implicit_warp.extraction.cells import Cells, Found
from implicit_warp.extraction.cube import CORNERS
from implicit_warp.extraction.samples import NUMPY, CornerSamples, Sampler

_COARSEST = 32
"""Cells along the side of the largest block."""

_ROUNDING = 0.01
"""Voxels by which a ball is taken smaller, for the rounding of values and of lattice points."""


def crossed_cells(sampler: Sampler, lipschitz: float, batch: int) -> Found:
    """All cells whose corners differ in sign.

    Args:
        sampler: of the field.
        lipschitz: a bound on the change of its values a unit of distance.
        batch: blocks handled at a time.
    """
    samples = CornerSamples(sampler)
    unit = sampler.lattice.voxel * lipschitz
    first, last = sampler.first_cell, sampler.last_cell
    axes = [np.arange(a, b + 1, _COARSEST) for a, b in zip(first, last, strict=True)]
    blocks = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    found: list[Cells] = []
    size = _COARSEST
    while size > 1:
        half = size // 2
        children = [
            _children(block, samples.of(block, size), size, unit, last)
            for block in np.array_split(blocks, max(1, -(-len(blocks) // batch)))
        ]
        blocks = np.concatenate(children)
        size = half
    doubtful = [np.empty((0, 3), np.int64)]
    for block in np.array_split(blocks, max(1, -(-len(blocks) // batch))):
        values = samples.of(block)
        inside = values < 0
        crossed = inside.any(axis=1) & ~inside.all(axis=1)
        found.append(Cells(block[crossed], values[crossed]))
        near = np.abs(values).min(axis=1, initial=np.inf) <= 0.5 * math.sqrt(3.0) * unit
        doubtful.append(block[near & ~crossed])
    return Found(Cells.joined(found, NUMPY[sampler.dtype]), np.concatenate(doubtful))


def _children(
    blocks: NDArray[np.int64],
    values: NDArray[np.floating],
    size: int,
    unit: float,
    last: NDArray[np.int64],
) -> NDArray[np.int64]:
    """The halves, along every axis, of blocks that no balls are known to cover."""
    half = size // 2
    # Radius of the ball about each corner, in voxels. Beyond a wall all is outside, so that no ball
    # of the inside holds there, and nothing is known about corners there.
    beyond = np.isinf(values)
    at_wall = beyond.any(axis=1, keepdims=True)
    reach = np.where(beyond | (at_wall & (values < 0)), 0.0, np.abs(values) / unit - _ROUNDING)
    covered = reach.max(axis=1) > math.sqrt(3.0) * size
    covered |= reach.min(axis=1) > 0.5 * math.sqrt(3.0) * size
    blocks, reach = blocks[~covered], reach[~covered]
    # The child at each corner is covered if that corner's ball reaches through it.
    needed = reach <= math.sqrt(3.0) * half
    children = (blocks[:, None] + half * CORNERS)[needed]
    return children[(children <= last).all(axis=1)]
