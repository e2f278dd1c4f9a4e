"""Closed triangle meshes as fields."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from fields.closed_mesh import ClosedMesh, Closest, closed_mesh
from fields.errors import InputError, MissingDependency
from fields.expression import X, Y, Z, call
from fields.field import Field, make_field
from fields.notation import Call, History, Opaque, literal
from fields.operations import Body
from fields.oracle import Boxes, enclose_by_lipschitz
from fields.tags import Tags

FORMATS = (".stl", ".obj", ".ply", ".off")

_BLOCK = 1 << 18
"""Points searched at a time: bounds the memory used beyond the result to some 100 MB."""


class TriangleMesh(Protocol):
    """What a mesh must have; `trimesh.Trimesh` does."""

    @property
    def vertices(self) -> ArrayLike:
        """`(v, 3)`."""
        ...

    @property
    def faces(self) -> ArrayLike:
        """`(f, 3)`, indices of vertices, counter-clockwise from outside."""
        ...


def mesh(source: TriangleMesh | str | os.PathLike[str]) -> Field:
    """The signed distance to a closed triangle mesh; exact, Lipschitz 1.

    The nearest triangle is found by Open3D in float32, relative to the size of the mesh;
    the nearest point on that triangle, its distance and the sign are then computed in
    float64. So values carry float64 accuracy except where float32 cannot tell which of
    two triangles is nearer: there the distance may be too large by about 1e-6 of the
    mesh's diagonal, or of the distance itself where that is larger.

    Gradients are the unit vectors away from (outside) or towards (inside) the nearest
    point, and on the surface the normal. Differentiating them again raises
    NotImplementedError. Points on other devices are brought to the CPU, and values taken back.

    Args:
        source: an object with `vertices` and `faces`, such as `trimesh.Trimesh`; or the
            path of an STL, OBJ, PLY or OFF file. If a file's surface is open as stored,
            vertices with equal coordinates are merged (STL has no other form). Objects
            are taken as they are.

    Raises:
        InputError: the file does not exist, cannot be read or is of another kind; the
            mesh is empty, open, non-manifold at an edge, inconsistently oriented or
            inside out, or has non-finite vertices.
        MissingDependency: Open3D is not installed or does not load.

    Non-guarantees: self-intersections are not looked for; where the surface crosses
    itself, the sign is that of the nearest sheet. Faces without area are accepted, but
    the sign can be wrong at points nearest to one that lies along a sharp edge.
    """
    history: History
    if isinstance(source, str | os.PathLike):
        surface = _read(Path(source))
        history = Call("mesh", (), (literal(source),))
    elif hasattr(source, "vertices") and hasattr(source, "faces"):
        surface = closed_mesh(source.vertices, source.faces)
        history = Opaque(f"mesh of {len(surface.faces)} faces")
    else:
        raise InputError(
            "source",
            source,
            "it is neither a mesh nor a path",
            "pass an object with vertices and faces, or the path of a file",
        )
    (value,) = call(MeshOracle(surface), (X, Y, Z))
    used = surface.vertices[np.unique(surface.faces)]
    extent = np.stack([used.min(axis=0), used.max(axis=0)])
    return make_field(Body(value, Tags.of_distance(extent)), history)


class MeshOracle:
    """The signed distance to a closed mesh, as a leaf of the expression graph."""

    name = "mesh"
    outputs = 1

    def __init__(self, surface: ClosedMesh) -> None:
        o3d = import_open3d("a mesh field")
        low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
        # Float32 resolves a mesh best if it is centred and of size one.
        self._center = (low + high) / 2
        self._size = float((high - low).max())
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(self._tensor(surface.vertices), _indices(o3d, surface))
        self._scene = scene
        self.surface = surface

    def __call__(self, points: Tensor) -> Tensor:
        """Signed distances `(..., 1)` at points `(..., 3)`."""
        return _SignedDistance.apply(points, self).unsqueeze(-1)

    def enclose(self, boxes: Boxes) -> np.ndarray:
        """A distance changes by at most one a unit of distance."""
        return enclose_by_lipschitz(self, boxes, 1.0)

    def closest(self, points: np.ndarray) -> Closest:
        """Signed distances and their gradients at float64 points `(n, 3)`, in blocks."""
        parts = [
            self.surface.closest(block, self._nearest_triangles(block))
            for block in np.array_split(points, max(1, -(-len(points) // _BLOCK)))
        ]
        distances, directions = zip(*parts, strict=True)
        return Closest(np.concatenate(distances), np.concatenate(directions))

    def _nearest_triangles(self, points: np.ndarray) -> np.ndarray:
        if len(points) == 0:
            return np.empty(0, dtype=np.int64)
        found = self._scene.compute_closest_points(self._tensor(points))
        return found["primitive_ids"].numpy().astype(np.int64)

    def _tensor(self, points: np.ndarray) -> Any:
        return import_open3d("a mesh field").core.Tensor(
            ((points - self._center) / self._size).astype(np.float32)
        )


def _indices(o3d: ModuleType, surface: ClosedMesh) -> Any:
    return o3d.core.Tensor(surface.faces.astype(np.uint32))


class _SignedDistance(torch.autograd.Function):
    """Values from the oracle; the gradient is the direction found along with them."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, oracle: MeshOracle) -> Tensor:
        flat = points.detach().to("cpu", torch.float64).reshape(-1, 3).numpy()
        closest = oracle.closest(flat)
        like = {"dtype": points.dtype, "device": points.device}
        direction = torch.from_numpy(closest.direction).to(**like).view(points.shape)
        ctx.save_for_backward(points, direction)
        return torch.from_numpy(closest.signed_distance).to(**like).view(points.shape[:-1])

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        points, direction = ctx.saved_tensors
        return upstream.unsqueeze(-1) * _Direction.apply(points, direction), None


class _Direction(torch.autograd.Function):
    """The gradient as a function of the points, so that differentiating it again fails
    instead of passing for zero."""

    @staticmethod
    def forward(ctx: Any, points: Tensor, direction: Tensor) -> Tensor:
        return direction.clone()

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        raise NotImplementedError(
            "second derivatives of a mesh field are not available; take its gradient with "
            "points.detach(), or sample it on a grid that can be differentiated twice"
        )


# --- files ----------------------------------------------------------------------------


def import_open3d(needed_for: str) -> ModuleType:
    """Open3D, or an error that says what needs it and how to get it."""
    try:
        return import_module("open3d")
    except (ImportError, OSError) as error:
        raise MissingDependency(
            "open3d",
            needed_for,
            "Install it with `pip install open3d`; on Debian it also needs the packages "
            f"libusb-1.0-0 libegl1 libgl1 (the import said: {error})",
        ) from error


def _read(path: Path) -> ClosedMesh:
    if not path.is_file():
        raise InputError("source", str(path), "there is no such file", "check the path")
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            "source",
            str(path),
            f"files of the kind {path.suffix or '(no extension)'} are not read here",
            f"use one of {', '.join(FORMATS)}, or load it with trimesh and pass the mesh",
        )
    o3d = import_open3d("a mesh field")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        loaded = o3d.io.read_triangle_mesh(str(path))
    vertices, faces = np.asarray(loaded.vertices), np.asarray(loaded.triangles)
    if len(faces) == 0:
        raise InputError(
            "source",
            str(path),
            "no triangles could be read from it",
            "check that the file is complete and holds a surface, not only points",
        )
    try:
        return closed_mesh(vertices, faces)
    except InputError:
        distinct, index = np.unique(vertices, axis=0, return_inverse=True)
        if len(distinct) == len(vertices):
            raise
        merged = index.reshape(-1)[faces]
        # Merging can make slivers collapse; what is left of them is no face any more.
        whole = (merged != np.roll(merged, -1, axis=1)).all(axis=1)
        return closed_mesh(distinct, merged[whole])
