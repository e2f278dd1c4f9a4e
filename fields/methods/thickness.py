"""Changes of a field's thickness and size, other than by scaling."""

from __future__ import annotations

from typing import Self

from numpy.typing import ArrayLike

from fields import thickness as rules
from fields.base import FieldBase, derived


class Thickness(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    def offset(self, distance: float) -> Self:
        """Grown by a distance, or shrunk by a negative one: a - distance.

        Of a distance it is the true offset surface, with round edges; the field remains a
        distance only outside it (grown) or inside (shrunk), so it is not tagged exact.
        """
        return derived(rules.offset, (self,), distance=distance)

    def shell(self, thickness: float) -> Self:
        """The surface made solid, half of the thickness on each side: |a| - thickness/2.

        The surface itself vanishes. Not exact. Of a field that is not a distance the
        thickness varies.
        """
        return derived(rules.shell, (self,), thickness=thickness)

    def hollow(self, thickness: float) -> Self:
        """Only a wall left, inwards from the surface, which stays.

        Not exact. Of a field that is not a distance the thickness varies.
        """
        return derived(rules.hollow, (self,), thickness=thickness)

    def onion(self, thickness: float, layers: int, gap: float | None = None) -> Self:
        """Several walls inside each other, the outermost inwards from the surface, which stays.

        Not exact. Of a field that is not a distance the thickness varies.

        Args:
            thickness: of each wall.
            layers: how many; those deeper than the shape is thick do not appear.
            gap: between two walls; the thickness if None.
        """
        return derived(rules.onion, (self,), thickness=thickness, layers=layers, gap=gap)

    def elongate(self, size: float | ArrayLike) -> Self:
        """Cut along the coordinate planes, drawn apart, and joined by straight prisms.

        Not exact, and not injective as a map of space: what is inserted repeats the section.

        Args:
            size: how much longer the shape becomes along each axis; 0 leaves one as it is.
        """
        return derived(rules.elongate, (self,), size=size)

    def displace(self, amount: Self, limit: float | None = None) -> Self:
        """The surface moved outwards by another field's values: a - amount. Not exact.

        Args:
            amount: a field, or an expression or function made one by `fields.Field` or
                `fields.from_function`, with its Lipschitz bound if it is known.
            limit: the amount is clamped to [-limit, limit]. Without one the result is unbounded,
                since nothing is known of the amount's size.
        """
        return derived(rules.displace, (self, amount), limit=limit)
