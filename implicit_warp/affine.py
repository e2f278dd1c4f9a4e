"""Affine maps: rigid motions, similarities and any other with positive determinant."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from fields.arguments import direction
from implicit_warp.certificate import Certificate, as_region
from implicit_warp.errors import InputError
from implicit_warp.layers import invert_affine
from implicit_warp.maps import Map

if TYPE_CHECKING:
    from fields import Field
    from implicit_warp.layer_geometry import Transitions
    from implicit_warp.local_bounds import LocalBounds


class Affine(Map):
    """The map x -> L x + t.

    Args:
        linear: (3, 3) with positive determinant.
        translation: (3,).

    Raises:
        InputError: another shape, values not finite, or a determinant that is not positive.
    """

    def __init__(self, linear=None, translation=(0.0, 0.0, 0.0)) -> None:
        linear = _array("linear", np.eye(3) if linear is None else linear, (3, 3))
        translation = _array("translation", translation, (3,))
        from implicit_warp.orientation import determinant_signs

        signs, self._orientation = determinant_signs(linear[None])
        if signs[0] <= 0:
            raise InputError(
                "linear",
                linear.tolist(),
                f"its determinant {np.linalg.det(linear):.3g} is not positive, so the map is "
                "singular or mirrors space",
                "check for a zero scale or an odd number of negative ones",
            )
        self.matrix = torch.from_numpy(np.concatenate([linear, translation[:, None]], 1))
        self._inverse_matrix = invert_affine(self.matrix)

    @classmethod
    def from_matrix(cls, matrix) -> Affine:
        """From a (3, 4) or homogeneous (4, 4) matrix."""
        matrix = np.asarray(matrix, dtype=np.float64)
        if matrix.shape == (4, 4):
            if not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0, atol=1e-12):
                raise InputError(
                    "matrix",
                    matrix[3].tolist(),
                    "the last row of a homogeneous matrix must be 0 0 0 1",
                    "transpose it if it was written for row vectors",
                )
            matrix = matrix[:3]
        matrix = _array("matrix", matrix, (3, 4))
        return cls(matrix[:, :3], matrix[:, 3])

    @property
    def lipschitz(self) -> tuple[float, float]:
        """The largest singular value, and the inverse of the smallest, rounded upwards."""
        return tuple(float(maps.norm[0]) for maps in self._bounded)

    def __repr__(self) -> str:
        return f"Affine({self.matrix[:, :3].tolist()}, {self.matrix[:, 3].tolist()})"

    def _certify(self, box: np.ndarray | None) -> Certificate:
        forward, backward = self.lipschitz
        return Certificate(
            repr(self),
            True,
            region=as_region(box),
            by_filter=self._orientation.by_filter,
            exactly=self._orientation.exactly,
            singular_values=((1.0 / backward, forward),),
        )

    def _pull_back(self, field: Field) -> Field:
        return field.affine(self.matrix[:, :3].tolist(), self.matrix[:, 3].tolist())

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        return _affine_bounds(self._bounded[0], boxes)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return _affine_bounds(self._bounded[1], boxes)

    @cached_property
    def _bounded(self) -> tuple[Transitions, Transitions]:
        from implicit_warp.layer_geometry import bounded_affine

        there, back = self.matrix[None].numpy(), self._inverse_matrix[None].numpy()
        return bounded_affine(there), bounded_affine(there, back)

    def _forward(self, points: Tensor) -> Tensor:
        return _apply(self.matrix, points)[0]

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return _apply(self.matrix, points)

    def _inverse(self, points: Tensor) -> Tensor:
        return _apply(self._inverse_matrix, points)[0]

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return _apply(self._inverse_matrix, points)


def rigid_motion(
    rotate=None, translate=(0.0, 0.0, 0.0), pivot=(0.0, 0.0, 0.0), matrix=None
) -> Affine:
    """A rigid motion: turn about an axis through the pivot, then translate.

    Args:
        rotate: (axis, degrees), the axis "x", "y", "z" or a vector of three numbers; right-handed.
        translate: (3,) in the user's units.
        pivot: (3,) a point that the rotation keeps.
        matrix: instead of all the others, a rigid (3, 4) or (4, 4) matrix.

    Raises:
        InputError: an argument is malformed, or the matrix is not rigid (to 1e-6).
    """
    if matrix is not None:
        if rotate is not None or np.any(translate) or np.any(pivot):
            raise InputError(
                "matrix",
                matrix,
                "a matrix already holds the whole motion",
                "pass either the matrix or rotate, translate and pivot",
            )
        motion = Affine.from_matrix(matrix)
        linear = motion.matrix[:, :3].numpy()
        if not np.allclose(linear @ linear.T, np.eye(3), rtol=0, atol=1e-6):
            raise InputError(
                "matrix",
                linear.tolist(),
                "its 3x3 part is not a rotation: R R^T differs from the identity by more than 1e-6",
                "normalise it; handles move rigidly",
            )
        return motion
    translate = _array("translate", translate, (3,))
    pivot = _array("pivot", pivot, (3,))
    rotation = np.eye(3) if rotate is None else rotation_matrix(*_axis_and_angle(rotate))
    return Affine(rotation, pivot - rotation @ pivot + translate)


def rotation_matrix(axis, degrees: float) -> np.ndarray:
    """The (3, 3) right-handed rotation by an angle in degrees about an axis (Rodrigues)."""
    unit = axis_vector(axis)
    if not math.isfinite(degrees):
        raise InputError("rotate", degrees, "the angle is not finite", "give degrees")
    angle = math.radians(degrees)
    x, y, z = unit
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)


def axis_vector(axis) -> np.ndarray:
    """The unit vector of an axis given by name or as three numbers."""
    if isinstance(axis, str) and axis not in ("x", "y", "z"):
        raise InputError("axis", axis, "no axis of that name", 'use "x", "y", "z" or a vector')
    return np.array(direction("axis", axis))


def _axis_and_angle(rotate):
    try:
        axis, degrees = rotate
        return axis, float(degrees)
    except (TypeError, ValueError) as error:
        raise InputError(
            "rotate", rotate, "not a pair of axis and angle", 'pass e.g. ("z", 60), in degrees'
        ) from error


def _array(argument: str, value, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(argument, value, "not numbers", f"pass shape {shape}") from error
    if array.shape != shape:
        raise InputError(argument, value, f"shape {array.shape}", f"pass shape {shape}")
    if not np.isfinite(array).all():
        raise InputError(argument, value, "not finite", "look for a division by zero")
    return array


def _affine_bounds(maps: Transitions, boxes: np.ndarray) -> LocalBounds:
    from implicit_warp.local_bounds import LocalBounds, middle_and_half

    centres, halves = middle_and_half(boxes)
    linear, offset, norm = maps.matrix[0, :, :3], maps.matrix[0, :, 3], float(maps.norm[0])
    unit = 2.0**-53
    images = centres @ linear.T + offset
    off = (float(maps.error[0]) + 16.0 * unit * norm) * np.linalg.norm(centres, axis=1)
    off += float(maps.offset_error[0]) + 8.0 * unit * np.abs(images).sum(1)
    reach = np.linalg.norm(halves, axis=1) * (1.0 + 8.0 * unit)
    across = halves @ np.abs(linear).T * (1.0 + 8.0 * unit) + float(maps.error[0]) * reach[:, None]
    across += off[:, None]
    image_boxes = np.stack([images - across, images + across], 1)
    return LocalBounds(np.full(len(boxes), norm), images, norm * reach + off, image_boxes)


def _apply(matrix: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
    matrix = matrix.to(points)
    linear = matrix[:, :3]
    # A Jacobian of its own for every point: callers may write to them.
    return points @ linear.T + matrix[:, 3], linear.repeat(len(points), 1, 1)
