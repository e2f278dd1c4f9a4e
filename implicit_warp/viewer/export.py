"""Files of an edit, within the working folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from fields import Field
from implicit_warp.checking import CheckReport, check
from implicit_warp.deformation import deform
from implicit_warp.errors import InputError
from implicit_warp.extraction import extract_mesh
from implicit_warp.files import refuse_target
from implicit_warp.mesh_files import WRITABLE, write_mesh
from implicit_warp.warp import Warp


def inside(
    folder: Path, name: str, suffixes: Sequence[str], keep: Sequence[Path | None] = ()
) -> Path:
    """The path of a file that the page names, in the working folder or below.

    Args:
        folder: the working folder.
        name: the file's name, or its path from there.
        suffixes: that it may have.
        keep: files that must not be replaced: those that the edit was made from.

    Raises:
        InputError: it would lie elsewhere, its suffix is none of these, or it is to be kept.
    """
    text = name.strip()
    if "\0" in text:
        raise InputError("file", name, "it holds a null character", "leave it out")
    if not text:
        raise InputError("file", name, "it has no name", f"write e.g. part{suffixes[0]}")
    folder = folder.resolve()
    path = (folder / text).resolve()
    if not path.is_relative_to(folder) or path == folder:
        raise InputError(
            "file",
            name,
            f"it lies outside of the working folder {folder}",
            "name a file in that folder; move it elsewhere afterwards",
        )
    refuse_target(path, tuple(suffixes))
    if any(other is not None and path == other.resolve() for other in keep):
        raise InputError(
            "file", name, "it would replace the file that is edited", "choose another name"
        )
    return path


def export_mesh(
    field: Field,
    warp: Warp | None,
    path: Path,
    resolution: int,
    progress: Callable[[int, int], None] | None = None,
) -> CheckReport:
    """The surface, deformed if there is a warp, extracted, written, and checked as it is on disk.

    The same steps as `implicit-warp deform` takes after its solve.
    """
    mesh, _ = extract_mesh(
        field if warp is None else deform(field, warp), resolution, progress=progress
    )
    write_mesh(mesh, path)
    return check(path)


MESHES = WRITABLE
"""Suffixes of mesh files."""
