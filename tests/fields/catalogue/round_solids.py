"""Solids of revolution, and ellipsoids."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

import fields as sdf
from fields import Field
from tests.fields.catalogue.surface import REACH
from tests.fields.second_descriptions import arc, line, outline, radial, revolved

A, B = np.array([-0.4, 0.3, -0.5]), np.array([0.5, -0.2, 0.7])
AXIS = (B - A) / np.linalg.norm(B - A)
SIZE = float(np.linalg.norm(B - A))

EXAMPLES: dict[str, Field] = {
    "rounded_cylinder": sdf.rounded_cylinder(0.8, 1.2, 0.25),
    "rounded_cylinder, fully": sdf.rounded_cylinder(0.5, 1.6, 0.5),
    "capped_cone": sdf.capped_cone(A, B, 0.7, 0.3),
    "capped_cone, a cone": sdf.capped_cone((0, 0, -0.8), (0, 0, 0.8), 0.8, 0.0),
    "capped_cone, a cylinder": sdf.capped_cone(B, A, 0.4, 0.4),
    "rounded_cone": sdf.rounded_cone(A, B, 0.6, 0.2),
    "rounded_cone, wider": sdf.rounded_cone((0, 0, 0), (0, 0, 0.6), 0.3, 0.7),
    "infinite_cone": sdf.infinite_cone(70),
    "infinite_cone, more than half": sdf.infinite_cone(250),
    "solid_angle": sdf.solid_angle(1.3, 80),
    "solid_angle, more than half": sdf.solid_angle(1.1, 260),
    "cut_sphere": sdf.cut_sphere(1.2, 0.4),
    "cut_sphere, most": sdf.cut_sphere(1.1, -0.6),
    "cut_hollow_sphere": sdf.cut_hollow_sphere(1.1, 0.5, 0.2),
    "cut_hollow_sphere, flat": sdf.cut_hollow_sphere(1.3, -0.7, 0.3),
    "cut_hollow_sphere, nearly closed": sdf.cut_hollow_sphere(1.0, 0.99, 0.4),
    "death_star": sdf.death_star(1.1, 0.8, 1.2),
    "death_star, deep": sdf.death_star(1.1, 1.0, 0.5),
    "death_star, a slice": sdf.death_star(1.1, 2.0, 1.5),
    "lens": sdf.lens(2.4, 0.8),
    "spindle": sdf.spindle(2.4, 1.0),
    "egg": sdf.egg(0.8, 0.3, 0.9),
    "egg, blunt": sdf.egg(0.8, 0.7, 0.4),
    "ellipsoid": sdf.ellipsoid((1.5, 1.0, 0.5)),
    "ellipsoid, exact": sdf.ellipsoid((1.5, 1.0, 0.5), exact=True),
    "ellipsoid, oblate, exact": sdf.ellipsoid((1.2, 1.2, 0.4), exact=True),
    "ellipsoid, prolate, exact": sdf.ellipsoid((0.4, 0.4, 1.3), exact=True),
    "ellipsoid, a ball, exact": sdf.ellipsoid(0.9, exact=True),
    "superellipsoid": sdf.superellipsoid((1.2, 0.9, 0.7), 4),
    "superellipsoid, pointed": sdf.superellipsoid(1.1, 1.2),
    "superellipsoid, a cylinder": sdf.superellipsoid((0.9, 0.9, 0.6), 2, vertical=8),
    "superellipsoid, a double cone": sdf.superellipsoid((0.9, 0.7, 1.0), 2, vertical=1),
}


def _frame():
    other = np.cross(AXIS, [1.0, 0, 0])
    other /= np.linalg.norm(other)
    return np.stack([np.cross(other, AXIS), other, AXIS])


def _place(points):
    return points @ _frame() + A


def _unplace(points):
    return (points - A) @ _frame().T


def _grown_capsule(r, z):
    """Balls that slide along the axis while their radius changes evenly."""
    t = np.linspace(0, 1, 4001)[:, None]
    gap = np.hypot(r, z - SIZE * t) - (0.6 + t * (0.2 - 0.6))
    return gap.min(axis=0) < 0


def _round_cone_profile():
    """The arcs end where the common tangent touches."""
    lean = np.degrees(np.arcsin((0.6 - 0.2) / SIZE))
    low, high = arc((0, 0), 0.6, -90, lean), arc((0, SIZE), 0.2, lean, 90)
    return [low, high, line(low(np.array([1.0]))[0], high(np.array([0.0]))[0])]


def _cone_side(half, reach):
    side = np.radians(half)
    return line((0, 0), (reach * np.sin(side), reach * np.cos(side)))


def _angle(r, z):
    return np.degrees(np.arctan2(r, z))


def _rim(radius, height):
    """The angle of a sphere's circle at a height, from its equator."""
    return np.degrees(np.arcsin(height / radius))


def _cut(radius, height):
    rim = np.sqrt(radius**2 - height**2)
    return [line((0, height), (rim, height)), arc((0, 0), radius, _rim(radius, height), 90)]


def _bowl(radius, height, half):
    rim = _rim(radius, height)
    middle = arc((0, 0), radius, -90, rim)(np.array([1.0]))[0]
    return [
        arc((0, 0), radius - half, -90, rim),
        arc((0, 0), radius + half, -90, rim),
        arc(middle, half, rim, rim + 180),
    ]


def _in_bowl(radius, height, half):
    path = arc((0, 0), radius, -90, _rim(radius, height))(np.linspace(0, 1, 40_001))
    tree = cKDTree(path)
    return lambda r, z: tree.query(np.stack([r, z], axis=1))[0] < half


def _bitten(radius, bite, distance):
    height = (radius**2 - bite**2 + distance**2) / (2 * distance)
    return [
        arc((0, 0), radius, -90, _rim(radius, height)),
        arc((0, distance), bite, -90, _rim(bite, height - distance)),
    ]


def _lens(half_width, half):
    depth = (half_width**2 - half**2) / (2 * half)
    rim = np.degrees(np.arctan2(depth, half_width))
    return [arc((0, s * depth), depth + half, -s * 90, -s * rim) for s in (-1, 1)]


def _in_lens(r, z):
    depth = (1.2**2 - 0.4**2) / 0.8
    return np.hypot(r, np.abs(z) + depth) < depth + 0.4


def _in_vesica(r, z):
    depth = (1.2**2 - 0.5**2) / 1.0
    return np.hypot(r + depth, z) < depth + 0.5


VESICA_DEPTH = (1.2**2 - 0.5**2) / 1.0
VESICA_TIP = np.degrees(np.arctan2(1.2, VESICA_DEPTH))
EGG_DEPTH = (0.9**2 - 0.5**2) / (2 * 0.5)
EGG_TURN = np.degrees(np.arctan2(0.9, EGG_DEPTH))


def _in_egg(r, z):
    """The profile, region by region: ball, ball, and below the arc between them."""
    ball = (r**2 + z**2 < 0.64) & (z < 0)
    cap = r**2 + (z - 0.9) ** 2 < 0.09
    arc_part = (np.hypot(r + EGG_DEPTH, z) < EGG_DEPTH + 0.8) & (z >= 0)
    return ball | cap | (arc_part & (np.arctan2(z, r + EGG_DEPTH) < np.radians(EGG_TURN)))


def _gauge(radii, n, m=None):
    def norm(p):
        x, y, z = np.abs(p / np.array(radii)).T
        m_ = n if m is None else m
        return ((x**n + y**n) ** (m_ / n) + z**m_) ** (1 / m_)

    return norm


SURFACES = {
    "rounded_cylinder": revolved(
        EXAMPLES["rounded_cylinder"],
        [
            *outline((0, -0.6), (0.55, -0.6)),
            *outline((0.8, -0.35), (0.8, 0.35)),
            *outline((0, 0.6), (0.55, 0.6)),
            arc((0.55, 0.35), 0.25, 0, 90),
            arc((0.55, -0.35), 0.25, -90, 0),
        ],
        lambda r, z: np.hypot(np.maximum(r - 0.55, 0), np.maximum(abs(z) - 0.35, 0)) < 0.25,
    ),
    "capped_cone": revolved(
        EXAMPLES["capped_cone"],
        outline((0, 0), (0.7, 0), (0.3, SIZE), (0, SIZE)),
        lambda r, z: (z > 0) & (z < SIZE) & (r < 0.7 - 0.4 * z / SIZE),
        _place,
        _unplace,
    ),
    "rounded_cone": revolved(
        EXAMPLES["rounded_cone"], _round_cone_profile(), _grown_capsule, _place, _unplace
    ),
    "infinite_cone": revolved(
        EXAMPLES["infinite_cone"],
        [_cone_side(35, 2 * REACH)],
        lambda r, z: _angle(r, z) < 35,
    ),
    "infinite_cone, more than half": revolved(
        EXAMPLES["infinite_cone, more than half"],
        [_cone_side(125, 2 * REACH)],
        lambda r, z: _angle(r, z) < 125,
    ),
    "solid_angle": revolved(
        EXAMPLES["solid_angle"],
        [_cone_side(40, 1.3), arc((0, 0), 1.3, 50, 90)],
        lambda r, z: (_angle(r, z) < 40) & (np.hypot(r, z) < 1.3),
    ),
    "solid_angle, more than half": revolved(
        EXAMPLES["solid_angle, more than half"],
        [_cone_side(130, 1.1), arc((0, 0), 1.1, -40, 90)],
        lambda r, z: (_angle(r, z) < 130) & (np.hypot(r, z) < 1.1),
    ),
    "cut_sphere": revolved(
        EXAMPLES["cut_sphere"], _cut(1.2, 0.4), lambda r, z: (np.hypot(r, z) < 1.2) & (z > 0.4)
    ),
    "cut_sphere, most": revolved(
        EXAMPLES["cut_sphere, most"],
        _cut(1.1, -0.6),
        lambda r, z: (np.hypot(r, z) < 1.1) & (z > -0.6),
    ),
    "cut_hollow_sphere": revolved(
        EXAMPLES["cut_hollow_sphere"], _bowl(1.1, 0.5, 0.1), _in_bowl(1.1, 0.5, 0.1)
    ),
    "cut_hollow_sphere, flat": revolved(
        EXAMPLES["cut_hollow_sphere, flat"], _bowl(1.3, -0.7, 0.15), _in_bowl(1.3, -0.7, 0.15)
    ),
    "death_star": revolved(
        EXAMPLES["death_star"],
        _bitten(1.1, 0.8, 1.2),
        lambda r, z: (np.hypot(r, z) < 1.1) & (np.hypot(r, z - 1.2) > 0.8),
    ),
    "death_star, deep": revolved(
        EXAMPLES["death_star, deep"],
        _bitten(1.1, 1.0, 0.5),
        lambda r, z: (np.hypot(r, z) < 1.1) & (np.hypot(r, z - 0.5) > 1.0),
    ),
    "death_star, a slice": revolved(
        EXAMPLES["death_star, a slice"],
        _bitten(1.1, 2.0, 1.5),
        lambda r, z: (np.hypot(r, z) < 1.1) & (np.hypot(r, z - 1.5) > 2.0),
    ),
    "lens": revolved(EXAMPLES["lens"], _lens(1.2, 0.4), _in_lens),
    "spindle": revolved(
        EXAMPLES["spindle"],
        [arc((-VESICA_DEPTH, 0), VESICA_DEPTH + 0.5, -VESICA_TIP, VESICA_TIP)],
        _in_vesica,
    ),
    "egg": revolved(
        EXAMPLES["egg"],
        [
            arc((0, 0), 0.8, -90, 0),
            arc((-EGG_DEPTH, 0), EGG_DEPTH + 0.8, 0, EGG_TURN),
            arc((0, 0.9), 0.3, EGG_TURN, 90),
        ],
        _in_egg,
    ),
    "ellipsoid": radial(EXAMPLES["ellipsoid"], _gauge((1.5, 1.0, 0.5), 2)),
    "ellipsoid, exact": radial(EXAMPLES["ellipsoid, exact"], _gauge((1.5, 1.0, 0.5), 2)),
    "ellipsoid, oblate, exact": radial(
        EXAMPLES["ellipsoid, oblate, exact"], _gauge((1.2, 1.2, 0.4), 2)
    ),
    "ellipsoid, prolate, exact": radial(
        EXAMPLES["ellipsoid, prolate, exact"], _gauge((0.4, 0.4, 1.3), 2)
    ),
    "superellipsoid": radial(EXAMPLES["superellipsoid"], _gauge((1.2, 0.9, 0.7), 4)),
    "superellipsoid, pointed": radial(EXAMPLES["superellipsoid, pointed"], _gauge((1.1,) * 3, 1.2)),
    "superellipsoid, a cylinder": radial(
        EXAMPLES["superellipsoid, a cylinder"], _gauge((0.9, 0.9, 0.6), 2, 8)
    ),
    "superellipsoid, a double cone": radial(
        EXAMPLES["superellipsoid, a double cone"], _gauge((0.9, 0.7, 1.0), 2, 1)
    ),
}
