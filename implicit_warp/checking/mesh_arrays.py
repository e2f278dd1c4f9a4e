"""From what the caller has (a mesh object, a path) to the two arrays that are checked.

The arrays are taken as they are: nothing is merged, dropped or reordered, because a checker
that repairs first has nothing left to find. The exceptions are files whose format cannot say which
corners are one vertex: STL stores no connectivity at all (see `mesh_files.read_mesh`), and glTF
stores a vertex once for each normal and texture coordinate that it has.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from implicit_warp.errors import InputError

if TYPE_CHECKING:
    import trimesh

SPLITTING_FORMATS = (".glb", ".gltf")
"""Suffixes of files that must store a vertex again for each normal and texture coordinate."""


def mesh_arrays(
    mesh: trimesh.Trimesh | str | os.PathLike[str], *, merge_vertices: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices `(V, 3)` and faces `(F, 3)` of a mesh object or file.

    Files are read unprocessed. Vertices with equal coordinates are made one where the file's
    format cannot say which corners are the same vertex (STL, GLB, glTF), or if `merge_vertices`.

    Raises:
        InputError: not a mesh, no such file, or bad arrays.
        FileFormatError: the file is damaged, or holds no triangles.
    """
    if isinstance(mesh, str | os.PathLike):
        from implicit_warp.mesh_files import read_mesh

        path = Path(mesh)
        merge_vertices |= path.suffix.lower() in SPLITTING_FORMATS
        mesh = read_mesh(path)
    try:
        vertices, faces = mesh.vertices, mesh.faces
    except AttributeError:
        raise InputError(
            "mesh",
            mesh,
            f"a {type(mesh).__name__} has no vertices and faces",
            "Pass a trimesh.Trimesh or the path of a mesh file",
        ) from None
    vertices, faces = validated(vertices, faces)
    if merge_vertices:
        from implicit_warp.mesh_files import merge_equal_vertices

        vertices, faces = merge_equal_vertices(vertices, faces)
    return vertices, faces


def validated(
    vertices: ArrayLike, faces: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The two arrays as contiguous float64 `(V, 3)` and int64 `(F, 3)`.

    Raises:
        InputError: wrong shape or type, or an index out of range. NaN is no error here: it is
            for the checks to find.
    """
    points = _array("vertices", vertices)
    corners = _array("faces", faces)
    if not points.size:
        points = np.empty((0, 3))
    if not corners.size:
        corners = np.empty((0, 3), dtype=np.int64)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise InputError(
            "vertices",
            f"array of {points.dtype} {points.shape}",
            "vertices are real numbers of shape (V, 3)",
            "Pass three coordinates a vertex",
        )
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        raise InputError(
            "faces",
            f"array of {corners.dtype} {corners.shape}",
            "faces are integers of shape (F, 3)",
            "Triangulate polygons first, and pass indices as integers",
        )
    if corners.size and (corners.min() < 0 or corners.max() >= len(points)):
        bad = (corners < 0) | (corners >= len(points))
        face = int(np.flatnonzero(bad.any(axis=1))[0])
        raise InputError(
            "faces",
            corners[face].tolist(),
            f"face {face} refers to a vertex outside 0 to {len(points) - 1}",
            "Rebuild the faces: indices count from zero and must exist",
        )
    return (
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(corners, dtype=np.int64),
    )


def _array(argument: str, value: ArrayLike) -> NDArray[Any]:
    try:
        return np.asarray(value)
    except ValueError as error:
        raise InputError(
            argument, value, f"not a rectangular array ({error})", "Pass an (n, 3) array"
        ) from error
