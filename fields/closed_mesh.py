"""Closed triangle meshes: what a signed distance needs of them, checked and prepared.

The sign of the distance comes from pseudonormals (Baerentzen and Aanaes, "Signed distance
computation using the angle weighted pseudonormal", IEEE TVCG 2005): if c is the point of
the surface nearest to p, then p is outside exactly if (p - c) . n > 0, where n is the
normal of the face, the sum of the normals of both faces at an edge, or the sum of the
normals weighted by their angles at a vertex, whichever c lies on. Unlike counting the
crossings of a ray, this cannot be upset by a ray that passes through an edge. Where parts
touch in a vertex their sums are added: a ball around p that meets the surface only in that
vertex is on the same side of all of them, so each sum has the same sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields.errors import InputError
from fields.tags import Box, Tags
from fields.triangle_tree import Floats, Integers, TriangleTree


class ImperfectMesh(InputError):  # noqa: N818 (named for what is the matter)
    """A mesh that is no closed, consistently oriented surface of a solid."""


class Closest(NamedTuple):
    """The nearest points of given triangles.

    Attributes:
        signed_distance: `(n,)`, negative inside.
        direction: `(n, 3)`, the unit gradient of the signed distance.
    """

    signed_distance: Floats
    direction: Floats


def directed(
    away: Floats, sign: Floats, normal: Floats, use_normal: NDArray[np.bool_], size: Floats
) -> Closest:
    """Signed distances and their unit gradients.

    On the surface there is no direction to the nearest point; and above the inside of a face the
    normal is that direction, without its rounding.

    Args:
        away: `(n, 3)`, from the nearest points.
        sign: `(n,)`, -1 inside, else 1.
        normal: `(n, 3)`, of the surface at the nearest points, of any length.
        use_normal: `(n,)`, where the normal is the gradient.
        size: `(n,)`, that of the coordinates, which decides what counts as on the surface.
    """
    distance = np.linalg.norm(away, axis=1)
    use_normal = use_normal | (distance <= 1e-12 * size)
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = np.where(
            use_normal[:, None],
            normal / np.linalg.norm(normal, axis=1, keepdims=True),
            sign[:, None] * away / distance[:, None],
        )
    return Closest(sign * distance, np.nan_to_num(direction, nan=0.0))


@dataclass(frozen=True, slots=True, eq=False)
class ClosedMesh:
    """A closed, consistently oriented triangle mesh with outward normals.

    Made by `closed_mesh`, which checks all of that. It may have several parts, cavities
    and vertices where parts only touch. Not checked: self-intersection.

    Attributes:
        vertices: `(v, 3)`.
        faces: `(f, 3)`, counter-clockwise from outside.
        normals: `(f, 3)`, unit; zero for faces without area.
        neighbours: `(f, 3)`, the face across the edge from corner k to corner k + 1.
        vertex_normals: `(v, 3)`, sums of the normals of the faces, weighted by angle.
    """

    vertices: Floats
    faces: Integers
    normals: Floats
    neighbours: Integers
    vertex_normals: Floats

    @property
    def tags(self) -> Tags:
        """Those of a true distance."""
        return Tags.of_distance(extent_of(self.vertices, self.faces))

    def closest(self, points: Floats, tree: TriangleTree) -> Closest:
        """Signed distances and their gradients at points `(n, 3)`, by the tree of the faces."""
        triangle, feature, foot = tree.nearest(points)
        normal = self._pseudonormals(triangle, feature)
        sign = np.where(np.einsum("ij,ij->i", points - foot, normal) < 0, -1.0, 1.0)
        size = np.abs(self.vertices[self.faces[triangle]]).max(axis=(1, 2))
        return directed(points - foot, sign, normal, feature == 0, size)

    def _pseudonormals(self, triangles: Integers, feature: Integers) -> Floats:
        normal = self.normals[triangles].copy()
        for k in range(3):
            on_edge = feature == 1 + k
            normal[on_edge] += self.normals[self.neighbours[triangles[on_edge], k]]
            on_corner = feature == 4 + k
            normal[on_corner] = self.vertex_normals[self.faces[triangles[on_corner], k]]
        return normal


# --- checking and preparing -----------------------------------------------------------


def closed_mesh(vertices: ArrayLike, faces: ArrayLike) -> ClosedMesh:
    """Check a mesh and prepare it for signed distances.

    Raises:
        InputError: it is empty, has NaN or infinite vertices, bad indices, open or
            non-manifold edges, faces turned against their neighbours, no volume, or is
            inside out.
        ImperfectMesh: an InputError, for all but the first three of these and no volume.
    """
    v, f = checked_arrays(vertices, faces)
    _refuse_degenerate(f)
    neighbours = _neighbours(f)
    corners = v[f]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = signed_volume(corners)
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if abs(volume) <= 1e-12 * size**3:
        raise InputError(
            "mesh", f"volume {volume:g}", "it encloses nothing", "pass the surface of a solid"
        )
    if volume < 0:
        raise ImperfectMesh(
            "mesh",
            f"volume {volume:g}",
            "it is inside out: its normals point into the solid",
            "reverse every face, with mesh.invert() in trimesh",
        )
    lengths = np.linalg.norm(cross, axis=1, keepdims=True)
    normals = cross / np.where(lengths > 0, lengths, 1.0)
    weighted = _corner_angles(corners)[:, :, None] * normals[:, None, :]
    vertex_normals = np.zeros_like(v)
    np.add.at(vertex_normals, f.reshape(-1), weighted.reshape(-1, 3))
    return ClosedMesh(v, f, normals, neighbours, vertex_normals)


def signed_volume(corners: Floats) -> float:
    """The volume that closed triangles `(f, 3, 3)` enclose, negative if they are inside out.

    About the middle of the mesh, so that one far from the origin loses no digits.
    """
    a, b, c = np.moveaxis(corners - (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1))) / 2, 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b - a, c - a))) / 6


def extent_of(vertices: Floats, faces: Integers) -> Box:
    """The box of the vertices that faces use."""
    used = vertices[np.unique(faces)]
    return np.stack([used.min(axis=0), used.max(axis=0)])


def checked_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[Floats, Integers]:
    """Vertices `(v, 3)`, finite, and faces `(f, 3)` of them, at least one.

    Raises:
        InputError: they are something else.
    """
    v, f = np.array(vertices, dtype=np.float64), np.asarray(faces)
    if v.size == 0 or f.size == 0:
        raise InputError(
            "mesh",
            f"{len(v)} vertices and {len(f)} faces",
            "it is empty",
            "check the file or the step that made it",
        )
    if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3 or f.dtype.kind not in "iu":
        raise InputError(
            "mesh",
            f"vertices {v.shape}, faces {f.shape} {f.dtype}",
            "vertices (v, 3) and integer triangles (f, 3) are needed",
            "triangulate it first",
        )
    bad = ~np.isfinite(v).all(axis=1)
    if bad.any():
        raise InputError(
            "mesh",
            v[bad.argmax()].tolist(),
            f"{bad.sum()} of {len(v)} vertices are NaN or infinite, the first is number "
            f"{bad.argmax()}",
            "repair or remove them",
        )
    f = f.astype(np.int64)
    if f.min() < 0 or f.max() >= len(v):
        raise InputError(
            "mesh",
            f"face indices from {f.min()} to {f.max()}",
            f"there are only {len(v)} vertices",
            "check the step that made it",
        )
    return v, f


def uses_a_vertex_twice(faces: Integers) -> NDArray[np.bool_]:
    """Which faces have fewer than three corners."""
    return (faces == np.roll(faces, -1, axis=1)).any(axis=1)


def _refuse_degenerate(faces: Integers) -> None:
    twice = uses_a_vertex_twice(faces)
    if twice.any():
        raise ImperfectMesh(
            "mesh",
            f"face {twice.argmax()} = {faces[twice.argmax()].tolist()}",
            f"{twice.sum()} faces use a vertex twice",
            "remove degenerate faces",
        )


def _neighbours(faces: Integers) -> Integers:
    """For each face and corner k, the face across the edge from corner k to k + 1.

    An oriented closed surface has every directed edge once, and its reverse once.
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    count = int(faces.max()) + 1
    key, reverse = start * count + end, end * count + start
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    repeated = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(repeated):
        edge = order[repeated[0]]
        raise ImperfectMesh(
            "mesh",
            f"edge {start[edge]} -> {end[edge]}",
            f"{len(repeated)} edges are used twice in the same direction: faces are turned "
            "against their neighbours, doubled, or more than two meet at an edge",
            "make the winding consistent (trimesh: mesh.fix_normals()) and remove doubled "
            "or non-manifold faces",
        )
    position = np.minimum(np.searchsorted(ordered, reverse), len(ordered) - 1)
    is_open = ordered[position] != reverse
    if is_open.any():
        edge = is_open.argmax()
        raise ImperfectMesh(
            "mesh",
            f"edge {start[edge]} -> {end[edge]}",
            f"it is open: {is_open.sum()} edges have a face on one side only, so it has no inside",
            "close its holes; if only its vertices are split, merge them "
            "(trimesh: mesh.merge_vertices())",
        )
    return (order[position] // 3).reshape(-1, 3)


def _corner_angles(corners: Floats) -> Floats:
    """The angles of triangles `(f, 3, 3)`, in radians, `(f, 3)`."""
    ahead = np.roll(corners, -1, axis=1) - corners
    back = np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(ahead, back), axis=2)
    return np.arctan2(sine, np.einsum("fkj,fkj->fk", ahead, back))
