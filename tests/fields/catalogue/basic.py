"""The first primitives, the booleans, motions and thickness."""

from __future__ import annotations

import numpy as np
import torch

import fields as sdf
from fields import Field
from tests.fields.catalogue.surface import REACH, Surface


def _twist(points: torch.Tensor) -> torch.Tensor:
    """A shear by a sine: injective, gradient norm at most 1 + 0.3."""
    x, y, z = points.unbind(-1)
    return torch.stack([x + 0.3 * torch.sin(z), y, z], dim=-1)


def _ellipsoid(points: torch.Tensor) -> torch.Tensor:
    return (points / points.new_tensor([1.5, 1.0, 0.5])).norm(dim=-1) - 1


TILT = sdf.box((1.0, 0.6, 0.4)).rotate(35, (1, 2, 3))
PEANUT = sdf.sphere(0.7, (-0.5, 0, 0)) | sdf.sphere(0.7, (0.5, 0, 0))
SHEARED = sdf.sphere(1).remap(
    _twist, lipschitz=1.3, bounds=((-1.3, -1, -1), (1.3, 1, 1)), growth=1.3, name="shear"
)
HALF_TURN = np.diag([-1.0, -1.0, 1.0])

EXAMPLES: dict[str, Field] = {
    "sphere": sdf.sphere(1.0),
    "sphere off centre": sdf.sphere(0.8, (0.3, -0.2, 0.5)),
    "box": sdf.box(1.5),
    "box off centre": sdf.box((1.0, 2.0, 0.5), center=(0.2, 0.1, -0.4)),
    "rounded box": sdf.rounded_box((1.0, 2.0, 0.8), 0.2),
    "rounded box, fully": sdf.rounded_box((1.0, 2.0, 1.5), 0.5),
    "cylinder, infinite": sdf.cylinder(0.5),
    "cylinder": sdf.cylinder(0.5, 2.0),
    "capsule": sdf.capsule((-0.5, 0.2, 0.1), (0.7, -0.4, 0.9), 0.4),
    "torus": sdf.torus(1.0, 0.3),
    "cone": sdf.cone(0.8, 1.6),
    "cone, flat": sdf.cone(1.5, 0.5),
    "plane": sdf.plane((1, 2, -2), (0.1, 0.2, 0.3)),
    "plane square to an axis": sdf.plane("-y", (9.0, 0.4, 9.0)),
    "below": sdf.below(0.3),
    "above": sdf.above(-0.2),
    "left": sdf.left(0.1),
    "right": sdf.right(0.4),
    "front": sdf.front(-0.5),
    "behind": sdf.behind(0.6),
    "union": PEANUT,
    "union, apart": sdf.sphere(0.5, (-1, 0, 0)) | sdf.box(0.8, (1, 0, 0)),
    "union, smooth": sdf.sphere(0.7).union(TILT, sdf.box(0.5, (0.6, 0, 0)), smooth=0.4),
    "union, unbounded": sdf.sphere(0.7) | sdf.below(-1.0),
    "intersection": sdf.sphere(1.0) & sdf.box(1.5),
    "intersection, smooth": sdf.sphere(1.0).intersection(sdf.box(1.5), smooth=0.3),
    "intersection of half-spaces": (
        sdf.below(1) & sdf.above(-1) & sdf.left(1) & sdf.right(-0.5) & sdf.front(1) & sdf.behind(0)
    ),
    "intersection, empty": sdf.sphere(0.5, (-1, 0, 0)) & sdf.sphere(0.5, (1, 0, 0)),
    "difference": sdf.sphere(1.0) - sdf.cylinder(0.4),
    "difference, smooth": sdf.sphere(1.0).difference(sdf.cylinder(0.4), smooth=0.3),
    "difference, bored": (
        (sdf.sphere(1) & sdf.box(1.5))
        - (sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5).orient("y") | sdf.cylinder(0.5))
    ),
    "negate": sdf.box(1.5).negate(),
    "translate": TILT.translate((0.5, -0.25, 1.0)),
    "rotate": TILT.rotate(70, "x"),
    "rotate, matrix": (sdf.cone(0.8, 1.6) | sdf.box(1.0)).rotate(HALF_TURN),
    "rotate an intersection": (sdf.box(1.5) & sdf.below(0.2)).rotate(50, (1, 1, 0)).offset(0.3),
    "orient": sdf.cylinder(0.5, 2.0).orient("x"),
    "orient, oblique": sdf.cone(0.8, 1.6).orient((1, -1, 0.5)),
    "orient, down": sdf.cone(0.8, 1.6).orient("-z"),
    "scale": sdf.torus(1.0, 0.3).scale(1.7),
    "scale, uneven": sdf.sphere(1.0).scale((2.0, 1.0, 0.5)),
    "scale, uneven, grown": sdf.box(1.0).scale((2.0, 1.0, 0.5)).offset(0.2),
    "offset": PEANUT.offset(0.25),
    "offset inwards": sdf.box((2.0, 1.5, 1.2)).offset(-0.3),
    "offset inwards, to nothing": sdf.box((2.0, 1.5, 0.4)).offset(-0.3),
    "offset inwards and back": sdf.box((2.0, 1.5, 0.4)).offset(-0.3).offset(0.4),
    "shell": PEANUT.shell(0.2),
    "shell of a steep field": SHEARED.shell(0.3),
    "remap": SHEARED,
    "remap, smooth union": SHEARED.union(sdf.box(1.2, (0, 0, 1)), smooth=0.5),
    "from_function": sdf.from_function(
        _ellipsoid, lipschitz=2.0, bounds=((-1.5, -1, -0.5), (1.5, 1, 0.5)), name="ellipsoid"
    ),
}


def _on_sphere(rng, n):
    directions = rng.normal(size=(n, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _on_box(rng, n, half):
    points = rng.uniform(-1, 1, (n, 3))
    axis = rng.integers(0, 3, n)
    points[np.arange(n), axis] = rng.choice([-1.0, 1.0], n)
    return points * half


def _on_grown_box(rng, n, inner, radius):
    """Points of a box, each pushed out to the sphere of directions that are normal there."""
    outward = _on_sphere(rng, n)
    face = _on_box(rng, n, np.ones(3))
    kind = rng.integers(0, 3, n)
    corner = np.sign(outward)
    # A point of a face, an edge or a corner, and a direction of its normal cone.
    held = np.argsort(rng.uniform(size=(n, 3)), axis=1)
    fixed = np.zeros((n, 3), dtype=bool)
    for count in range(3):
        rows = np.flatnonzero(kind >= count)
        fixed[rows, held[rows, count]] = True
    normal = np.where(fixed, outward, 0.0)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.where(fixed, corner, face * rng.uniform(0, 1, (n, 1))) * inner + radius * normal


def _on_disc(rng, n, radius, z):
    angle, r = rng.uniform(0, 2 * np.pi, n), radius * np.sqrt(rng.uniform(0, 1, n))
    return np.stack([r * np.cos(angle), r * np.sin(angle), np.full(n, z)], axis=1)


def _on_tube(rng, n, radius, low, high):
    angle = rng.uniform(0, 2 * np.pi, n)
    z = rng.uniform(low, high, n)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _on_cylinder(rng, n):
    caps = [_on_disc(rng, n // 4, 0.5, -1.0), _on_disc(rng, n // 4, 0.5, 1.0)]
    return np.concatenate([*caps, _on_tube(rng, n // 2, 0.5, -1.0, 1.0)])


def _on_cone(rng, n):
    side = _on_tube(rng, n // 2, 1.0, 0.0, 1.0)
    t = side[:, 2:]
    side = np.concatenate([0.8 * t * side[:, :2], 0.8 - 1.6 * t], axis=1)
    return np.concatenate([_on_disc(rng, n // 2, 0.8, -0.8), side])


def _on_torus(rng, n):
    u, v = rng.uniform(0, 2 * np.pi, (2, n))
    r = 1.0 + 0.3 * np.cos(v)
    return np.stack([r * np.cos(u), r * np.sin(u), 0.3 * np.sin(v)], axis=1)


CAPSULE_ENDS = np.array([[-0.5, 0.2, 0.1], [0.7, -0.4, 0.9]])


def _on_capsule(rng, n):
    a, b = CAPSULE_ENDS
    axis = (b - a) / np.linalg.norm(b - a)
    outward = _on_sphere(rng, n)
    along = outward @ axis
    caps = np.where(along[:, None] > 0, b, a) + 0.4 * outward
    across = outward - along[:, None] * axis
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    tube = a + rng.uniform(0, 1, (n, 1)) * (b - a) + 0.4 * across
    return np.concatenate([caps[: n // 2], tube[n // 2 :]])


def _in_capsule(p):
    t = np.linspace(0, 1, 2001)[:, None]
    axis = CAPSULE_ENDS[0] + t * (CAPSULE_ENDS[1] - CAPSULE_ENDS[0])
    return np.array([((q - axis) ** 2).sum(axis=1).min() < 0.16 for q in p])


def _half_space(field, axis, value, sign):
    def sample(rng, n):
        points = rng.uniform(-REACH, REACH, (n, 3))
        points[:, axis] = value
        return points

    return Surface(field, sample, lambda p: sign * (p[:, axis] - value) < 0)


def _on_plane(rng, n):
    normal = np.array([1.0, 2.0, -2.0]) / 3
    points = rng.uniform(-REACH, REACH, (n, 3))
    return points - ((points - [0.1, 0.2, 0.3]) @ normal)[:, None] * normal


def _radius(p):
    return np.hypot(p[:, 0], p[:, 1])


SURFACES: dict[str, Surface] = {
    "sphere": Surface(
        EXAMPLES["sphere off centre"],
        lambda rng, n: 0.8 * _on_sphere(rng, n) + [0.3, -0.2, 0.5],
        lambda p: ((p - [0.3, -0.2, 0.5]) ** 2).sum(axis=1) < 0.64,
    ),
    "box": Surface(
        EXAMPLES["box off centre"],
        lambda rng, n: _on_box(rng, n, np.array([0.5, 1.0, 0.25])) + np.array([0.2, 0.1, -0.4]),
        lambda p: (np.abs(p - [0.2, 0.1, -0.4]) < [0.5, 1.0, 0.25]).all(axis=1),
    ),
    "rounded_box": Surface(
        EXAMPLES["rounded box"],
        lambda rng, n: _on_grown_box(rng, n, np.array([0.3, 0.8, 0.2]), 0.2),
        lambda p: ((p - np.clip(p, [-0.3, -0.8, -0.2], [0.3, 0.8, 0.2])) ** 2).sum(axis=1) < 0.04,
    ),
    "cylinder": Surface(
        EXAMPLES["cylinder"],
        _on_cylinder,
        lambda p: (_radius(p) < 0.5) & (np.abs(p[:, 2]) < 1.0),
    ),
    "cylinder, infinite": Surface(
        EXAMPLES["cylinder, infinite"],
        lambda rng, n: _on_tube(rng, n, 0.5, -2 * REACH, 2 * REACH),
        lambda p: _radius(p) < 0.5,
    ),
    "capsule": Surface(EXAMPLES["capsule"], _on_capsule, _in_capsule),
    "torus": Surface(
        EXAMPLES["torus"],
        _on_torus,
        lambda p: (_radius(p) - 1.0) ** 2 + p[:, 2] ** 2 < 0.09,
    ),
    "cone": Surface(
        EXAMPLES["cone"],
        _on_cone,
        lambda p: (p[:, 2] > -0.8) & (_radius(p) < 0.5 * (0.8 - p[:, 2])),
    ),
    "plane": Surface(
        EXAMPLES["plane"], _on_plane, lambda p: (p - [0.1, 0.2, 0.3]) @ [1.0, 2.0, -2.0] < 0
    ),
    "below": _half_space(EXAMPLES["below"], 2, 0.3, 1),
    "above": _half_space(EXAMPLES["above"], 2, -0.2, -1),
    "left": _half_space(EXAMPLES["left"], 0, 0.1, 1),
    "right": _half_space(EXAMPLES["right"], 0, 0.4, -1),
    "front": _half_space(EXAMPLES["front"], 1, -0.5, 1),
    "behind": _half_space(EXAMPLES["behind"], 1, 0.6, -1),
}
