"""Bend in closed form: the axis becomes an arc on a range, and goes on straight beyond it.

In the axis's frame, with x towards the inside of the bend, R = length / angle the radius of the
axis's arc, and C = (R, 0, low) its centre, a point at distance rho = R - x from C's line goes to

    C + rho (-cos phi, 0, sin phi) + (0, y, 0),    phi = (z - low) / R,      low <= z <= high,

stays where it is for z <= low, and for z >= high is moved as a rigid body.

A bend is no map of all space: at x >= R the arc's inside overlaps itself.  Its *domain* is

    rho > 0,    low - z < rho tan w,    z - high < rho tan w,    w = min(90, (360 - angle) / 2)

degrees (no condition on z where w is 90).  There it is injective: phi, continued by
-atan((low - z) / rho) below and angle + atan((z - high) / rho) above, is the polar angle of the
image about C's line.  It stays within (-w, angle + w), a span of at most a full turn, so it says
which of the three pieces a point comes from; and every piece is injective by itself, with
determinant rho / R > 0 on the arc and 1 beyond it.  The domain is an intersection of half spaces,
so a box lies in it if its corners do.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from fields.arguments import number
from implicit_warp.axial import ROUNDING, AxialMap, meets_range
from implicit_warp.certificate import Certificate, no_certificate
from implicit_warp.errors import InputError

if TYPE_CHECKING:
    from fields import Field
    from implicit_warp.local_bounds import LocalBounds


class Bend(AxialMap):
    """Bend an axis into an arc; injective, and defined, on one side of the arc's centre line.

    See the module for formula and domain.  det J = 1 - x / R on the arc, R = length / angle.

    Args:
        degrees: the whole angle, between -360 and 360 and not 0; negative bends away.
        axis: "x", "y", "z" or a vector.
        origin: (3,) a point of the axis, from which z is measured.
        between: (low, high) range of z that becomes the arc; its length is kept on the axis.
        towards: the direction to which the far end leans, as far as it is across the axis.

    Raises:
        InputError: a malformed argument; and on evaluation, a point outside of the domain, or for
            the inverse one that is not the image of any.
    """

    def __init__(
        self, degrees, axis="z", origin=(0.0, 0.0, 0.0), between=(0.0, 1.0), towards=None
    ) -> None:
        self.degrees = number("degrees", degrees)
        if not 0.0 < abs(self.degrees) < 360.0:
            raise InputError(
                "degrees",
                degrees,
                "a bend turns by more than nothing and less than a full turn",
                "pass an angle in degrees, or use iw.Affine() for the identity",
            )
        if between is None:
            raise InputError("between", None, "a bend needs a range", "pass (low, high)")
        super().__init__(axis, origin, between, towards)
        if self.degrees < 0.0:
            self.frame = self.frame * torch.tensor([-1.0, -1.0, 1.0], dtype=torch.float64)
        self._angle = math.radians(abs(self.degrees))
        self._curvature = self._angle / (self.between[1] - self.between[0])
        self._wedge = min(0.5 * math.pi, math.pi - 0.5 * self._angle)

    def __repr__(self) -> str:
        towards = math.copysign(1.0, self.degrees) * self.frame[:, 0]
        return self._described(str(self.degrees), f"towards={towards.tolist()}")

    def contains(self, points) -> np.ndarray:
        """(n,) which of the points (n, 3) lie in the domain."""
        return self._in_domain(self._to_frame(points)).numpy()

    def image_contains(self, points) -> np.ndarray:
        """(n,) which of the points (n, 3) are images of points of the domain."""
        return self._in_image(*self._polar(self._to_frame(points))).numpy()

    def _to_frame(self, points) -> Tensor:
        points = torch.as_tensor(points, dtype=torch.float64)
        return (points - self.origin) @ self.frame

    def _in_domain(self, p: Tensor) -> Tensor:
        x, _, z = p.unbind(-1)
        low, high = self.between
        inside = 1.0 - self._curvature * x > 0.0
        beyond = self._curvature * torch.maximum(low - z, z - high)
        if self._wedge < 0.5 * math.pi:
            inside &= beyond < (1.0 - self._curvature * x) * math.tan(self._wedge)
        return inside

    def _polar(self, p: Tensor) -> tuple[Tensor, Tensor]:
        """Polar angle about C's line, in (angle / 2 - pi, angle / 2 + pi], and rho / R."""
        x, _, z = p.unbind(-1)
        a, b = 1.0 - self._curvature * x, self._curvature * (z - self.between[0])
        # Measured from the middle of the arc, so that the cut is opposite to it.
        cos, sin = math.cos(0.5 * self._angle), math.sin(0.5 * self._angle)
        return torch.atan2(b * cos - a * sin, a * cos + b * sin) + 0.5 * self._angle, torch.hypot(
            a, b
        )

    def _in_image(self, phi: Tensor, rho: Tensor) -> Tensor:
        return (phi > -self._wedge) & (phi < self._angle + self._wedge) & (rho > 0.0)

    def _pull_back(self, field: Field) -> Field | None:
        if field.bounds is None:
            return None
        # The frame has x towards the inside already, whatever the sign of the angle.
        inside = self.frame[:, 0].tolist()
        return field.bend(abs(self.degrees), towards=inside, **self._placed())

    def _local(self, p: Tensor, inverse: bool) -> tuple[Tensor, Tensor]:
        return self._unbend(p) if inverse else self._bend(p)

    def _bend(self, p: Tensor) -> tuple[Tensor, Tensor]:
        _refuse(~self._in_domain(p), self, "lie outside of the bend's domain")
        x, y, z = p.unbind(-1)
        low, high = self.between
        k = self._curvature
        phi = k * (z.clamp(low, high) - low)
        beyond = z - z.clamp(low, high)
        cos, sin, half = phi.cos(), phi.sin(), (0.5 * phi).sin()
        # R (1 - cos phi) without cancellation.
        u = x * cos + 2.0 * half * half / k + beyond * sin
        w = low + sin / k - x * sin + beyond * cos
        stretch = torch.where(beyond == 0.0, 1.0 - k * x, torch.ones_like(x))
        return torch.stack([u, y, w], -1), _turned(cos, sin, stretch)

    def _unbend(self, p: Tensor) -> tuple[Tensor, Tensor]:
        phi, rho = self._polar(p)
        _refuse(~self._in_image(phi, rho), self, "are no images under the bend")
        u, y, w = p.unbind(-1)
        low, high = self.between
        k = self._curvature
        on_arc = (phi >= 0.0) & (phi <= self._angle)
        # On the arc x = (1 - rho) / k, here without cancellation for weak bends.
        arc_x = (2.0 * u - k * u * u - k * (w - low) ** 2) / (1.0 + rho)
        # Beyond its end, turn back about the centre.
        cos, sin = math.cos(self._angle), math.sin(self._angle)
        half = math.sin(0.5 * self._angle)
        du, dw = u - 2.0 * half * half / k, w - low - sin / k
        end_x, end_z = cos * du - sin * dw, high + sin * du + cos * dw
        above = phi > self._angle
        x = torch.where(on_arc, arc_x, torch.where(above, end_x, u))
        z = torch.where(on_arc, low + phi / k, torch.where(above, end_z, w))
        turn = phi.clamp(0.0, self._angle)
        # J = rotation x stretch along the axis, so J^-1 = (rotation x inverse stretch)^T.
        shrink = 1.0 / torch.where(on_arc, rho, torch.ones_like(rho))
        jacobian = _turned(turn.cos(), turn.sin(), shrink).transpose(-1, -2)
        return torch.stack([x, y, z], -1), jacobian

    def _certify(self, box: np.ndarray | None) -> Certificate:
        return self._certified(box, inverse=False)

    def _certify_inverse(self, box: np.ndarray | None) -> Certificate:
        return self._certified(box, inverse=True)

    def _certified(self, box: np.ndarray | None, inverse: bool) -> Certificate:
        map_ = self.inv if inverse else self
        if box is None:
            cause = "a bend is injective on one side of its centre line only; name a box"
            return no_certificate(map_, cause, box)
        if not np.isfinite(box).all() or not self._reach(self._corners(box[None]), inverse)[0][0]:
            what = "image" if inverse else "domain"
            return no_certificate(map_, f"the box is not within the bend's {what}", box)
        return self._proved(box)

    def _bounds(self, boxes: np.ndarray, inverse: bool) -> LocalBounds:
        inside, _ = self._reach(self._corners(boxes), inverse)
        if not inside.all():
            first = int(np.flatnonzero(~inside)[0])
            raise InputError(
                "boxes",
                boxes[first].tolist(),
                f"box {first} is not within the bend's {'image' if inverse else 'domain'}",
                "keep to one side of the bend's centre line",
            )
        return super()._bounds(boxes, inverse)

    def _stretch(self, corners: np.ndarray, inverse: bool) -> np.ndarray:
        _, factor = self._reach(corners, inverse)
        return np.maximum(1.0, factor)

    def _reach(self, corners: np.ndarray, inverse: bool) -> tuple[np.ndarray, np.ndarray]:
        """(n,) do the hulls of corners (n, 8, 3) lie in the domain (or image), with a margin for
        rounding; and (n,) the largest stretch on the arc."""
        size = 1.0 + self._curvature * (np.abs(corners).max((1, 2)) + abs(self.between[0]))
        slack = ROUNDING * size
        a = 1.0 - self._curvature * corners[..., 0]
        low, high = self.between
        if not inverse:
            beyond = self._curvature * np.maximum(low - corners[..., 2], corners[..., 2] - high)
            inside = a.min(1) > slack
            if self._wedge < 0.5 * math.pi:
                tangent = math.tan(self._wedge)
                inside &= (a * tangent - beyond).min(1) > slack * (1.0 + tangent)
            return inside, np.where(meets_range(corners, self.between), a.max(1) + slack, 1.0)
        # The hull's polar angles are those of its corners, if a line through C leaves it on one
        # side; so does the line across the direction to its middle, or nothing is claimed.
        b = self._curvature * (corners[..., 2] - low)
        mean_a, mean_b = a.mean(1, keepdims=True), b.mean(1, keepdims=True)
        length = np.maximum(np.hypot(mean_a, mean_b), np.finfo(np.float64).tiny)
        ahead = (a * mean_a + b * mean_b) / length
        nearest = ahead.min(1) - slack
        sure = nearest > 0.0
        turned = np.arctan2(b * mean_a - a * mean_b, a * mean_a + b * mean_b)
        half = 0.5 * self._angle
        cos, sin = math.cos(half), math.sin(half)
        middle = np.arctan2(mean_b * cos - mean_a * sin, mean_a * cos + mean_b * sin) + half
        angles = middle + turned
        spare = slack / np.where(sure, nearest, 1.0)
        first, last = angles.min(1) - spare, angles.max(1) + spare
        sure &= (first > -self._wedge) & (last < self._angle + self._wedge)
        on_arc = sure & (last >= 0.0) & (first <= self._angle)
        return sure, 1.0 / np.where(on_arc, nearest, 1.0)


def _turned(cos: Tensor, sin: Tensor, stretch: Tensor) -> Tensor:
    """Rotations in the plane of x and z, after a stretch along the axis."""
    zero, one = torch.zeros_like(cos), torch.ones_like(cos)
    rows = [cos, zero, sin * stretch, zero, one, zero, -sin, zero, cos * stretch]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def _refuse(outside: Tensor, bend: Bend, cause: str) -> None:
    if bool(outside.any()):
        rows = outside.nonzero().squeeze(-1)
        raise InputError(
            "points",
            f"{len(rows)} of {len(outside)} rows, the first is row {int(rows[0])}",
            f"they {cause}",
            f"keep to one side of the centre line of {bend!r}; `contains` tells",
        )
