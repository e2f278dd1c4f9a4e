"""Twist and taper in closed form, and what maps about an axis share.

An axial map works in coordinates (x, y, z) with z along its axis, measured from its origin.  What
it does along the axis happens on a range of z, and goes on beyond it so that the map is a
homeomorphism: a twist stops turning, a taper keeps its last factor, a bend (`bend`) goes straight.

The certificates of these maps are short proofs by hand, given in each class, from exact
comparisons of their parameters.  They speak about the formulas in exact arithmetic; the axis's
frame is a rotation up to rounding, which no sign here depends on.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from fields.arguments import interval, number, pair, positive
from fields.operations import axis_frame
from implicit_warp.affine import axis_vector
from implicit_warp.certificate import Certificate, as_region
from implicit_warp.errors import InputError
from implicit_warp.maps import Map

if TYPE_CHECKING:
    from fields import Field
    from implicit_warp.local_bounds import LocalBounds

ROUNDING = 1e-13
"""Relative widening of bounds from boxes in an axis's frame: some fifty roundings of 2^-53 each."""


class AxialMap(Map):
    """A map in coordinates whose third is along an axis; subclasses work in those coordinates.

    Args:
        axis: "x", "y", "z" or a vector.
        origin: (3,) a point of the axis, where z = 0.
        between: (low, high) range of z on which the map acts; None for all z.
        towards: a direction that the x coordinate is to follow, as far as it is perpendicular to
            the axis; any by default.

    Attributes:
        frame: (3, 3) a rotation with columns x, y and the axis.
        origin, between: as given.
    """

    def __init__(self, axis, origin, between, towards=None) -> None:
        origin = np.array([number(f"origin[{i}]", v) for i, v in enumerate(_three(origin))])
        self.between = None if between is None else interval("between", between)
        across = None if towards is None else axis_vector(towards)
        self.frame = torch.from_numpy(axis_frame(axis_vector(axis), across))
        self.origin = torch.from_numpy(origin)

    @abstractmethod
    def _local(self, p: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        """Images (n, 3) and Jacobians (n, 3, 3) of points in the axis's frame."""

    def _mapped(self, points: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        frame, origin = self.frame.to(points), self.origin.to(points)
        image, jacobian = self._local((points - origin) @ frame, inverse)
        return image @ frame.T + origin, frame @ jacobian @ frame.T

    def _forward(self, points: Tensor) -> Tensor:
        return self._mapped(points, False)[0]

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return self._mapped(points, False)

    def _inverse(self, points: Tensor) -> Tensor:
        return self._mapped(points, True)[0]

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return self._mapped(points, True)

    @abstractmethod
    def _stretch(self, corners: np.ndarray, inverse: bool) -> np.ndarray:
        """(n,) bounds on the Jacobian's norm on the hulls of corners (n, 8, 3), in the frame."""

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        return self._bounds(boxes, inverse=False)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return self._bounds(boxes, inverse=True)

    def _bounds(self, boxes: np.ndarray, inverse: bool) -> LocalBounds:
        from implicit_warp.local_bounds import ball_bounds, middle_and_half

        corners = self._corners(boxes)
        stretch = self._stretch(corners, inverse) * (1.0 + ROUNDING)
        centres, halves = middle_and_half(boxes)
        images = self._mapped(torch.from_numpy(centres), inverse)[0].numpy()
        # The image is computed with errors relative to the sizes of point and origin.
        size = np.linalg.norm(centres, axis=1) + np.linalg.norm(images, axis=1)
        size += 2.0 * float(self.origin.norm())
        radii = stretch * (np.linalg.norm(halves, axis=1) * (1.0 + ROUNDING) + ROUNDING * size)
        return ball_bounds(stretch, images, radii)

    def _corners(self, boxes: np.ndarray) -> np.ndarray:
        """(n, 8, 3) the corners of boxes in the axis's frame."""
        choice = np.indices((2, 2, 2)).reshape(3, 8)
        corners = np.stack([boxes[:, choice[i], i] for i in range(3)], -1)
        return (corners - self.origin.numpy()) @ self.frame.numpy()

    def _placed(self) -> dict[str, object]:
        """The arguments that place the operation of the same name on fields."""
        axis, origin = self.frame[:, 2].tolist(), self.origin.tolist()
        return {"axis": axis, "origin": origin, "between": self.between}

    def _proved(self, box: np.ndarray | None) -> Certificate:
        return Certificate(repr(self), True, region=as_region(box))

    def _described(self, *arguments: str) -> str:
        parts = [*arguments, f"axis={self.frame[:, 2].tolist()}", f"origin={self.origin.tolist()}"]
        if self.between is not None:
            parts.append(f"between={self.between}")
        return f"{type(self).__name__}({', '.join(parts)})"


class Twist(AxialMap):
    """Turn about an axis by an angle that grows along it.

    (x, y, z) -> (Q(a(z)) (x, y), z), with Q the rotation of the plane and a(z) = rate (z - low)
    where low <= z <= high, constant beyond; a(z) = rate z if it is not bounded.

    Every plane across the axis is turned as a whole, so the map is a homeomorphism for every
    continuous a, which is its certificate; its inverse is the twist back, and det J = 1.  There is
    no global Lipschitz constant: it grows with the distance r from the axis, as
    (s + sqrt(s^2 + 4)) / 2 with s = r |rate| in radians.

    Args:
        degrees: per unit of length, right-handed about the axis.
        axis: "x", "y", "z" or a vector.
        origin: (3,) a point of the axis, from which z is measured.
        between: (low, high) range of z along which the twist grows.

    Raises:
        InputError: a malformed argument.
    """

    def __init__(self, degrees, axis="z", origin=(0.0, 0.0, 0.0), between=None) -> None:
        super().__init__(axis, origin, between)
        self.degrees = number("degrees", degrees)

    def __repr__(self) -> str:
        return self._described(str(self.degrees))

    @property
    def lipschitz(self) -> tuple[float | None, float | None]:
        """None, None: the stretch grows without bound away from the axis (1 without a twist)."""
        return (None, None) if self.degrees else (1.0 + ROUNDING, 1.0 + ROUNDING)

    def _certify(self, box: np.ndarray | None) -> Certificate:
        return self._proved(box)

    def _pull_back(self, field: Field) -> Field:
        return field.twist(self.degrees, **self._placed())

    def _local(self, p: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        rate = math.radians(self.degrees) * (-1.0 if inverse else 1.0)
        x, y, z = p.unbind(-1)
        along, slope = along_range(z, self.between)
        cos, sin = (rate * along).cos(), (rate * along).sin()
        u, v = cos * x - sin * y, sin * x + cos * y
        zero, one = torch.zeros_like(z), torch.ones_like(z)
        rows = [cos, -sin, -rate * slope * v, sin, cos, rate * slope * u, zero, zero, one]
        return torch.stack([u, v, z], -1), torch.stack(rows, -1).unflatten(-1, (3, 3))

    def _stretch(self, corners: np.ndarray, inverse: bool) -> np.ndarray:
        # The distance from the axis is convex, so its maximum is at a corner; a twist keeps it.
        shear = abs(math.radians(self.degrees)) * _farthest(corners)
        shear = np.where(meets_range(corners, self.between), shear, 0.0)
        return 0.5 * (shear + np.hypot(shear, 2.0))


class Taper(AxialMap):
    """Scale across an axis by a factor that changes linearly along it.

    (x, y, z) -> (s(z) x, s(z) y, z), with s = factors[0] for z <= low, factors[1] for z >= high,
    and linear between.

    s is continuous and positive, since both factors are and no value between them is smaller; so
    every plane across the axis is scaled onto itself, and the map is a homeomorphism: that is its
    certificate.  det J = s^2.  There is no global Lipschitz constant unless the factors are equal:
    it grows with the distance from the axis, as s' does.

    Args:
        factors: (at low, at high), positive.
        axis: "x", "y", "z" or a vector.
        origin: (3,) a point of the axis, from which z is measured.
        between: (low, high) range of z along which the factor changes.

    Raises:
        InputError: a malformed argument, or a factor that is not positive.
    """

    def __init__(self, factors, axis="z", origin=(0.0, 0.0, 0.0), between=(0.0, 1.0)) -> None:
        super().__init__(axis, origin, interval("between", between))
        self.factors = pair("factors", factors, positive)

    def __repr__(self) -> str:
        return self._described(repr(self.factors))

    @property
    def lipschitz(self) -> tuple[float | None, float | None]:
        """None, None unless both factors are equal: the stretch grows away from the axis."""
        first, last = self.factors
        if first != last:
            return None, None
        return max(1.0, first) * (1.0 + ROUNDING), max(1.0, 1.0 / first) * (1.0 + ROUNDING)

    @property
    def _rate(self) -> float:
        return (self.factors[1] - self.factors[0]) / (self.between[1] - self.between[0])

    def _certify(self, box: np.ndarray | None) -> Certificate:
        return self._proved(box)

    def _pull_back(self, field: Field) -> Field:
        return field.taper(self.factors, **self._placed())

    def _factor(self, z):
        # As a mean of the two factors, so that rounding cannot take it beyond either.
        low, high = self.between
        share = ((z - low) / (high - low)).clip(0.0, 1.0)
        return (1.0 - share) * self.factors[0] + share * self.factors[1]

    def _local(self, p: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        x, y, z = p.unbind(-1)
        scale, slope = self._factor(z), self._rate * along_range(z, self.between)[1]
        if inverse:
            scale, slope = 1.0 / scale, -slope / (scale * scale)
        zero, one = torch.zeros_like(z), torch.ones_like(z)
        rows = [scale, zero, slope * x, zero, scale, slope * y, zero, zero, one]
        image = torch.stack([scale * x, scale * y, z], -1)
        return image, torch.stack(rows, -1).unflatten(-1, (3, 3))

    def _stretch(self, corners: np.ndarray, inverse: bool) -> np.ndarray:
        # J is s across, and [[s, s' r], [0, 1]] in the plane of axis and point; its norm grows
        # with s and |s' r|, each at most its value at a corner.
        at_corners = self._factor(corners[..., 2])
        slope = np.where(meets_range(corners, self.between), abs(self._rate), 0.0) * _farthest(
            corners
        )
        scale = at_corners.max(1)
        if inverse:
            scale = 1.0 / at_corners.min(1)
            slope = slope * scale * scale
        half = 0.5 * (np.hypot(scale + 1.0, slope) + np.hypot(scale - 1.0, slope))
        return np.maximum(scale, half)


def along_range(z: Tensor, between) -> tuple[Tensor, Tensor]:
    """How far z is along the range, and the derivative of that."""
    if between is None:
        return z, torch.ones_like(z)
    low, high = between
    inside = (z >= low) & (z <= high)
    return z.clamp(low, high) - low, inside.to(z.dtype)


def meets_range(corners: np.ndarray, between) -> np.ndarray:
    """(n,) may the hulls of corners (n, 8, 3) meet the range, rounding considered?"""
    if between is None:
        return np.ones(len(corners), bool)
    z = corners[..., 2]
    slack = ROUNDING * (1.0 + np.abs(corners).max((1, 2)) + max(abs(v) for v in between))
    return (z.max(1) + slack >= between[0]) & (z.min(1) - slack <= between[1])


def _farthest(corners: np.ndarray) -> np.ndarray:
    """(n,) the largest distance from the axis."""
    return np.hypot(corners[..., 0], corners[..., 1]).max(1) * (1.0 + ROUNDING)


def _three(origin):
    try:
        x, y, z = origin
    except (TypeError, ValueError) as error:
        raise InputError("origin", origin, "not three numbers", "pass (x, y, z)") from error
    return x, y, z
