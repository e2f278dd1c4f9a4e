"""Reflections, and arrays of copies.

Only `mirror` is injective as a map of space; the others show one part of it more than once, so
what was elsewhere is lost. `fields.copies` says why their results are right all the same.
"""

from __future__ import annotations

from typing import Self

from numpy.typing import ArrayLike

from fields import copies
from fields.base import FieldBase, derived

_ORIGIN = (0.0, 0.0, 0.0)


class Copies(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    def mirror(self, axis: str | ArrayLike = "x", point: ArrayLike = _ORIGIN) -> Self:
        """The image in a plane. Exact if the field is; injective.

        For both, `a | a.mirror("x")`; to make a shape symmetric, `symmetry`.

        Args:
            axis: the plane's normal: "x", "y", "z", one of these with a minus sign, or a vector.
            point: `(3,)`, any point of the plane.
        """
        return derived(copies.mirror, (self,), axis=axis, point=point)

    def symmetry(self, axis: str | ArrayLike = "x", point: ArrayLike = _ORIGIN) -> Self:
        """The part in front of a plane, and its image behind it.

        Not injective: what was behind the plane is lost. Exact if the field is, and if its bounds
        are in front of the plane.

        Args:
            axis: the plane's normal, which points to the part that is kept.
            point: `(3,)`, any point of the plane.
        """
        return derived(copies.symmetry, (self,), axis=axis, point=point)

    def repeat(
        self,
        spacing: float | ArrayLike,
        count: int | ArrayLike | None = None,
        mirrored: bool = False,
    ) -> Self:
        """Copies in a row, a grid or a lattice: the union of all of them, also where they overlap.

        Not injective. Values up to half of the least spacing are those of the union of all copies;
        larger ones are lower bounds of it.

        Args:
            spacing: from each copy to the next, along all axes or along each; 0 for an axis along
                which there is one copy only. The field must be bounded along the others.
            count: how many copies along all axes or along each, the middle of them at the origin;
                None for copies without end, one of them in place.
            mirrored: reflect every second copy along each axis, in its own middle plane.

        Raises:
            InputError: all spacings are 0, the field has no bounds along an axis, or so many copies
                overlap that a point has to see more than 1000.
        """
        return derived(copies.repeat, (self,), spacing=spacing, count=count, mirrored=mirrored)

    def linear_array(self, count: int, offset: ArrayLike) -> Self:
        """A row of copies, the first in place. Not injective; values as for `repeat`.

        Args:
            count: how many.
            offset: `(3,)`, from each to the next.

        Raises:
            InputError: the offset is zero, or the field has no bounds along it.
        """
        return derived(copies.linear_array, (self,), count=count, offset=offset)

    def circular_array(self, count: int, axis: str | ArrayLike = "z") -> Self:
        """Copies turned by equal angles about an axis through the origin, the first in place.

        Not injective. Copies may overlap and the shape may meet the axis; all copies are computed
        then, while for a shape away from it two or three are. Values up to r sin(180 degrees /
        count), r the distance of the bounds from the axis, are those of the union of all copies;
        larger ones are lower bounds of it.

        Args:
            count: how many.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.
        """
        return derived(copies.circular_array, (self,), count=count, axis=axis)
