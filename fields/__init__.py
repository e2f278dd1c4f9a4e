"""Scalar fields on R^3: signed distances, their combinations, and what is known of them.

    import fields as sdf

    shape = sdf.sphere(1.0) & sdf.box(1.5)
    shape -= sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5)
    values = shape(points)          # (..., 3) -> (...), numpy or torch, negative inside
    shape.bounds, shape.lipschitz, shape.exact

Every field is an expression graph (`fields.expression`) with tags (`fields.tags`).
Needs numpy and torch. What needs more imports it when it is called: `mesh` Open3D, `text` and
`svg` fontTools and Manifold, `image` scikit-image and Pillow, outlines of many edges Numba.
"""

from __future__ import annotations

from fields.errors import InputError, MissingDependency
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
from fields.profiles.curved import (
    arc,
    circle,
    ellipse,
    line,
    moon,
    pie,
    ring,
    uneven_capsule,
    vesica,
)
from fields.profiles.curves import spline
from fields.profiles.drawing import svg
from fields.profiles.lettering import text
from fields.profiles.picture import image
from fields.profiles.straight import (
    cross,
    hexagon,
    octagon,
    parallelogram,
    polygon,
    polyline,
    rectangle,
    regular_polygon,
    rhombus,
    rounded_rectangle,
    star,
    strip,
    trapezoid,
    triangle,
)
from fields.profiles.turned import lathe

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
coil = Field.coil
extrude = Field.extrude
extrude_to = Field.extrude_to
loft = Field.loft
revolve = Field.revolve
slice = Field.slice
sweep = Field.sweep
taper_extrude = Field.taper_extrude
twist_extrude = Field.twist_extrude

__all__ = [
    "Field",
    "InputError",
    "MissingDependency",
    "above",
    "arc",
    "behind",
    "below",
    "box",
    "capsule",
    "circle",
    "coil",
    "cone",
    "cross",
    "cylinder",
    "difference",
    "ellipse",
    "extrude",
    "extrude_to",
    "from_function",
    "front",
    "hexagon",
    "image",
    "intersection",
    "lathe",
    "left",
    "line",
    "loft",
    "mesh",
    "moon",
    "negate",
    "octagon",
    "offset",
    "orient",
    "parallelogram",
    "parse",
    "pie",
    "plane",
    "polygon",
    "polyline",
    "rectangle",
    "regular_polygon",
    "revolve",
    "rhombus",
    "right",
    "ring",
    "rotate",
    "rounded_box",
    "rounded_rectangle",
    "scale",
    "shell",
    "slice",
    "sphere",
    "spline",
    "star",
    "strip",
    "svg",
    "sweep",
    "taper_extrude",
    "text",
    "torus",
    "translate",
    "trapezoid",
    "triangle",
    "twist_extrude",
    "uneven_capsule",
    "union",
    "vesica",
]
