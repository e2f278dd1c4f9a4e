"""Samples on a grid as fields."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.expression import X, Y, Z, call, clamp, length, maximum, minimum, where_negative
from fields.field import Field, make_field
from fields.grid_oracle import GridOracle
from fields.notation import History, Opaque
from fields.operations import Body
from fields.spline import FEWEST
from fields.tags import EVERYWHERE, Box, Tags, grown

Interpolation = Literal["linear", "cubic"]
Outside = Literal["distance", "clamp"]

_DEGREES = {"linear": 1, "cubic": 3}


def grid(
    values: ArrayLike,
    *,
    spacing: float | ArrayLike | None = None,
    origin: ArrayLike = (0.0, 0.0, 0.0),
    bounds: ArrayLike | None = None,
    interpolation: Interpolation = "linear",
    outside: Outside = "distance",
) -> Field:
    """Samples on a grid along the axes, interpolated in between.

    "linear" is trilinear: continuous, with an error of second order in the spacing, and never
    beyond the samples around a point. "cubic" is a tensor product of cubic splines: two continuous
    derivatives and an error of fourth order, but it can swing beyond samples near a jump.

    Beyond the box of the samples the field goes on from the value v at the nearest point of the
    box, which is a distance d away. With "distance" it is sqrt(v^2 + d^2) where v > 0, and v + d
    elsewhere. So it is continuous, positive far away, and if v is at most the distance to a surface
    within the box, so is what it goes on with. With "clamp" it is v.

    Not exact. `lipschitz` is computed from the samples: the largest slope L itself for "linear", a
    bound L on it for "cubic". With "distance" it is max(L, 1), or sqrt(L^2 + 1) if the inside
    reaches the walls of the box.

    Args:
        values: `(nx, ny, nz)`, negative inside, at least 2 (cubic: 4) along each axis. Float32
            samples are kept as such, everything else becomes float64.
        spacing: between samples; one number, or three.
        origin: `(3,)`, where the first sample is.
        bounds: in place of spacing and origin, the box `(2, 3)` from the first to the last sample.
        interpolation: "linear" or "cubic".
        outside: "distance" or "clamp". To end a shape at the box's walls, intersect it with a box.

    Raises:
        InputError: an argument is not of the kind described, or samples are NaN or infinite.
    """
    samples = _samples(values, interpolation)
    first, step = _placed(samples.shape, spacing, origin, bounds)
    if outside not in ("distance", "clamp"):
        raise InputError("outside", outside, "there is no such choice", 'use "distance" or "clamp"')
    oracle = GridOracle(samples, first, step, _DEGREES[interpolation])
    text = f"grid of {' x '.join(str(n) for n in samples.shape)} samples"
    return grid_field(oracle, outside, Opaque(text))


def grid_field(oracle: GridOracle, outside: Outside, history: History) -> Field:
    """The field of an oracle, with its continuation beyond the box."""
    low, high = oracle.box
    axes = tuple(
        clamp(axis, float(a), float(b)) for axis, a, b in zip((X, Y, Z), low, high, strict=True)
    )
    (value,) = call(oracle, axes)  # type: ignore[arg-type]
    if outside == "clamp":
        return make_field(Body(value, _clamped_tags(oracle)), history)
    beyond = length(*(p - q for p, q in zip((X, Y, Z), axes, strict=True)))
    continued = length(maximum(value, 0.0), beyond) + minimum(value, 0.0)
    expression = where_negative(-beyond, continued, value)
    return make_field(Body(expression, _continued_tags(oracle)), history)


# --- tags -----------------------------------------------------------------------------


def _continued_tags(oracle: GridOracle) -> Tags:
    """The tags of a grid with "distance" beyond its box.

    Lipschitz: the value v at the nearest point of the box changes along the walls only, with
    slope L or less, and the distance d only away from them. So g = sqrt(v^2 + d^2) has a gradient
    of squared norm (v^2 |grad v|^2 + d^2) / g^2 <= max(L, 1)^2, and v + d of at most L^2 + 1.
    Extent: where v < 0 on a wall, the inside reaches -v beyond it.
    Growth: let the grid's own be g. Beyond the box f <= t means v^2 + d^2 <= t^2 where v > 0, so
    the point is within g v + d <= sqrt(g^2 + 1) t of the extent, and d <= t - v elsewhere.
    """
    extent, growth = _extent_and_growth(oracle)
    slope, depth = oracle.steepest, max(0.0, -oracle.least_on_walls)
    lipschitz = max(slope, 1.0) if depth == 0 else math.hypot(slope, 1.0)
    return Tags(False, lipschitz, grown(extent, depth), math.hypot(growth, 1.0))


def _clamped_tags(oracle: GridOracle) -> Tags:
    extent, _ = _extent_and_growth(oracle)
    if oracle.least_on_walls <= 0:
        return Tags(False, oracle.steepest, EVERYWHERE, growth=1.0)
    return Tags(False, oracle.steepest, extent, growth=None)


def _extent_and_growth(oracle: GridOracle) -> tuple[Box, float]:
    """A box around the inside within the grid's box, and how level sets grow from it.

    Cells have lower bounds m. The extent is the box of those with m <= 0, and a cell more on every
    side; elsewhere m > 0, and growth is the largest ratio of a cell's reach beyond the extent
    and m.
    """
    least = oracle.cell_bounds[0][0]
    low, high = oracle.box
    step = oracle.spacing
    inside = least <= 0
    ends = []
    for axis, count in enumerate(least.shape):
        along = np.flatnonzero(inside.any(axis=tuple(a for a in range(3) if a != axis)))
        first, last = (along[0] - 1, along[-1] + 2) if len(along) else (count // 2, count // 2)
        ends.append((max(first, 0), min(last, count)))
    begin, end = np.array(ends).T
    extent = np.stack([low + step * begin, np.where(end == least.shape, high, low + step * end)])
    beyond = np.zeros(least.shape)
    for axis, count in enumerate(least.shape):
        cell = np.arange(count)
        reach = np.maximum(begin[axis] - cell, cell + 1 - end[axis]).clip(0) * step[axis]
        np.maximum(beyond, reach.reshape([-1 if a == axis else 1 for a in range(3)]), out=beyond)
    outer = beyond > 0
    growth = float((beyond[outer] / least[outer]).max()) if outer.any() else 0.0
    return extent, growth * (1 + 1e-12)


# --- arguments ------------------------------------------------------------------------


def _samples(values: ArrayLike, interpolation: str) -> NDArray[np.floating]:
    if interpolation not in _DEGREES:
        raise InputError(
            "interpolation", interpolation, "there is no such choice", 'use "linear" or "cubic"'
        )
    try:
        samples = np.asarray(values)
    except (TypeError, ValueError):
        samples = np.empty(0, dtype=object)
    if samples.dtype.kind == "b":
        raise InputError(
            "values", samples.dtype, "these are marks, not values", "use fields.from_occupancy"
        )
    if samples.dtype.kind not in "fiu" or samples.ndim != 3:
        raise InputError(
            "values",
            f"{samples.dtype} {samples.shape}",
            "a grid is an array of real numbers with three axes",
            "pass an array of shape (nx, ny, nz)",
        )
    fewest = FEWEST if interpolation == "cubic" else 2
    if min(samples.shape) < fewest:
        raise InputError(
            "values",
            samples.shape,
            f"{interpolation} interpolation needs {fewest} samples along each axis",
            "pass more samples" + (' or interpolation="linear"' if fewest > 2 else ""),
        )
    single = samples.dtype.kind == "f" and samples.dtype.itemsize <= 4
    samples = np.array(samples, dtype=np.float32 if single else np.float64, order="C")
    bad = ~np.isfinite(samples)
    if bad.any():
        first = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            "values",
            float(samples[first]),
            f"{bad.sum()} of {bad.size} samples are NaN or infinite, the first at index {first}",
            "fill them, with a large positive value where nothing is known",
        )
    return samples


def _placed(
    shape: tuple[int, ...],
    spacing: float | ArrayLike | None,
    origin: ArrayLike,
    bounds: ArrayLike | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The place of the first sample and the steps between samples, `(3,)` each."""
    if (spacing is None) == (bounds is None):
        raise InputError(
            "spacing",
            spacing,
            "a grid is placed either by spacing or by bounds",
            "pass one of them: spacing=(dx, dy, dz), or bounds=((x0, y0, z0), (x1, y1, z1))",
        )
    if bounds is None:
        step = np.array(arguments.numbers_or_one("spacing", spacing))
        return np.array(arguments.vector("origin", origin)), step
    low, high = arguments.box_bounds("bounds", bounds)
    if (low >= high).any():
        raise InputError("bounds", bounds, "the box has no volume", "pass minimum < maximum")
    return low, (high - low) / (np.array(shape) - 1)
