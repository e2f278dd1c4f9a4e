"""A mesh made ready to be looked at: checked, its normals smoothed, its colours resolved."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from implicit_warp.errors import InputError

if TYPE_CHECKING:
    import trimesh

Array: TypeAlias = "NDArray[np.floating]"
Color: TypeAlias = "ArrayLike | Callable[[Array], ArrayLike] | None"

CLAY = (0.82, 0.80, 0.77)
"""The colour of a mesh that was given none."""

HELD = (0.36, 0.49, 0.66)
"""A calm blue, for regions that stay where they are."""

MOVED = (0.90, 0.52, 0.32)
"""A warm orange, for regions that are moved."""


def checked_arrays(mesh: trimesh.Trimesh) -> tuple[Array, NDArray[np.int64]]:
    """Vertices `(V, 3)` and faces `(F, 3)` of a mesh that can be shown.

    Raises:
        InputError: no faces, vertices that are not finite, or faces that name no vertex.
    """
    vertices = np.asarray(getattr(mesh, "vertices", ()), dtype=np.float64)
    faces = np.asarray(getattr(mesh, "faces", ()), dtype=np.int64)
    if vertices.ndim != 2 or faces.ndim != 2 or len(vertices) == 0 or len(faces) == 0:
        raise InputError(
            "mesh",
            mesh,
            "it has no faces to show",
            "pass a triangle mesh; an empty one often means that the field has no surface "
            "within the bounds it was extracted from",
        )
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(axis=1).sum())
        raise InputError(
            "mesh",
            mesh,
            f"{bad} of its {len(vertices)} vertices are not finite",
            "look for a division by zero in what made or moved them",
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            "mesh",
            mesh,
            f"a face names vertex {faces.max()} or {faces.min()} of {len(vertices)}",
            "check the indices, which start at 0",
        )
    return vertices, faces


def corner_normals(vertices: Array, faces: NDArray[np.int64], crease_angle: float) -> Array:
    """One unit normal for each corner of each face, `(F, 3, 3)`, smooth except at creases.

    The normal of a corner is the mean of the normals of the faces around its vertex that
    deviate from its own face by at most `crease_angle` degrees, weighted by their angles at the
    vertex (Thuermer and Wuethrich 1998), so that it does not depend on how a flat region is cut
    into triangles.  Vertices at the same place count as one.  Faces without area get zeros.
    """
    corners = vertices[faces]
    edges = np.roll(corners, -1, axis=1) - corners
    face_normals = _unit(np.cross(edges[:, 0], edges[:, 1]))
    unit_edges = _unit(edges)
    cosines = -np.einsum("fci,fci->fc", unit_edges, np.roll(unit_edges, 1, axis=1))
    angles = np.arccos(np.clip(cosines, -1, 1)).reshape(-1)

    _, place = np.unique(vertices, axis=0, return_inverse=True)
    corner_place = place.reshape(-1)[faces].reshape(-1)
    order = np.argsort(corner_place, kind="stable")
    normals = np.repeat(face_normals, 3, axis=0)
    sums = normals * angles[:, None]
    limit = math.cos(math.radians(crease_angle))
    # Corners of one place are neighbours in `order`.  Pair each with the one k further on, for
    # every k at once over the mesh: within one k no corner appears twice on the same side.
    sorted_place = corner_place[order]
    ends = np.searchsorted(sorted_place, sorted_place, side="right")
    head, k = np.arange(len(order)), 0
    while len(head):
        k += 1
        head = head[head + k < ends[head]]
        a, b = order[head], order[head + k]
        smooth = np.einsum("ni,ni->n", normals[a], normals[b]) >= limit
        a, b = a[smooth], b[smooth]
        sums[a] += normals[b] * angles[b, None]
        sums[b] += normals[a] * angles[a, None]
    return _unit(sums).reshape(-1, 3, 3)


class Paint:
    """Colours of a mesh at hit points, as linear RGB.

    Args:
        color: None for `CLAY`, one sRGB triple, one for each vertex `(V, 3)` or face `(F, 3)`, or
            a function from points `(n, 3)` to colours `(n, 3)`; all in [0, 1].  If there are as
            many vertices as faces, an array is taken to be of vertices.
        places: `(V, 3)` where the vertices are for such a function, if not where they are shown:
            at rest, say.

    Raises:
        InputError: another shape, or values that are not in [0, 1].
    """

    def __init__(
        self,
        color: Color,
        vertices: Array,
        faces: NDArray[np.int64],
        places: ArrayLike | None = None,
    ) -> None:
        self._function = color if callable(color) else None
        self._faces = faces
        self._places = None if places is None else np.asarray(places, dtype=np.float64)
        if self._places is not None and self._places.shape != vertices.shape:
            raise InputError(
                "places",
                self._places.shape,
                f"not one place for each of the {len(vertices)} vertices",
                "pass an array of shape (V, 3)",
            )
        self._single = self._of_vertices = self._of_faces = None
        if callable(color):
            return
        values = _checked_colors(CLAY if color is None else color, color)
        if values.shape == (3,):
            self._single = srgb_to_linear(values)
        elif values.shape == (len(vertices), 3):
            self._of_vertices = srgb_to_linear(values)
        elif values.shape == (len(faces), 3):
            self._of_faces = srgb_to_linear(values)
        else:
            raise InputError(
                "color",
                color,
                f"its shape {values.shape} fits neither the {len(vertices)} vertices nor the "
                f"{len(faces)} faces",
                "pass (3,), (V, 3), (F, 3) or a function of points",
            )

    def __call__(self, face: NDArray[np.int64], weights: Array, points: Array) -> Array:
        """Linear RGB `(n, 3)` in faces `(n,)` at barycentric `weights` `(n, 3)` and `points`."""
        if self._function is not None:
            if self._places is not None:
                points = np.einsum("nc,nci->ni", weights, self._places[self._faces[face]])
            found = _checked_colors(self._function(points), self._function)
            if found.shape != points.shape:
                raise InputError(
                    "color",
                    self._function,
                    f"it gave shape {found.shape} for points of shape {points.shape}",
                    "return one RGB triple for each point",
                )
            return srgb_to_linear(found)
        if self._of_faces is not None:
            return self._of_faces[face]
        if self._of_vertices is not None:
            return np.einsum("nc,nci->ni", weights, self._of_vertices[self._faces[face]])
        return np.broadcast_to(self._single, points.shape)


def rgb(argument: str, value: ArrayLike) -> Array:
    """One sRGB colour `(3,)` in [0, 1], or an error that names `argument`."""
    values = _checked_colors(value, value, argument)
    if values.shape != (3,):
        raise InputError(argument, value, "not one colour", "pass (red, green, blue) in [0, 1]")
    return values


def srgb_to_linear(values: Array) -> Array:
    """Undo the sRGB transfer curve (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(values: Array) -> Array:
    """Apply the sRGB transfer curve (IEC 61966-2-1) to values in [0, 1]."""
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)


def _checked_colors(values: ArrayLike, shown: object, argument: str = "color") -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(
            argument, shown, "not numbers", "pass (red, green, blue) in [0, 1]"
        ) from None
    if array.size and not (array.min() >= 0 and array.max() <= 1):  # false for NaN too
        raise InputError(
            argument, shown, "colours are not all within [0, 1]", "divide values of 0..255 by 255"
        )
    return array


def _unit(vectors: Array) -> Array:
    """Vectors scaled to length one along the last axis; zeros stay zeros."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0)
