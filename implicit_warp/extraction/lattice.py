"""The lattice on which a field is sampled, and which of its points need sampling at all.

A field with a known Lipschitz bound L cannot vanish in a block of voxels whose centre has a
value beyond L times the distance to the block's farthest point. Such blocks are skipped, from
coarse to fine; all their points are on the side of their centre. Without a bound every point
is sampled: guessing that a field is a distance would leave holes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fields import Field
from implicit_warp.errors import InputError

BLOCK = 8
"""Cells along the side of the smallest block that can be skipped."""

_COARSEST = 8 * BLOCK
_MARGIN = 2  # voxels around a field's own bounds, so that its surface stays off the walls


@dataclass(frozen=True)
class Lattice:
    """Points origin + voxel * (i, j, k), 0 <= (i, j, k) < shape, spanning cubic voxels."""

    origin: NDArray[np.float64]
    voxel: float
    shape: tuple[int, int, int]

    @property
    def cells(self) -> NDArray[np.int64]:
        """Number of voxels along each axis."""
        return np.array(self.shape) - 1

    @property
    def far_corner(self) -> NDArray[np.float64]:
        """The last point."""
        return self.origin + self.voxel * self.cells


def lattice_for(field: Field, resolution: int, bounds: ArrayLike | None) -> Lattice:
    """The lattice of `resolution` voxels along the longest side of a box.

    The other sides are rounded up to whole voxels, half of the excess at each end. The box is
    `bounds` `(2, 3)`, or the field's own bounds and two voxels more on every side.

    Raises:
        InputError: no bounds, or a box that is no box; a resolution that is too small.
    """
    if isinstance(resolution, bool) or not isinstance(resolution, int | np.integer):
        raise InputError("resolution", resolution, "not a whole number", "Use 64 to 512")
    margin = _MARGIN if bounds is None else 0
    if resolution < 2 * margin + 2:
        raise InputError(
            "resolution", resolution, "too few voxels to hold a surface", "Use 64 to 512"
        )
    if bounds is None and field.bounds is None:
        raise InputError(
            "bounds",
            None,
            "the field is unbounded, or its bounds are unknown",
            "Pass bounds=[[x0, y0, z0], [x1, y1, z1]], or intersect the field with a box",
        )
    box = _box(field.bounds if bounds is None else bounds)
    sides = box[1] - box[0]
    longest = float(sides.max())
    if longest == 0.0:
        raise InputError(
            "bounds", box.tolist(), "the box has no extent: the field is empty", "Check the field"
        )
    voxel = longest / (int(resolution) - 2 * margin)
    # A side that is a whole number of voxels but for rounding needs no extra one.
    cells = np.maximum(np.ceil(sides / voxel - 1e-9), 1).astype(int) + 2 * margin
    origin = 0.5 * (box[0] + box[1]) - 0.5 * voxel * cells
    return Lattice(origin, voxel, (int(cells[0]) + 1, int(cells[1]) + 1, int(cells[2]) + 1))


def _box(bounds: ArrayLike) -> NDArray[np.float64]:
    try:
        box = np.asarray(bounds, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("bounds", bounds, f"not numbers ({error})", _BOX_REMEDY) from error
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise InputError(
            "bounds", bounds, "not two finite corners, minimum before maximum", _BOX_REMEDY
        )
    return box


_BOX_REMEDY = "Pass [[x0, y0, z0], [x1, y1, z1]] with x0 < x1 and so on"


class Sampler:
    """Samples a field on slabs of a lattice, each point at most once.

    Args:
        field: what is sampled, without gradients.
        lattice: where.
        level: the value that separates inside from outside, exact in `dtype`.
        dtype: torch.float32 or torch.float64, of points and values.
        batch: points a call of the field.
    """

    def __init__(
        self, field: Field, lattice: Lattice, level: float, dtype: torch.dtype, batch: int
    ) -> None:
        self._field = field
        self._lattice = lattice
        self._level = level
        self._dtype = dtype
        self._batch = batch
        self._numpy_dtype = np.float32 if dtype == torch.float32 else np.float64
        self.lowest = math.inf
        self.highest = -math.inf
        """Range of the values seen so far."""
        bound = field.lipschitz
        self._sides = None if bound is None or not math.isfinite(bound) else self._prune(bound)

    def slab(
        self, begin: int, end: int, first_plane: NDArray[np.floating] | None
    ) -> tuple[NDArray[np.floating], NDArray[np.bool_], NDArray[np.bool_] | None]:
        """Sample the planes x = begin, ..., end (included) of the lattice.

        Args:
            begin: first plane.
            end: last plane.
            first_plane: the values of plane `begin` if a slab before has sampled it.

        Returns:
            Values `(end - begin + 1, ny, nz)`, NaN where skipped; which points are inside;
            and which were sampled, None for all.
        """
        planes = (end - begin + 1, *self._lattice.shape[1:])
        skip = 0 if first_plane is None else 1
        if self._sides is None:
            values = np.empty(planes, self._numpy_dtype)
            wanted = np.arange(skip * values[0].size, values.size)
            needed = None
        else:
            values = np.full(planes, np.nan, self._numpy_dtype)
            needed = self._needed(begin, end)
            wanted = skip * values[0].size + np.flatnonzero(needed[skip:])
        flat = values.reshape(-1)
        if first_plane is not None:
            values[0] = first_plane
        for start in range(0, len(wanted), self._batch):
            batch = wanted[start : start + self._batch]
            flat[batch] = self._evaluate(self._points(batch, begin))
        inside = values < self._level
        if needed is not None:
            inside |= self._skipped_inside(begin, end) & ~needed
        return values, inside, needed

    def _points(self, flat: NDArray[np.int64], begin: int) -> NDArray[np.float64]:
        """Lattice points of flat indices into the slab that begins at a plane."""
        _, ny, nz = self._lattice.shape
        rows, k = np.divmod(flat, nz)
        i, j = np.divmod(rows, ny)
        points = np.empty((len(flat), 3))
        for axis, index in enumerate((i + begin, j, k)):
            points[:, axis] = self._lattice.origin[axis] + self._lattice.voxel * index
        return points

    def _evaluate(self, points: NDArray[np.float64]) -> NDArray[np.floating]:
        with torch.no_grad():
            values = self._field.evaluate(torch.from_numpy(points).to(self._dtype))
        result = values.cpu().numpy()
        if result.shape != (len(points),):
            raise InputError(
                "field",
                self._field,
                f"it gave values of shape {result.shape} for points of shape {points.shape}",
                "Return one value a point",
            )
        finite = np.isfinite(result)
        if not finite.all():
            where = points[np.flatnonzero(~finite)[0]]
            raise InputError(
                "field",
                self._field,
                f"{int((~finite).sum())} of {len(points)} values in one batch are NaN or infinite, "
                f"the first at {where.tolist()}",
                "Mend the field there, or choose bounds that leave the place out",
            )
        self.lowest = min(self.lowest, float(result.min()))
        self.highest = max(self.highest, float(result.max()))
        return result

    # --- skipping blocks ---

    def _prune(self, lipschitz: float) -> NDArray[np.int8]:
        """Side of each block: -1 inside, 1 outside, 0 where it has to be sampled."""
        cells = self._lattice.cells
        size = _COARSEST
        sides = np.zeros(-(-cells // size), dtype=np.int8)
        while True:
            blocks = np.argwhere(sides == 0)
            centres = self._lattice.origin + self._lattice.voxel * size * (blocks + 0.5)
            batches = range(0, len(centres), self._batch)
            values = np.concatenate(
                [self._evaluate(centres[b : b + self._batch]) for b in batches] or [np.empty(0)]
            ).astype(np.float64)
            # One voxel more than the block's own reach, for the field's rounding.
            reach = 0.5 * math.sqrt(3.0) * (size + 1) * self._lattice.voxel
            certain = np.abs(values - self._level) > lipschitz * reach
            sides[tuple(blocks[certain].T)] = np.where(values[certain] < self._level, -1, 1)
            if size == BLOCK:
                return sides
            size //= 2
            for axis in range(3):
                sides = np.repeat(sides, 2, axis=axis)
            x, y, z = -(-cells // size)
            sides = sides[:x, :y, :z]

    def _needed(self, begin: int, end: int) -> NDArray[np.bool_]:
        """Points of some planes that belong to a block that has to be sampled."""
        cells = self._lattice.cells
        first, last = max(begin - 1, 0), min(end + 1, int(cells[0]))
        needed = self._sides[np.arange(first, last) // BLOCK] == 0
        for axis in (1, 2):
            needed = np.take(needed, np.arange(cells[axis]) // BLOCK, axis=axis)
        for axis in range(3):
            needed = _cells_to_points(needed, axis)
        return needed[begin - first : end - first + 1]

    def _skipped_inside(self, begin: int, end: int) -> NDArray[np.bool_]:
        """Whether the block at each point of some planes is inside; right for skipped points."""
        inside = self._sides == -1
        ranges = (
            range(begin, end + 1),
            range(self._lattice.shape[1]),
            range(self._lattice.shape[2]),
        )
        for axis, indices in enumerate(ranges):
            block = np.minimum(np.array(indices), self._lattice.cells[axis] - 1) // BLOCK
            inside = np.take(inside, block, axis=axis)
        return inside


def _cells_to_points(cells: NDArray[np.bool_], axis: int) -> NDArray[np.bool_]:
    """Flag the points at either end of flagged cells along one axis."""
    pad = [(0, 0)] * 3
    pad[axis] = (0, 1)
    after = np.pad(cells, pad)
    pad[axis] = (1, 0)
    return after | np.pad(cells, pad)
