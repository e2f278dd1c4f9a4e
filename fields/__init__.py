"""Scalar fields on R^3: signed distances, their combinations, and what is known of them.

    import fields as sdf

    shape = sdf.sphere(1.0) & sdf.box(1.5)
    shape -= sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5)
    values = shape(points)          # (..., 3) -> (...), numpy or torch, negative inside
    shape.bounds, shape.lipschitz, shape.exact

Every field is an expression graph (`fields.expression`) with tags (`fields.tags`).
Needs numpy and torch; `mesh` imports Open3D when it is called.
"""

from __future__ import annotations

from fields.errors import InputError, MissingDependency
from fields.evaluators.choice import back_end
from fields.field import Field, from_function
from fields.mesh import mesh
from fields.parse import parse
from fields.primitives import (
    above,
    behind,
    below,
    box,
    capsule,
    cone,
    cylinder,
    front,
    left,
    plane,
    right,
    rounded_box,
    sphere,
    torus,
)

# Each operation is a method of Field and, unbound, a function of fields.
union = Field.union
intersection = Field.intersection
difference = Field.difference
negate = Field.negate
translate = Field.translate
rotate = Field.rotate
orient = Field.orient
scale = Field.scale
offset = Field.offset
shell = Field.shell
symmetric_difference = Field.symmetric_difference
pipe = Field.pipe
engrave = Field.engrave
groove = Field.groove
tongue = Field.tongue
morph = Field.morph
transition_linear = Field.transition_linear
transition_radial = Field.transition_radial
hollow = Field.hollow
onion = Field.onion
elongate = Field.elongate
displace = Field.displace
affine = Field.affine
mirror = Field.mirror
symmetry = Field.symmetry
repeat = Field.repeat
linear_array = Field.linear_array
circular_array = Field.circular_array
twist = Field.twist
taper = Field.taper
shear = Field.shear
bend = Field.bend

__all__ = [
    "Field",
    "InputError",
    "MissingDependency",
    "above",
    "affine",
    "back_end",
    "behind",
    "below",
    "bend",
    "box",
    "capsule",
    "circular_array",
    "cone",
    "cylinder",
    "difference",
    "displace",
    "elongate",
    "engrave",
    "from_function",
    "front",
    "groove",
    "hollow",
    "intersection",
    "left",
    "linear_array",
    "mesh",
    "mirror",
    "morph",
    "negate",
    "offset",
    "onion",
    "orient",
    "parse",
    "pipe",
    "plane",
    "repeat",
    "right",
    "rotate",
    "rounded_box",
    "scale",
    "shear",
    "shell",
    "sphere",
    "symmetric_difference",
    "symmetry",
    "taper",
    "tongue",
    "torus",
    "transition_linear",
    "transition_radial",
    "translate",
    "twist",
    "union",
]
