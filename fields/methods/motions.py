"""Rigid motions, scalings and other affine maps of fields."""

from __future__ import annotations

from typing import Self

from numpy.typing import ArrayLike

from fields import operations
from fields.base import FieldBase, derived


class Motions(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    def translate(self, offset: ArrayLike) -> Self:
        """Moved by a vector."""
        return derived(operations.translate, (self,), offset=offset)

    def rotate(self, rotation: float | ArrayLike, axis: str | ArrayLike = "z") -> Self:
        """Turned about the origin.

        Args:
            rotation: an angle in degrees, right-handed about `axis`; or a 3x3 rotation
                matrix R, which sends each point p of the field to R p.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any
                length. Not used with a matrix.

        Raises:
            InputError: the matrix is not a rotation to 1e-6, or the axis is zero.
        """
        return derived(operations.rotate, (self,), rotation=rotation, axis=axis)

    def orient(self, axis: str | ArrayLike) -> Self:
        """Turned about the origin by the shortest way that sends +z to `axis`.

        Args:
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any
                length. For "-z" it is the half turn about x.
        """
        return derived(operations.orient, (self,), axis=axis)

    def scale(self, factor: float | ArrayLike) -> Self:
        """Scaled about the origin.

        Args:
            factor: one positive factor, which keeps an exact field exact; or three,
                one an axis, which keeps the Lipschitz bound but not exactness.
        """
        return derived(operations.scale, (self,), factor=factor)

    def affine(self, linear: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Self:
        """Carried along by the map p -> M p + translation; values stay, distances do not.

        Use `rotate`, `scale` and `translate` where they say the same: they keep what is exact.

        Args:
            linear: M, a 3x3 matrix that may shear, stretch, turn and reflect.
            translation: `(3,)`.

        Raises:
            InputError: the matrix is singular.
        """
        return derived(operations.affine, (self,), linear=linear, translation=translation)
