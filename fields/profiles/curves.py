"""Curves as chains of short edges.

A contour is a chain of cubic Bezier segments `(n, 4, 2)`. A segment whose second differences of
control points are at most d departs from its n equal chords by at most (3 * 2 / 8) d / n^2 (Wang's
bound), so the number of chords follows from a tolerance. Their ends lie on the curve.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.operations import Body
from fields.primitives import primitive
from fields.profiles.edges import Points
from fields.profiles.outline import outline_body
from fields.profiles.simple import plane_points, simple_polygon

Contour = NDArray[np.float64]
"""Control points `(n, 4, 2)` of cubic segments; each starts where the last one ends."""

Kind = Literal["catmull-rom", "b-spline", "bezier"]

RELATIVE_TOLERANCE = 1e-3
"""How far curves may be from their chords, as a part of the longer side of the bounds."""


@primitive
def spline(points: ArrayLike, kind: Kind = "catmull-rom", tolerance: float | None = None) -> Body:
    """A profile: the inside of a closed smooth curve.

    The curve is replaced by chords. The field is an exact distance to these, and so within the
    tolerance of the distance to the curve.

    Args:
        points: `(n, 2)`, at least three, around the shape in either direction; not closed. They
            stand for
            "catmull-rom": points that the curve passes through;
            "b-spline": control points of a uniform cubic B-spline, smoother, inside their hull;
            "bezier": corners and handles of cubic segments in turn (corner, handle, handle,
            corner, ..., handle), so three for each segment.
        kind: see `points`.
        tolerance: the largest distance of the curve from the chords; None for 1/1000 of the longer
            side of its bounds.

    Raises:
        InputError: the curve crosses itself, at this tolerance; or the numbers do not fit.
    """
    corners = plane_points("points", points, least=3)
    if kind not in get_args(Kind):
        raise InputError(
            "kind", kind, "there is no such curve", f"use one of {', '.join(get_args(Kind))}"
        )
    contour = _CONTOURS[kind](corners)
    accuracy = checked_tolerance(tolerance, [contour])
    return outline_body([simple_polygon("points", chords(contour, accuracy))])


def checked_tolerance(tolerance: float | None, contours: list[Contour]) -> float:
    """A given tolerance; or `RELATIVE_TOLERANCE` of the longer side of all control points' box."""
    if tolerance is not None:
        return arguments.positive("tolerance", tolerance)
    points = np.concatenate([contour.reshape(-1, 2) for contour in contours])
    return RELATIVE_TOLERANCE * float(np.ptp(points, axis=0).max())


def chords(contour: Contour, tolerance: float) -> Points:
    """The starts `(m, 2)` of chords that are within a tolerance of a closed contour.

    Points that repeat the one before are dropped; fewer than three may be left.
    """
    bend = np.abs(np.diff(contour, n=2, axis=1)).max(axis=1)  # (n, 2)
    counts = np.ceil(np.sqrt(0.75 * np.hypot(*bend.T) / tolerance)).astype(int).clip(1)
    segment = np.repeat(np.arange(len(contour)), counts)
    first = np.repeat(np.cumsum(counts) - counts, counts)
    t = ((np.arange(len(segment)) - first) / counts[segment])[:, None]
    a, b, c, d = contour[segment].transpose(1, 0, 2)
    s = 1 - t
    points = s**3 * a + 3 * s * s * t * b + 3 * s * t * t * c + t**3 * d
    return points[(points != np.roll(points, 1, axis=0)).any(axis=1)]


def straight(a: Points, b: Points) -> Contour:
    """Segments `(n, 4, 2)` for straight lines from a to b, both `(n, 2)`."""
    return np.stack([a, (2 * a + b) / 3, (a + 2 * b) / 3, b], axis=1)


def _through(points: Points) -> Contour:
    """Uniform Catmull-Rom: the tangent at a point is half the way between its neighbours."""
    tangent = (np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)) / 2
    end, end_tangent = np.roll(points, -1, axis=0), np.roll(tangent, -1, axis=0)
    return np.stack([points, points + tangent / 3, end - end_tangent / 3, end], axis=1)


def _near(points: Points) -> Contour:
    """A uniform cubic B-spline, segment by segment."""
    before, after = np.roll(points, 1, axis=0), np.roll(points, -1, axis=0)
    first, second = (2 * points + after) / 3, (points + 2 * after) / 3
    start = (before + 4 * points + after) / 6
    return np.stack([start, first, second, np.roll(start, -1, axis=0)], axis=1)


def _by_handles(points: Points) -> Contour:
    if len(points) % 3:
        raise InputError(
            "points",
            points,
            f"{len(points)} points are no closed chain of cubic segments",
            "pass three for each segment: a corner and two handles",
        )
    groups = points.reshape(-1, 3, 2)
    return np.concatenate([groups, np.roll(groups[:, :1], -1, axis=0)], axis=1)


_CONTOURS = {"catmull-rom": _through, "b-spline": _near, "bezier": _by_handles}
