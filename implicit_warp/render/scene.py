"""Rays against triangles, by Open3D; the only file of the renderer that knows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from implicit_warp.render.open3d_library import import_open3d
from implicit_warp.render.surface import Array, Paint, corner_normals


@dataclass(frozen=True)
class Hits:
    """Where rays met the surface: one row for each ray that did.

    `ray` are indices into the rays cast; `point` and `position` the same place in the mesh's
    units and in the frame of the scene; `lifted` is `position` moved onto the curved surface that
    the smooth normals pretend there is.  Normals have length one and face the ray's origin.
    """

    ray: NDArray[np.int64]
    face: NDArray[np.int64]
    weights: Array
    point: Array
    position: Array
    lifted: Array
    normal: Array


class Scene:
    """One painted mesh, centred and scaled so that float32 rays resolve it.

    Args:
        vertices: `(V, 3)` in the mesh's units.
        faces: `(F, 3)`.
        paint: what gives the colours.
        center, size: a point goes to `(point - center) / size` in the scene.
        crease_angle: as in `corner_normals`.

    Raises:
        MissingDependency: Open3D cannot be imported.
    """

    def __init__(
        self,
        vertices: Array,
        faces: NDArray[np.int64],
        paint: Paint,
        *,
        center: Array,
        size: float,
        crease_angle: float,
    ) -> None:
        open3d = import_open3d("drawing a picture")
        self._core, geometry = open3d.core, open3d.t.geometry
        unit = (vertices - center) / size
        self.vertices = unit.astype(np.float32)
        self.paint = paint
        self._given = vertices
        self._faces = faces
        self._normals = corner_normals(unit, faces, crease_angle).astype(np.float32)
        self._caster = geometry.RaycastingScene()
        self._caster.add_triangles(
            self._core.Tensor(self.vertices), self._core.Tensor(faces.astype(np.uint32))
        )

    def cast(self, origin: Array, directions: Array) -> Hits:
        """The first hits of rays `(n, 3)` from one origin `(3,)`."""
        found = self._caster.cast_rays(self._rays(origin, directions))
        ray = np.flatnonzero(np.isfinite(found["t_hit"].numpy()))
        face = found["primitive_ids"].numpy()[ray].astype(np.int64)
        uv = found["primitive_uvs"].numpy()[ray]
        weights = np.column_stack([1 - uv.sum(axis=1), uv])
        corners, normals = self.vertices[self._faces[face]], self._normals[face]
        position = np.einsum("nc,nci->ni", weights, corners)
        # The planes through the corners along their normals bound the curved surface: a shadow
        # ray that starts on them does not hit the facets next door (Hanika 2021).
        below = np.einsum("nci,nci->nc", position[:, None] - corners, normals).clip(max=0)
        towards = directions[ray].astype(np.float32)
        flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        behind = np.einsum("ni,ni->n", flat, towards) > 0
        below[behind] = 0
        lifted = position - np.einsum("nc,nci->ni", weights * below, normals)
        normal = np.einsum("nc,nci->ni", weights, normals)
        normal[behind] *= -1
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        point = np.einsum("nc,nci->ni", weights, self._given[self._faces[face]], dtype=np.float64)
        return Hits(ray, face, weights, point, position, lifted, normal)

    def blocked(self, origins: Array, directions: Array, reach: float) -> NDArray[np.bool_]:
        """Whether rays `(..., 3)` meet the mesh within `reach` times their direction's length."""
        rays = self._rays(origins, directions)
        return self._caster.test_occlusions(rays, tnear=0.0, tfar=reach).numpy()

    def _rays(self, origins: Array, directions: Array) -> Any:
        rays = np.empty((*directions.shape[:-1], 6), dtype=np.float32)
        rays[..., :3] = origins
        rays[..., 3:] = directions
        return self._core.Tensor(rays)
