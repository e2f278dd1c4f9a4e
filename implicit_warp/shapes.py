"""What the command line takes as a shape: a field script, a learned field, a volume or a mesh."""

from __future__ import annotations

import runpy
import sys
import traceback
from pathlib import Path

from fields import Field, load_grid, load_neural, mesh
from fields.grid_files import VOLUMES
from implicit_warp.errors import InputError
from implicit_warp.mesh_files import read_mesh

FIELDS = (".py", ".safetensors")
"""Suffixes of files that hold a field; others are meshes."""


def load_shape(path: str | Path) -> Field:
    """The field that a file describes.

    A field script is a Python file that defines ``shape``; it is *run*, so use only scripts that
    you trust.  A volume (``.npz``, ``.nrrd``, ``.vti``) holds samples of a field, negative inside.
    A ``.safetensors`` file is a learned field.  Any mesh file becomes a distance field, if it is
    closed.

    Raises:
        InputError: no such file; a script that fails, or defines no field named ``shape``.
        FileFormatError: a mesh file that is damaged; a ``.safetensors`` file that is, or that holds
            something else, such as a map.
    """
    path = Path(path)
    if path.suffix.lower() in VOLUMES:
        return load_grid(path)
    if path.suffix.lower() == ".safetensors":
        return load_neural(path)
    if path.suffix.lower() != ".py":
        return mesh(read_mesh(path))
    if not path.is_file():
        raise InputError("shape", str(path), "there is no such file", "check the path")
    folder = str(path.resolve().parent)
    sys.path.insert(0, folder)  # as for any script, its neighbours can be imported
    try:
        names = runpy.run_path(str(path), run_name="__implicit_warp_shape__")
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # whatever a user's script raises is reported
        line = _line_in(path, error)
        raise InputError(
            "shape", str(path), f"the script failed{line}: {error!r}", "mend the script"
        ) from error
    finally:
        sys.path.remove(folder)
    shape = names.get("shape")
    if not isinstance(shape, Field):
        found = "defines no name 'shape'" if shape is None else f"its 'shape' is {shape!r}"
        raise InputError(
            "shape", str(path), f"the script {found}", "assign the finished field to 'shape'"
        )
    return shape


def _line_in(path: Path, error: BaseException) -> str:
    lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
    if isinstance(error, SyntaxError) and error.lineno:
        lines.append(error.lineno)
    return f" in line {lines[-1]}" if lines else ""
