"""Boolean operations on fields, and blends of two."""

from __future__ import annotations

from typing import Self, Unpack

from numpy.typing import ArrayLike

from fields import operations, seams, transitions
from fields.base import FieldBase, derived
from fields.joints import Joint, with_joints


class Combinations(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    def __or__(self, other: Self) -> Self:
        return self.union(other) if isinstance(other, FieldBase) else NotImplemented

    def __and__(self, other: Self) -> Self:
        return self.intersection(other) if isinstance(other, FieldBase) else NotImplemented

    def __sub__(self, other: Self) -> Self:
        return self.difference(other) if isinstance(other, FieldBase) else NotImplemented

    def __xor__(self, other: Self) -> Self:
        return self.symmetric_difference(other) if isinstance(other, FieldBase) else NotImplemented

    def __invert__(self) -> Self:
        return self.negate()

    @with_joints
    def union(self, *others: Self, **joint: Unpack[Joint]) -> Self:
        """The points in any of the fields: min(a, b, ...).

        Args:
            others: fields to unite with.
            joint: the shape of the edge where two surfaces meet, by one of the keywords
                `smooth`, `cubic`, `exponential`, `root` (blends), `round` (a fillet),
                `chamfer` (a bevel) and `stairs`, with its size; see `fields.joints`. None of
                them, or 0, leaves it sharp. `union(a, b, smooth=k)` is Quilez's polynomial
                smooth minimum: where two values differ by less than k, up to k/4 is added.
                Joints are made from left to right and their order matters, but for
                `exponential`, which takes all fields at once.

        Returns:
            The union. Exact only if the parts are and their bounds are apart, and the edge is
            sharp. Any joint keeps the Lipschitz bound; bounds are lost if it is given and a
            part is a remapped field without `growth`.

        Raises:
            InputError: more than one joint, or a negative size.
        """
        return derived(operations.union, (self, *others), **joint)

    @with_joints
    def intersection(self, *others: Self, **joint: Unpack[Joint]) -> Self:
        """The points in all of the fields: max(a, b, ...). Not exact.

        Args:
            others: fields to intersect with.
            joint: as for `union`; here it removes material.
        """
        return derived(operations.intersection, (self, *others), **joint)

    @with_joints
    def difference(self, *others: Self, **joint: Unpack[Joint]) -> Self:
        """The points in this field and in none of the others: max(a, -b, ...). Not exact.

        Args:
            others: fields to take away.
            joint: as for `union`; here it removes material.
        """
        return derived(operations.difference, (self, *others), **joint)

    def symmetric_difference(self, *others: Self) -> Self:
        """The points in an odd number of the fields: max(min(a, b), -max(a, b)). Not exact.

        Args:
            others: fields to combine with, from left to right.
        """
        return derived(operations.symmetric_difference, (self, *others))

    def negate(self) -> Self:
        """The complement: -a, with inside and outside exchanged. Unbounded."""
        return derived(operations.negate, (self,))

    # --- where two surfaces meet ---

    def pipe(self, other: Self, radius: float) -> Self:
        """A pipe along the curve where both surfaces meet: sqrt(a^2 + b^2) - radius.

        Args:
            other: the other surface.
            radius: of the pipe, round where the surfaces meet at right angles.
        """
        return derived(seams.pipe, (self, other), radius=radius)

    def engrave(self, other: Self, depth: float) -> Self:
        """This field with a V-shaped channel along the curve where the surfaces meet.

        Args:
            other: whose surface says where.
            depth: of the V, as wide on each side.
        """
        return derived(seams.engrave, (self, other), depth=depth)

    def groove(self, other: Self, depth: float, width: float) -> Self:
        """This field with a rectangular channel along the curve where the surfaces meet.

        Args:
            other: whose surface says where.
            depth: into this field.
            width: of the channel, half on each side of the other surface.
        """
        return derived(seams.groove, (self, other), depth=depth, width=width)

    def tongue(self, other: Self, height: float, width: float) -> Self:
        """This field with a rectangular ridge along the curve where the surfaces meet.

        Args:
            other: whose surface says where.
            height: out of this field.
            width: of the ridge, half on each side of the other surface.
        """
        return derived(seams.tongue, (self, other), height=height, width=width)

    # --- from one field to another ---

    def morph(self, other: Self, share: float) -> Self:
        """Between two fields: (1 - share) a + share b. Not exact.

        Args:
            other: the field that a share of 1 gives.
            share: from 0 to 1.
        """
        return derived(transitions.morph, (self, other), share=share)

    def transition_linear(self, other: Self, start: ArrayLike, end: ArrayLike) -> Self:
        """This field before a point, another beyond a second one, and between them a mean.

        Args:
            other: the field at `end` and beyond.
            start: `(3,)`; the mean is made across planes square to the way from here to `end`.
            end: `(3,)`, another point.

        Returns:
            (1 - t) a + t b. With bounds and Lipschitz bounds of both it has a Lipschitz bound;
            it is larger the nearer `start` and `end` are.
        """
        return derived(transitions.transition_linear, (self, other), start=start, end=end)

    def transition_radial(
        self, other: Self, inner: float, outer: float, axis: str | ArrayLike = "z"
    ) -> Self:
        """This field near an axis through the origin, another far from it, between them a mean.

        Args:
            other: the field at `outer` and beyond.
            inner: distance from the axis up to which this field counts alone.
            outer: distance from which the other does.
            axis: "x", "y", "z", one of these with a minus sign, or a vector of any length.

        Returns:
            As for `transition_linear`.
        """
        return derived(
            transitions.transition_radial, (self, other), inner=inner, outer=outer, axis=axis
        )
