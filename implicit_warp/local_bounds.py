"""What a map does to boxes, as every kind of map reports it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from implicit_warp.errors import InputError

_U = 2.0**-53


@dataclass(frozen=True)
class LocalBounds:
    """What a map does to each of n boxes.

    Attributes:
        lipschitz: (n,) bounds on the spectral norm of the Jacobian, hence Lipschitz constants of
            the map on the box.
        centres: (n, 3) the images of the boxes' centres, to rounding.
        radii: (n,) the image of a box lies in the ball of this radius about its centre's image.
        boxes: (n, 2, 3) axis-aligned boxes that hold the images.
    """

    lipschitz: NDArray[np.float64]
    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    boxes: NDArray[np.float64]


def checked_boxes(boxes) -> NDArray[np.float64]:
    """Boxes (n, 2, 3) as float64.

    Raises:
        InputError: another shape, values that are not finite, or a low corner above the high one.
    """
    try:
        array = np.asarray(boxes, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("boxes", boxes, "not numbers", "pass corners (n, 2, 3)") from error
    if array.ndim != 3 or array.shape[1:] != (2, 3):
        raise InputError(
            "boxes", array.shape, "this is the shape", "pass low and high corners as (n, 2, 3)"
        )
    if not np.isfinite(array).all():
        raise InputError("boxes", array.shape, "not all corners are finite", "bound the boxes")
    wrong = np.flatnonzero((array[:, 0] > array[:, 1]).any(1))
    if len(wrong):
        raise InputError(
            "boxes",
            array[wrong[0]].tolist(),
            f"the low corner of box {wrong[0]} is above the high one",
            "pass (low, high)",
        )
    return np.ascontiguousarray(array)


def middle_and_half(boxes: NDArray[np.float64]) -> tuple[NDArray, NDArray]:
    """Centres (n, 3) and half lengths (n, 3) of boxes, the latter rounded up to cover them."""
    centres = 0.5 * boxes[:, 0] + 0.5 * boxes[:, 1]
    halves = np.maximum(boxes[:, 1] - centres, centres - boxes[:, 0])
    return centres, halves * (1.0 + 4.0 * _U)


def ball_bounds(lipschitz, centres, radii) -> LocalBounds:
    """Local bounds whose boxes are those of the balls, rounded outwards."""
    reach = (radii * (1.0 + 4.0 * _U))[:, None] + 4.0 * _U * np.abs(centres)
    return LocalBounds(lipschitz, centres, radii, np.stack([centres - reach, centres + reach], 1))
