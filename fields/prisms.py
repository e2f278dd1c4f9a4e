"""Prisms, plates and frames: what a saw and a milling machine make of a block.

All are true signed distances. A prism is the product of its profile and an interval
(`fields.formulas.prism_distance`), so it is exact because its profile is. Profiles: Inigo
Quilez, "2D distance functions", https://iquilezles.org/articles/distfunctions2d/ (sector, rhombus,
polygon), here with gradients that are right on the border. Angles are in degrees.
"""

from __future__ import annotations

import math

import numpy as np

from fields import arguments
from fields.errors import InputError
from fields.expression import X, Y, Z, length, maximum, minimum, where_negative
from fields.formulas import (
    box_distance,
    chain_distance,
    exact_body,
    folded_to_sector,
    outside_or_faces,
    pie_distance,
    prism_distance,
)
from fields.operations import Body
from fields.primitives import primitive


@primitive
def slab(
    x0: float | None = None,
    y0: float | None = None,
    z0: float | None = None,
    x1: float | None = None,
    y1: float | None = None,
    z1: float | None = None,
) -> Body:
    """A box given by its sides, any of which may be left out: what is between them.

    Args:
        x0: smallest x; None if there is no end on this side.
        y0: smallest y, or None.
        z0: smallest z, or None.
        x1: largest x, or None; above `x0`.
        y1: largest y, or None; above `y0`.
        z1: largest z, or None; above `z0`.
    """
    given = {"x0": x0, "y0": y0, "z0": z0, "x1": x1, "y1": y1, "z1": z1}
    sides = {
        name: arguments.number(name, value) for name, value in given.items() if value is not None
    }
    if not sides:
        raise InputError("x0", None, "no side is given, so this is all of space", "pass a side")
    offsets = []
    for axis, name in zip((X, Y, Z), "xyz", strict=True):
        low, high = sides.get(f"{name}0"), sides.get(f"{name}1")
        if low is not None and high is not None and low >= high:
            raise InputError(
                f"{name}1", high, f"it is not above {name}0 = {low:g}", "exchange the two"
            )
        if low is not None:
            offsets.append(low - axis)
        if high is not None:
            offsets.append(axis - high)
    # Of two opposite offsets one at most is positive, so their squares do not both count.
    return exact_body(
        box_distance(tuple(offsets)),
        [sides.get(f"{name}0", -math.inf) for name in "xyz"],
        [sides.get(f"{name}1", math.inf) for name in "xyz"],
    )


@primitive
def prism(sides: int, radius: float, height: float) -> Body:
    """A prism on a regular polygon about the z axis, with an edge above +x.

    Args:
        sides: how many, 3 or more.
        radius: of the circle through the polygon's corners.
        height: full length along z, centred at the origin.
    """
    n = arguments.whole("sides", sides, 3)
    return _regular_prism(
        n, arguments.positive("radius", radius), arguments.positive("height", height)
    )


def _regular_prism(n: int, radius: float, height: float) -> Body:
    u, v = folded_to_sector(X, Y, n)
    half = math.pi / n
    cosine, sine = math.cos(half), math.sin(half)
    # The side's middle is at the angle pi / n, and the corner at 0.
    face = cosine * u + sine * v - radius * cosine
    past = maximum(sine * u - cosine * v - radius * sine, 0.0)
    angles = 2 * half * np.arange(n)
    x, y = radius * np.cos(angles), radius * np.sin(angles)
    profile = outside_or_faces(face, length(face, past))
    return exact_body(
        prism_distance(profile, height),
        (x.min(), y.min(), -height / 2),
        (x.max(), y.max(), height / 2),
    )


@primitive
def hexagonal_prism(width: float, height: float) -> Body:
    """A hexagonal bar about the z axis, with an edge above +x: a nut or a bolt's head.

    Args:
        width: across flats, the size of the spanner.
        height: full length along z, centred at the origin.
    """
    radius = arguments.positive("width", width) / math.sqrt(3)
    return _regular_prism(6, radius, arguments.positive("height", height))


@primitive
def triangular_prism(side: float, height: float) -> Body:
    """A bar on an equilateral triangle about the z axis, with an edge above +x.

    Args:
        side: of the triangle.
        height: full length along z, centred at the origin.
    """
    radius = arguments.positive("side", side) / math.sqrt(3)
    return _regular_prism(3, radius, arguments.positive("height", height))


@primitive
def rhombic_prism(width: float, depth: float, height: float) -> Body:
    """A prism on a rhombus about the z axis.

    Args:
        width: the diagonal along x.
        depth: the diagonal along y.
        height: full length along z, centred at the origin.
    """
    w = arguments.positive("width", width) / 2
    d = arguments.positive("depth", depth) / 2
    h = arguments.positive("height", height)
    profile = chain_distance(abs(X), abs(Y), ((w, 0.0), (0.0, d)))
    return exact_body(prism_distance(profile, h), (-w, -d, -h / 2), (w, d, h / 2))


@primitive
def wedge(width: float, depth: float, height: float, top: float = 0.0) -> Body:
    """A ramp: a block whose +x side leans back, in the box of the same size about the origin.

    Args:
        width: along x, at the bottom.
        depth: along y.
        height: along z.
        top: what is left of the width at the top; 0 for a sharp ridge, at most `width`.
    """
    w = arguments.positive("width", width)
    d = arguments.positive("depth", depth) / 2
    h = arguments.positive("height", height) / 2
    left = arguments.not_negative("top", top)
    if left > w:
        raise InputError("top", top, f"it is more than width = {w:g}", "pass top <= width")
    low, high = -w / 2, w / 2
    corners = [(low, -h), (high, -h), (low + left, h), (low, h), (low, -h)]
    profile = chain_distance(X, Z, corners)
    return exact_body(box_distance((profile, abs(Y) - d)), (low, -d, -h), (high, d, h))


@primitive
def tube(radius: float, inner: float, height: float) -> Body:
    """A hollow cylinder about the z axis.

    Args:
        radius: of the outside.
        inner: radius of the hole, less than `radius`.
        height: full length along z, centred at the origin.
    """
    r = arguments.positive("radius", radius)
    hole = arguments.positive("inner", inner)
    h = arguments.positive("height", height)
    if hole >= r:
        raise InputError("inner", inner, f"no wall is left of radius = {r:g}", "pass less")
    wall = abs(length(X, Y) - (r + hole) / 2) - (r - hole) / 2
    return exact_body(prism_distance(wall, h), (-r, -r, -h / 2), (r, r, h / 2))


@primitive
def sector(radius: float, angle: float, height: float) -> Body:
    """A slice of a cake: a sector of a disc about +x, extruded along z.

    Args:
        radius: greater than zero.
        angle: at the tip, in degrees, above 0 and below 360.
        height: full length along z, centred at the origin.
    """
    r = arguments.positive("radius", radius)
    half = math.radians(arguments.between("angle", angle, 0, 360)) / 2
    h = arguments.positive("height", height)
    profile = pie_distance(abs(Y), X, r, half)
    side = r * math.sin(min(half, math.pi / 2))
    back = r * min(math.cos(half), 0.0)
    return exact_body(prism_distance(profile, h), (back, -side, -h / 2), (r, side, h / 2))


@primitive
def box_frame(size: float | tuple[float, float, float], thickness: float) -> Body:
    """The twelve edges of a box, as square bars inside it.

    Outside, the distance is the least to three bars (in the octant that reflections leave);
    inside it is to what is missing: the outside of the box, and three tunnels. Quilez's formula
    has the bars only and is no distance where they meet.

    Args:
        size: the full edge length of a cube, or three of them.
        thickness: of the bars; less than half of the shortest edge.
    """
    half = np.array(arguments.numbers_or_one("size", size)) / 2
    t = arguments.positive("thickness", thickness)
    if t >= half.min():
        raise InputError(
            "thickness",
            thickness,
            f"no window is left in the shortest side, {2 * half.min():g}",
            "pass less than half of it",
        )
    folded = [abs(axis) - float(h) for axis, h in zip((X, Y, Z), half, strict=True)]
    within = [offset + t for offset in folded]  # beyond the window
    bar = [maximum(offset, -a) for offset, a in zip(folded, within, strict=True)]
    tunnels, bars = [], []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        tunnels.append(box_distance((within[one], within[other])))
        offsets = (folded[axis], bar[one], bar[other])
        bars.append(length(*(maximum(offset, 0.0) for offset in offsets)))
    inside = maximum(*folded, -minimum(*tunnels))
    return exact_body(where_negative(-inside, minimum(*bars), inside), -half, half)
