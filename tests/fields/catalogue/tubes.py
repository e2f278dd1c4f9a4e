"""Tubes along curves, sheets, threads and knots."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

import fields as sdf
from fields import Field
from tests.fields.catalogue.surface import Surface
from tests.fields.second_descriptions import Piece, line, outermost, tube

ZIGZAG = np.array([(-0.9, 0.2, -0.3), (0.1, -0.6, 0.4), (0.6, 0.7, 0.5), (0.9, 0.2, -0.6)])
BENT = np.array([(-1.0, 0.3, 0.2), (0.4, -1.2, 0.1), (0.9, 0.8, -0.5)])
LONG = np.array([(-1.0, 0.0, 0.0), (0.2, 0.001, 0.0), (1.2, 0.3, 0.0)])
CORNERS = np.array([(-0.8, -0.5, 0.1), (0.9, -0.4, -0.3), (0.1, 0.9, 0.4)])
SQUARE = np.array([(-0.8, -0.5, 0.2), (0.7, -0.6, 0.5), (0.9, 0.5, 0.54), (-0.6, 0.8, 0.24)])
SQUARE[3, 2] += (
    (SQUARE[0] - SQUARE[3])
    @ np.cross(SQUARE[1] - SQUARE[0], SQUARE[2] - SQUARE[0])
    / np.cross(SQUARE[1] - SQUARE[0], SQUARE[2] - SQUARE[0])[2]
)

EXAMPLES: dict[str, Field] = {
    "capped_torus": sdf.capped_torus(1.0, 0.25, 140),
    "capped_torus, more than half": sdf.capped_torus(0.9, 0.2, 290),
    "capped_torus, ends that meet": sdf.capped_torus(0.9, 0.3, 345),
    "link": sdf.link(1.0, 0.6, 0.2),
    "polyline_tube": sdf.polyline_tube(ZIGZAG, 0.2),
    "polyline_tube, one piece": sdf.polyline_tube(ZIGZAG[:2], 0.3),
    "triangle_plate": sdf.triangle_plate(*CORNERS, 0.3),
    "quad_plate": sdf.quad_plate(*SQUARE, 0.2),
    "bezier_tube": sdf.bezier_tube(*BENT, 0.25),
    "bezier_tube, thick": sdf.bezier_tube(*BENT, 0.9),
    "bezier_tube, nearly straight": sdf.bezier_tube(*LONG, 0.3),
    "bezier_tube, straight": sdf.bezier_tube((0, 0, 0), (0.5, 0.2, 0), (1, 0.4, 0), 0.3),
    "bezier_tube, back and forth": sdf.bezier_tube((0, 0, 0), (2, 0, 0), (0.5, 0, 0), 0.3),
    "helix": sdf.helix(0.9, 0.2, 0.8, 2.3),
    "helix, flat ends": sdf.helix(0.9, 0.2, 0.8, 1.7, ends="flat"),
    "helix, left": sdf.helix(0.6, 0.25, 2.0, 1.2, hand="left"),
    "helix, an arc": sdf.helix(1.0, 0.2, 0.5, 0.6, ends="flat"),
    "helix, an arc with round ends": sdf.helix(1.0, 0.2, 1.5, 0.4),
    "helix, turns that meet": sdf.helix(0.8, 0.3, 0.4, 2.0),
    "helix, flat turns that meet": sdf.helix(0.8, 0.3, 0.4, 2.0, ends="flat"),
    "helix, steep": sdf.helix(0.3, 0.2, 3.0, 0.8, ends="flat"),
    "thread": sdf.thread(1.6, 0.4, 1.5),
    "thread, left, three starts": sdf.thread(1.8, 0.3, 1.2, starts=3, hand="left"),
    "thread, coarse": sdf.thread(1.0, 0.8, 2.0),
    "torus_knot": sdf.torus_knot(2, 3, 1.0, 0.4, 0.15),
    "torus_knot, a coil": sdf.torus_knot(1, 5, 0.9, 0.3, 0.2),
    "torus_knot, five": sdf.torus_knot(5, 2, 1.0, 0.35, 0.12),
}


def _arc(radius: float, angle: float) -> Piece:
    def points(t: np.ndarray) -> np.ndarray:
        a = np.radians(angle) * (t - 0.5)
        return np.stack([radius * np.cos(a), radius * np.sin(a), 0 * a], axis=1)

    return points


def _link() -> list[Piece]:
    def turn(sign: float) -> Piece:
        def points(t: np.ndarray) -> np.ndarray:
            a = np.pi * (t - 0.5)
            return sign * np.stack([0.5 + 0.6 * np.cos(a), 0.6 * np.sin(a), 0 * a], axis=1)

        return points

    sides = [line((-0.5, y, 0), (0.5, y, 0)) for y in (-0.6, 0.6)]
    return [turn(1.0), turn(-1.0), *sides]


def _bezier(a, b, c) -> Piece:
    return lambda t: (
        ((1 - t) ** 2)[:, None] * a + (2 * t * (1 - t))[:, None] * b + (t**2)[:, None] * c
    )


def _helix(radius, pitch, turns, side=1.0) -> Piece:
    def points(t: np.ndarray) -> np.ndarray:
        a = 2 * np.pi * turns * (t - 0.5)
        z = pitch * a / (2 * np.pi)
        return np.stack([radius * np.cos(a), side * radius * np.sin(a), z], axis=1)

    return points


def _flat_helix(field: Field, radius, thin, pitch, turns) -> Surface:
    a = np.pi * turns * np.array([-1.0, 1.0])
    rise = np.full(2, pitch / (2 * np.pi))
    tangents = np.stack([-radius * np.sin(a), radius * np.cos(a), rise], axis=1)
    return tube(field, [_helix(radius, pitch, turns)], thin, flat=tangents)


def _plate(field: Field, corners: np.ndarray, thickness: float) -> Surface:
    """A point of a face, an edge or a corner, and a direction that is normal there."""
    half = thickness / 2
    following = np.roll(corners, -1, axis=0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    outward = np.cross(following - corners, normal)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)

    def flat(rng, n):
        weights, which = rng.dirichlet((1, 1, 1), n), rng.integers(2, len(corners), n)
        triangles = np.stack([corners[which * 0], corners[which - 1], corners[which]], axis=1)
        return (weights[..., None] * triangles).sum(axis=1)

    def sample(rng, n):
        share = n // 3
        which, t = rng.integers(len(corners), size=share), rng.uniform(size=(share, 1))
        up = rng.normal(size=(share, 1)) * normal
        edge = corners[which] + t * (following - corners)[which]
        along_edge = up + np.abs(rng.normal(size=(share, 1))) * outward[which]
        at_corner = along_edge + np.abs(rng.normal(size=(share, 1))) * outward[which - 1]
        feet = np.concatenate([flat(rng, share), edge, corners[which]])
        ways = np.concatenate([np.sign(up @ normal)[:, None] * normal, along_edge, at_corner])
        return feet + half * ways / np.linalg.norm(ways, axis=1, keepdims=True)

    rims = [tube(field, [line(a, b)], half) for a, b in zip(corners, following, strict=True)]

    def inside(p):
        relative = p[:, None] - corners
        over = ((relative * outward).sum(axis=-1) < 0).all(axis=1)
        near = np.any([rim.inside(p) for rim in rims], axis=0)
        return near | (over & (np.abs(relative[:, 0] @ normal) < half))

    return Surface(field, sample, inside)


def _thread_radius(z, angle, crest, pitch, lead):
    """The profile of ISO 68-1 by interpolation between its corners."""
    phase = np.mod((z - lead * angle / (2 * np.pi)) / pitch, 1.0)
    root = crest - 0.625 * np.sqrt(0.75) * pitch
    return np.interp(
        phase, [0, 1 / 16, 3 / 8, 5 / 8, 15 / 16, 1], [crest, crest, root, root, crest, crest]
    )


def _thread(field: Field, crest: float, pitch: float, lead: float, height: float) -> Surface:
    def sample(rng, n):
        angle = rng.uniform(-np.pi, np.pi, n)
        z = rng.uniform(-height / 2, height / 2, n)
        z[: n // 3] = rng.choice([-height / 2, height / 2], n // 3)
        r = _thread_radius(z, angle, crest, pitch, lead)
        r[: n // 3] *= np.sqrt(rng.uniform(size=n // 3))
        return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)

    def inside(p):
        r, angle = np.hypot(p[:, 0], p[:, 1]), np.arctan2(p[:, 1], p[:, 0])
        below = r < _thread_radius(p[:, 2], angle, crest, pitch, lead)
        return below & (np.abs(p[:, 2]) < height / 2)

    return Surface(field, sample, inside)


def _knot(field: Field, p: int, q: int, major: float, minor: float, radius: float) -> Surface:
    """Discs in the half-planes through the axis, around each crossing."""

    def centers(turn):
        winding = q / p * turn
        return major + minor * np.cos(winding), minor * np.sin(winding)

    def sample(rng, n):
        turn, around = rng.uniform(0, 2 * np.pi * p, n), rng.uniform(0, 2 * np.pi, n)
        r, z = centers(turn)
        r, z = r + radius * np.cos(around), z + radius * np.sin(around)
        points = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
        return points[~inside(points, radius - 1e-9)]

    def inside(points, size=radius):
        turn = np.arctan2(points[:, 1], points[:, 0])
        within = np.zeros(len(points), dtype=bool)
        for lap in range(p):
            r, z = centers(turn + 2 * np.pi * lap)
            within |= np.hypot(np.hypot(points[:, 0], points[:, 1]) - r, points[:, 2] - z) < size
        return within

    return Surface(field, sample, inside)


def _from_line(p):
    """The distance to the zigzag, from dense points of it: good to 1e-8 at the tube's radius."""
    t = np.linspace(0, 1, 40_001)[:, None]
    dense = np.concatenate([a + t * (b - a) for a, b in pairwise(ZIGZAG)])
    return cKDTree(dense).query(p)[0] - 0.2


SURFACES = {
    "capped_torus": tube(EXAMPLES["capped_torus"], [_arc(1.0, 140)], 0.25),
    "capped_torus, more than half": tube(
        EXAMPLES["capped_torus, more than half"], [_arc(0.9, 290)], 0.2
    ),
    "link": tube(EXAMPLES["link"], _link(), 0.2, closed=True),
    "polyline_tube": outermost(
        tube(
            EXAMPLES["polyline_tube"],
            [line(a, b) for a, b in pairwise(ZIGZAG)],
            0.2,
        ),
        _from_line,
    ),
    "triangle_plate": _plate(EXAMPLES["triangle_plate"], CORNERS, 0.3),
    "quad_plate": _plate(EXAMPLES["quad_plate"], SQUARE, 0.2),
    "bezier_tube": tube(EXAMPLES["bezier_tube"], [_bezier(*BENT)], 0.25),
    "bezier_tube, nearly straight": tube(
        EXAMPLES["bezier_tube, nearly straight"], [_bezier(*LONG)], 0.3
    ),
    "helix": tube(EXAMPLES["helix"], [_helix(0.9, 0.8, 2.3)], 0.2),
    "helix, flat ends": _flat_helix(EXAMPLES["helix, flat ends"], 0.9, 0.2, 0.8, 1.7),
    "helix, left": tube(EXAMPLES["helix, left"], [_helix(0.6, 2.0, 1.2, -1.0)], 0.25),
    "helix, an arc": _flat_helix(EXAMPLES["helix, an arc"], 1.0, 0.2, 0.5, 0.6),
    "helix, an arc with round ends": tube(
        EXAMPLES["helix, an arc with round ends"], [_helix(1.0, 1.5, 0.4)], 0.2
    ),
    "helix, steep": _flat_helix(EXAMPLES["helix, steep"], 0.3, 0.2, 3.0, 0.8),
    "thread": _thread(EXAMPLES["thread"], 0.8, 0.4, 0.4, 1.5),
    "thread, left, three starts": _thread(
        EXAMPLES["thread, left, three starts"], 0.9, 0.3, -0.9, 1.2
    ),
    "torus_knot": _knot(EXAMPLES["torus_knot"], 2, 3, 1.0, 0.4, 0.15),
    "torus_knot, five": _knot(EXAMPLES["torus_knot, five"], 5, 2, 1.0, 0.35, 0.12),
}
