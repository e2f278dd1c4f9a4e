"""Primitive shapes, as true signed distances.

Every primitive is exact (a Euclidean distance, inside and out) and so has Lipschitz
constant 1, and every one that is bounded has tight bounds. Lengths are in the units of
the points. Shapes are centred at the origin unless they say otherwise; move them with
`Field.translate`, `Field.rotate` and `Field.orient`.

The formulas are the usual ones (collected by Inigo Quilez, "3D SDFs",
https://iquilezles.org/articles/distfunctions/), arranged so that gradients are right on
the surface itself and not only near it: inside and on a face the largest of the plane
distances is taken as it is, and a square root only outside.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import ParamSpec

import numpy as np
from numpy.typing import ArrayLike

from fields import arguments, notation
from fields.errors import InputError
from fields.expression import (
    X,
    Y,
    Z,
    clamp,
    length,
    maximum,
    minimum,
)
from fields.field import Field, make_field
from fields.formulas import ORIGIN, about, box_distance, exact_body, outside_or_faces
from fields.operations import Body
from fields.tags import EVERYWHERE, Box, Tags

_P = ParamSpec("_P")

PRIMITIVES: dict[str, Callable[..., Field]] = {}
"""Every primitive by name: the constructors that `fields.parse` accepts, and the list
from which the tests draw."""


def primitive(function: Callable[_P, Body]) -> Callable[_P, Field]:
    """Make a constructor of fields from one of bodies, and enter it into `PRIMITIVES`."""
    own_signature = signature(function)
    optional = notation.defaults(function)
    name = function.__name__

    @wraps(function)
    def constructor(*args: _P.args, **kwargs: _P.kwargs) -> Field:
        given = own_signature.bind(*args, **kwargs).arguments
        body = function(*args, **kwargs)
        return make_field(body, notation.recorded(name, (), given, optional))

    constructor.__signature__ = own_signature.replace(return_annotation="Field")  # type: ignore[attr-defined]
    if name in PRIMITIVES:
        raise NameError(f"there is a primitive {name} already")
    PRIMITIVES[name] = constructor
    return constructor


# --- solids ---------------------------------------------------------------------------


@primitive
def sphere(radius: float, center: ArrayLike = ORIGIN) -> Body:
    """A ball: |p - center| - radius.

    Args:
        radius: greater than zero.
        center: `(3,)`.
    """
    r = arguments.positive("radius", radius)
    c, (x, y, z) = about(center)
    return exact_body(length(x, y, z) - r, np.subtract(c, r), np.add(c, r))


@primitive
def box(size: float | ArrayLike, center: ArrayLike = ORIGIN) -> Body:
    """A box with sides along the axes.

    Args:
        size: the full edge length of a cube, or three of them.
        center: `(3,)`.
    """
    half = np.array(arguments.numbers_or_one("size", size)) / 2
    c, axes = about(center)
    offsets = tuple(abs(axis) - float(h) for axis, h in zip(axes, half, strict=True))
    return exact_body(box_distance(offsets), np.subtract(c, half), np.add(c, half))


@primitive
def rounded_box(size: float | ArrayLike, radius: float) -> Body:
    """A box whose edges and corners are rounded off, within the box of the same size.

    Args:
        size: the full edge length of a cube, or three of them.
        radius: of the edges; at most half of the shortest edge.
    """
    half = np.array(arguments.numbers_or_one("size", size)) / 2
    r = arguments.positive("radius", radius)
    if r > half.min():
        raise InputError(
            "radius",
            radius,
            f"it is more than half of the shortest edge, {2 * half.min():g}",
            "pass a smaller radius or a larger size",
        )
    # A convex body grown by r stays an exact distance, inside and out.
    offsets = tuple(abs(axis) - float(h) for axis, h in zip((X, Y, Z), half - r, strict=True))
    return exact_body(box_distance(offsets) - r, -half, half)


@primitive
def cylinder(radius: float, height: float | None = None) -> Body:
    """A cylinder about the z axis.

    Args:
        radius: greater than zero.
        height: full length along z, centred at the origin; None for an infinite one.
    """
    r = arguments.positive("radius", radius)
    side = length(X, Y) - r
    if height is None:
        return exact_body(side, (-r, -r, -math.inf), (r, r, math.inf))
    h = arguments.positive("height", height) / 2
    return exact_body(box_distance((side, abs(Z) - h)), (-r, -r, -h), (r, r, h))


@primitive
def capsule(a: ArrayLike, b: ArrayLike, radius: float) -> Body:
    """All points within a radius of the segment from a to b.

    Args:
        a: `(3,)`, centre of one round end.
        b: `(3,)`, centre of the other; must differ from a.
        radius: greater than zero.
    """
    start, end = (np.array(arguments.vector(*item)) for item in (("a", a), ("b", b)))
    r = arguments.positive("radius", radius)
    axis = end - start
    squared = float(axis @ axis)
    if squared == 0:
        raise InputError("b", b, "it equals a, so there is no axis", "use sphere(radius, center=a)")
    along = [float(component) for component in axis]
    relative = [q - float(s) for q, s in zip((X, Y, Z), start, strict=True)]
    dot = sum((q * c for q, c in zip(relative, along, strict=True)), start=0.0)
    t = clamp(dot / squared, 0.0, 1.0)
    distance = length(*(q - t * c for q, c in zip(relative, along, strict=True)))
    return exact_body(distance - r, np.minimum(start, end) - r, np.maximum(start, end) + r)


@primitive
def torus(major: float, minor: float) -> Body:
    """A ring about the z axis: a tube around a circle in the plane z = 0.

    Args:
        major: radius of the circle.
        minor: radius of the tube; less than `major`, as the ring would otherwise meet
            itself and its formula would not be a distance.
    """
    ring = arguments.positive("major", major)
    tube = arguments.positive("minor", minor)
    if tube >= ring:
        raise InputError(
            "minor", minor, f"the tube closes the hole of major = {ring:g}", "pass minor < major"
        )
    reach = ring + tube
    distance = length(length(X, Y) - ring, Z) - tube
    return exact_body(distance, (-reach, -reach, -tube), (reach, reach, tube))


@primitive
def cone(radius: float, height: float) -> Body:
    """A solid cone about the z axis, apex up, centred at the origin.

    The base is the disc of the radius at z = -height/2; the apex is at z = +height/2.

    Args:
        radius: of the base, greater than zero.
        height: greater than zero.
    """
    r = arguments.positive("radius", radius)
    h = arguments.positive("height", height)
    slant = math.hypot(r, h)
    across, below_apex = length(X, Y), h / 2 - Z
    # In the half-plane (distance from the axis, z): how far beyond the slanted side and
    # beyond the base, and where along each of them (zero excess on the edge itself).
    side = across * (h / slant) - below_apex * (r / slant)
    along = across * (r / slant) + below_apex * (h / slant)
    base = below_apex - h
    to_side = length(side, along - clamp(along, 0.0, slant))
    to_base = length(base, maximum(across - r, 0.0))
    distance = outside_or_faces(maximum(side, base), minimum(to_side, to_base))
    return exact_body(distance, (-r, -r, -h / 2), (r, r, h / 2))


# --- half-spaces ----------------------------------------------------------------------


@primitive
def plane(normal: str | ArrayLike, point: ArrayLike = ORIGIN) -> Body:
    """The half-space behind a plane: n . (p - point), negative on the side opposite n.

    Args:
        normal: an axis name ("z", "-x", ...) or a vector of any length.
        point: `(3,)`, any point of the plane.
    """
    n = arguments.direction("normal", normal)
    p = arguments.vector("point", point)
    height = float(np.dot(n, p))
    expression = n[0] * X + n[1] * Y + n[2] * Z - height
    return Body(expression, Tags.of_distance(_half_space_extent(n, height)))


def _half_space_extent(normal: arguments.Vector, height: float) -> Box:
    """Unbounded, except for a plane square to an axis."""
    extent = EVERYWHERE.copy()
    for axis, component in enumerate(normal):
        if component == 1:
            extent[1, axis] = height
        elif component == -1:
            extent[0, axis] = -height
    return extent


@primitive
def below(z: float) -> Body:
    """The half-space of points with a smaller z."""
    value = arguments.number("z", z)
    return exact_body(Z - value, (-math.inf,) * 3, (math.inf, math.inf, value))


@primitive
def above(z: float) -> Body:
    """The half-space of points with a larger z."""
    value = arguments.number("z", z)
    return exact_body(value - Z, (-math.inf, -math.inf, value), (math.inf,) * 3)


@primitive
def left(x: float) -> Body:
    """The half-space of points with a smaller x."""
    value = arguments.number("x", x)
    return exact_body(X - value, (-math.inf,) * 3, (value, math.inf, math.inf))


@primitive
def right(x: float) -> Body:
    """The half-space of points with a larger x."""
    value = arguments.number("x", x)
    return exact_body(value - X, (value, -math.inf, -math.inf), (math.inf,) * 3)


@primitive
def front(y: float) -> Body:
    """The half-space of points with a smaller y (nearer to a viewer who looks along +y)."""
    value = arguments.number("y", y)
    return exact_body(Y - value, (-math.inf,) * 3, (math.inf, value, math.inf))


@primitive
def behind(y: float) -> Body:
    """The half-space of points with a larger y."""
    value = arguments.number("y", y)
    return exact_body(value - Y, (-math.inf, value, -math.inf), (math.inf,) * 3)
