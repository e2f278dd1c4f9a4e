"""Is a polygon simple? Decided exactly."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fields import arguments
from fields.errors import InputError
from fields.profiles.edges import Points

_BLOCK = 1 << 20
"""Pairs of edges looked at together."""

_ROUNDING = 4 * 2.0**-53
"""The sum of two products of differences is right up to so much of its terms (Shewchuk, 1997)."""


def plane_points(argument: str, value: ArrayLike, least: int) -> Points:
    """Points `(n, 2)` with at least so many rows, all finite, and no two in a row the same."""
    items = value.tolist() if isinstance(value, np.ndarray | Tensor) else value
    if not isinstance(items, list | tuple):
        raise InputError(argument, value, "points are needed", "pass a list of pairs (x, y)")
    if len(items) < least:
        raise InputError(
            argument,
            value,
            f"{len(items)} points are too few",
            f"pass at least {least} pairs (x, y)",
        )
    points = np.array([arguments.pair(f"{argument}[{i}]", item) for i, item in enumerate(items)])
    same = (points[1:] == points[:-1]).all(axis=1)
    if same.any():
        index = int(same.argmax())
        raise InputError(
            argument,
            points[index].tolist(),
            f"points {index} and {index + 1} are the same",
            "leave one of them out",
        )
    return points


def simple_polygon(argument: str, value: ArrayLike) -> Points:
    """The corners of a simple polygon `(n, 2)`, counter-clockwise; a repeated first is dropped.

    Raises:
        InputError: fewer than three points, equal ones in a row, or edges that touch or cross.
    """
    points = plane_points(argument, value, least=3)
    if (points[0] == points[-1]).all():
        points = plane_points(argument, points[:-1], least=3)
    pair = first_contact(points)
    if pair is not None:
        first, second = pair
        raise InputError(
            argument,
            value,
            f"edge {first}, from {points[first].tolist()}, and edge {second}, from "
            f"{points[second].tolist()}, touch or cross",
            "pass the corners in order around a simple polygon; make holes by difference",
        )
    return points if signed_area(points) > 0 else points[::-1].copy()


def signed_area(points: Points) -> float:
    """The area of a polygon `(n, 2)`, negative if it is clockwise."""
    x, y = (points - points[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def first_contact(points: Points) -> tuple[int, int] | None:
    """Two edges of a closed polygon that meet elsewhere than in the end they share, or None."""
    ends = np.roll(points, -1, axis=0)
    count = len(points)
    for first, second in _overlapping_boxes(points, ends):
        is_next = (first + 1) % count == second
        is_last = (second + 1) % count == first
        touch = _meet(points[first], ends[first], points[second], ends[second])
        touch &= ~(is_next | is_last)
        touch |= is_next & _folds_back(points[first], ends[first], ends[second])
        touch |= is_last & _folds_back(points[second], ends[second], ends[first])
        if touch.any():
            at = int(touch.argmax())
            return tuple(sorted((int(first[at]), int(second[at]))))  # type: ignore[return-value]
    return None


def _overlapping_boxes(start: Points, end: Points):
    """Pairs of edges whose boxes meet, each pair once, in blocks."""
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.argsort(low[:, 0], kind="stable")
    low, high = low[order], high[order]
    # In the order of their left sides, an edge's partners follow it up to its own right side.
    stop = np.searchsorted(low[:, 0], high[:, 0], side="right")
    partners = np.maximum(stop - np.arange(len(order)) - 1, 0)
    total = np.concatenate([[0], np.cumsum(partners)])
    row = 0
    while row < len(order):
        until = int(np.searchsorted(total, total[row] + _BLOCK, side="right")) - 1
        until = max(until, row + 1)
        first = np.repeat(np.arange(row, until), partners[row:until])
        second = first + 1 + np.arange(len(first)) - (total[first] - total[row])
        meets = (low[first, 1] <= high[second, 1]) & (low[second, 1] <= high[first, 1])
        yield order[first[meets]], order[second[meets]]
        row = until


def _meet(a: Points, b: Points, c: Points, d: Points) -> NDArray[np.bool_]:
    """Do the closed segments a b and c d, whose boxes meet, have a common point?"""
    return (_turn(a, b, c) * _turn(a, b, d) <= 0) & (_turn(c, d, a) * _turn(c, d, b) <= 0)


def _folds_back(a: Points, b: Points, c: Points) -> NDArray[np.bool_]:
    """Does the path a, b, c run back along itself?"""
    return (_turn(a, b, c) == 0) & (np.einsum("ij,ij->i", a - b, c - b) > 0)


def _turn(a: Points, b: Points, c: Points) -> NDArray[np.float64]:
    """The exact sign of the turn at b on the way from a to c: 1 to the left, -1 to the right."""
    left = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1])
    right = (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    sign = np.sign(left - right)
    for i in np.flatnonzero(np.abs(left - right) <= _ROUNDING * (np.abs(left) + np.abs(right))):
        (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in p[i].tolist()] for p in (a, b, c))
        exact = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        sign[i] = (exact > 0) - (exact < 0)
    return sign
