"""Points with true distances, drawn from a field before a network is fitted to it.

Every number comes from the field itself: a point moved off the surface by h along the normal is not
at the distance h where another part of the surface is nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fields.errors import InputError
from fields.expression import X, Y, Z
from fields.field import Field
from fields.mesh import MeshOracle
from fields.neural.options import NeuralOptions

Floats = NDArray[np.float64]

_BAND = 0.03
"""Half the width of the band from which surface points are projected, over the diagonal."""

_ROUNDS = 256
"""Draws of points in the box before a surface that no band catches is given up."""

_ON_SURFACE = 1e-4
"""How far from the surface a projected point may end, over the diagonal."""


@dataclass(frozen=True, slots=True, eq=False)
class Cube:
    """A training box and its place in [-1, 1]^3.

    Attributes:
        box: `(2, 3)`.
        diagonal: of the shape's own bounds; errors are measured by it.
    """

    box: Floats
    diagonal: float

    @staticmethod
    def around(bounds: Floats, padding: float) -> Cube:
        """The bounds, and a fraction `padding` of their diagonal more on every side."""
        diagonal = float(np.linalg.norm(np.ptp(bounds, axis=0)))
        return Cube(bounds + padding * diagonal * np.array([[-1.0], [1.0]]), diagonal)

    @property
    def unit(self) -> float:
        """The length of 1 of the cube: half the longest side of the box."""
        return float(np.ptp(self.box, axis=0).max()) / 2

    def inwards(self, points: Floats) -> Tensor:
        """Points of the box, in the cube, float32."""
        return torch.from_numpy((points - self.box.mean(axis=0)) / self.unit).float()


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points in the cube [-1, 1]^3 with distances in its units, float32.

    Attributes:
        surface, gradients: `(m, 3)` on the surface, and of the field there: normals of a distance.
        near, near_distances: `(m, 3)` and `(m,)`, the same points moved off the surface.
        box, box_distances: `(k, 3)` and `(k,)`, uniform in the training box.
    """

    surface: Tensor
    gradients: Tensor
    near: Tensor
    near_distances: Tensor
    box: Tensor
    box_distances: Tensor

    def to(self, device: str) -> Samples:
        """On another device."""
        return Samples(*(getattr(self, name).to(device) for name in self.__slots__))


def bounded(source: Field) -> Floats:
    """The bounds of a field that can be learned.

    Raises:
        InputError: it has none, or they are flat.
    """
    if source.bounds is None:
        raise InputError(
            "source",
            source,
            "it has no bounds, so there is no box to learn it in",
            "intersect it with a box",
        )
    if not (np.ptp(source.bounds, axis=0) > 0).all():
        raise InputError(
            "source", source.bounds.tolist(), "its bounds hold nothing", "pass a solid shape"
        )
    return source.bounds


def draw(source: Field, cube: Cube, options: NeuralOptions) -> Samples:
    """All samples of a fit.

    Raises:
        InputError: the field is NaN or infinite somewhere, or has no surface in its bounds.
    """
    rng = np.random.default_rng(options.seed)
    surface, gradients = surface_points(source, cube, options.near_samples, rng)
    spread = cube.diagonal * rng.choice(np.array(options.near_scales), len(surface))
    near = surface + rng.normal(size=surface.shape) * spread[:, None]
    near = np.clip(near, cube.box[0], cube.box[1])
    box = rng.uniform(cube.box[0], cube.box[1], (options.box_samples, 3))

    def distances(points: Floats) -> Tensor:
        return torch.from_numpy(_finite(source, points) / cube.unit).float()

    return Samples(
        surface=cube.inwards(surface),
        gradients=torch.from_numpy(gradients).float(),
        near=cube.inwards(near),
        near_distances=distances(near),
        box=cube.inwards(box),
        box_distances=distances(box),
    )


def surface_points(
    source: Field, cube: Cube, count: int, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    """About uniform points `(count, 3)` on a field's surface in a box, and its gradients there.

    Those of a distance have length 1, also on an edge, where the field's own is a mean of two.
    """
    mesh = _mesh_of(source)
    points = _on_faces(mesh, count, rng) if mesh else _projected(source, cube, count, rng)
    gradients = source.gradient(points)
    return points, units(gradients) if source.exact else gradients


def units(vectors: Floats) -> Floats:
    """Vectors `(n, 3)` at length 1; zero where they are."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)


def _mesh_of(source: Field) -> MeshOracle | None:
    """The mesh that a field is the distance to, if it is just that."""
    node = source.expression
    node = node.arguments[0] if node.kind == "component" else node
    is_mesh = isinstance(node.payload, MeshOracle) and node.arguments == (X, Y, Z)
    return node.payload if is_mesh else None


def _on_faces(mesh: MeshOracle, count: int, rng: np.random.Generator) -> Floats:
    """Uniform by area."""
    corners = mesh.surface.vertices[mesh.surface.faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.linalg.norm(np.cross(first, second), axis=1)
    face = rng.choice(len(areas), count, p=areas / areas.sum())
    u, v = rng.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return corners[face, 0] + u * first[face] + v * second[face]


def _projected(source: Field, cube: Cube, count: int, rng: np.random.Generator) -> Floats:
    """Uniform points of a thin band around the surface, moved onto it by Newton's method.

    The band's volume over a piece of surface is that of the piece times the band's width, so that
    points come out nearly uniform by area.
    """
    found: list[Floats] = []
    have = 0
    for _ in range(_ROUNDS):
        points = rng.uniform(cube.box[0], cube.box[1], (max(count, 1 << 14), 3))
        points = points[np.abs(_finite(source, points)) < _BAND * cube.diagonal]
        points = points[: count - have + count // 8]  # a few are lost on the way
        for _ in range(3):
            values, gradient = source.value_and_gradient(points)
            squared = np.maximum((gradient**2).sum(axis=1), 1e-12)
            points = points - (values / squared)[:, None] * gradient
        on = np.abs(source(points)) <= _ON_SURFACE * cube.diagonal
        on &= ((points >= cube.box[0]) & (points <= cube.box[1])).all(axis=1)
        found.append(points[on])
        have += int(on.sum())
        if have >= count:
            return np.concatenate(found)[:count]
    raise InputError(
        "source",
        source,
        f"of {count} points of its surface only {have} were found in its bounds",
        "check that it is negative somewhere inside them, and positive around",
    )


def _finite(source: Field, points: Floats) -> Floats:
    values = source(points)
    bad = ~np.isfinite(values)
    if bad.any():
        raise InputError(
            "source",
            source,
            f"its value at {points[bad.argmax()].tolist()} is {values[bad.argmax()]}",
            "mend the field: it must be finite everywhere in its bounds",
        )
    return values
