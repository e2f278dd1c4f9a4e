"""Which blocks of a lattice a surface may pass through, and samples there.

What an extraction needs before it makes triangles. A lattice point with indices i has the
coordinates origin + voxel * i, computed in float64 and rounded to the dtype; a block of `size`
cells a side has (size + 1)^3 of them, those on its faces shared with its neighbours.

Guarantees: a block that is left out has no sample on the level or on its other side, in the dtype
asked for, rounding included (`Field.enclose` says when). Samples are the same bits that
`Field.evaluate` gives at the same points on its compiled path. Both hold for any number of
threads.

Fields that call oracles are bounded and sampled too, only without the programs that get shorter
from cube to cube, so their whole formula is evaluated in every block that remains.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.evaluators.enclosures import bounds_on_boxes, checked_dtype
from fields.evaluators.threads import in_parts
from fields.field import Field
from fields.z_order import z_order

Integers = NDArray[np.int64]

SHIFT = 2
"""The largest cubes that are tried at once have 2**SHIFT blocks a side."""

CUBES = 8
"""Cubes that a thread takes at a time."""

POINTS = 1 << 18
"""Samples that are taken at a time where an oracle is called."""


class Blocks(NamedTuple):
    """What is known of some blocks.

    Attributes:
        bounds: `(n, 2)`, between which all values of the block lie; those of a larger cube for a
            block that was left out with its neighbours.
        crossed: `(n,)`, may the field take the level in it?
        values: `(n, (size + 1)**3)`, the samples of the crossed blocks, z running fastest, then
            y; rows of the others are not set.
    """

    bounds: NDArray[np.float64]
    crossed: NDArray[np.bool_]
    values: NDArray[np.floating]


def crossed_blocks(
    field: Field,
    origin: ArrayLike,
    voxel: float | ArrayLike,
    corners: ArrayLike,
    size: int,
    *,
    level: float = 0.0,
    dtype: DTypeLike = np.float32,
) -> NDArray[np.bool_]:
    """Which blocks the level set may pass through, `(n,)`; see `sample_blocks`."""
    return _visited(field, origin, voxel, corners, size, level, dtype, sampled=False).crossed


def sample_blocks(
    field: Field,
    origin: ArrayLike,
    voxel: float | ArrayLike,
    corners: ArrayLike,
    size: int,
    *,
    level: float = 0.0,
    dtype: DTypeLike = np.float32,
) -> Blocks:
    """Bounds of blocks, and samples of those that the level set may pass through.

    Makes room for the samples of all the blocks it is given: for many, ask `crossed_blocks`
    first. Fast if neighbouring blocks are given together.

    Args:
        field: any field.
        origin: `(3,)`, the lattice point with indices 0.
        voxel: the spacing, or three of them.
        corners: `(n, 3)` whole numbers, the indices of each block's first lattice point.
        size: cells along an edge of a block.
        level: the value that is looked for.
        dtype: float32 or float64, in which samples are taken.

    Raises:
        InputError: an argument is not of the kind described.
    """
    return _visited(field, origin, voxel, corners, size, level, dtype, sampled=True)


def lattice_points(
    origin: ArrayLike, voxel: float | ArrayLike, corners: ArrayLike, size: int, dtype: DTypeLike
) -> NDArray[np.floating]:
    """The points `(n, (size + 1)**3, 3)` at which `sample_blocks` evaluates."""
    spacing = np.array(arguments.numbers_or_one("voxel", voxel))
    steps = np.stack(np.meshgrid(*[np.arange(size + 1)] * 3, indexing="ij"), axis=-1)
    indices = np.asarray(corners)[:, None] + steps.reshape(-1, 3)
    return (np.asarray(origin, np.float64) + spacing * indices).astype(dtype)


def _visited(
    field: Field,
    origin: ArrayLike,
    voxel: float | ArrayLike,
    corners: ArrayLike,
    size: int,
    level: float,
    dtype: DTypeLike,
    *,
    sampled: bool,
) -> Blocks:
    kind = checked_dtype(dtype)
    lattice = np.array(
        [arguments.vector("origin", origin), arguments.numbers_or_one("voxel", voxel)]
    )
    threshold = arguments.number("level", level)
    places = _checked_corners(corners)
    if not isinstance(size, int | np.integer) or size < 1:
        raise InputError("size", size, "a block has one cell or more a side", "pass 8 or 16")
    keys = z_order((places - places.min(axis=0, initial=0)) // size)
    order = np.argsort(keys, kind="stable")
    keys, places = keys[order], places[order]
    room = (len(places), (size + 1) ** 3) if sampled else (0, 1)
    found = Blocks(
        np.empty((len(places), 2)), np.empty(len(places), np.bool_), np.empty(room, kind)
    )
    visit = _visit_with_oracles if field.tape.calls_oracles else _visit
    visit(field, lattice, keys, places, int(size), threshold, found, sampled)
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return Blocks(*(item[back] if len(item) else item for item in found))


def _checked_corners(corners: ArrayLike) -> Integers:
    array = np.asarray(corners)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InputError(
            "corners",
            corners,
            "blocks are given by the indices of their first lattice points",
            "pass whole numbers of shape (n, 3)",
        )
    return array.astype(np.int64)


def _starts(keys: Integers) -> Integers:
    """Where runs of equal keys begin, and the end of the last."""
    changes = np.flatnonzero(np.diff(keys)) + 1
    return np.concatenate([[0], changes, [len(keys)]])


def _visit(
    field: Field,
    lattice: NDArray[np.float64],
    keys: Integers,
    corners: Integers,
    size: int,
    level: float,
    found: Blocks,
    sampled: bool,
) -> None:
    from fields.evaluators.blocks import visit_blocks

    (stage,) = field.tape.compiled.stages
    program = stage.program
    dtype = found.values.dtype
    limits = np.finfo(dtype)
    rounded = program.constants.astype(dtype).astype(np.float64)
    lipschitz = np.inf if field.lipschitz is None else field.lipschitz
    starts = _starts(keys >> 3 * SHIFT)

    def task(start: int, stop: int) -> None:
        visit_blocks(
            program.codes,
            program.arguments,
            program.constants,
            rounded,
            int(program.outputs[0]),
            (float(limits.tiny), float(limits.eps)),
            float(lipschitz),
            level,
            lattice,
            keys,
            corners,
            size,
            starts[start : stop + 1],
            SHIFT,
            found.bounds,
            found.crossed,
            sampled,
            found.values,
        )

    if len(keys):
        in_parts(task, len(starts) - 1, CUBES)


def _visit_with_oracles(
    field: Field,
    lattice: NDArray[np.float64],
    keys: Integers,
    corners: Integers,
    size: int,
    level: float,
    found: Blocks,
    sampled: bool,
) -> None:
    dtype = found.values.dtype
    alive = np.arange(len(keys))
    for shift in range(SHIFT, -1, -1):
        starts = _starts(keys[alive] >> 3 * shift) if len(alive) else np.zeros(1, np.int64)
        low = np.minimum.reduceat(corners[alive], starts[:-1]) if len(alive) else corners[:0]
        high = np.maximum.reduceat(corners[alive], starts[:-1]) if len(alive) else corners[:0]
        boxes = np.stack([low, high + size], axis=1)
        boxes = (lattice[0] + lattice[1] * boxes).astype(dtype)
        bounds = bounds_on_boxes(field.tape, field.lipschitz, boxes, dtype)[:, :2]
        cubes = np.repeat(np.arange(len(boxes)), np.diff(starts))
        found.bounds[alive] = bounds[cubes]
        found.crossed[alive] = ((bounds[:, 0] <= level) & (level <= bounds[:, 1]))[cubes]
        alive = alive[found.crossed[alive]]
    if sampled:
        step = max(1, POINTS // found.values.shape[1])
        for start in range(0, len(alive), step):
            part = alive[start : start + step]
            points = lattice_points(lattice[0], lattice[1], corners[part], size, dtype)
            found.values[part] = field.tape.compiled.values(torch.from_numpy(points)).numpy()
