"""Solids described a second time, by points of their surface and by who is inside.

Nothing here computes a distance to anything but points: hulls come from Qhull, profiles are
traced and turned or extruded, tubes are swept, level sets are found by bisection.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from fields import Field
from tests.fields.catalogue.surface import REACH, Surface

Piece = Callable[[np.ndarray], np.ndarray]
"""Part of a curve: parameters `(n,)` in [0, 1] to points `(n, d)`."""


def line(a: Sequence[float], b: Sequence[float]) -> Piece:
    start, end = np.array(a, float), np.array(b, float)
    return lambda t: start + t[:, None] * (end - start)


def arc(center: Sequence[float], radius: float, begin: float, end: float) -> Piece:
    """From one angle to another, in degrees, counter-clockwise from the first axis."""

    def points(t: np.ndarray) -> np.ndarray:
        angle = np.radians(begin + t * (end - begin))
        return np.array(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    return points


def outline(*corners: Sequence[float]) -> list[Piece]:
    """The lines from each corner to the next."""
    return [line(a, b) for a, b in pairwise(corners)]


def directions(rng: np.random.Generator, n: int) -> np.ndarray:
    vectors = rng.normal(size=(n, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def on_pieces(rng: np.random.Generator, n: int, pieces: Sequence[Piece]) -> np.ndarray:
    """As many points on each piece, its ends among them."""
    share = -(-n // len(pieces))
    return np.concatenate(
        [piece(np.concatenate([[0.0, 1.0], rng.uniform(size=share - 2)])) for piece in pieces]
    )


def hull(field: Field, corners: np.ndarray) -> Surface:
    """The convex hull of some points."""
    found = ConvexHull(corners)
    triangles = found.points[found.simplices]
    area = np.linalg.norm(
        np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
    )

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        weights = rng.dirichlet((1, 1, 1), n - len(corners))
        chosen = triangles[rng.choice(len(area), n - len(corners), p=area / area.sum())]
        vertices = found.points[found.vertices]
        return np.concatenate([vertices, (weights[..., None] * chosen).sum(axis=1)])

    normals, offsets = found.equations[:, :3], found.equations[:, 3]
    return Surface(field, sample, lambda p: (p @ normals.T + offsets < 0).all(axis=1))


def revolved(
    field: Field,
    pieces: Sequence[Piece],
    inside: Callable[[np.ndarray, np.ndarray], np.ndarray],
    place: Callable[[np.ndarray], np.ndarray] = lambda p: p,
    unplace: Callable[[np.ndarray], np.ndarray] = lambda p: p,
) -> Surface:
    """A profile in (distance from the axis, height), turned about z and then placed."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        profile = on_pieces(rng, n, pieces)
        angle = rng.uniform(0, 2 * np.pi, len(profile))
        r, z = profile.T
        return place(np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1))

    def within(points: np.ndarray) -> np.ndarray:
        p = unplace(points)
        return inside(np.hypot(p[:, 0], p[:, 1]), p[:, 2])

    return Surface(field, sample, within)


def extruded(
    field: Field,
    pieces: Sequence[Piece],
    inside: Callable[[np.ndarray, np.ndarray], np.ndarray],
    height: float,
    axes: tuple[int, int, int] = (0, 1, 2),
) -> Surface:
    """A border in two coordinates, extruded along the third; `axes` says which are which."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        border = on_pieces(rng, n // 2, pieces)
        wall = np.column_stack([border, rng.uniform(-height / 2, height / 2, len(border))])
        low, high = border.min(axis=0), border.max(axis=0)
        plane = rng.uniform(low, high, (2 * n, 2))
        plane = np.concatenate([border[:40], plane[inside(*plane.T)][: n // 2]])
        cap = np.column_stack([plane, rng.choice([-height / 2, height / 2], len(plane))])
        points = np.empty((len(wall) + len(cap), 3))
        points[:, axes] = np.concatenate([wall, cap])
        return points

    first, second, third = axes
    return Surface(
        field,
        sample,
        lambda p: inside(p[:, first], p[:, second]) & (np.abs(p[:, third]) < height / 2),
    )


def tube(
    field: Field,
    pieces: Sequence[Piece],
    radius: float,
    closed: bool = False,
    flat: np.ndarray | None = None,
) -> Surface:
    """All that is within a radius of a curve made of pieces, or the discs square to it.

    Around joints of pieces there are balls, parts of which may be inside: drop those samples by
    `outermost`. With `flat`, the tangents `(2, 3)` at both ends, these are discs.
    """
    step = 1e-6

    def frames(piece: Piece, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tangent = piece(np.minimum(t + step, 1)) - piece(np.maximum(t - step, 0))
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        other = np.eye(3)[np.abs(tangent).argmin(axis=1)]
        u = np.cross(tangent, other)
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        return tangent, u, np.cross(tangent, u)

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        found = []
        share = n // (len(pieces) + (0 if closed else 1))
        for piece in pieces:
            t, angle = rng.uniform(size=share), rng.uniform(0, 2 * np.pi, (share, 1))
            _, u, v = frames(piece, t)
            found.append(piece(t) + radius * (np.cos(angle) * u + np.sin(angle) * v))
        if not closed:
            for index, (piece, end) in enumerate(((pieces[0], 0.0), (pieces[-1], 1.0))):
                at = np.full(share // 2, end)
                if flat is None:
                    out = directions(rng, len(at))
                    outwards = (2 * end - 1) * frames(piece, at)[0]
                    out *= np.sign((out * outwards).sum(axis=1, keepdims=True))
                else:
                    out = np.cross(directions(rng, len(at)), flat[index])
                    out /= np.linalg.norm(out, axis=1, keepdims=True)
                    out *= np.sqrt(rng.uniform(size=(len(at), 1)))
                found.append(piece(at) + radius * out)
            joints = np.concatenate(
                [np.zeros((0, 3)), *(piece(np.ones(1000)) for piece in pieces[:-1])]
            )
            found.append(joints + radius * directions(rng, len(joints)))
        return np.concatenate(found)

    dense = np.linspace(0, 1, 40_001)
    tree = cKDTree(np.concatenate([piece(dense) for piece in pieces]))

    def inside(points: np.ndarray) -> np.ndarray:
        distance, nearest = tree.query(points)
        within = distance < radius
        if flat is not None:
            within &= (nearest > 0) & (nearest < tree.n - 1)
        return within

    return Surface(field, sample, inside)


def outermost(surface: Surface, distance: Callable[[np.ndarray], np.ndarray]) -> Surface:
    """Without the samples that `distance` says are inside."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        points = surface.sample(rng, n)
        return points[distance(points) > -1e-9]

    return Surface(surface.field, sample, surface.inside)


def level_set(
    field: Field, value: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
) -> Surface:
    """Where a function of x, y and z is negative; its zeros by bisection between random points."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        a, b = rng.uniform(-REACH, REACH, (2, 6 * n, 3))
        b = a + 0.1 * (b - a)
        crossing = (value(*a.T) < 0) != (value(*b.T) < 0)
        a, b = a[crossing][:n], b[crossing][:n]
        below = value(*a.T) < 0
        low, high = np.where(below[:, None], a, b), np.where(below[:, None], b, a)
        for _ in range(60):
            middle = (low + high) / 2
            negative = (value(*middle.T) < 0)[:, None]
            low, high = np.where(negative, middle, low), np.where(negative, high, middle)
        return (low + high) / 2

    return Surface(field, sample, lambda p: value(*p.T) < 0)


def radial(field: Field, gauge: Callable[[np.ndarray], np.ndarray]) -> Surface:
    """Where a function that grows in proportion along rays from the origin is below 1."""

    def sample(rng: np.random.Generator, n: int) -> np.ndarray:
        rays = np.concatenate([np.eye(3), -np.eye(3), directions(rng, n - 6)])
        return rays / gauge(rays)[:, None]

    return Surface(field, sample, lambda p: gauge(p) < 1)
