"""A pinhole camera, and the closest one that holds what is to be shown."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields.arguments import Vector, box_bounds, number, vector
from fields.arguments import direction as unit_direction
from implicit_warp.errors import InputError

DEFAULT_DIRECTION = (0.75, -1.1, 0.62)
"""From the target to the eye: from the front, a little to the right and above."""

DEFAULT_SIZE = (960, 720)

NEAREST = 0.05
"""How near a fitted camera may come to a point, as a fraction of the shape's radius."""


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with square pixels.

    Args:
        eye: where the camera is, in the units of the mesh.
        target: the point it looks at; it appears in the middle of the picture.
        up: which way is up in the world; the ground under the mesh is perpendicular to it.  If
            the camera looks along it, another axis is taken as the picture's vertical.
        fov: the vertical field of view in degrees, between 0 and 180.

    Raises:
        InputError: `eye` equals `target`, `up` is zero, or `fov` is out of range.
    """

    eye: Vector
    target: Vector
    up: Vector = (0.0, 0.0, 1.0)
    fov: float = 28.0

    def __post_init__(self) -> None:
        for name in ("eye", "target", "up"):
            object.__setattr__(self, name, vector(name, getattr(self, name)))
        object.__setattr__(self, "fov", _field_of_view(self.fov))
        if np.linalg.norm(np.subtract(self.eye, self.target)) == 0:
            raise InputError("eye", self.eye, "it is the target", "move the camera away from it")
        if np.linalg.norm(self.up) == 0:
            raise InputError("up", self.up, "a zero vector points nowhere", "pass (0, 0, 1)")

    @classmethod
    def fit(
        cls,
        bounds: ArrayLike,
        *,
        direction: Vector | str = DEFAULT_DIRECTION,
        size: tuple[int, int] = DEFAULT_SIZE,
        up: Vector = (0.0, 0.0, 1.0),
        fov: float = 28.0,
        margin: float = 0.08,
    ) -> Camera:
        """The closest camera that sees the whole of a box.

        Args:
            bounds: the box `(2, 3)`, rows minimum and maximum.
            direction: from the target to the eye; three numbers or an axis such as "-y".
            size: width and height of the picture in pixels; only their ratio matters.
            up: as in `Camera`.
            fov: as in `Camera`.
            margin: the fraction of the picture to leave free on each side, below 0.5.

        Raises:
            InputError: an unusable box, direction, size or margin.
        """
        return cls.fit_points(
            box_corners(box_bounds("bounds", bounds)),
            direction=direction,
            size=size,
            up=up,
            fov=fov,
            margin=margin,
        )

    @classmethod
    def fit_points(
        cls,
        points: ArrayLike,
        *,
        direction: Vector | str = DEFAULT_DIRECTION,
        size: tuple[int, int] = DEFAULT_SIZE,
        up: Vector = (0.0, 0.0, 1.0),
        fov: float = 28.0,
        margin: float = 0.08,
    ) -> Camera:
        """The closest camera that sees every one of the points `(n, 3)`; else like `fit`.

        Each side of the view is a plane through the eye.  A point is inside the right one if
        `x + t z <= x_eye + t z_eye`, with `x, y, z` along the camera's right, up and backward
        axes and `t` the tangent of half the opening; the largest left-hand side of each of the
        four planes decides, so the answer is exact and needs no search.  Only with a wide
        opening can a point come nearer to the eye than a twentieth of the shape's radius; then
        the camera steps back to that distance.
        """
        cloud = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if len(cloud) == 0 or not np.isfinite(cloud).all():
            raise InputError("points", points, "no points, or not finite", "pass a real shape")
        if not 0 <= number("margin", margin) < 0.5:
            raise InputError("margin", margin, "not in [0, 0.5)", "0.08 leaves a calm border")
        width, height = picture_size(size)
        middle = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
        radius = float(np.linalg.norm(cloud - middle, axis=1).max())
        if radius == 0:
            raise InputError("points", points, "all of them are one point", "pass a real shape")
        away = np.array(unit_direction("direction", direction))
        axes = cls(tuple(middle + away), tuple(middle), up, fov).axes()
        # In units of the radius, so that neither huge nor tiny shapes lose digits.
        local = (cloud - middle) / radius @ axes.T
        tangent = np.array([width / height, 1.0]) * _tangent(fov) * (1 - 2 * margin)
        reach = tangent * local[:, 2:]
        high = (local[:, :2] + reach).max(axis=0)
        low = (-local[:, :2] + reach).max(axis=0)
        distances = (high + low) / (2 * tangent)
        depth = max(float(distances.max()), float(local[:, 2].max()) + NEAREST)
        eye = middle + radius * (axes.T @ [*((high - low) / 2), depth])
        target = eye - radius * depth * axes[2]
        return cls(tuple(eye), tuple(target), up, fov)

    def axes(self) -> NDArray[np.float64]:
        """The camera's right, up and backward unit vectors, as rows `(3, 3)`."""
        back = np.subtract(self.eye, self.target)
        back = back / np.linalg.norm(back)
        right = np.cross(self.up, back)
        if np.linalg.norm(right) < 1e-6 * np.linalg.norm(self.up):
            # Looking along `up`: the axis that is most across the view is as good as any.
            right = np.cross(np.eye(3)[np.abs(back).argmin()], back)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(back, right), back])

    def directions(
        self, columns: NDArray[np.float64], rows: NDArray[np.float64], size: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Unit vectors `(..., 3)` from the eye through positions in the picture.

        Positions are in pixels from the upper left corner of the picture.
        """
        width, height = size
        scale = 2 * _tangent(self.fov) / height
        across = (columns - width / 2) * scale
        upward = (height / 2 - rows) * scale
        right, up, back = self.axes()
        rays = across[..., None] * right + upward[..., None] * up - back
        return rays / np.linalg.norm(rays, axis=-1, keepdims=True)

    def project(self, points: ArrayLike, size: tuple[int, int]) -> NDArray[np.float64]:
        """Where points `(..., 3)` appear: column and row in pixels `(..., 2)`.

        Points behind the camera give NaN.
        """
        width, height = size
        local = (np.asarray(points, dtype=np.float64) - self.eye) @ self.axes().T
        depth = np.where(local[..., 2] < 0, -local[..., 2], np.nan)
        scale = height / (2 * _tangent(self.fov)) / depth
        columns, rows = width / 2 + local[..., 0] * scale, height / 2 - local[..., 1] * scale
        return np.stack([columns, rows], axis=-1)


def box_corners(box: NDArray[np.float64]) -> NDArray[np.float64]:
    """The eight corners `(8, 3)` of a box `(2, 3)`."""
    return np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)


def picture_size(size: tuple[int, int]) -> tuple[int, int]:
    """A width and height in pixels that a picture can have, or an error."""
    whole = isinstance(size, tuple | list) and len(size) == 2
    if not whole or not all(isinstance(n, int | np.integer) and 16 <= n <= 16384 for n in size):
        raise InputError(
            "size", size, "not a width and height of 16 to 16384 pixels", "pass (960, 720)"
        )
    return int(size[0]), int(size[1])


def _tangent(fov: float) -> float:
    return math.tan(math.radians(fov) / 2)


def _field_of_view(fov: float) -> float:
    if not 0 < number("fov", fov) < 180:
        raise InputError("fov", fov, "not an angle between 0 and 180 degrees", "28 looks natural")
    return float(fov)
