"""Solids with flat faces, as true signed distances.

All of them are one construction (`convex_distance`): inside a convex polyhedron the nearest
point is the foot on the nearest face's plane; outside it is that foot where it lies in the face,
else a point of an edge. Symmetric solids fold the point by the mirrors of their group first, and
then look at the one face that is left (`fields.formulas` says why that is exact): the regular
and rhombic solids cost a few reflections and one edge.

The groups are those of Coxeter, "Regular Polytopes" (1973); folding into their chambers is
common in shaders. What is special here is that edges and corners are treated, so that values
are distances outside too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    maximum,
    minimum,
    sqrt,
    square,
    where_negative,
)
from fields.formulas import beyond, exact_body, folded, linear, outside_or_faces
from fields.operations import Body
from fields.primitives import primitive

Points = NDArray[np.float64]

GOLDEN = (1 + math.sqrt(5)) / 2

FLAT = 1e-9
"""Points within this part of a hull's size of a plane count as on it."""

MOST_POINTS = 60
"""Planes are found by trying all triples of points, and every edge costs 20 operations."""


class Face(NamedTuple):
    """A flat face.

    Attributes:
        normal: outward, of unit length.
        chain: corners in the order that is counter-clockwise from outside. Edges are between
            neighbours in the chain only: a whole face repeats its first corner at the end,
            and the part of one that mirrors leave is open where they cut it.
    """

    normal: Points
    chain: Sequence[Points]


def convex_distance(point: Coordinates, faces: Sequence[Face]) -> Expression:
    """The distance to a convex polyhedron, whose faces may be what mirrors leave of it."""
    heights, squares, outside_of = [], [], []
    seen: set[frozenset[bytes]] = set()
    for face in faces:
        height = linear(face.normal, point) - float(face.normal @ face.chain[0])
        heights.append(height)
        sides = []
        for side, square_distance, ends in _edges(point, face, height):
            sides.append(side)
            if ends not in seen:
                squares.append(square_distance)
                seen.add(ends)
        outside_of.append(maximum(*sides))
    outside = sqrt(minimum(*squares))
    for height, side in zip(heights, outside_of, strict=True):
        outside = where_negative(maximum(side, -height), height, outside)
    return outside_or_faces(maximum(*heights), outside)


def sheet_distance(point: Coordinates, face: Face) -> Expression:
    """The distance, nowhere negative, to a flat convex polygon."""
    height = linear(face.normal, point) - float(face.normal @ face.chain[0])
    sides, squares = [], []
    for side, square_distance, _ in _edges(point, face, height):
        sides.append(side)
        squares.append(square_distance)
    return where_negative(maximum(*sides), abs(height), sqrt(minimum(*squares)))


def _edges(
    point: Coordinates, face: Face, height: Expression
) -> list[tuple[Expression, Expression, frozenset[bytes]]]:
    """For each edge: how far beyond it in the face's plane, squared distance, its ends."""
    found = []
    for a, b in pairwise(face.chain):
        size = float(np.linalg.norm(b - a))
        tangent = (b - a) / size
        across = np.cross(tangent, face.normal)
        side = linear(across, point) - float(across @ a)
        position = linear(tangent, point) - float(tangent @ a)
        total = square(height) + square(side) + square(beyond(position, size))
        found.append((side, total, frozenset((a.tobytes(), b.tobytes()))))
    return found


# --- hulls ----------------------------------------------------------------------------


@primitive
def convex_hull(points: ArrayLike) -> Body:
    """The smallest convex solid that holds some points: any tetrahedron, wedge, gem.

    Args:
        points: `(n, 3)`, 4 to 60 of them, not all in one plane. Points inside the hull of the
            others do not matter.
    """
    cloud = arguments.points_array("points", points, 4)
    if len(cloud) > MOST_POINTS:
        raise InputError(
            "points",
            points,
            f"{len(cloud)} are more than {MOST_POINTS}, for which the formula would be too long",
            "use fields.mesh for a detailed polyhedron",
        )
    faces = hull_faces(cloud)
    if not faces:
        raise InputError(
            "points",
            points,
            "they lie in one plane, so there is no solid",
            "add a point off the plane, or use triangle or quad with a thickness",
        )
    return exact_body(convex_distance((X, Y, Z), faces), cloud.min(axis=0), cloud.max(axis=0))


def hull_faces(cloud: Points) -> list[Face]:
    """The faces of a hull: planes through three points that have no point in front."""
    size = float(np.ptp(cloud, axis=0).max())
    triples = cloud[list(combinations(range(len(cloud)), 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    # The widest triple of a plane comes first and gives its normal, for it rounds least.
    order = np.argsort(-lengths)
    wide = order[lengths[order] > FLAT * size * size]
    normals, corners = normals[wide] / lengths[wide, None], triples[wide, 0]
    heights = normals @ cloud.T - (normals * corners).sum(axis=1)[:, None]
    if not (np.abs(heights) > FLAT * size).any():
        return []
    faces: dict[frozenset[int], Face] = {}
    for normal, height in zip(
        np.concatenate([normals, -normals]), np.concatenate([heights, -heights]), strict=True
    ):
        if height.max() <= FLAT * size:
            members = np.flatnonzero(height >= -FLAT * size)
            faces.setdefault(frozenset(members.tolist()), _outline(cloud[members], normal))
    return list(faces.values())


def _outline(members: Points, normal: Points) -> Face:
    """The corners of a flat convex set of points, counter-clockwise about the normal."""
    middle = members.mean(axis=0)
    first = members[np.linalg.norm(members - middle, axis=1).argmax()] - middle
    u = first / np.linalg.norm(first)
    v = np.cross(normal, u)
    flat = np.stack([(members - middle) @ u, (members - middle) @ v], axis=1)
    kept = [int(i) for i in np.argsort(np.arctan2(flat[:, 1], flat[:, 0]))]
    while (straight := _first_straight(flat[kept])) is not None:
        del kept[straight]
    corners = [members[i] for i in kept]
    return Face(normal, [*corners, corners[0]])


def _first_straight(outline: Points) -> int | None:
    """The first point of a closed outline where it does not turn left, so no corner."""
    before = outline - np.roll(outline, 1, axis=0)
    after = np.roll(before, -1, axis=0)
    turns = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    sizes = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    straight = np.flatnonzero(turns <= FLAT * sizes)
    return int(straight[0]) if len(straight) else None


@primitive
def pyramid(width: float, height: float) -> Body:
    """A pyramid on a square, apex up, centred at the origin like a cone.

    Args:
        width: of the base, whose sides are along x and y, at z = -height/2.
        height: greater than zero.
    """
    w = arguments.positive("width", width) / 2
    h = arguments.positive("height", height) / 2
    # Folded by the mirrors x = 0, y = 0 and x = y: one side and half of its base are left.
    u, v = abs(X), abs(Y)
    point = (maximum(u, v), minimum(u, v), Z)
    slant = math.hypot(2 * h, w)
    middle, corner, apex = np.array([[w, 0.0, -h], [w, w, -h], [0.0, 0.0, h]])
    faces = [
        Face(np.array([2 * h, 0.0, w]) / slant, (middle, corner, apex)),
        Face(np.array([0.0, 0.0, -1.0]), (corner, middle)),
    ]
    return exact_body(convex_distance(point, faces), (-w, -w, -h), (w, w, h))


# --- regular and rhombic solids -------------------------------------------------------


class Chamber(NamedTuple):
    """What the mirrors of a solid leave: every point has one image there.

    Attributes:
        point: that image, of x, y and z.
        axis: the direction there of all three coordinate axes.
    """

    point: Coordinates
    axis: tuple[float, float, float]


def _octahedral() -> Chamber:
    """x >= y >= z >= 0, one of 48, by the mirrors of a cube.

    Its corners: (1, 0, 0) of order 4, (1, 1, 1) of order 3 and (1, 1, 0) of order 2.
    """
    x, y, z = abs(X), abs(Y), abs(Z)
    x, y = maximum(x, y), minimum(x, y)
    y, z = maximum(y, z), minimum(y, z)
    return Chamber((maximum(x, y), minimum(x, y), z), (1, 0, 0))


def _tetrahedral() -> Chamber:
    """x >= y >= |z|, one of 24, by the mirrors of a tetrahedron.

    The folds at x = y, y = z and y = -z, twice: the longest element of the group.
    """
    x, y, z = X, Y, Z
    for _ in range(2):
        x, y = maximum(x, y), minimum(x, y)
        y, z = maximum(y, z), minimum(y, z)
        y, z = maximum(y, -z), maximum(z, -y)
    return Chamber((x, y, z), (1, 0, 0))


_A, _B, _C = GOLDEN / 2, 1 / 2, 1 / (2 * GOLDEN)
ICOSAHEDRAL_FOLDS = ((_A, -_B, _C), (-_B, -_C, _A), (_A, -_B, -_C), (_C, _A, -_B), (-_B, -_C, _A))
"""Mirrors of an icosahedron that, after those of the coordinate planes, leave one chamber of
120: the shortest such list, found by trying all."""


def _icosahedral() -> Chamber:
    """One of 120, by the mirrors of an icosahedron.

    Its corners, with g the golden ratio: (g, 0, 1) of order 5, (1, 1, 1) of order 3 and
    (1, 1/g, g) of order 2.
    """
    point: tuple[Expression, ...] = (abs(X), abs(Y), abs(Z))
    for mirror in ICOSAHEDRAL_FOLDS:
        point = folded(point, mirror)
    x, y, z = point
    return Chamber((x, y, z), (_B, _C, _A))


def _uniform(chamber: Chamber, radius: float, normal: ArrayLike, *corners: ArrayLike) -> Body:
    """A solid with one kind of face, from the part of one edge that lies in the chamber.

    The foot of a point of the chamber in its face's plane lies on the same side of the mirrors
    through the face's middle, for these are square to the plane: only the edge can be passed.

    Args:
        chamber: where one face is looked at.
        radius: of the sphere through the farthest corners.
        normal: of the face, of any length.
        corners: directions of the two ends of the edge's part.
    """
    r = arguments.positive("radius", radius)
    n = np.array(normal, np.float64)
    n /= np.linalg.norm(n)
    ends = np.array([np.divide(c, n @ np.asarray(c)) for c in corners])
    ends *= r / np.linalg.norm(ends, axis=1).max()
    if np.cross(ends[1] - ends[0], n) @ ends[0] < 0:
        ends = ends[::-1]
    distance = convex_distance(chamber.point, [Face(n, ends)])
    reach = np.full(3, (ends @ np.array(chamber.axis)).max())
    return exact_body(distance, -reach, reach)


@primitive
def tetrahedron(radius: float) -> Body:
    """Four triangles; one corner along (1, 1, 1).

    Args:
        radius: of the sphere through the corners.
    """
    return _uniform(_tetrahedral(), radius, (1, 1, -1), (1, 0, 0), (1, 1, 1))


@primitive
def octahedron(radius: float) -> Body:
    """Eight triangles; the corners lie on the axes.

    Args:
        radius: of the sphere through the corners.
    """
    return _uniform(_octahedral(), radius, (1, 1, 1), (1, 1, 0), (1, 0, 0))


@primitive
def dodecahedron(radius: float) -> Body:
    """Twelve pentagons; one corner along (1, 1, 1), edges square to the axes.

    Args:
        radius: of the sphere through the corners.
    """
    two = (1, 1 / GOLDEN, GOLDEN)
    return _uniform(_icosahedral(), radius, (GOLDEN, 0, 1), two, (1, 1, 1))


@primitive
def icosahedron(radius: float) -> Body:
    """Twenty triangles; one face square to (1, 1, 1), edges square to the axes.

    Args:
        radius: of the sphere through the corners.
    """
    two = (1, 1 / GOLDEN, GOLDEN)
    return _uniform(_icosahedral(), radius, (1, 1, 1), two, (GOLDEN, 0, 1))


@primitive
def rhombic_dodecahedron(radius: float) -> Body:
    """Twelve rhombi, a solid that fills space; six corners lie on the axes.

    Args:
        radius: of the sphere through those six, the farthest of its fourteen corners.
    """
    return _uniform(_octahedral(), radius, (1, 1, 0), (1, 0, 0), (1, 1, 1))


@primitive
def rhombic_triacontahedron(radius: float) -> Body:
    """Thirty rhombi, six of them square to the axes.

    Args:
        radius: of the sphere through the farthest corners, twelve of thirty-two.
    """
    two = (1, 1 / GOLDEN, GOLDEN)
    return _uniform(_icosahedral(), radius, two, (GOLDEN, 0, 1), (1, 1, 1))
