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

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


class Closest(NamedTuple):
    """The nearest points of given triangles.

    Attributes:
        signed_distance: `(n,)`, negative inside.
        direction: `(n, 3)`, the unit gradient of the signed distance.
    """

    signed_distance: Floats
    direction: Floats


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

    def closest(self, points: Floats, triangles: Integers) -> Closest:
        """Signed distances and their gradients, if the nearest triangles are known.

        Args:
            points: `(n, 3)`.
            triangles: `(n,)`, for each point a face on which its nearest point lies.
        """
        corners = self.vertices[self.faces[triangles]]
        best, feature = _closest_on_triangles(points, corners)
        normal = self._pseudonormals(triangles, feature)
        away = points - best
        distance = np.linalg.norm(away, axis=1)
        sign = np.where(np.einsum("ij,ij->i", away, normal) < 0, -1.0, 1.0)
        # On the surface there is no direction to the nearest point; and above the inside
        # of a face the normal is that direction, without its rounding.
        size = np.abs(corners).max(axis=(1, 2))
        use_normal = (distance <= 1e-12 * size) | (feature == 0)
        with np.errstate(invalid="ignore", divide="ignore"):
            direction = np.where(
                use_normal[:, None],
                normal / np.linalg.norm(normal, axis=1, keepdims=True),
                sign[:, None] * away / distance[:, None],
            )
        return Closest(sign * distance, np.nan_to_num(direction, nan=0.0))

    def _pseudonormals(self, triangles: Integers, feature: Integers) -> Floats:
        normal = self.normals[triangles].copy()
        for k in range(3):
            on_edge = feature == 1 + k
            normal[on_edge] += self.normals[self.neighbours[triangles[on_edge], k]]
            on_corner = feature == 4 + k
            normal[on_corner] = self.vertex_normals[self.faces[triangles[on_corner], k]]
        return normal


def _closest_on_triangles(points: Floats, corners: Floats) -> tuple[Floats, Integers]:
    """Nearest points `(n, 3)` of n triangles, and what they lie on.

    Features: 0 the inside, 1 + k the edge from corner k to corner k + 1, 4 + k corner k.
    The nearest of three edge points and, where it is in the triangle, of the foot of the
    perpendicular: every candidate is on the triangle, so that a bad division in a needle
    of a triangle can only lose to the others.
    """
    best = np.empty_like(points)
    feature = np.zeros(len(points), dtype=np.int64)
    least = np.full(len(points), np.inf)
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        edge = end - start
        squared = np.einsum("ij,ij->i", edge, edge)
        along = np.einsum("ij,ij->i", points - start, edge)
        t = np.clip(along / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
        candidate = np.where(t[:, None] < 1, start + t[:, None] * edge, end)
        distance = np.linalg.norm(points - candidate, axis=1)
        nearer = distance < least
        best[nearer], least[nearer] = candidate[nearer], distance[nearer]
        on = np.where(t <= 0, 4 + k, np.where(t >= 1, 4 + (k + 1) % 3, 1 + k))
        feature[nearer] = on[nearer]
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    cross = np.cross(first, second)
    area = np.einsum("ij,ij->i", cross, cross)
    relative = points - origin
    scale = np.where(area > 0, area, np.inf)
    v = np.einsum("ij,ij->i", np.cross(relative, second), cross) / scale
    w = np.einsum("ij,ij->i", np.cross(first, relative), cross) / scale
    foot = origin + v[:, None] * first + w[:, None] * second
    inside = (v > 0) & (w > 0) & (v + w < 1)
    inside &= np.linalg.norm(points - foot, axis=1) < least
    best[inside], feature[inside] = foot[inside], 0
    return best, feature


# --- checking and preparing -----------------------------------------------------------


def closed_mesh(vertices: ArrayLike, faces: ArrayLike) -> ClosedMesh:
    """Check a mesh and prepare it for signed distances.

    Raises:
        InputError: it is empty, has NaN or infinite vertices, bad indices, open or
            non-manifold edges, faces turned against their neighbours, no volume, or is
            inside out.
    """
    v, f = _checked_arrays(vertices, faces)
    neighbours = _neighbours(f)
    # Volume about the mesh's own middle, so that a mesh far from the origin loses no digits.
    corners = v[f] - (v[f].min(axis=(0, 1)) + v[f].max(axis=(0, 1))) / 2
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    volume = float(np.einsum("ij,ij->", corners[:, 0], cross)) / 6
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    if abs(volume) <= 1e-12 * size**3:
        raise InputError(
            "mesh", f"volume {volume:g}", "it encloses nothing", "pass the surface of a solid"
        )
    if volume < 0:
        raise InputError(
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


def _checked_arrays(vertices: ArrayLike, faces: ArrayLike) -> tuple[Floats, Integers]:
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
    twice = (f == np.roll(f, -1, axis=1)).any(axis=1)
    if twice.any():
        raise InputError(
            "mesh",
            f"face {twice.argmax()} = {f[twice.argmax()].tolist()}",
            f"{twice.sum()} faces use a vertex twice",
            "remove degenerate faces",
        )
    return v, f


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
        raise InputError(
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
        raise InputError(
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
