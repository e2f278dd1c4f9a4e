"""Boolean operations on fields."""

from __future__ import annotations

from typing import Self

from fields import operations
from fields.base import FieldBase, derived


class Combinations(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    def __or__(self, other: Self) -> Self:
        return self.union(other) if isinstance(other, FieldBase) else NotImplemented

    def __and__(self, other: Self) -> Self:
        return self.intersection(other) if isinstance(other, FieldBase) else NotImplemented

    def __sub__(self, other: Self) -> Self:
        return self.difference(other) if isinstance(other, FieldBase) else NotImplemented

    def union(self, *others: Self, smooth: float = 0.0) -> Self:
        """The points in any of the fields: min(a, b, ...).

        Args:
            others: fields to unite with.
            smooth: blend radius k, a field value. Where two values differ by less than
                k the crease is replaced by a quadratic blend (Quilez's polynomial smooth
                minimum), continuous in the gradient, which adds material up to k/4
                thick. Blends are applied from left to right; their order matters.

        Returns:
            The union. Exact only if the parts are and their bounds are apart. Bounds are
            lost if `smooth` > 0 and a part is a remapped field without `growth`.
        """
        return derived(operations.union, (self, *others), smooth=smooth)

    def intersection(self, *others: Self, smooth: float = 0.0) -> Self:
        """The points in all of the fields: max(a, b, ...). Not exact.

        Args:
            others: fields to intersect with.
            smooth: blend radius as for `union`; the blend removes material.
        """
        return derived(operations.intersection, (self, *others), smooth=smooth)

    def difference(self, *others: Self, smooth: float = 0.0) -> Self:
        """The points in this field and in none of the others: max(a, -b, ...). Not exact.

        Args:
            others: fields to take away.
            smooth: blend radius as for `union`; the blend removes material.
        """
        return derived(operations.difference, (self, *others), smooth=smooth)

    def negate(self) -> Self:
        """The complement: -a, with inside and outside exchanged. Unbounded."""
        return derived(operations.negate, (self,))
