"""Triangle pairs decided without any rounding, on Python integers.

A finite float64 is an integer times a power of two, so all coordinates become integers once
multiplied by one common power of two (`integer_points`). Orientation signs are then exact.
This module decides the pairs that float64 leaves open; it is some thousand times slower than
the filter, and the referee wherever an answer is in doubt.

Two faces *intersect* when the closed triangles have a point in common outside the hull of
the vertices that they share by index (nothing, a vertex, or an edge). Three shared vertices
make a `DUPLICATE`. A zero-area face counts as what it is, the closed segment or the point
that its corners span. How they intersect is one of the kinds of `IntersectionKind`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import IntEnum
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Point = tuple[int, int, int]
RationalPoint = tuple[Fraction, ...]

_PLANES = ((1, 2), (2, 0), (0, 1))
_MET, _PIERCED = 1, 2


class IntersectionKind(IntEnum):
    """How two faces intersect; each pair has one kind. Zero, `NONE`, when they do not.

    *Insides* are the triangles without their edges.
    """

    NONE = 0
    CROSSING = 1
    """The insides pass through each other, in two planes; with or without a common vertex."""
    OVERLAP = 2
    """In one plane, without a common vertex, and the insides have an area in common."""
    FOLD = 3
    """In one plane, with a common vertex or edge, and the insides have an area in common."""
    TOUCHING = 4
    """Contact, beyond what they share by index, that leaves the insides apart: a corner or an
    edge of one on the other, in one plane or in two."""
    DUPLICATE = 5
    """The same three vertices, by index and in any order."""
    DEGENERATE = 6
    """One of the two, at least, has zero area, and they meet beyond what they share."""


def integer_points(points: NDArray[np.float64]) -> list[Point]:
    """Finite float64 points `(n, 3)`, times one common power of two, as exact integers."""
    mantissas, exponents = np.frexp(points)
    integers = (mantissas * 2.0**53).astype(np.int64)
    nonzero = integers != 0
    lowest = int(exponents[nonzero].min()) if nonzero.any() else 0
    shifts = np.where(nonzero, exponents - lowest, 0)
    return [
        (int(m[0]) << int(s[0]), int(m[1]) << int(s[1]), int(m[2]) << int(s[2]))
        for m, s in zip(integers, shifts, strict=True)
    ]


def sign(value: int | Fraction) -> int:
    """Sign of a number: -1, 0 or 1."""
    return (value > 0) - (value < 0)


def orient3d(a: Point, b: Point, c: Point, d: Point) -> int:
    """Exact sign of det[a - d, b - d, c - d]."""
    ax, ay, az = a[0] - d[0], a[1] - d[1], a[2] - d[2]
    bx, by, bz = b[0] - d[0], b[1] - d[1], b[2] - d[2]
    cx, cy, cz = c[0] - d[0], c[1] - d[1], c[2] - d[2]
    return sign(az * (bx * cy - cx * by) + bz * (cx * ay - ax * cy) + cz * (ax * by - bx * ay))


def orient2d(a: Point, b: Point, c: Point, axis: int) -> int:
    """Exact sign of the turn a -> b -> c, seen along a coordinate axis."""
    i, j = _PLANES[axis]
    return sign((a[i] - c[i]) * (b[j] - c[j]) - (a[j] - c[j]) * (b[i] - c[i]))


def visible_axis(a: Point, b: Point, c: Point) -> int | None:
    """An axis along which the triangle is seen with non-zero area; None if it has none."""
    for axis in (2, 0, 1):
        if orient2d(a, b, c, axis) != 0:
            return axis
    return None


def volume_sign(points: Sequence[Point], faces: Iterable[Sequence[int]]) -> int:
    """Sign of the volume that closed faces enclose; positive when they face outwards."""
    total = 0
    for f in faces:
        a, b, c = (points[i] for i in f)
        total += _dot(a, _cross(b, c))
    return sign(total)


def decide(points: Sequence[Point], face: Sequence[int], other: Sequence[int]) -> IntersectionKind:
    """Whether and how two faces intersect, exactly.

    Args:
        points: integer points, indexed by vertex (a list or a dictionary).
        face: the three vertex indices of one face.
        other: the three vertex indices of the other.
    """
    common = set(face) & set(other)
    if len(common) == 3:
        return IntersectionKind.DUPLICATE
    # The shared vertices come first, the others keep their order.
    first = [points[i] for i in sorted(face, key=lambda i: i not in common)]
    second = [points[i] for i in sorted(other, key=lambda i: i not in common)]
    axis = visible_axis(*first)
    other_axis = visible_axis(*second)
    if axis is None or other_axis is None:
        if len(common) == 2 and not (axis is None and other_axis is None):
            # A segment along an edge of a real triangle leaves it where the edge ends.
            return IntersectionKind.NONE
        shared = [points[i] for i in common]
        meet = _meet_outside(first, second, shared)
        return IntersectionKind.DEGENERATE if meet else IntersectionKind.NONE
    if len(common) == 2:
        # Beyond the common edge the two meet only when folded flat onto each other.
        p, q, c = first
        d = second[2]
        flat = orient3d(p, q, c, d) == 0 and orient2d(p, q, c, axis) == orient2d(p, q, d, axis)
        return IntersectionKind.FOLD if flat else IntersectionKind.NONE
    if len(common) == 1:
        # Both faces are star-shaped about the common corner: if they share another point, they
        # share the last one on the ray through it, which lies on an edge opposite the corner.
        contacts = (
            _segment_triangle(first[1], first[2], second, other_axis),
            _segment_triangle(second[1], second[2], first, axis),
        )
    else:
        contacts = tuple(
            _segment_triangle(p[k], p[k - 2], t, t_axis)
            for p, t, t_axis in ((first, second, other_axis), (second, first, axis))
            for k in range(3)
        )
    if _PIERCED in contacts:
        return IntersectionKind.CROSSING
    if not any(contacts):
        return IntersectionKind.NONE
    if all(orient3d(*first, x) == 0 for x in second):
        if not _insides_overlap(first, second, axis):
            return IntersectionKind.TOUCHING
        return IntersectionKind.FOLD if common else IntersectionKind.OVERLAP
    # No edge pierces the other's inside, yet edges may cross edges: then the common segment has
    # a length, and neither triangle lies on one side of the other.
    through = (
        _straddles(first, second)
        and _straddles(second, first)
        and len(set(_common_corners(first, second))) > 1
    )
    return IntersectionKind.CROSSING if through else IntersectionKind.TOUCHING


def _straddles(triangle: Sequence[Point], other: Sequence[Point]) -> bool:
    """Whether a triangle has corners strictly on both sides of the other's plane."""
    sides = [orient3d(*other, x) for x in triangle]
    return min(sides) < 0 < max(sides)


def _insides_overlap(first: Sequence[Point], second: Sequence[Point], axis: int) -> bool:
    """Whether two triangles of one plane, seen along `axis`, have an area in common.

    If not, the line of an edge of one of them has the other on its outer side or on itself.
    """
    for triangle, other in ((first, second), (second, first)):
        turn = orient2d(*triangle, axis)
        for k in range(3):
            s, e = triangle[k - 1], triangle[k]
            if all(orient2d(s, e, x, axis) * turn <= 0 for x in other):
                return False
    return True


def _segment_triangle(p: Point, q: Point, triangle: Sequence[Point], axis: int) -> int:
    """Contact of the closed segment pq with a closed triangle of non-zero area along `axis`.

    Zero for none, `_PIERCED` where the segment's inside goes through the triangle's, else `_MET`.
    """
    a, b, c = triangle
    side_p, side_q = orient3d(a, b, c, p), orient3d(a, b, c, q)
    if side_p * side_q > 0:
        return 0
    if side_p == 0 and side_q == 0:
        turn = orient2d(a, b, c, axis)
        edges = ((a, b), (b, c), (c, a))
        inside = any(all(orient2d(s, e, x, axis) * turn >= 0 for s, e in edges) for x in (p, q))
        return _MET if inside or any(_segments_meet(p, q, s, e, axis) for s, e in edges) else 0
    turns = (orient3d(p, q, a, b), orient3d(p, q, b, c), orient3d(p, q, c, a))
    if max(turns) > 0 and min(turns) < 0:
        return 0
    return _PIERCED if side_p * side_q < 0 and 0 not in turns else _MET


def _segments_meet(p: Point, q: Point, a: Point, b: Point, axis: int) -> bool:
    """Whether two closed segments of one plane meet, seen along an axis not in that plane."""
    i, j = _PLANES[axis]

    def within(s: Point, e: Point, x: Point) -> bool:
        return min(s[i], e[i]) <= x[i] <= max(s[i], e[i]) and min(s[j], e[j]) <= x[j] <= max(
            s[j], e[j]
        )

    pq_a, pq_b = orient2d(p, q, a, axis), orient2d(p, q, b, axis)
    ab_p, ab_q = orient2d(a, b, p, axis), orient2d(a, b, q, axis)
    if pq_a * pq_b < 0 and ab_p * ab_q < 0:
        return True
    return (
        (pq_a == 0 and within(p, q, a))
        or (pq_b == 0 and within(p, q, b))
        or (ab_p == 0 and within(a, b, p))
        or (ab_q == 0 and within(a, b, q))
    )


# --- general position does not matter: any hulls, in rationals, slowly ----------------------


def _meet_outside(first: Sequence[Point], second: Sequence[Point], shared: Sequence[Point]) -> bool:
    """Whether the hulls of two point triples meet in a point outside the hull of `shared`.

    `shared` (at most two points) lies in both hulls. Any triple may be degenerate. The common
    part is convex, so it exceeds the shared hull exactly when one of its corners does.
    """
    # Corners that coincide decide at once most pairs of a mesh that collapsed.
    if any(not _in_segment(x, shared) for x in set(first) & set(second)):
        return True
    if len(set(first)) == len(set(second)) == 1:
        return False
    return any(not _in_segment(x, shared) for x in _common_corners(first, second))


def _common_corners(first: Sequence[Point], second: Sequence[Point]) -> list[RationalPoint]:
    """Points whose hull is the common part of the hulls of two point triples.

    The first is clipped by the half-spaces whose intersection is the second.
    """
    corners: list[RationalPoint] = [tuple(map(Fraction, p)) for p in first]
    for normal, offset in _half_spaces(second):
        corners = _clipped(corners, normal, offset)
        if not corners:
            break
    return corners


def _half_spaces(triple: Sequence[Point]) -> list[tuple[Point, int]]:
    """Half-spaces n . x <= h whose intersection is the hull of three points."""
    a, b, c = triple
    normal = _cross(_minus(b, a), _minus(c, a))
    result = []
    if any(normal):
        result += [(normal, _dot(normal, a)), (_negative(normal), -_dot(normal, a))]
        for s, e in ((a, b), (b, c), (c, a)):
            outward = _cross(_minus(e, s), normal)
            result.append((outward, _dot(outward, s)))
        return result
    # Collinear: the longest of the three sides is the hull. Its line is the intersection of two
    # planes, of the three that contain it and a coordinate direction.
    s, e = max(((a, b), (b, c), (c, a)), key=lambda pair: _squared(_minus(pair[1], pair[0])))
    along = _minus(e, s)
    unit_vectors = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    normals = [_cross(along, u) for u in unit_vectors] if any(along) else list(unit_vectors)
    for n in normals:
        result += [(n, _dot(n, s)), (_negative(n), -_dot(n, s))]
    result += [(along, _dot(along, e)), (_negative(along), -_dot(along, s))]
    return result


def _clipped(corners: list[RationalPoint], normal: Point, offset: int) -> list[RationalPoint]:
    """Corners of a convex polygon (or segment, or point) cut by n . x <= h."""
    heights = [_dot(normal, x) - offset for x in corners]
    if all(h <= 0 for h in heights):
        return corners
    kept = []
    for k, (x, h) in enumerate(zip(corners, heights, strict=True)):
        before, h_before = corners[k - 1], heights[k - 1]
        if h * h_before < 0:
            t = h_before / (h_before - h)
            kept.append(tuple(p + t * (r - p) for p, r in zip(before, x, strict=True)))
        if h <= 0:
            kept.append(x)
    return kept


def _in_segment(x: RationalPoint, shared: Sequence[Point]) -> bool:
    if not shared:
        return False
    s, e = shared[0], shared[-1]
    along, to_x = _minus(e, s), _minus(x, s)
    if any(_cross(along, to_x)):
        return False
    if not any(along):
        return not any(to_x)
    return 0 <= _dot(along, to_x) <= _squared(along)


def _minus(a: Sequence, b: Sequence) -> tuple:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _negative(a: Sequence) -> tuple:
    return (-a[0], -a[1], -a[2])


def _dot(a: Sequence, b: Sequence):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _squared(a: Sequence):
    return _dot(a, a)


def _cross(a: Sequence, b: Sequence) -> tuple:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
