"""Fixed sample patterns, and the filter that averages exactly one period of them.

A few rays a pixel are noisy.  Here each pixel of a square tile takes its own part of one large
low-discrepancy set, and a filter of the tile's size then averages the whole set at every pixel
(interleaved sampling, Keller and Heidrich 2001): smooth, and without a random number.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from implicit_warp.render.surface import Array

TILE = 8
"""Side of the tile in samples."""

# The plastic number's powers: the two-dimensional counterpart of the golden ratio.
_STEP = np.array([0.7548776662466927, 0.5698402909980532])


def ordered(side: int) -> NDArray[np.int64]:
    """Bayer's ordered matrix `(side, side)`, a power of two: neighbours get distant ranks."""
    ranks = np.zeros((1, 1), dtype=np.int64)
    while len(ranks) < side:
        ranks = np.block([[4 * ranks, 4 * ranks + 2], [4 * ranks + 3, 4 * ranks + 1]])
    return ranks


def in_tiles(pattern: Array, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> Array:
    """For each pixel its own part `(n, k, ...)` of a pattern `(tile * tile, k, ...)`.

    Together the pixels of any window of the tile's size hold the whole pattern.
    """
    tile = math.isqrt(len(pattern))
    return pattern[ordered(tile)[rows % tile, columns % tile]]


def unit_square(count: int, tile: int = TILE) -> NDArray[np.float64]:
    """A pattern of `count` points of the unit square for each pixel of a tile."""
    index = np.arange(1, tile * tile * count + 1)
    return ((0.5 + index[:, None] * _STEP) % 1.0).reshape(tile * tile, count, 2)


def cosine_lobe(square: NDArray[np.float64]) -> NDArray[np.float32]:
    """Unit vectors about (0, 0, 1) with density cos(angle) / pi, from points of the square."""
    radius, angle = np.sqrt(square[..., 0]), 2 * np.pi * square[..., 1]
    height = np.sqrt(1 - square[..., 0])
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1).astype(np.float32)


def cone(square: NDArray[np.float64], axis: Array, spread: float) -> NDArray[np.float32]:
    """Unit vectors towards a disc of radius `spread` at distance one along `axis` `(3,)`."""
    radius, angle = spread * np.sqrt(square[..., 0]), 2 * np.pi * square[..., 1]
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.ones_like(radius)], -1)
    return turned(disc, np.broadcast_to(axis, (len(disc), 3))).astype(np.float32) / np.sqrt(
        1 + radius[..., None] ** 2, dtype=np.float32
    )


def turned(local: Array, normals: Array) -> Array:
    """Vectors `(n, k, 3)` turned so that (0, 0, 1) becomes the unit normal `(n, 3)`.

    The frame varies smoothly with the normal (Duff et al. 2017, "Building an orthonormal basis,
    revisited"), so that neighbouring pixels share their pattern.
    """
    nx, ny, nz = normals.T
    sign = np.copysign(np.ones_like(nz), nz)
    a = -1.0 / (sign + nz)
    b = nx * ny * a
    first = np.stack([1 + sign * nx**2 * a, sign * b, -sign * nx], axis=1)
    second = np.stack([b, sign + ny**2 * a, -ny], axis=1)
    result = local[..., :1] * first[:, None]
    result += local[..., 1:2] * second[:, None]
    result += local[..., 2:] * normals[:, None]
    return result


def smooth_on_surface(
    values: NDArray[np.float32],
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    covered: NDArray[np.bool_],
    thickness: float,
) -> NDArray[np.float32]:
    """Average `values` `(h, w, c)` over one tile, but only along the same smooth surface.

    Two pixels belong together if each is `covered`, their normals `(h, w, 3)` agree and the offset
    of their positions `(h, w, 3)` leaves the tangent plane by less than `thickness`.  Rows
    first, then columns: the windows are one tile long in each direction.
    """
    for axis in (0, 1):
        total = np.where(covered[..., None], values, 0).astype(np.float32)
        weight = covered.astype(np.float32)
        for shift in range(-TILE // 2, TILE // 2):
            if shift == 0:
                continue
            here, there = _overlap(values.shape[axis], shift, axis)
            normal = normals[here]
            agree = np.einsum("hwi,hwi->hw", normal, normals[there])
            offset = np.einsum("hwi,hwi->hw", normal, positions[there] - positions[here])
            near = (agree > 0.9) & (np.abs(offset) < thickness) & covered[there] & covered[here]
            total[here] += near[..., None] * values[there]
            weight[here] += near
        values = total / np.maximum(weight, 1)[..., None]
    return values


def _overlap(length: int, shift: int, axis: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Index pairs such that element i of the first is element i + shift of the second."""
    first = slice(max(0, -shift), max(0, length - max(0, shift)))
    second = slice(max(0, shift), max(0, length - max(0, -shift)))
    before = (slice(None),) * axis
    return (*before, first), (*before, second)
