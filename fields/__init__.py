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

from fields.ellipsoids import ellipsoid, superellipsoid
from fields.errors import InputError, MissingDependency
from fields.field import Field, from_function
from fields.helices import helix, thread, torus_knot
from fields.lattices import gyroid, neovius, schwarz_d, schwarz_p
from fields.mesh import mesh
from fields.parse import parse
from fields.polyhedra import (
    convex_hull,
    dodecahedron,
    icosahedron,
    octahedron,
    pyramid,
    rhombic_dodecahedron,
    rhombic_triacontahedron,
    tetrahedron,
)
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
from fields.prisms import (
    box_frame,
    hexagonal_prism,
    prism,
    rhombus,
    sector,
    slab,
    triangular_prism,
    tube,
    wedge,
)
from fields.round_solids import (
    capped_cone,
    cut_hollow_sphere,
    cut_sphere,
    death_star,
    egg,
    infinite_cone,
    lens,
    rounded_cone,
    rounded_cylinder,
    solid_angle,
    vesica,
)
from fields.tubes import bezier, capped_torus, link, polyline, quad, triangle

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
    "bezier",
    "box",
    "box_frame",
    "capped_cone",
    "capped_torus",
    "capsule",
    "cone",
    "convex_hull",
    "cut_hollow_sphere",
    "cut_sphere",
    "cylinder",
    "death_star",
    "difference",
    "dodecahedron",
    "egg",
    "ellipsoid",
    "from_function",
    "front",
    "gyroid",
    "helix",
    "hexagonal_prism",
    "icosahedron",
    "infinite_cone",
    "intersection",
    "left",
    "lens",
    "link",
    "mesh",
    "negate",
    "neovius",
    "octahedron",
    "offset",
    "orient",
    "parse",
    "plane",
    "polyline",
    "prism",
    "pyramid",
    "quad",
    "rhombic_dodecahedron",
    "rhombic_triacontahedron",
    "rhombus",
    "right",
    "rotate",
    "rounded_box",
    "rounded_cone",
    "rounded_cylinder",
    "scale",
    "schwarz_d",
    "schwarz_p",
    "sector",
    "shell",
    "slab",
    "solid_angle",
    "sphere",
    "superellipsoid",
    "tetrahedron",
    "thread",
    "torus",
    "torus_knot",
    "translate",
    "triangle",
    "triangular_prism",
    "tube",
    "union",
    "vesica",
    "wedge",
]
