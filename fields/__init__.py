"""Scalar fields on R^3: signed distances, their combinations, and what is known of them.

    import fields as sdf

    shape = sdf.sphere(1.0) & sdf.box(1.5)
    shape -= sdf.cylinder(0.5).orient("x") | sdf.cylinder(0.5)
    values = shape(points)          # (..., 3) -> (...), numpy or torch, negative inside
    shape.bounds, shape.lipschitz, shape.exact

Every field is an expression graph (`fields.expression`) with tags (`fields.tags`).
Needs numpy and torch. What needs more imports it when it is called: `mesh` Open3D, `text` and
`svg` fontTools and Manifold, `image` scikit-image and Pillow, outlines of many edges Numba.
Needs numpy and torch; meshes and grids import Numba when they are made, and libraries for files
when they are read.
Needs numpy and torch; `mesh` imports Open3D when it is called, networks import Numba and
safetensors when they are.
"""

from __future__ import annotations

from fields.ellipsoids import ellipsoid, superellipsoid
from fields.errors import FileFormatError, InputError, MissingDependency
from fields.evaluators.choice import back_end
from fields.field import Field, from_function
from fields.grid import grid
from fields.grid_files import load_grid, save_grid
from fields.helices import helix, thread, torus_knot
from fields.lattices import gyroid, neovius, schwarz_d, schwarz_p
from fields.mesh import mesh
from fields.neural.architecture import HashGrid, Siren
from fields.neural.family import Family, FamilyReport, fit_family
from fields.neural.fit import NeuralReport, fit_neural
from fields.neural.options import NeuralOptions
from fields.neural.storing import load_neural, save_neural
from fields.occupancy import from_occupancy
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
    rhombic_prism,
    sector,
    slab,
    triangular_prism,
    tube,
    wedge,
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
    spindle,
)
from fields.tubes import (
    bezier_tube,
    capped_torus,
    link,
    polyline_tube,
    quad_plate,
    triangle_plate,
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
bend_radial = Field.bend_radial
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
    "affine",
    "arc",
    "back_end",
    "behind",
    "below",
    "bend",
    "bend_radial",
    "bezier_tube",
    "box",
    "box_frame",
    "capped_cone",
    "capped_torus",
    "capsule",
    "circle",
    "circular_array",
    "coil",
    "cone",
    "convex_hull",
    "cross",
    "cut_hollow_sphere",
    "cut_sphere",
    "cylinder",
    "death_star",
    "difference",
    "displace",
    "dodecahedron",
    "egg",
    "ellipse",
    "ellipsoid",
    "elongate",
    "engrave",
    "extrude",
    "extrude_to",
    "fit_family",
    "fit_neural",
    "from_function",
    "from_occupancy",
    "front",
    "grid",
    "groove",
    "gyroid",
    "helix",
    "hexagon",
    "hexagonal_prism",
    "hollow",
    "icosahedron",
    "image",
    "infinite_cone",
    "intersection",
    "lathe",
    "left",
    "lens",
    "line",
    "linear_array",
    "link",
    "load_grid",
    "load_neural",
    "loft",
    "mesh",
    "mirror",
    "moon",
    "morph",
    "negate",
    "neovius",
    "octagon",
    "octahedron",
    "offset",
    "onion",
    "orient",
    "parallelogram",
    "parse",
    "pie",
    "pipe",
    "plane",
    "polygon",
    "polyline",
    "polyline_tube",
    "prism",
    "pyramid",
    "quad_plate",
    "rectangle",
    "regular_polygon",
    "repeat",
    "revolve",
    "rhombic_dodecahedron",
    "rhombic_prism",
    "rhombic_triacontahedron",
    "rhombus",
    "right",
    "ring",
    "rotate",
    "rounded_box",
    "rounded_cone",
    "rounded_cylinder",
    "rounded_rectangle",
    "save_grid",
    "save_neural",
    "scale",
    "schwarz_d",
    "schwarz_p",
    "sector",
    "shear",
    "shell",
    "slab",
    "slice",
    "solid_angle",
    "sphere",
    "spindle",
    "spline",
    "star",
    "strip",
    "superellipsoid",
    "svg",
    "sweep",
    "symmetric_difference",
    "symmetry",
    "taper",
    "taper_extrude",
    "tetrahedron",
    "text",
    "thread",
    "tongue",
    "torus",
    "torus_knot",
    "transition_linear",
    "transition_radial",
    "translate",
    "trapezoid",
    "triangle",
    "triangle_plate",
    "triangular_prism",
    "tube",
    "twist",
    "twist_extrude",
    "uneven_capsule",
    "union",
    "vesica",
    "wedge",
]
