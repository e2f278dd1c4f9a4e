"""Triangle meshes as fields."""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from fields.closed_mesh import ClosedMesh, Closest, ImperfectMesh, checked_arrays, closed_mesh
from fields.errors import InputError
from fields.expression import X, Y, Z, call
from fields.field import Field, make_field
from fields.imperfect_mesh import TriangleSoup, triangle_soup
from fields.mesh_files import merged, read_triangles
from fields.notation import History, Opaque, recorded
from fields.operations import Body
from fields.oracle import Boxes, enclose_by_lipschitz
from fields.triangle_tree import Floats, Integers, TriangleTree

_BLOCK = 1 << 18
"""Points searched at a time: bounds the memory used beyond the result to some 100 MB."""

Sign = Literal["auto", "normals", "winding"]
Imperfect = Literal["error", "warn", "accept"]

_CHOICES = {"sign": ("auto", "normals", "winding"), "imperfect": ("error", "warn", "accept")}


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


def mesh(
    source: TriangleMesh | str | os.PathLike[str],
    *,
    sign: Sign = "auto",
    imperfect: Imperfect = "error",
) -> Field:
    """The signed distance to a triangle mesh.

    Of a closed, consistently oriented mesh it is exact, with Lipschitz bound 1. The nearest
    triangle, the distance and the sign are computed in float64.

    A mesh that is open, non-manifold at an edge, inconsistently oriented, inside out or has
    degenerate faces is refused, unless `imperfect` says otherwise. Then degenerate faces are left
    out and faces are turned to agree with their neighbours. If that mends it, all is as above. If
    not, the sign is that of the winding number: inside is where it is above one half, within the
    mesh's box. The tags then say what is left: the field is not exact, and has no Lipschitz bound
    if there are holes, as the sign switches in them while the distance is not zero.

    Gradients are the unit vectors away from (outside) or towards (inside) the nearest
    point, and on the surface the normal. Differentiating them again raises
    NotImplementedError. Points on other devices are brought to the CPU, and values taken back.

    Args:
        source: an object with `vertices` and `faces`, such as `trimesh.Trimesh`; or the
            path of an STL, OBJ, PLY, OFF, GLB, glTF or 3MF file. If a file's surface is open as
            stored, vertices with equal coordinates are merged (STL has no other form). Objects
            are taken as they are.
        sign: how inside is told from outside: "normals", from the surface's normal at the nearest
            point, which needs a closed mesh; "winding", by winding number, for meshes that
            intersect themselves; "auto", the first where it can be.
        imperfect: what to do with an imperfect mesh: "error" refuses it, "warn" says what is the
            matter and takes it, "accept" takes it.

    Raises:
        InputError: the file does not exist, cannot be read or is of another kind; the
            mesh is empty, flat or imperfect, or has non-finite vertices.
        MissingDependency: trimesh, which reads files, is not installed.

    Non-guarantees: self-intersections are not looked for. Where the surface crosses itself, the
    sign by normals is that of the nearest sheet; by winding number it is right, but the distance
    inside is one to the nearest sheet even if that is itself inside. Faces without area are
    accepted, but the sign by normals can be wrong at points nearest to one that lies along a
    sharp edge. An imperfect mesh far from closed has no inside that all would agree on.
    """
    for argument, value in (("sign", sign), ("imperfect", imperfect)):
        if value not in _CHOICES[argument]:
            known = ", ".join(repr(choice) for choice in _CHOICES[argument])
            raise InputError(argument, value, "there is no such choice", f"use one of {known}")
    history: History
    is_file = isinstance(source, str | os.PathLike)
    if is_file:
        vertices, faces = read_triangles(Path(source))
        given = {"source": source, "sign": sign, "imperfect": imperfect}
        history = recorded("mesh", (), given, {"sign": "auto", "imperfect": "error"})
    elif hasattr(source, "vertices") and hasattr(source, "faces"):
        vertices, faces = source.vertices, source.faces
        history = Opaque(f"mesh of {len(faces)} faces")
    else:
        raise InputError(
            "source",
            source,
            "it is neither a mesh nor a path",
            "pass an object with vertices and faces, or the path of a file",
        )
    surface = _surface(vertices, faces, sign, imperfect, may_merge=is_file)
    (value,) = call(MeshOracle(surface), (X, Y, Z))
    return make_field(Body(value, surface.tags), history)


def _surface(
    vertices: ArrayLike, faces: ArrayLike, sign: Sign, imperfect: Imperfect, may_merge: bool
) -> ClosedMesh | TriangleSoup:
    """The mesh, prepared for the sign that was asked for, or the error that it deserves."""
    v, f = checked_arrays(vertices, faces)
    try:
        try:
            surface: ClosedMesh | TriangleSoup = closed_mesh(v, f)
        except ImperfectMesh:
            if not may_merge:
                raise
            v, f = merged(v, f)
            surface = closed_mesh(v, f)
    except ImperfectMesh as defect:
        if imperfect == "error":
            raise _with_remedy(
                defect, 'or pass imperfect="accept" for a sign by winding number'
            ) from None
        surface = _mended(v, f)
        if sign == "normals" and isinstance(surface, TriangleSoup):
            raise _with_remedy(defect, 'or choose sign="winding"') from None
        if imperfect == "warn":
            how = "mended" if isinstance(surface, ClosedMesh) else "its sign is by winding number"
            message = f"the mesh is imperfect, {how}. {defect.value}: {defect.cause}"
            warnings.warn(message, stacklevel=3)
    if sign == "winding" and isinstance(surface, ClosedMesh):
        return TriangleSoup(surface.vertices, surface.faces, is_closed=True)
    return surface


def _mended(vertices: Floats, faces: Integers) -> ClosedMesh | TriangleSoup:
    soup = triangle_soup(vertices, faces)
    try:
        return closed_mesh(soup.vertices, soup.faces)
    except ImperfectMesh:
        return soup


def _with_remedy(error: InputError, also: str) -> ImperfectMesh:
    return ImperfectMesh(error.argument, error.value, error.cause, f"{error.remedy}; {also}")


class MeshOracle:
    """The signed distance to a mesh, as a leaf of the expression graph."""

    name = "mesh"
    outputs = 1

    def __init__(self, surface: ClosedMesh | TriangleSoup) -> None:
        self.surface = surface
        self._tree = TriangleTree(surface.vertices[surface.faces])

    def __call__(self, points: Tensor) -> Tensor:
        """Signed distances `(..., 1)` at points `(..., 3)`."""
        return _SignedDistance.apply(points, self).unsqueeze(-1)

    def enclose(self, boxes: Boxes) -> np.ndarray:
        """A distance changes by at most one a unit of distance.

        Where the sign can switch within a box, both signs of all that its size can be.
        """
        bounds = enclose_by_lipschitz(self, boxes, 1.0)
        if self.surface.tags.lipschitz is None:
            most = np.abs(bounds).max(axis=-1)
            bounds = np.stack([-most, most], axis=-1)
        return bounds

    def closest(self, points: np.ndarray) -> Closest:
        """Signed distances and their gradients at float64 points `(n, 3)`, in blocks."""
        parts = [
            self.surface.closest(block, self._tree)
            for block in np.array_split(points, max(1, -(-len(points) // _BLOCK)))
        ]
        distances, directions = zip(*parts, strict=True)
        return Closest(np.concatenate(distances), np.concatenate(directions))

    def within(self, points: np.ndarray, limit: float) -> np.ndarray:
        """Signed distances at float64 points `(n, 3)`; NaN where they are not below `limit`.

        Much faster than `closest` for points most of which are far away.
        """
        values = np.full(len(points), np.nan)
        near = self._tree.nearest(points, limit).triangle >= 0
        values[near] = self.closest(points[near]).signed_distance
        return values


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
