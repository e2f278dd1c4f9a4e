"""Bounds of a field on boxes: interval arithmetic, and the Lipschitz bound if there is one."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, DTypeLike, NDArray

from fields.errors import InputError
from fields.oracle import Boxes
from fields.tape import Tape

ASSUMED = 1024.0
"""Where a Lipschitz bound is used, values are taken to be computed within so many epsilon of the
dtype, relative to the largest coordinate or value on the box, if nothing better is proved. (Nothing
is where a `where_negative` is undecided: a rounding may then take the wrong branch, which changes
little if the field is continuous, but intervals do not know that.)"""


def bounds_on_boxes(
    tape: Tape, lipschitz: float | None, boxes: ArrayLike, dtype: DTypeLike
) -> NDArray[np.float64]:
    """Low, high and error `(..., 3)` on boxes `(..., 2, 3)`; see `Field.enclose`.

    With a Lipschitz bound L, exact values are within L * r of the exact value at the centre, r
    being half of the box's diagonal; computed ones are within the box's error of exact ones, or
    within what is assumed of it, whichever is less.
    """
    checked = _checked(boxes)
    kind = checked_dtype(dtype)
    flat = checked.reshape(-1, 2, 3)
    found = tape.compiled.bounds(flat, kind)
    if lipschitz is not None:
        finite = np.isfinite(flat).all(axis=(1, 2))
        found[finite] = _tightened(tape, lipschitz, flat[finite], kind, found[finite])
    return found.reshape(*checked.shape[:-2], 3)


def _tightened(
    tape: Tape, lipschitz: float, boxes: Boxes, dtype: np.dtype, found: NDArray[np.float64]
) -> NDArray[np.float64]:
    centres = 0.5 * boxes.sum(axis=1)
    halves = np.maximum(boxes[:, 1] - centres, centres - boxes[:, 0])
    reach = lipschitz * np.linalg.norm(halves, axis=1) * (1 + 1e-12)
    at = tape.compiled.values(torch.from_numpy(centres)).numpy()
    largest = np.maximum(np.abs(at) + reach, np.abs(boxes).max(axis=(1, 2)))
    error = np.minimum(found[:, 2], ASSUMED * np.finfo(dtype).eps * largest)
    with np.errstate(invalid="ignore"):  # infinity - infinity, which fmax and fmin pass over
        margin = reach + error + ASSUMED * np.finfo(np.float64).eps * largest
        low = np.fmax(found[:, 0], at - margin)
        high = np.fmin(found[:, 1], at + margin)
    return np.stack([low, high, error], axis=1)


def checked_dtype(dtype: DTypeLike) -> np.dtype:
    """float32 or float64."""
    try:
        kind = np.dtype(dtype)
    except TypeError:
        kind = np.dtype(object)
    if kind not in (np.float32, np.float64):
        raise InputError(
            "dtype", dtype, "fields are evaluated in float32 or float64", "pass one of the two"
        )
    return kind


def _checked(boxes: ArrayLike) -> Boxes:
    try:
        result = np.array(boxes, dtype=np.float64)
    except (TypeError, ValueError):
        result = np.empty(0)
    if (
        result.ndim < 2
        or result.shape[-2:] != (2, 3)
        or not (result[..., 0, :] <= result[..., 1, :]).all()
    ):
        raise InputError(
            "boxes",
            boxes,
            "a box is two rows of three numbers, minimum first, none of them NaN",
            "pass an array of shape (..., 2, 3)",
        )
    return result
