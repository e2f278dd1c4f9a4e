"""Scalar fields on R^3: signed distances, their combinations, and what is known of them.

    import fields as sdf

    shape = sdf.sphere(1.0) & sdf.box(1.5)
    shape -= sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5)
    values = shape(points)          # (..., 3) -> (...), numpy or torch, negative inside
    shape.bounds, shape.lipschitz, shape.exact

Every field is an expression graph (`fields.expression`) with tags (`fields.tags`).
Needs numpy and torch; meshes and grids import Numba when they are made, and libraries for files
when they are read.
"""

from __future__ import annotations

from fields.errors import InputError, MissingDependency
from fields.field import Field, from_function
from fields.grid import grid
from fields.grid_files import load_grid, save_grid
from fields.mesh import mesh
from fields.occupancy import from_occupancy
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
    "Field",
    "InputError",
    "MissingDependency",
    "above",
    "behind",
    "below",
    "box",
    "capsule",
    "cone",
    "cylinder",
    "difference",
    "from_function",
    "from_occupancy",
    "front",
    "grid",
    "intersection",
    "left",
    "load_grid",
    "mesh",
    "negate",
    "offset",
    "orient",
    "parse",
    "plane",
    "right",
    "rotate",
    "rounded_box",
    "save_grid",
    "scale",
    "shell",
    "sphere",
    "torus",
    "translate",
    "union",
]
