"""Find the crossed cells of a warped field from the surface of the field at rest.

The surface of s o f^-1 is the image under f of the surface of s.  That one is found where it is
cheap and where bounds are sharp, at rest, and carried forward: every cell that a carried point
falls into is a seed.  From the seeds the surface is followed: where a cell's face has corners of
both signs, the cell beyond it is crossed too.  So only cells at the surface are sampled.

Guarantees: the surface is closed whatever the seeds are, since following ends only where nothing
is left to follow; and each part of it that holds a seed is found whole.
Non-guarantee: a part of the lattice's surface without any seed is missed.  Seeds lie closer than
the cells' sides, so such a part would be one that passes between them.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import prange
from numpy.typing import NDArray

from fields import Field
from fields.jit import kernel, parallel_kernel
from implicit_warp import deformation
from implicit_warp.deformation import Origin
from implicit_warp.extraction.cells import Cells, Found
from implicit_warp.extraction.cube import CORNERS, FACE_AXIS, FACE_SIDE
from implicit_warp.extraction.samples import NUMPY, CornerSamples, Sampler, hashed

_MOST_STRETCH = 4.0
"""How much finer than the lattice the surface at rest is found, at most."""


_ALL_OVER = 9
"""Points along each side of a box at which a stretch is looked at."""


def carried(field: Field) -> Origin | None:
    """What a field was carried from by a map that is no formula of it; None for all others."""
    origin = deformation.origin(field)
    return None if origin is None or origin.formula else origin


def resolution_at_rest(carried: Origin, voxel: float, surface: NDArray[np.float64]) -> int:
    """Voxels along the longest side of the field at rest, so that carried ones are no larger.

    Args:
        carried: the field.
        voxel: of the lattice for the carried field.
        surface: (n, 3) points of the surface at rest, where the map's stretch is looked at; if
            there are none, a coarse look having missed it, that is done all over its bounds.
    """
    if not len(surface):
        axes = np.linspace(*np.asarray(carried.rest.bounds, np.float64), _ALL_OVER, axis=1)
        surface = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    jacobians = carried.map.jacobian(torch.from_numpy(surface))
    stretch = float(torch.linalg.matrix_norm(jacobians, ord=2).max())
    side = float(np.ptp(carried.rest.bounds, axis=0).max())
    return max(8, math.ceil(side / voxel * min(max(stretch, 1.0), _MOST_STRETCH)) + 4)


def seeds(carried: Origin, surface: NDArray[np.float64], sampler: Sampler) -> NDArray[np.float64]:
    """(n, 3) the images of points of the surface at rest."""
    return carried.map(torch.from_numpy(surface).to(sampler.dtype)).double().numpy()


def follow(sampler: Sampler, seeds: NDArray[np.float64], batch: int) -> Found:
    """The crossed cells that can be reached from the cells of some points of the surface.

    The corners of the lattice are always among these, for walls that lie inside the shape all over.

    Args:
        sampler: of the field.
        seeds: (n, 3) points of the surface; instead of those beyond the lattice its outermost
            cells are looked at.
        batch: cells handled at a time.
    """
    lattice, samples = sampler.lattice, CornerSamples(sampler)
    first, last = sampler.first_cell, sampler.last_cell
    cells = np.floor((seeds - lattice.origin) / lattice.voxel).astype(np.int64)
    extent = np.array(lattice.shape) + 4
    visited = _Visited(extent)
    within = ((cells >= first) & (cells <= last)).all(axis=1)
    frontier = visited.new(cells[within])
    outermost = [first + CORNERS * (last - first), np.clip(cells[~within], first, last)]
    found: list[Cells] = []
    doubtful = None
    while doubtful is None or len(frontier):
        onwards, uncrossed = [], []
        for block in np.array_split(frontier, max(1, -(-len(frontier) // batch))):
            values = samples.of(block)
            inside = values < 0
            crossed = inside.any(axis=1) & ~inside.all(axis=1)
            cells = Cells(block[crossed], values[crossed])
            found.append(cells)
            uncrossed.append(block[~crossed])
            onwards.append(_beyond_crossed_faces(*cells, first, last))
        if doubtful is None:  # the first round: these hold seeds, and what is met later does not
            doubtful = np.concatenate(uncrossed)
            onwards += outermost
        frontier = visited.new(np.concatenate(onwards))
    return Found(Cells.joined(found, NUMPY[sampler.dtype]), doubtful, certain=True)


class _Visited:
    """The set of cells that have been met."""

    def __init__(self, extent: NDArray[np.int64]) -> None:
        self._extent = extent
        self._slots = np.full(1 << 12, -1, np.int64)
        self._size = 0

    def new(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Those of the cells (n, 3) that were not met before, each once; they now count as met."""
        keys = np.ascontiguousarray(
            ((cells[:, 0] + 2) * self._extent[1] + cells[:, 1] + 2) * self._extent[2]
            + cells[:, 2]
            + 2
        )
        while 2 * (self._size + len(keys)) > len(self._slots):
            self._slots = _rehashed(self._slots)
        fresh = _enter(keys, self._slots)
        self._size += int(fresh.sum())
        return cells[fresh]


@kernel
def _enter(keys, slots):
    mask = len(slots) - 1
    fresh = np.zeros(len(keys), np.bool_)
    for i in range(len(keys)):
        at = hashed(keys[i]) & mask
        while slots[at] >= 0 and slots[at] != keys[i]:
            at = (at + 1) & mask
        if slots[at] < 0:
            slots[at] = keys[i]
            fresh[i] = True
    return fresh


@kernel
def _rehashed(slots):
    result = np.full(2 * len(slots), -1, np.int64)
    _enter(slots[slots >= 0], result)
    return result


def _beyond_crossed_faces(
    corners: NDArray[np.int64],
    values: NDArray[np.floating],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
) -> NDArray[np.int64]:
    """The neighbours of cells across those of their faces whose corners differ in sign."""
    neighbours = np.empty((len(corners), 6, 3), np.int64)
    across = np.empty((len(corners), 6), np.bool_)
    _neighbours(corners, values, first, last, neighbours, across)
    return neighbours[across]


@parallel_kernel
def _neighbours(corners, values, first, last, neighbours, across):
    zero = values.dtype.type(0.0)
    for i in prange(len(corners)):
        for f in range(6):
            axis, side = FACE_AXIS[f], FACE_SIDE[f]
            inside = 0
            for c in range(8):
                if CORNERS[c, axis] == side:
                    inside += np.int64(values[i, c] < zero)
            for a in range(3):
                neighbours[i, f, a] = corners[i, a]
            neighbours[i, f, axis] += 2 * side - 1
            there = neighbours[i, f, axis]
            within = there >= first[axis] and there <= last[axis]
            across[i, f] = within and inside > 0 and inside < 4
