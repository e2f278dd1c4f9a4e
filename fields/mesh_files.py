"""Triangle meshes from files, as arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fields.errors import InputError, MissingDependency
from fields.triangle_tree import Floats, Integers

FORMATS = (".stl", ".obj", ".ply", ".off", ".glb", ".gltf", ".3mf")


def read_triangles(path: Path) -> tuple[Floats, Integers]:
    """Vertices `(v, 3)` and faces `(f, 3)` as stored; scenes of several meshes are joined.

    Raises:
        InputError: there is no such file, it is of another kind, or holds no triangles.
        MissingDependency: trimesh is not installed.
    """
    if not path.is_file():
        raise InputError("source", str(path), "there is no such file", "check the path")
    if path.suffix.lower() not in FORMATS:
        raise InputError(
            "source",
            str(path),
            f"files of the kind {path.suffix or '(no extension)'} are not read here",
            f"use one of {', '.join(FORMATS)}, or load it with another library and pass the mesh",
        )
    try:
        import trimesh
    except ImportError as error:
        raise MissingDependency(
            "trimesh", "reading a mesh file", "Install it with `pip install trimesh lxml networkx`"
        ) from error
    cause = "no triangles could be read from it"
    try:
        loaded = trimesh.load(path, process=False, maintain_order=True)
        mesh = loaded.to_mesh() if isinstance(loaded, trimesh.Scene) else loaded
    except Exception as error:  # noqa: BLE001 - whatever a parser makes of a damaged file
        mesh, cause = None, f"{cause} ({error})"
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InputError(
            "source",
            str(path),
            cause,
            "check that the file is complete and holds a surface, not only points",
        )
    return np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)


def merged(vertices: Floats, faces: Integers) -> tuple[Floats, Integers]:
    """Vertices with equal coordinates made one, and the faces that this leaves three corners."""
    distinct, index = np.unique(vertices, axis=0, return_inverse=True)
    joined = index.reshape(-1)[faces]
    # Merging can make slivers collapse; what is left of them is no face any more.
    whole = (joined != np.roll(joined, -1, axis=1)).all(axis=1)
    return distinct, joined[whole]
