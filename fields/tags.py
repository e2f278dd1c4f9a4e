"""What is known of a field besides its formula, and how that survives operations.

The zero set and inside of a field are written S = {f <= 0}. Four facts are tracked:

exact
    |f(p)| is the Euclidean distance from p to the zero set, for every p, inside and out.
lipschitz
    |f(p) - f(q)| <= lipschitz * |p - q| for all p, q; None if unknown.
extent
    an axis-aligned box that contains S; sides may be infinite (a half-space still knows
    where it ends). The public `bounds` is the extent if all sides are finite.
growth
    for every t >= 0, {f <= t} lies within the extent grown by growth * t on all sides;
    None if unknown. An exact distance has growth 1. It is what makes the bounds of an
    offset, a shell or a smooth union safe even for fields that are not distances:
    the level set f = t of, say, a warped field may be much farther out than t.

Extents are computed in float64 and are conservative up to its rounding. A box with no
points, such as the overlap of two boxes that do not meet, is stored with zero width at
the middle of the gap; the growth law still holds for it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Box = NDArray[np.float64]

EVERYWHERE: Box = np.array([[-np.inf] * 3, [np.inf] * 3])
EVERYWHERE.setflags(write=False)


@dataclass(frozen=True, slots=True, eq=False)
class Tags:
    """The four facts of the module's docstring.

    Args:
        exact: is it a true signed distance?
        lipschitz: bound on the gradient's norm, or None.
        extent: `(2, 3)`, rows minimum and maximum, entries may be infinite.
        growth: see the module's docstring; None if unknown.
    """

    exact: bool
    lipschitz: float | None
    extent: Box
    growth: float | None

    @staticmethod
    def of_distance(extent: Box) -> Tags:
        """The tags of a true signed distance with this extent."""
        return Tags(exact=True, lipschitz=1.0, extent=extent, growth=1.0)

    @property
    def bounds(self) -> Box | None:
        """The extent if it is finite, else None."""
        return self.extent if np.isfinite(self.extent).all() else None


def largest(values: list[float | None]) -> float | None:
    """The largest of some bounds; None if any is unknown."""
    return None if None in values else max(values)  # type: ignore[type-var]


def hull(first: Box, second: Box) -> Box:
    """The smallest box that contains both."""
    return np.stack([np.minimum(first[0], second[0]), np.maximum(first[1], second[1])])


def overlap(first: Box, second: Box) -> Box:
    """The box of common points; axes on which there are none get zero width."""
    return _not_inverted(np.maximum(first[0], second[0]), np.minimum(first[1], second[1]))


def are_apart(first: Box, second: Box) -> bool:
    """Is there a gap between the two boxes?"""
    return bool((np.maximum(first[0], second[0]) > np.minimum(first[1], second[1])).any())


def grown(box: Box, distance: float) -> Box:
    """The box with every side moved outwards; inwards if the distance is negative."""
    return _not_inverted(box[0] - distance, box[1] + distance)


def deepened(tags: Tags, depth: float) -> Tags:
    """The tags of a field that is less by at most `depth`, with the same Lipschitz bound.

    Extent: {f - depth <= t} is {f <= t + depth}.
    """
    unknown = tags.growth is None
    extent = EVERYWHERE if unknown else grown(tags.extent, tags.growth * depth)
    return replace(tags, exact=False, extent=extent)


def linear_image(box: Box, matrix: NDArray[np.float64]) -> Box:
    """The smallest axis-aligned box that contains `matrix @ p` for all p of the box."""
    with np.errstate(invalid="ignore"):
        ends = matrix[None] * box[:, None, :]
    ends = np.where(matrix == 0, 0.0, ends)  # 0 * infinity: that axis plays no part
    return np.stack([ends.min(axis=0).sum(axis=1), ends.max(axis=0).sum(axis=1)])


def _not_inverted(low: Box, high: Box) -> Box:
    with np.errstate(invalid="ignore"):
        middle = (low + high) / 2
    inverted = low > high
    return np.stack([np.where(inverted, middle, low), np.where(inverted, middle, high)])
