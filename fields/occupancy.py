"""Marked voxels, such as segmented medical volumes, as fields."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.errors import InputError
from fields.field import Field
from fields.grid import grid


def from_occupancy(
    mask: ArrayLike, *, spacing: float | ArrayLike = 1.0, origin: ArrayLike = (0.0, 0.0, 0.0)
) -> Field:
    """The solid made of marked voxels: signed distances at their middles, and linear in between.

    Voxels are boxes, and the distances are exact Euclidean ones to the surface of the union of the
    marked ones, so two middles on either side of a face have values of half the spacing and the
    field is zero on the face between them. Voxels beyond the array count as not marked.

    Not exact: linear interpolation rounds off the steps at edges and corners, which is what makes
    the surface of a segmentation usable.

    Args:
        mask: `(nx, ny, nz)`, booleans; of labels, pass `labels == 3`.
        spacing: edges of a voxel; one number, or three.
        origin: `(3,)`, the middle of the first voxel.

    Raises:
        InputError: the mask has another shape or kind, or marks nothing.
    """
    marks = np.asarray(mask)
    if marks.dtype != np.bool_ or marks.ndim != 3 or marks.size == 0:
        raise InputError(
            "mask",
            f"{marks.dtype} {marks.shape}",
            "marks are booleans in an array with three axes",
            "pass `volume > threshold` or `labels == number`",
        )
    if not marks.any():
        raise InputError("mask", marks.shape, "no voxel is marked", "check the label or threshold")
    step = np.array(arguments.numbers_or_one("spacing", spacing))
    first = np.array(arguments.vector("origin", origin))
    from fields.kernels.distance_transform import squared_distances

    marks = np.pad(marks, 2)  # so that the surface is closed, and off the walls
    outside = np.sqrt(squared_distances(marks, step))
    inside = np.sqrt(squared_distances(~marks, step))
    return grid(np.where(marks, -inside, outside), spacing=step, origin=first - 2 * step)
