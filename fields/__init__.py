"""Scalar fields on R^3: signed distances, their combinations, and what is known of them.

    import fields as sdf

    shape = sdf.sphere(1.0) & sdf.box(1.5)
    shape -= sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5)
    values = shape(points)          # (..., 3) -> (...), numpy or torch, negative inside
    shape.bounds, shape.lipschitz, shape.exact

Every field is an expression graph (`fields.expression`) with tags (`fields.tags`).
Needs numpy and torch; `mesh` imports Open3D when it is called, networks import Numba and
safetensors when they are.
"""

from __future__ import annotations

from fields.errors import FileFormatError, InputError, MissingDependency
from fields.field import Field, from_function
from fields.mesh import mesh
from fields.neural.architecture import HashGrid, Siren
from fields.neural.family import Family, FamilyReport, fit_family
from fields.neural.fit import NeuralReport, fit_neural
from fields.neural.options import NeuralOptions
from fields.neural.storing import load_neural, save_neural
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

__all__ = [
    "Family",
    "FamilyReport",
    "Field",
    "FileFormatError",
    "HashGrid",
    "InputError",
    "MissingDependency",
    "NeuralOptions",
    "NeuralReport",
    "Siren",
    "above",
    "behind",
    "below",
    "box",
    "capsule",
    "cone",
    "cylinder",
    "difference",
    "fit_family",
    "fit_neural",
    "from_function",
    "front",
    "intersection",
    "left",
    "load_neural",
    "mesh",
    "negate",
    "offset",
    "orient",
    "parse",
    "plane",
    "right",
    "rotate",
    "rounded_box",
    "save_neural",
    "scale",
    "shell",
    "sphere",
    "torus",
    "translate",
    "union",
]
