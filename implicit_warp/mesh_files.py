"""Meshes on disk: read as they are, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.files import atomic_write, refuse_target

if TYPE_CHECKING:
    import trimesh

WRITABLE = (".stl", ".obj", ".ply", ".off", ".glb", ".3mf")
"""Suffixes that `write_mesh` takes."""


def read_mesh(path: str | Path) -> trimesh.Trimesh:
    """Read a mesh without repairing anything.

    An STL file holds loose triangles: there, vertices whose coordinates are equal bit for bit are
    one vertex.  Scenes of several meshes are joined into one.

    Raises:
        InputError: no such file, or no format that trimesh reads.
        FileFormatError: the file is damaged, or holds no triangles.
    """
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError("path", str(path), "there is no such file", "check the path")
    known = trimesh.available_formats()
    if path.suffix.lower().lstrip(".") not in known:
        raise InputError(
            "path", str(path), f"{path.suffix!r} is no mesh format", f"use {', '.join(WRITABLE)}"
        )
    try:
        loaded = trimesh.load(path, process=False, maintain_order=True)
        mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
    except Exception as error:  # whatever a format's parser makes of a damaged file
        raise FileFormatError(
            f"{path}: not a readable {path.suffix} file ({error}). It may be truncated"
        ) from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise FileFormatError(f"{path}: holds no triangles; truncated, a point cloud, or empty")
    if path.suffix.lower() == ".stl":
        vertices, faces = merge_equal_vertices(mesh.vertices, mesh.faces)
        return trimesh.Trimesh(vertices, faces, process=False)
    return mesh


def write_mesh(mesh: trimesh.Trimesh, path: str | Path) -> None:
    """Write a mesh in the format of the path's suffix; the old file stays until the new is whole.

    Non-guarantee: STL, PLY, GLB and 3MF hold float32 or rounded coordinates, so vertices that
    float64 keeps apart can fall together.  Check the file that was written.

    Raises:
        InputError: a suffix that cannot be written, or a folder that does not exist.
    """
    path = Path(path)
    refuse_target(path, WRITABLE)
    # An OBJ's texture would be a second and a third file, with names that may be taken.
    options = {"include_texture": False} if path.suffix.lower() == ".obj" else {}
    with atomic_write(path) as temporary:
        mesh.export(temporary, **options)


def merge_equal_vertices(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make vertices with bitwise equal coordinates one, in order of first appearance."""
    from implicit_warp.checking.equal_vertices import first_of_equal

    vertices = np.asarray(vertices)
    first = first_of_equal(vertices)
    kept = first == np.arange(len(first))
    rank = np.cumsum(kept) - 1
    return vertices[kept], rank[first][np.asarray(faces)]
