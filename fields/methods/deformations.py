"""Twist, taper, shear and bends.

The maps of the same names in `implicit_warp` have the same parameters, and `deform` by one of them
gives the same field; as maps they also carry meshes and points. All are injective: a bend where it
is defined, and it refuses other shapes. `bend_radial` is no map.
"""

from __future__ import annotations

from typing import Self

from numpy.typing import ArrayLike

from fields import deformations
from fields.base import FieldBase, derived

_ORIGIN = (0.0, 0.0, 0.0)


class Deformations(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    def twist(
        self,
        degrees: float,
        axis: str | ArrayLike = "z",
        origin: ArrayLike = _ORIGIN,
        between: ArrayLike | None = None,
    ) -> Self:
        """Turned about an axis by an angle that grows along it. Not exact.

        Args:
            degrees: per unit of length, right-handed about the axis.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.
            origin: `(3,)`, a point of the axis, where the angle is zero.
            between: (low, high), measured along the axis from the origin: the angle grows from
                zero on this range and stays as it is beyond; None for everywhere.

        Returns:
            The twisted field. Its Lipschitz bound is the field's times (s + sqrt(s^2 + 4)) / 2,
            s = r times the rate in radians, r a little more than the farthest that the bounds
            reach from the axis; without bounds across the axis there is none.
        """
        return derived(
            deformations.twist, (self,), degrees=degrees, axis=axis, origin=origin, between=between
        )

    def taper(
        self,
        factors: ArrayLike,
        axis: str | ArrayLike = "z",
        origin: ArrayLike = _ORIGIN,
        between: ArrayLike = (0.0, 1.0),
    ) -> Self:
        """Scaled across an axis by a factor that changes linearly along it. Not exact.

        Args:
            factors: at the low and at the high end of the range, positive.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.
            origin: `(3,)`, a point of the axis.
            between: (low, high), measured along the axis from the origin; beyond it the factors
                stay as they are.
        """
        return derived(
            deformations.taper, (self,), factors=factors, axis=axis, origin=origin, between=between
        )

    def shear(
        self,
        slope: float,
        axis: str | ArrayLike = "z",
        towards: str | ArrayLike = "x",
        origin: ArrayLike = _ORIGIN,
        between: ArrayLike | None = None,
    ) -> Self:
        """Planes across an axis slid over each other, by a distance that grows along it. Not exact.

        Args:
            slope: distance slid per unit of length along the axis.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.
            towards: the direction to which the planes slide, as far as it is across the axis.
            origin: `(3,)`, a point of the plane that stays.
            between: (low, high), measured along the axis from the origin: planes on this range
                slide, those beyond it go along; None for everywhere.
        """
        return derived(
            deformations.shear,
            (self,),
            slope=slope,
            axis=axis,
            towards=towards,
            origin=origin,
            between=between,
        )

    def bend(
        self,
        degrees: float,
        axis: str | ArrayLike = "z",
        origin: ArrayLike = _ORIGIN,
        between: ArrayLike = (0.0, 1.0),
        towards: str | ArrayLike | None = None,
    ) -> Self:
        """An axis bent into an arc on a range, and straight beyond it. Not exact.

        Values up to half of the clearance, the distance between the field's bounds and the arc's
        line of centres, are those of the bent field; larger ones are cut off there.

        Args:
            degrees: the whole angle, between -360 and 360 and not 0; negative bends away.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.
            origin: `(3,)`, a point of the axis.
            between: (low, high), measured along the axis from the origin: the range that becomes
                the arc; its length is kept on the axis.
            towards: the direction to which the far end leans, as far as it is across the axis.

        Raises:
            InputError: space would be folded within the field's bounds, because they reach the
                arc's line of centres or because straight ends meet; or the bounds are not known.
        """
        return derived(
            deformations.bend,
            (self,),
            degrees=degrees,
            axis=axis,
            origin=origin,
            between=between,
            towards=towards,
        )

    def bend_radial(
        self,
        height: float,
        between: ArrayLike = (0.0, 1.0),
        axis: str | ArrayLike = "z",
        origin: ArrayLike = _ORIGIN,
    ) -> Self:
        """Made a dish: slid along an axis by a distance that grows away from it. Not exact.

        Args:
            height: distance slid along the axis from the outer radius on.
            between: (inner, outer), distances from the axis: within the inner one nothing moves,
                from there to the outer one the distance slid grows linearly.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.
            origin: `(3,)`, a point of the axis.
        """
        return derived(
            deformations.bend_radial,
            (self,),
            height=height,
            between=between,
            axis=axis,
            origin=origin,
        )
