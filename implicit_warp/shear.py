"""Shear in closed form: planes across an axis slide over each other."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from fields.arguments import number
from implicit_warp.axial import ROUNDING, AxialMap, along_range, meets_range
from implicit_warp.certificate import Certificate

if TYPE_CHECKING:
    from fields import Field


class Shear(AxialMap):
    """Slide planes across an axis by a distance that grows along it.

    (x, y, z) -> (x + slope a(z), y, z), a(z) = z - low where low <= z <= high, constant beyond;
    a(z) = z if it is not bounded.

    Every plane across the axis is moved as a whole and within itself, so the map is a homeomorphism
    for every continuous a, which is its certificate; its inverse is the shear by -slope, and
    det J = 1.  Both have the Lipschitz constant (s + sqrt(s^2 + 4)) / 2, s = |slope|: the larger
    singular value of [[1, s], [0, 1]].

    Args:
        slope: distance slid per unit of length along the axis.
        axis: "x", "y", "z" or a vector.
        towards: the direction of sliding, as far as it is across the axis.
        origin: (3,) a point of the axis, from which z is measured.
        between: (low, high) range of z along which the distance grows.

    Raises:
        InputError: a malformed argument.
    """

    def __init__(self, slope, axis="z", towards="x", origin=(0.0, 0.0, 0.0), between=None) -> None:
        super().__init__(axis, origin, between, towards)
        self.slope = number("slope", slope)

    def __repr__(self) -> str:
        return self._described(str(self.slope), f"towards={self.frame[:, 0].tolist()}")

    @property
    def lipschitz(self) -> tuple[float | None, float | None]:
        """The constant above, for both directions."""
        constant = 0.5 * (abs(self.slope) + math.hypot(self.slope, 2.0)) * (1.0 + ROUNDING)
        return constant, constant

    def _certify(self, box: np.ndarray | None) -> Certificate:
        return self._proved(box)

    def _pull_back(self, field: Field) -> Field:
        return field.shear(self.slope, towards=self.frame[:, 0].tolist(), **self._placed())

    def _local(self, p: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        rate = -self.slope if inverse else self.slope
        x, y, z = p.unbind(-1)
        along, grows = along_range(z, self.between)
        zero, one = torch.zeros_like(z), torch.ones_like(z)
        rows = [one, zero, rate * grows, zero, one, zero, zero, zero, one]
        image = torch.stack([x + rate * along, y, z], -1)
        return image, torch.stack(rows, -1).unflatten(-1, (3, 3))

    def _stretch(self, corners: np.ndarray, inverse: bool) -> np.ndarray:
        return np.where(meets_range(corners, self.between), self.lipschitz[0], 1.0)
