"""Triply periodic minimal surfaces: solids that fill all of space, and walls along them.

Each surface is the zero set of a trigonometric level function F of the coordinates times
2 pi / cell, the usual approximation to the minimal surface (Schoen, "Infinite periodic minimal
surfaces without self-intersections", NASA TN D-5541, 1970; von Schnering and Nesper, "Nodal
surfaces of Fourier series", 1991). The fields are F divided by a proven bound on its gradient:
Lipschitz with constant 1, so that they never overestimate a distance, and no distances.

They are unbounded: intersect them with what they are to fill, as in `gyroid(0.5, 0.05) & box(2)`.
"""

from __future__ import annotations

import math

from fields import arguments
from fields.expression import Coordinates, Expression, X, Y, Z, cos, sin
from fields.formulas import bounding_body
from fields.operations import Body
from fields.primitives import primitive
from fields.tags import EVERYWHERE


def _lattice(level: Expression, steepest: float, cell: float, thickness: float | None) -> Body:
    """F / (steepest * frequency), or its walls.

    On the set |F| = steepest * frequency * t / 2 every point is at least t / 2 from F = 0, by
    the bound, so a wall is nowhere thinner than t; it is thicker where F is less steep.
    """
    distance = level * (cell / (2 * math.pi * steepest))
    if thickness is not None:
        distance = abs(distance) - arguments.positive("thickness", thickness) / 2
    return bounding_body(distance, *EVERYWHERE)


def _angles(cell: float) -> tuple[float, Coordinates]:
    size = arguments.positive("cell", cell)
    rate = 2 * math.pi / size
    return size, (rate * X, rate * Y, rate * Z)


@primitive
def gyroid(cell: float, thickness: float | None = None) -> Body:
    """Schoen's gyroid: sin x cos y + sin y cos z + sin z cos x.

    Its gradient is (cos x cos y - sin z sin x, ...). By Cauchy and Schwarz the first square is
    at most (cos^2 x + sin^2 x) (cos^2 y + sin^2 z); the three sum to 3.

    Args:
        cell: the period along each axis.
        thickness: the least thickness of a wall along the surface; None for the solid on its
            negative side, half of space.
    """
    size, (x, y, z) = _angles(cell)
    level = sin(x) * cos(y) + sin(y) * cos(z) + sin(z) * cos(x)
    return _lattice(level, math.sqrt(3), size, thickness)


@primitive
def schwarz_p(cell: float, thickness: float | None = None) -> Body:
    """Schwarz's primitive surface: cos x + cos y + cos z.

    Its gradient (-sin x, -sin y, -sin z) is at most sqrt(3).

    Args:
        cell: the period along each axis.
        thickness: the least thickness of a wall along the surface; None for the solid on its
            negative side, around (cell/2, cell/2, cell/2).
    """
    size, (x, y, z) = _angles(cell)
    return _lattice(cos(x) + cos(y) + cos(z), math.sqrt(3), size, thickness)


@primitive
def schwarz_d(cell: float, thickness: float | None = None) -> Body:
    """Schwarz's diamond surface: sin x cos(y - z) + cos x sin(y + z).

    With C = cos(y - z), S = sin(y + z) and q = sin^2 x, the squared gradient is 2 plus the
    quadratic form (1 - 3q) C^2 - 2 sin x cos x C S - (2 - 3q) S^2, which is at most 1 on the
    square |C|, |S| <= 1. A form that is positive somewhere is largest on the border. On |C| = 1
    its largest value is 1 - 3q + q (1 - q) / (2 - 3q) <= 1 for q <= 5/8, and else that at
    |S| = 1, 2 |sin x cos x| - 1 <= 0; on |S| = 1 the same holds with 1 - q for q.

    Args:
        cell: the period along each axis.
        thickness: the least thickness of a wall along the surface; None for the solid on its
            negative side, half of space.
    """
    size, (x, y, z) = _angles(cell)
    level = sin(x) * cos(y - z) + cos(x) * sin(y + z)
    return _lattice(level, math.sqrt(3), size, thickness)


@primitive
def neovius(cell: float, thickness: float | None = None) -> Body:
    """Neovius' surface: 3 (cos x + cos y + cos z) + 4 cos x cos y cos z.

    The square of its gradient is a sum of sin^2 x (3 + 4 cos y cos z)^2; with A = cos^2 x and so
    on it is at most that of (1 - A) (3 + 2 B + 2 C)^2, which is convex in each of A, B and C and
    so largest at a corner of the unit cube: 50. (The true maximum seems to be 49.)

    Args:
        cell: the period along each axis.
        thickness: the least thickness of a wall along the surface; None for the solid on its
            negative side, around (cell/2, cell/2, cell/2).
    """
    size, (x, y, z) = _angles(cell)
    a, b, c = cos(x), cos(y), cos(z)
    return _lattice(3.0 * (a + b + c) + 4.0 * (a * b * c), math.sqrt(50), size, thickness)
