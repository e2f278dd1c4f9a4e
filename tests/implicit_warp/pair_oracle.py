"""A slow, plain oracle for intersecting triangles, in rationals.

It shares nothing with the code under test, neither the predicates nor the method: the
intersection of two convex sets is the hull of few candidate points (corners of one in the
other, crossings of an edge with an edge or a plane), so all of them are computed and looked
at. Faces may be degenerate.

The kind follows from one more fact of convexity: the mean of these points lies in the relative
inside of the common part, and so in the insides of both triangles if these meet at all.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

Vector = tuple[int | Fraction, int | Fraction, int | Fraction]


def meet_outside_shared(vertices, face, other) -> bool:
    """Whether two faces have a common point outside the hull of their shared vertices."""
    return kind_of_intersection(vertices, face, other) != "none"


def kind_of_intersection(vertices, face, other) -> str:
    """The lower-case name of the `IntersectionKind` that two faces should get."""
    shared = sorted(set(map(int, face)) & set(map(int, other)))
    if len(shared) == 3:
        return "duplicate"
    used = sorted({*map(int, face), *map(int, other)})
    points = dict(zip(used, _integers([vertices[i] for i in used]), strict=True))
    first, second, corners = ([points[int(i)] for i in s] for s in (face, other, shared))
    hull_of_shared = {0: None, 1: corners * 3, 2: (corners * 2)[:3]}[len(shared)]
    common = list(_common_points(first, second))
    if all(hull_of_shared is not None and _in_hull(x, hull_of_shared) for x in common):
        return "none"
    if not any(_normal(first)) or not any(_normal(second)):
        return "degenerate"
    middle = tuple(Fraction(sum(c), len(common)) for c in zip(*common, strict=True))
    if not (_in_hull(middle, first, strictly=True) and _in_hull(middle, second, strictly=True)):
        return "touching"
    if any(_cross(_normal(first), _normal(second))):
        return "crossing"
    return "fold" if shared else "overlap"


def _common_points(first, second):
    for a, b in ((first, second), (second, first)):
        yield from (x for x in a if _in_hull(x, b))
        normal = _normal(b)
        for p, q in combinations(a, 2):
            climb = _dot(normal, _sub(q, p))
            if climb != 0:
                t = Fraction(_dot(normal, _sub(b[0], p)), climb)
                x = _along(p, q, t)
                if 0 <= t <= 1 and _in_hull(x, b):
                    yield x
    for p, q in combinations(first, 2):
        for r, s in combinations(second, 2):
            x = _crossing(p, q, r, s)
            if x is not None:
                yield x


def _crossing(p, q, r, s):
    """The single common point of two segments that are not parallel, if there is one."""
    u, v, w = _sub(q, p), _sub(s, r), _sub(r, p)
    n = _cross(u, v)
    squared = _dot(n, n)
    if squared == 0 or _dot(w, n) != 0:
        return None
    t = Fraction(_dot(_cross(w, v), n), squared)
    k = Fraction(_dot(_cross(w, u), n), squared)
    return _along(p, q, t) if 0 <= t <= 1 and 0 <= k <= 1 else None


def _normal(corners) -> Vector:
    a, b, c = corners
    return _cross(_sub(b, a), _sub(c, a))


def _in_hull(x, corners, strictly: bool = False) -> bool:
    a, b, c = corners
    normal = _normal(corners)
    if not any(normal):
        return any(_in_segment(x, p, q) for p, q in combinations(corners, 2))
    weights = [_dot(normal, _cross(_sub(q, p), _sub(x, p))) for p, q in ((a, b), (b, c), (c, a))]
    return _dot(normal, _sub(x, a)) == 0 and all(w > 0 if strictly else w >= 0 for w in weights)


def _in_segment(x, p, q) -> bool:
    if any(_cross(_sub(q, p), _sub(x, p))):
        return False
    return all(min(s, e) <= c <= max(s, e) for c, s, e in zip(x, p, q, strict=True))


def _integers(points) -> list[Vector]:
    """Points times their coordinates' common denominator: floats are rational numbers."""
    ratios = [[float(c).as_integer_ratio() for c in p] for p in points]
    common = max(d for p in ratios for _, d in p)  # all are powers of two
    return [tuple(n * (common // d) for n, d in p) for p in ratios]


def _along(p, q, t) -> Vector:
    return tuple(s + t * (e - s) for s, e in zip(p, q, strict=True))


def _sub(a, b) -> Vector:
    return tuple(s - e for s, e in zip(a, b, strict=True))


def _dot(a, b) -> int | Fraction:
    return sum(s * e for s, e in zip(a, b, strict=True))


def _cross(a, b) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
