"""Where the samples of a grid are, and samples of fields taken there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.field import Field

_BLOCK = 1 << 18
"""Points handed out at a time."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Values on a grid that may be turned, and not yet checked.

    Attributes:
        values: `(nx, ny, nz)`, if all is well.
        origin: `(3,)`, place of the first sample.
        axes: `(3, 3)`, row i the step from a sample to the next along axis i; NaN if unknown.
    """

    values: NDArray[np.generic]
    origin: NDArray[np.float64]
    axes: NDArray[np.float64]


class DamagedFile(ValueError):  # noqa: N818 (named for what is the matter)
    """A file's content is not what its format says; the message says why, as a clause."""


@dataclass(frozen=True, eq=False)
class Places:
    """The points origin + step * (i, j, k), 0 <= (i, j, k) < shape.

    Attributes:
        origin: `(3,)`.
        step: `(3,)`.
        shape: how many along each axis.
    """

    origin: NDArray[np.float64]
    step: NDArray[np.float64]
    shape: tuple[int, int, int]

    def blocks(self) -> Iterator[tuple[slice, NDArray[np.float64]]]:
        """The points `(n, ny, nz, 3)`, some planes along the first axis at a time."""
        axes = [
            a + s * np.arange(n) for a, s, n in zip(self.origin, self.step, self.shape, strict=True)
        ]
        planes = max(1, _BLOCK // (self.shape[1] * self.shape[2]))
        for begin in range(0, self.shape[0], planes):
            some = slice(begin, min(begin + planes, self.shape[0]))
            yield some, np.stack(np.meshgrid(axes[0][some], *axes[1:], indexing="ij"), axis=-1)


def places(field: Field, spacing: float | ArrayLike, bounds: ArrayLike | None) -> Places:
    """Points that cover a box, the last ones less than a step beyond it.

    Args:
        field: in place of the box its own bounds are taken, and two steps more on every side.
        spacing: between the points; one number, or three.
        bounds: the box `(2, 3)`, or None.

    Raises:
        InputError: no bounds, or a box or spacing that is none.
    """
    step = np.array(arguments.numbers_or_one("spacing", spacing))
    if bounds is not None:
        low, high = arguments.box_bounds("bounds", bounds)
    elif field.bounds is not None:
        low, high = field.bounds + np.outer((-2, 2), step)
    else:
        raise InputError(
            "bounds", None, "the field is unbounded, or its bounds are unknown", "pass bounds"
        )
    # A side that is a whole number of steps but for rounding needs no extra one.
    nx, ny, nz = np.maximum(np.ceil((high - low) / step - 1e-9).astype(int), 1) + 1
    return Places(low, step, (int(nx), int(ny), int(nz)))


def sampled(field: Field, spacing: float | ArrayLike | None, bounds: ArrayLike | None) -> Samples:
    """A field's values on a grid, in float64; arguments as for `places`."""
    if spacing is None:
        raise InputError("spacing", spacing, "the field is no grid", "pass the step of the grid")
    where = places(field, spacing, bounds)
    values = np.empty(where.shape)
    for some, points in where.blocks():
        values[some] = field(points)
    return Samples(values, where.origin, np.diag(where.step))
