"""Tubes around curves, and sheets: all that is within a distance of a thin set.

The distance to a set less a radius is exact outside whatever the set is. Inside it is exact as
long as the radius does not exceed the set's reach (Federer, "Curvature measures", 1959): no
point of the tube has two nearest points, so the way from the set through the point to the tube's
border is straight. Each primitive says when that is so and is tagged exact only then; otherwise
the field is a lower bound inside, with Lipschitz constant 1 all the same. Distances to arcs,
parabolas and triangles as in Inigo Quilez, "3D SDFs",
https://iquilezles.org/articles/distfunctions/, except where noted. Angles are in degrees.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Expression,
    X,
    Y,
    Z,
    clamp,
    length,
    maximum,
    minimum,
    power,
    sqrt,
    square,
    where_negative,
)
from fields.formulas import bounding_body, exact_body, linear
from fields.operations import Body, Matrix
from fields.polyhedra import Face, sheet_distance
from fields.primitives import primitive

FLAT = 1e-9
"""Part of the size of some points by which they may be off a line or plane and count as on it."""


@primitive
def capped_torus(major: float, minor: float, angle: float) -> Body:
    """A piece of a ring about the z axis, with round ends, half to each side of +x.

    Exact, unless the ends meet each other.

    Args:
        major: radius of the ring's middle line.
        minor: radius of the tube, less than `major`.
        angle: from end to end, in degrees, above 0 and below 360.
    """
    ring, thin = _ring("major", major, "minor", minor)
    half = math.radians(arguments.between("angle", angle, 0, 360)) / 2
    sine, cosine = math.sin(half), math.cos(half)
    across = abs(Y)
    inside = cosine * across - sine * X  # the half of the plane's angles that the arc spans
    arc = length(length(X, Y) - ring, Z)
    end = length(X - ring * cosine, across - ring * sine, Z)
    gap = ring if cosine >= 0 else ring * sine
    side = ring * (sine if cosine > 0 else 1.0) + thin
    return bounding_body(
        where_negative(inside, arc, end) - thin,
        (ring * cosine - thin, -side, -thin),
        (ring + thin, side, thin),
        exact=thin <= gap,
    )


@primitive
def link(straight: float, major: float, minor: float) -> Body:
    """A link of a chain: a ring in the plane z = 0 that is drawn out along x.

    Args:
        straight: length of each straight part; the whole is longer by 2 (major + minor).
        major: radius of the middle line of the round parts.
        minor: radius of the tube, less than `major`.
    """
    half = arguments.positive("straight", straight) / 2
    ring, thin = _ring("major", major, "minor", minor)
    beyond = maximum(abs(X) - half, 0.0)
    reach = ring + thin
    return exact_body(
        length(length(beyond, Y) - ring, Z) - thin,
        (-half - reach, -reach, -thin),
        (half + reach, reach, thin),
    )


def _ring(first: str, major: object, second: str, minor: object) -> tuple[float, float]:
    ring, thin = arguments.positive(first, major), arguments.positive(second, minor)
    if thin >= ring:
        raise InputError(
            second, minor, f"the tube closes the hole of {first} = {ring:g}", "pass less"
        )
    return ring, thin


@primitive
def polyline_tube(points: ArrayLike, radius: float) -> Body:
    """A tube along straight pieces with round ends and joints: capsules end to end.

    Exact outside, and a bound inside, as the pieces overlap at the joints. Exact inside too
    for two points.

    Args:
        points: `(n, 3)`, at least two; neighbours must differ. Repeat the first at the end to
            close the line.
        radius: of the tube.
    """
    path = arguments.points_array("points", points, 2)
    r = arguments.positive("radius", radius)
    same = np.flatnonzero((path[1:] == path[:-1]).all(axis=1))
    if len(same):
        index = int(same[0]) + 1
        raise InputError(
            f"points[{index}]", points, "it equals the one before it", "leave one of them out"
        )
    distance = sqrt(minimum(*(_segment_square(a, b) for a, b in pairwise(path)))) - r
    return bounding_body(distance, path.min(axis=0) - r, path.max(axis=0) + r, exact=len(path) == 2)


def _segment_square(a: Matrix, b: Matrix) -> Expression:
    """The squared distance to a segment."""
    axis = b - a
    relative = [q - float(s) for q, s in zip((X, Y, Z), a, strict=True)]
    t = clamp(linear(axis / float(axis @ axis), relative), 0.0, 1.0)
    x, y, z = (
        square(q - t * float(c)) if c else square(q) for q, c in zip(relative, axis, strict=True)
    )
    return x + y + z


# --- sheets ---------------------------------------------------------------------------


@primitive
def triangle_plate(a: ArrayLike, b: ArrayLike, c: ArrayLike, thickness: float) -> Body:
    """All points within thickness / 2 of a flat triangle: a plate with round edges.

    Args:
        a: `(3,)`, a corner.
        b: `(3,)`, a corner.
        c: `(3,)`, a corner, not on a line with the others.
        thickness: of the plate.
    """
    corners = [np.array(arguments.vector(*item)) for item in zip("abc", (a, b, c), strict=True)]
    return _sheet(corners, "c", c, thickness)


@primitive
def quad_plate(a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, thickness: float) -> Body:
    """All points within thickness / 2 of a flat convex quadrilateral.

    Args:
        a: `(3,)`, a corner; b, c and d follow around the border.
        b: `(3,)`, a corner.
        c: `(3,)`, a corner.
        d: `(3,)`, a corner, in the plane of the others.
        thickness: of the plate.
    """
    given = zip("abcd", (a, b, c, d), strict=True)
    return _sheet([np.array(arguments.vector(*item)) for item in given], "d", d, thickness)


def _sheet(corners: list[Matrix], last: str, value: object, thickness: float) -> Body:
    """A convex set has infinite reach, so the distance is exact inside as well."""
    half = arguments.positive("thickness", thickness) / 2
    outline = np.stack(corners)
    size = float(np.ptp(outline, axis=0).max())
    edges = np.roll(outline, -1, axis=0) - outline
    turns = np.cross(edges, np.roll(edges, -1, axis=0))
    normal = turns.sum(axis=0)
    norm = float(np.linalg.norm(normal))
    if norm <= FLAT * size * size:
        raise InputError(last, value, "the corners lie on one line", "move a corner off it")
    normal /= norm
    if np.abs((outline - outline[0]) @ normal).max() > FLAT * size:
        raise InputError(
            last, value, "the corners do not lie in one plane", "use two triangles instead"
        )
    if (turns @ normal <= FLAT * size * size).any():
        raise InputError(
            last,
            value,
            "the corners do not go around a convex outline",
            "change their order, or use two triangles",
        )
    distance = sheet_distance((X, Y, Z), Face(normal, [*outline, outline[0]]))
    return exact_body(distance - half, outline.min(axis=0) - half, outline.max(axis=0) + half)


# --- parabolas ------------------------------------------------------------------------

NEWTON_STEPS = 5
"""From starts that are right where P or Q is zero and within a factor of 1.5 between; the two
steps after them are for the rounding that a far vertex brings."""

STEEP = 1e-9
"""Least divisor of a Newton step; smaller ones belong to no minimum of the distance."""


@primitive
def bezier_tube(a: ArrayLike, b: ArrayLike, c: ArrayLike, radius: float) -> Body:
    """A tube with round ends along a quadratic Bezier curve.

    Exact up to a radius equal to the least radius of curvature of the curve's parabola; above,
    exact outside only.

    Args:
        a: `(3,)`, where the curve begins.
        b: `(3,)`, what it bends towards: its tangents at a and c meet here.
        c: `(3,)`, where it ends.
        radius: of the tube.
    """
    start, control, end = (
        np.array(arguments.vector(*item)) for item in zip("abc", (a, b, c), strict=True)
    )
    r = arguments.positive("radius", radius)
    spread = np.ptp(np.stack([start, control, end]), axis=0)
    if not spread.any():
        raise InputError("c", c, "all three points are the same", "use sphere(radius, center=a)")
    low, high = np.transpose([_range(*axis) for axis in zip(start, control, end, strict=True)])
    bend = float(np.linalg.norm(np.cross(control - start, end - control)))
    if bend <= FLAT * float(spread.max()) ** 2:
        # All on one line: the curve covers a segment, perhaps twice.
        axis = max((end - start, control - start), key=np.linalg.norm)
        axis = axis / np.linalg.norm(axis)
        ends = _range(*((p - start) @ axis for p in (start, control, end)))
        square_distance = _segment_square(*(start + t * axis for t in ends))
        sharpest = math.inf
    else:
        square_distance = _parabola_square(start, control, end)
        sharpest = 2 * bend**2 / float(np.linalg.norm(start - 2 * control + end)) ** 3
    return bounding_body(sqrt(square_distance) - r, low - r, high + r, exact=r <= sharpest)


def _range(a: float, b: float, c: float) -> tuple[float, float]:
    """The least and largest value of a quadratic Bezier polynomial."""
    bend = a - 2 * b + c
    t = min(max((a - b) / bend, 0.0), 1.0) if bend else 0.0
    values = (a, c, a + 2 * t * (b - a) + t * t * bend)
    return min(values), max(values)


def _parabola_square(a: Matrix, b: Matrix, c: Matrix) -> Expression:
    """The squared distance to a + 2 t d + t^2 q for t from 0 to 1.

    The derivative of the distance is a cubic in t whose outer roots are minima. With
    t = s - d.q / |q|^2 it is s^3 + P s + Q: no quadratic term, so that Newton's iteration from
    beyond all roots is monotone. If there is one root only, the other iteration ends somewhere in
    the arc, which as a candidate does no harm.
    """
    d, q = b - a, a - 2 * b + c
    squared = float(q @ q)
    from_start = [float(s) - p for p, s in zip((X, Y, Z), a, strict=True)]
    shift = float(d @ q) / squared
    linear_term = linear(q / squared, from_start) + 2 * float(d @ d) / squared
    constant_term = linear(d / squared, from_start)
    p = linear_term - 3 * shift**2
    rest = constant_term - shift * linear_term + 2 * shift**3
    squares = []
    for sign in (1.0, -1.0):
        t = clamp(sign * _outer_root(p, sign * rest) - shift, 0.0, 1.0)
        for _ in range(2):
            value = ((t + 3 * shift) * t + linear_term) * t + constant_term
            slope = (3.0 * t + 6 * shift) * t + linear_term
            t = clamp(t - value / maximum(slope, STEEP), 0.0, 1.0)
        offsets = (
            offset + t * (2 * float(u) + t * float(v))
            for offset, u, v in zip(from_start, d, q, strict=True)
        )
        squares.append(sum((square(offset) for offset in offsets), start=0.0))
    return minimum(*squares)


def _outer_root(p: Expression, q: Expression) -> Expression:
    """The largest root of s^3 + p s + q if it is positive, else some number >= 0.

    Beyond the start the cubic is positive, increasing and convex.
    """
    s = sqrt(maximum(-p, 0.0)) + power(maximum(-q, 0.0), 1 / 3)
    for _ in range(NEWTON_STEPS):
        value, slope = (square(s) + p) * s + q, 3.0 * square(s) + p
        s = maximum(s - value / maximum(slope, STEEP), 0.0)
    return s
