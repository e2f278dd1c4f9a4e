"""Two-dimensional shapes. Surfaces are sampled within `REACH` along z."""

from __future__ import annotations

import numpy as np

import fields as sdf
from fields import Field
from fields.profiles.curves import _through, chords
from tests.fields.catalogue.surface import REACH, Surface

L_SHAPE = np.array([(-1, -1), (1, -1), (1, -0.2), (0, 0), (0.2, 1), (-1, 1)], dtype=float)
_ANGLES = np.linspace(0, 2 * np.pi, 90, endpoint=False)
_WAVE = 1 + 0.25 * np.sin(5 * _ANGLES)
FLOWER = np.stack([_WAVE * np.cos(_ANGLES), _WAVE * np.sin(_ANGLES)], axis=1)
KNOTS = np.array([(1, 0), (0.5, 0.7), (-0.9, 0.6), (-0.4, -0.1), (-0.6, -0.9)])
BENT = np.array([(-1, -0.5), (0, 0.5), (0.4, -0.4), (1, 0.2)])
MANY = np.stack([np.linspace(-1, 1, 70), 0.5 * np.sin(np.linspace(-3, 3, 70))], axis=1)
RADII = (1.3, 0.6)
OUTLINE = np.array([(0.7, -0.9), (0.9, -0.2), (0.4, 0.2), (0.5, 0.6), (0, 1)])

EXAMPLES: dict[str, Field] = {
    "circle": sdf.circle(0.8, (0.3, -0.2)),
    "ellipse": sdf.ellipse(RADII),
    "ellipse, upright": sdf.ellipse((0.4, 1.1)),
    "ring": sdf.ring(0.9, 0.4),
    "arc": sdf.arc(0.9, 0.4, 250),
    "arc, short": sdf.arc(0.9, 0.4, 80),
    "pie": sdf.pie(1.1, 75),
    "pie, most of it": sdf.pie(1.1, 290),
    "vesica": sdf.vesica(1.0, 2.2),
    "moon": sdf.moon(1.1, 0.9, 0.5),
    "moon, shallow": sdf.moon(1.0, 0.5, 1.2),
    "line": sdf.line((-0.8, 0.1), (0.7, -0.4), 0.5),
    "uneven_capsule": sdf.uneven_capsule(0.6, 0.25, 1.1),
    "uneven_capsule, top heavy": sdf.uneven_capsule(0.2, 0.5, 0.9),
    "rectangle": sdf.rectangle((1.6, 0.9), center=(0.2, -0.1)),
    "rounded_rectangle": sdf.rounded_rectangle((1.6, 1.2), 0.3),
    "rounded_rectangle, uneven": sdf.rounded_rectangle((1.6, 1.2), (0.6, 0, 0.3, 0.1)),
    "strip": sdf.strip(0.7),
    "cross": sdf.cross(2.0, 0.6),
    "triangle": sdf.triangle(1.8, 1.4),
    "trapezoid": sdf.trapezoid(0.8, 1.7, 1.1),
    "rhombus": sdf.rhombus(2.0, 1.2),
    "parallelogram": sdf.parallelogram(1.2, 0.9, 0.8),
    "regular_polygon": sdf.regular_polygon(7, 1.1),
    "hexagon": sdf.hexagon(1.7),
    "octagon": sdf.octagon(1.7),
    "star": sdf.star(5, 1.2, 0.5),
    "polygon": sdf.polygon(L_SHAPE),
    "polygon, searched": sdf.polygon(FLOWER),
    "polyline": sdf.polyline(BENT, 0.3),
    "polyline, searched": sdf.polyline(MANY, 0.3),
    "spline": sdf.spline(KNOTS, tolerance=0.02),
    "profiles combined": (sdf.rectangle(1.5) - sdf.circle(0.4)).rotate(30).offset(0.1),
    "lathe": sdf.lathe(OUTLINE),
}


def _upright(rng, points):
    return np.column_stack([points, rng.uniform(-REACH, REACH, len(points))])


def _chosen(rng, weights, n):
    return rng.choice(len(weights), n, p=np.array(weights) / np.sum(weights))


def _on_chain(rng, n, corners):
    """Points on the segments between corners, and on which segment each is."""
    along = np.diff(corners, axis=0)
    index = _chosen(rng, np.hypot(*along.T), n)
    return corners[index] + rng.uniform(0, 1, (n, 1)) * along[index], index


def _in_polygon(p, corners):
    """Crossings of the ray to the right."""
    inside = np.zeros(len(p), dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        straddles = (ay > p[:, 1]) != (by > p[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= straddles & (p[:, 0] < ax + (p[:, 1] - ay) * (bx - ax) / (by - ay))
    return inside


def _polygonal(label, corners):
    corners = np.array(corners, dtype=float)
    closed = np.concatenate([corners, corners[:1]])
    return Surface(
        EXAMPLES[label],
        lambda rng, n: _upright(rng, _on_chain(rng, n, closed)[0]),
        lambda p: _in_polygon(p, corners),
    )


def _on_arcs(*arcs):
    """A sampler of arcs, each (centre x, centre y, radius, from, to) in radians."""
    table = np.array(arcs, dtype=float)

    def sample(rng, n):
        index = _chosen(rng, table[:, 2] * (table[:, 4] - table[:, 3]), n)
        x, y, r, low, high = table[index].T
        angle = rng.uniform(low, high)
        return _upright(rng, np.stack([x + r * np.cos(angle), y + r * np.sin(angle)], axis=1))

    return sample


def _mixed(*parts):
    """A sampler that draws from several in turn."""

    def sample(rng, n):
        return np.concatenate([part(rng, n // len(parts)) for part in parts])

    return sample


def _on_segments(*segments):
    def sample(rng, n):
        ends = np.array(segments, dtype=float)
        index = _chosen(rng, np.hypot(*(ends[:, 1] - ends[:, 0]).T), n)
        t = rng.uniform(0, 1, (n, 1))
        return _upright(rng, ends[index, 0] + t * (ends[index, 1] - ends[index, 0]))

    return sample


def _radius(p, x=0.0, y=0.0):
    return np.hypot(p[:, 0] - x, p[:, 1] - y)


def _angle(p):
    return np.abs(np.degrees(np.arctan2(p[:, 1], p[:, 0])))


def _distance_to_chain(p, corners):
    along = np.diff(corners, axis=0)
    relative = p[:, None, :2] - corners[:-1]
    t = ((relative * along).sum(-1) / (along**2).sum(-1)).clip(0, 1)
    return np.linalg.norm(relative - t[..., None] * along, axis=-1).min(axis=1)


def _on_thick_chain(corners, half):
    """Points at a distance from a chain: beside its segments and around its corners."""

    def sample(rng, n):
        base, index = _on_chain(rng, n, corners)
        along = np.diff(corners, axis=0)[index]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        base += rng.choice([-half, half], (n, 1)) * normal
        angle = rng.uniform(0, 2 * np.pi, n)
        round_ = corners[rng.integers(0, len(corners), n)]
        round_ = round_ + half * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        points = np.concatenate([base, round_])
        return _upright(rng, points[_distance_to_chain(points, corners) > half - 1e-13])

    return sample


def _on_ellipse(rng, n):
    t = rng.uniform(0, 2 * np.pi, n)
    return _upright(rng, np.stack([RADII[0] * np.cos(t), RADII[1] * np.sin(t)], axis=1))


def _on_strip(rng, n):
    points = rng.uniform(-REACH, REACH, (n, 3))
    points[:, 1] = rng.choice([-0.35, 0.35], n)
    return points


def _pie():
    end = 1.1 * np.array([np.cos(np.radians(37.5)), np.sin(np.radians(37.5))])
    sample = _mixed(
        _on_arcs((0, 0, 1.1, -np.radians(37.5), np.radians(37.5))),
        _on_segments([(0, 0), end], [(0, 0), end * [1, -1]]),
    )
    return Surface(EXAMPLES["pie"], sample, lambda p: (_radius(p) < 1.1) & (_angle(p) < 37.5))


def _arc():
    half = np.radians(125)
    end = 0.9 * np.array([np.cos(half), np.sin(half)])
    sample = _on_arcs(
        (0, 0, 1.1, -half, half),
        (0, 0, 0.7, -half, half),
        (*end, 0.2, half, half + np.pi),
        (end[0], -end[1], 0.2, np.pi - half, 2 * np.pi - half),
    )

    def inside(p):
        in_band = (np.abs(_radius(p) - 0.9) < 0.2) & (_angle(p) < 125)
        return in_band | (np.hypot(p[:, 0] - end[0], np.abs(p[:, 1]) - end[1]) < 0.2)

    return Surface(EXAMPLES["arc"], sample, inside)


def _vesica():
    shift, radius = (1.1**2 / 0.5 - 0.5) / 2, (1.1**2 / 0.5 + 0.5) / 2
    tip = np.arctan2(1.1, shift)
    sample = _on_arcs((-shift, 0, radius, -tip, tip), (shift, 0, radius, np.pi - tip, np.pi + tip))
    return Surface(
        EXAMPLES["vesica"],
        sample,
        lambda p: (_radius(p, -shift) < radius) & (_radius(p, shift) < radius),
    )


def _moon():
    x = (1.1**2 - 0.9**2 + 0.5**2) / (2 * 0.5)
    y = np.sqrt(1.1**2 - x**2)
    outer, bite = np.arctan2(y, x), np.arctan2(y, x - 0.5)
    sample = _on_arcs((0, 0, 1.1, outer, 2 * np.pi - outer), (0.5, 0, 0.9, bite, 2 * np.pi - bite))
    return Surface(EXAMPLES["moon"], sample, lambda p: (_radius(p) < 1.1) & (_radius(p, 0.5) > 0.9))


def _uneven_capsule():
    tilt = np.arcsin((0.6 - 0.25) / 1.1)
    low, high = np.array([0, -0.55]), np.array([0, 0.55])
    normal = np.array([np.cos(tilt), np.sin(tilt)])
    sides = [(low + 0.6 * normal * m, high + 0.25 * normal * m) for m in ([1, 1], [-1, 1])]
    sample = _mixed(
        _on_arcs(
            (0, -0.55, 0.6, np.pi - tilt, 2 * np.pi + tilt), (0, 0.55, 0.25, tilt, np.pi - tilt)
        ),
        _on_segments(*sides),
    )

    def inside(p):
        """In a disc of those whose centres and radii go evenly from one to the other."""
        t = np.linspace(0, 1, 801)[:, None]
        gaps = np.hypot(p[:, 0], p[:, 1] + 0.55 - 1.1 * t) - (0.6 - 0.35 * t)
        return gaps.min(axis=0) < 0

    return Surface(EXAMPLES["uneven_capsule"], sample, inside)


def _rounded_rectangle():
    x, y = 0.8 - 0.3, 0.6 - 0.3
    quarter = np.pi / 2
    sample = _mixed(
        _on_arcs(
            *((sx * x, sy * y, 0.3, k * quarter, (k + 1) * quarter)
              for k, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]))
        ),
        _on_segments(
            [(0.8, -y), (0.8, y)], [(-0.8, -y), (-0.8, y)], [(-x, 0.6), (x, 0.6)],
            [(-x, -0.6), (x, -0.6)],
        ),
    )  # fmt: skip
    return Surface(
        EXAMPLES["rounded_rectangle"],
        sample,
        lambda p: np.hypot(p[:, 0] - p[:, 0].clip(-x, x), p[:, 1] - p[:, 1].clip(-y, y)) < 0.3,
    )


def _around(count, outer, inner=None):
    """Corners of a star, or of a regular polygon if `inner` is None, from the +x axis on."""
    angle = np.arange(count if inner is None else 2 * count) * 2 * np.pi
    angle /= len(angle)
    radius = np.full(len(angle), outer)
    if inner is not None:
        radius[1::2] = inner
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _lathe():
    chain = np.concatenate([[(0, OUTLINE[0, 1])], OUTLINE])

    def sample(rng, n):
        (points, _), angle = _on_chain(rng, n, chain), rng.uniform(0, 2 * np.pi, n)
        r, z = points.T
        return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)

    return Surface(
        EXAMPLES["lathe"],
        sample,
        lambda p: _in_polygon(np.stack([_radius(p), p[:, 2]], axis=1), chain),
    )


SURFACES: dict[str, Surface] = {
    "circle": Surface(
        EXAMPLES["circle"],
        _on_arcs((0.3, -0.2, 0.8, 0, 2 * np.pi)),
        lambda p: _radius(p, 0.3, -0.2) < 0.8,
    ),
    "ellipse": Surface(
        EXAMPLES["ellipse"],
        _on_ellipse,
        lambda p: (p[:, 0] / RADII[0]) ** 2 + (p[:, 1] / RADII[1]) ** 2 < 1,
    ),
    "ring": Surface(
        EXAMPLES["ring"],
        _on_arcs((0, 0, 1.1, 0, 2 * np.pi), (0, 0, 0.7, 0, 2 * np.pi)),
        lambda p: np.abs(_radius(p) - 0.9) < 0.2,
    ),
    "arc": _arc(),
    "pie": _pie(),
    "vesica": _vesica(),
    "moon": _moon(),
    "line": Surface(
        EXAMPLES["line"],
        _on_thick_chain(np.array([(-0.8, 0.1), (0.7, -0.4)]), 0.25),
        lambda p: _distance_to_chain(p, np.array([(-0.8, 0.1), (0.7, -0.4)])) < 0.25,
    ),
    "polyline": Surface(
        sdf.polyline(BENT[:2], 0.3),
        _on_thick_chain(BENT[:2], 0.15),
        lambda p: _distance_to_chain(p, BENT[:2]) < 0.15,
    ),
    "uneven_capsule": _uneven_capsule(),
    "rectangle": _polygonal(
        "rectangle", [(-0.6, -0.55), (1, -0.55), (1, 0.35), (-0.6, 0.35)]
    ),
    "rounded_rectangle": _rounded_rectangle(),
    "strip": Surface(EXAMPLES["strip"], _on_strip, lambda p: np.abs(p[:, 1]) < 0.35),
    "cross": _polygonal(
        "cross",
        [(1, -0.3), (1, 0.3), (0.3, 0.3), (0.3, 1), (-0.3, 1), (-0.3, 0.3), (-1, 0.3),
         (-1, -0.3), (-0.3, -0.3), (-0.3, -1), (0.3, -1), (0.3, -0.3)],
    ),
    "triangle": _polygonal("triangle", [(-0.9, -0.7), (0.9, -0.7), (0, 0.7)]),
    "trapezoid": _polygonal(
        "trapezoid", [(-0.4, -0.55), (0.4, -0.55), (0.85, 0.55), (-0.85, 0.55)]
    ),
    "rhombus": _polygonal("rhombus", [(1, 0), (0, 0.6), (-1, 0), (0, -0.6)]),
    "parallelogram": _polygonal(
        "parallelogram", [(-1, -0.45), (0.2, -0.45), (1, 0.45), (-0.2, 0.45)]
    ),
    "regular_polygon": _polygonal("regular_polygon", _around(7, 1.1)),
    "hexagon": _polygonal("hexagon", _around(6, 0.85 / np.cos(np.pi / 6))),
    "octagon": _polygonal(
        "octagon",
        _around(8, 0.85 / np.cos(np.pi / 8))
        @ [[np.cos(np.pi / 8), np.sin(np.pi / 8)], [-np.sin(np.pi / 8), np.cos(np.pi / 8)]],
    ),
    "star": _polygonal("star", _around(5, 1.2, 0.5)),
    "polygon": _polygonal("polygon", L_SHAPE),
    "polygon, searched": _polygonal("polygon, searched", FLOWER),
    "spline": _polygonal("spline", chords(_through(KNOTS), 0.02)),
    "lathe": _lathe(),
}  # fmt: skip
