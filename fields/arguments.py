"""Turn what users pass into plain numbers, or say why it cannot be done."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fields.errors import InputError

Vector: TypeAlias = "tuple[float, float, float]"


def number(argument: str, value: object) -> float:
    """A finite real number as a float; booleans and strings are refused."""
    if isinstance(value, np.ndarray | Tensor) and value.ndim == 0:
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, Real):
        raise InputError(argument, value, "a real number is needed", f"pass {argument} as a float")
    try:
        result = float(value)
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise InputError(
            argument, value, "it must be finite", "look for a division by zero or an overflow"
        )
    return result


def positive(argument: str, value: object) -> float:
    """A finite number above zero."""
    result = number(argument, value)
    if result <= 0:
        raise InputError(
            argument, value, "it must be greater than zero", "pass a positive length or factor"
        )
    return result


def not_negative(argument: str, value: object) -> float:
    """A finite number that is zero or more."""
    result = number(argument, value)
    if result < 0:
        raise InputError(argument, value, "it must not be negative", "pass zero or more")
    return result


def between(argument: str, value: object, low: float, high: float) -> float:
    """A finite number above `low` and below `high`."""
    result = number(argument, value)
    if not low < result < high:
        raise InputError(
            argument,
            value,
            f"it must be above {low:g} and below {high:g}",
            "pass a number in this range",
        )
    return result


def whole(argument: str, value: object, least: int = 1, most: int | None = None) -> int:
    """A whole number in a range; 3.0 counts as 3."""
    result = number(argument, value)
    bounds = f"of at least {least}" if most is None else f"from {least} to {most}"
    if result != int(result) or result < least or (most is not None and result > most):
        raise InputError(argument, value, f"it must be a whole number {bounds}", "pass an integer")
    return int(result)


def flag(argument: str, value: object) -> bool:
    """True or False."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(argument, value, "it is neither True nor False", "pass one of them")
    return bool(value)


def choice(argument: str, value: object, options: Sequence[str]) -> str:
    """One of some words."""
    if value not in options:
        raise InputError(argument, value, "there is no such choice", f"use {' or '.join(options)}")
    return str(value)


def vector(argument: str, value: object) -> Vector:
    """Three finite numbers."""
    items = value.tolist() if isinstance(value, np.ndarray | Tensor) else value
    if not isinstance(items, list | tuple) or len(items) != 3:
        raise InputError(argument, value, "three numbers are needed", "pass (x, y, z)")
    x, y, z = (number(f"{argument}[{index}]", item) for index, item in enumerate(items))
    return (x, y, z)


def pair(
    argument: str, value: object, check: Callable[[str, object], float] = number
) -> tuple[float, float]:
    """Two checked numbers."""
    try:
        first, second = value  # type: ignore[misc]
    except (TypeError, ValueError) as error:
        raise InputError(
            argument, value, "not a pair of numbers", "pass two, such as (0, 1)"
        ) from error
    return (check(f"{argument}[0]", first), check(f"{argument}[1]", second))


def interval(argument: str, value: object) -> tuple[float, float]:
    """Two numbers, the second above the first, and not so near that dividing by it overflows."""
    low, high = pair(argument, value)
    if not low < high or not math.isfinite(1.0 / (high - low)):
        raise InputError(argument, value, "an empty range", "pass (low, high) with low below high")
    return (low, high)


def points_array(argument: str, value: object, least: int) -> NDArray[np.float64]:
    """At least so many points `(n, 3)`, all coordinates finite."""
    items = value.tolist() if isinstance(value, np.ndarray | Tensor) else value
    if not isinstance(items, list | tuple) or len(items) < least:
        raise InputError(
            argument, value, f"at least {least} points are needed", "pass ((x, y, z), ...)"
        )
    return np.array([vector(f"{argument}[{index}]", item) for index, item in enumerate(items)])


def numbers_or_one(
    argument: str, value: object, check: Callable[[str, object], float] = positive
) -> Vector:
    """Three checked numbers, or one that is used for all three axes."""
    is_single = isinstance(value, Real) or (
        isinstance(value, np.ndarray | Tensor) and value.ndim == 0
    )
    x, y, z = (value, value, value) if is_single else vector(argument, value)
    return (check(argument, x), check(argument, y), check(argument, z))


def direction(argument: str, value: object) -> Vector:
    """A unit vector along "x", "y", "z", "-x", "-y", "-z", or along three numbers."""
    if isinstance(value, str):
        name = value.removeprefix("-")
        if name not in ("x", "y", "z"):
            raise InputError(
                argument, value, "there is no such axis", "use 'x', 'y', 'z', '-x', '-y' or '-z'"
            )
        sign = -1.0 if value.startswith("-") else 1.0
        x, y, z = (sign if axis == name else 0.0 for axis in "xyz")
        return (x, y, z)
    x, y, z = vector(argument, value)
    # Scaling first keeps the squares of very large or very small entries in range.
    largest = max(abs(x), abs(y), abs(z))
    if largest == 0:
        raise InputError(
            argument, value, "a zero vector has no direction", "pass an axis name or a vector"
        )
    x, y, z = x / largest, y / largest, z / largest
    norm = math.sqrt(x * x + y * y + z * z)
    return (x / norm, y / norm, z / norm)


def box_bounds(argument: str, value: ArrayLike) -> NDArray[np.float64]:
    """A finite box `(2, 3)`, rows minimum and maximum."""
    try:
        box = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        box = np.empty(0)
    if box.shape != (2, 3) or not np.isfinite(box).all() or (box[0] > box[1]).any():
        raise InputError(
            argument,
            value,
            "a box is two rows of three finite numbers, minimum first",
            "pass ((xmin, ymin, zmin), (xmax, ymax, zmax)), or None if it is unbounded",
        )
    return box


def points_tensor(argument: str, value: object) -> Tensor:
    """Points `(..., 3)` as a floating tensor, checked to be finite.

    Tensors keep their dtype, device and graph. Numpy float32 and float64 keep their
    precision; integers, lists and everything else that numpy reads become float64.
    """
    points = value if isinstance(value, Tensor) else _from_numpy(argument, value)
    if points.is_complex() or points.dtype == torch.bool:
        raise InputError(
            argument, points.dtype, "coordinates are real numbers", "pass floats or integers"
        )
    if not points.is_floating_point():
        points = points.to(torch.float64)
    if points.ndim == 0 or points.shape[-1] != 3:
        raise InputError(
            argument,
            tuple(points.shape),
            "the last axis of the shape must hold x, y and z",
            "pass an array of shape (..., 3)",
        )
    # A finite sum needs finite terms, and is by far the quicker to find out.
    if (
        not points.detach().sum().isfinite()
        and not (finite := points.detach().isfinite().all(dim=-1)).all()
    ):
        bad = (~finite).nonzero()
        first = tuple(bad[0].tolist())
        raise InputError(
            argument,
            points.detach()[first].tolist(),
            f"{len(bad)} of {finite.numel()} points are NaN or infinite, the first at index "
            f"{first}",
            "drop or repair them before evaluating a field",
        )
    return points


def _from_numpy(argument: str, value: object) -> Tensor:
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        array = np.empty(0, dtype=object)
    if array.dtype.kind not in "fiu":
        raise InputError(
            argument,
            value if array.dtype.kind == "O" else array.dtype,
            "coordinates are real numbers in a regular array",
            "pass an array of floats of shape (..., 3)",
        )
    is_single = array.dtype.kind == "f" and array.dtype.itemsize == 4
    dtype = np.float32 if is_single else np.float64
    return torch.from_numpy(np.require(array, dtype, ["C", "W", "A"]))
