"""Joints, seams, blends, thickness, copies and deformations."""

from __future__ import annotations

import torch

import fields as sdf
from fields import Field
from fields.expression import X, Y, Z, sin
from tests.fields.catalogue.surface import Surface

BALL = sdf.sphere(0.8, (-0.3, 0.1, 0))
BLOCK = sdf.box((1.2, 1.0, 0.8), center=(0.4, 0, 0.2))
PILL = sdf.capsule((-0.4, 0, -0.3), (0.4, 0.2, 0.3), 0.25)


def _squeezed(points: torch.Tensor) -> torch.Tensor:
    return points * points.new_tensor([1.0, 1.0, 1.6])


SQUEEZED_BOUNDS = ((-0.2, -0.5, -0.125), (1.0, 0.5, 0.375))
STEEP = BLOCK.remap(_squeezed, lipschitz=1.6, bounds=SQUEEZED_BOUNDS, growth=1.0)
UNKNOWN = BLOCK.remap(_squeezed, lipschitz=1.6, bounds=SQUEEZED_BOUNDS)
"""The same; how its level sets grow is not known."""

JOINTS: dict[str, dict[str, object]] = {
    "smooth": {"smooth": 0.4},
    "cubic": {"cubic": 0.5},
    "exponential": {"exponential": 0.1},
    "root": {"root": 0.2},
    "round": {"round": 0.3},
    "chamfer": {"chamfer": 0.3},
    "stairs": {"stairs": (0.4, 3)},
}

EXAMPLES: dict[str, Field] = {
    **{f"union, {name} joint": BALL.union(BLOCK, PILL, **joint) for name, joint in JOINTS.items()},
    **{
        f"intersection, {name} joint": BALL.intersection(BLOCK, **joint)
        for name, joint in JOINTS.items()
    },
    **{
        f"difference, {name} joint": BLOCK.difference(BALL, PILL, **joint)
        for name, joint in JOINTS.items()
    },
    "union of parallel surfaces, chamfered": sdf.below(0).union(sdf.below(0.1), chamfer=0.5),
    "union of steep fields, round": STEEP.union(BALL, round=0.3),
    "symmetric difference": BALL ^ BLOCK,
    "symmetric difference of three": BALL.symmetric_difference(BLOCK, PILL),
    "complement": ~BALL & sdf.box(2),
    "pipe": BALL.pipe(BLOCK, 0.15),
    "engrave": BALL.engrave(sdf.plane((1, 1, 0)), 0.15),
    "groove": BLOCK.groove(BALL, 0.15, 0.2),
    "tongue": BLOCK.tongue(BALL, 0.15, 0.2),
    "morph": BALL.morph(BLOCK, 0.3),
    "morph, all of it": BALL.morph(BLOCK, 1),
    "transition_linear": BALL.transition_linear(BLOCK, (-0.5, 0, 0), (0.7, 0.2, 0)),
    "transition_linear, unbounded": sdf.below(0.2).morph(BLOCK, 0.5),
    "transition_radial": sdf.cylinder(0.9, 0.4).transition_radial(sdf.box((2, 2, 1)), 0.3, 1.2),
    "hollow": BLOCK.hollow(0.15),
    "onion": sdf.sphere(1.2).onion(0.15, 3),
    "onion with a gap": BALL.onion(0.1, 2, gap=0.3) - sdf.above(0),
    "onion, more than fit": sdf.box(1.2).onion(0.1, 20),
    "elongate": sdf.torus(0.6, 0.2).elongate((1.0, 0.4, 0)),
    "elongate, thick": sdf.sphere(0.6).elongate((0.8, 0.4, 1.2)),
    "elongate, empty at the origin": sdf.torus(0.8, 0.2).elongate(0.6),
    "elongate through the surface": sdf.sphere(0.6, (0.6, 0, 0)).elongate(0.5),
    "displace": BALL.displace(
        sdf.Field(0.1 * sin(5 * X) * sin(5 * Y) * sin(5 * Z), lipschitz=0.5), limit=0.1
    ),
    "displace by a clamped field": BLOCK.displace(sdf.plane("x"), limit=0.2),
    "affine": BLOCK.affine([[1.2, 0.3, 0], [0, 0.8, -0.4], [0.1, 0, 1]], (0.1, 0.2, -0.3)),
    "affine, reflected and grown": PILL.affine([[0, 1, 0.5], [1, 0, 0], [0, 0, 1.3]]).offset(0.1),
    "mirror": sdf.cone(0.6, 1.2).mirror((1, 0.2, 1), (0.2, 0, 0)),
    "mirror, beside": PILL | PILL.mirror("z", (0, 0, -0.8)),
    "symmetry": PILL.symmetry("x"),
    "symmetry, oblique": sdf.box((1, 0.6, 0.4)).symmetry((1, 1, 0), (-0.2, 0.1, 0)),
    "symmetry, apart": sdf.sphere(0.4, (0.9, 0, 0)).symmetry("x"),
    "repeat": sdf.sphere(0.2, (0.1, 0, 0.3)).repeat(0.9),
    "repeat along an axis": (sdf.cylinder(0.3) - sdf.cylinder(0.2)).repeat((1.0, 0, 0)),
    "repeat, overlapping": PILL.repeat((0.5, 0.7, 0), count=(4, 3, 1)),
    "repeat, finite": sdf.box((0.3, 0.2, 0.5)).rotate(30).repeat((0.7, 0, 0.8), count=(5, 1, 2)),
    "repeat, mirrored": sdf.cone(0.3, 0.6).orient((1, 0.3, 0)).repeat((0.8, 0, 0), 4, True),
    "repeat, mirrored without end": PILL.repeat((1.1, 0.9, 0), mirrored=True),
    "repeat a field of unknown growth": UNKNOWN.repeat((0, 1.2, 0.6), count=3),
    "linear_array": PILL.linear_array(5, (0.5, 0.4, -0.2)),
    "linear_array, unbounded across": sdf.cylinder(0.2).linear_array(3, (0.6, 0.5, 0)),
    "circular_array": sdf.box((0.4, 0.2, 0.6), center=(1.2, 0.3, 0)).circular_array(9),
    "circular_array, overlapping": PILL.translate((1, 0, 0)).circular_array(5, "y"),
    "circular_array, through the axis": sdf.box((2.4, 0.2, 0.3), (0.3, 0, 0)).circular_array(3),
    "circular_array of a field of unknown growth": UNKNOWN.translate((0.9, 0, 0)).circular_array(
        7, (1, 1, 1)
    ),
    "twist": sdf.box((1.2, 0.4, 1.6)).twist(70),
    "twist on a range": BLOCK.twist(-90, (1, 0.2, 0), (0, 0.1, 0), (-0.3, 0.5)),
    "twist, grown": sdf.box((0.8, 0.3, 1.2)).twist(90).offset(0.1),
    "twist a field of unknown growth": UNKNOWN.twist(40),
    "taper": sdf.cylinder(0.6, 1.6).taper((1.2, 0.5), between=(-0.8, 0.8)),
    "taper, oblique": BLOCK.taper((0.7, 1.3), (1, 1, 0), (0.1, 0, 0), (-0.5, 0.6)),
    "shear": BLOCK.shear(0.5),
    "shear on a range": STEEP.shear(-0.8, "x", "y", (0.1, 0, 0), (0, 0.5)),
    "shear, grown": BALL.shear(0.4, (1, 0, 1), "y").offset(0.2),
    "bend_radial": sdf.box((1.6, 1.2, 0.3)).bend_radial(0.5, (0.2, 0.7)),
    "bend_radial, off the axis": BLOCK.bend_radial(-0.7, (0.3, 1.1), "x", (0, 0.9, 0.4)),
    "bend_radial, grown": BALL.bend_radial(0.4, (0, 1), (1, 0, 1)).offset(0.2),
    "bend": sdf.box((0.3, 0.5, 2.4)).bend(90, between=(-0.6, 0.6), towards="x"),
    "bend away": sdf.box((0.5, 0.3, 2.4)).bend(-120, between=(-0.7, 0.5), towards="y"),
    "bend to a ring": sdf.box((0.3, 0.4, 3.2)).bend(300, "z", (0, 0, 0), (-1.6, 1.6)),
    "bend, oblique": PILL.bend(60, (1, 1, 1), (0.1, 0, 0), (-0.6, 0.8)),
    "twist, then bend": sdf.box((0.4, 0.2, 2))
    .twist(60)
    .bend(100, between=(-0.8, 0.8), towards="y"),
}

SURFACES: dict[str, Surface] = {}
