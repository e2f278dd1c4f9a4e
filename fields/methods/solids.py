"""Solids from profiles, and profiles from solids."""

from __future__ import annotations

from typing import Self

from numpy.typing import ArrayLike

from fields import solids, sweeps
from fields.base import FieldBase, derived
from fields.solids import Ease


class Solids(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    @property
    def is_profile(self) -> bool:
        """Does the field not depend on z, so that it stands for a shape of the plane?

        Decided by the formula: True for `circle` and what is made of profiles by booleans,
        offsets and motions that keep z.
        """
        return solids.is_profile(self._body.expression)

    def extrude(self, height: float) -> Self:
        """The profile made a prism of this height along z, centred at z = 0. Exact if it is.

        Args:
            height: full height, greater than zero.

        Raises:
            InputError: the field is not a profile.
        """
        return derived(solids.extrude, (self,), height=height)

    def twist_extrude(self, height: float, degrees: float, top: float = 1.0) -> Self:
        """A prism that turns about the z axis on its way up.

        Not exact. The Lipschitz bound is sqrt(1 + (k r)^2) for an exact profile, with k radians a
        unit and r the profile's largest distance from the axis, so extraction leaves no holes.

        Args:
            height: full height, centred at z = 0, where the profile is not turned.
            degrees: the turn from the lower to the upper end, counter-clockwise.
            top: the scale of the upper end; the lower one has 1.

        Raises:
            InputError: the field is not a profile, or not bounded in x and y.
        """
        return derived(solids.twist_extrude, (self,), height=height, degrees=degrees, top=top)

    def taper_extrude(self, height: float, top: float) -> Self:
        """A prism that is scaled about the z axis on its way up. Not exact.

        Args:
            height: full height, centred at z = 0.
            top: the scale of the upper end, greater than zero; the lower one has 1.

        Raises:
            InputError: the field is not a profile, or not bounded in x and y.
        """
        return derived(solids.taper_extrude, (self,), height=height, top=top)

    def extrude_to(self, other: Self, height: float, ease: Ease = "linear") -> Self:
        """A body with this profile at its lower end and another at its upper one. See `loft`.

        Args:
            other: the upper profile.
            height: full height, centred at z = 0.
            ease: as for `loft`.
        """
        return derived(solids.extrude_to, (self, other), height=height, ease=ease)

    def loft(self, *others: Self, heights: ArrayLike, ease: Ease = "linear") -> Self:
        """A body with given profiles at given heights, in between the mean of their values.

        Not exact, with a Lipschitz bound. Profiles should overlap: where they do not, the mean of
        two distances can be positive everywhere, and the body is torn.

        Args:
            others: the profiles above this one.
            heights: one z for each profile, rising; the body ends at the first and the last.
            ease: how one changes to the next: "linear", or "smooth" without a crease at the
                profiles' heights.

        Raises:
            InputError: a field is not a profile, or not bounded in x and y; the heights do not fit.
        """
        return derived(solids.loft, (self, *others), heights=heights, ease=ease)

    def slice(self, z: float) -> Self:
        """The profile that the plane at height z cuts out of this field, for all z.

        Keeps the Lipschitz bound and the bounds in x and y; not exact unless the field is a
        profile already. There is no counterpart that projects: a shadow is a minimum over all z.

        Args:
            z: the height.
        """
        return derived(solids.slice, (self,), z=z)

    def revolve(self, offset: float = 0.0, degrees: float = 360.0) -> Self:
        """The profile turned about the z axis: its x becomes the distance from it, its y becomes z.

        What lies at negative x is not used. Exact if the profile is and lies at positive x, or is
        (by its formula) its own mirror image and makes a full turn. A side that lies on the axis
        stays a crease of the values inside: let such a profile cross the axis, or use `lathe`.

        Args:
            offset: how far the profile is moved along x first.
            degrees: how far it is turned, counter-clockwise from the half-plane of positive x;
                less than 360 makes flat ends.

        Raises:
            InputError: the field is not a profile, or has nothing at positive x.
        """
        return derived(sweeps.revolve, (self,), offset=offset, degrees=degrees)

    def coil(self, radius: float, pitch: float, turns: float) -> Self:
        """The profile wound about the z axis, as a spring or a thread, with ends cut flat in z.

        The profile stays in a half-plane through the axis: its x is added to the radius, its y to
        the height. Not exact; values far from the surface are cut off, see the Lipschitz bound.

        Args:
            radius: of the helix; the profile must not reach the axis.
            pitch: the rise with each turn, negative for a left-handed coil; more than the profile
                reaches up or down. Turns may overlap.
            turns: how many; |pitch| * turns is the height, centred at z = 0.

        Raises:
            InputError: the field is not a profile, not bounded in x and y, or does not fit.
        """
        return derived(sweeps.coil, (self,), radius=radius, pitch=pitch, turns=turns)

    def sweep(self, points: ArrayLike) -> Self:
        """The profile moved along a chain of segments, with mitred joints and flat ends.

        The profile is square to each segment. On the first its axes are turned from z by the
        shortest way, as by `orient`; from segment to segment they turn with the path and not
        about it. Lipschitz bound that of the profile; exact for a single segment only. For
        circular arcs use `revolve` with an angle.

        Args:
            points: `(n, 3)`, two or more.

        Raises:
            InputError: the field is not a profile, or not bounded in x and y; or a segment is too
                short for the bends at its ends.
        """
        return derived(sweeps.sweep, (self,), points=points)
