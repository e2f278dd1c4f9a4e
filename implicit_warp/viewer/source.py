"""The shape that is edited, its preview mesh, and whether its file has changed."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

from fields import Field
from implicit_warp.deformation import deform
from implicit_warp.errors import InputError
from implicit_warp.files import load
from implicit_warp.shapes import load_shape

if TYPE_CHECKING:
    import trimesh

PREVIEW_VERTICES = 15_000
"""About so many vertices a preview mesh has."""

_FIRST_RESOLUTION = 64


class ShapeSource:
    """A shape from a file that the command line takes, as it is or under a saved map.

    Args:
        path: the file.
        warp: a file with a map, under which the shape is edited.

    Attributes:
        path: the file.
        map: the saved map, or None.
        field: its shape, under the map if there is one.
        preview: a mesh of the shape at rest, coarse enough to follow a drag.

    Raises:
        InputError, FileFormatError: see `load_shape`; a shape without bounds.
    """

    def __init__(self, path: str | Path, warp: str | Path | None = None) -> None:
        self.path = Path(path)
        self.map = None if warp is None else load(warp)
        self._digest = b""
        self.field: Field
        self.preview: trimesh.Trimesh
        self.reload()

    def changed(self) -> bool:
        """Is the file's content another than when it was loaded?"""
        return self._now() != self._digest

    def reload(self) -> None:
        """Load the file again; what was loaded stays if that fails."""
        digest = self._now()
        self._digest = digest  # also of a broken file: it is reported once
        field = load_shape(self.path)
        if self.map is not None:
            field = deform(field, self.map)
        preview = preview_mesh(field)
        self.field, self.preview = field, preview

    def _now(self) -> bytes:
        try:
            return hashlib.sha256(self.path.read_bytes()).digest()
        except OSError:
            return b""


def preview_mesh(field: Field, vertices: int = PREVIEW_VERTICES) -> trimesh.Trimesh:
    """A mesh of about so many vertices: extracted once to see how large the surface is, and again.

    Raises:
        InputError: the field has no bounds, or no surface.
    """
    from implicit_warp.extraction import extract

    if field.bounds is None:
        raise InputError(
            "shape", field, "its bounds are unknown or infinite", "intersect it with a box"
        )
    mesh = extract(field, _FIRST_RESOLUTION, thin="ignore")
    finer = round(_FIRST_RESOLUTION * (vertices / len(mesh.vertices)) ** 0.5)
    return extract(field, min(max(finer, 24), 256), thin="ignore")
