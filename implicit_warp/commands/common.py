"""What the commands share: exit codes, options, and how they speak."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from implicit_warp.errors import InputError

if TYPE_CHECKING:
    from implicit_warp.checking import CheckReport

GOOD, BAD_MESH, BAD_INPUT, DEFECT, INTERRUPTED = 0, 1, 2, 3, 130

Out = Annotated[Path, arg(aliases=["-o"])]
Referee = Literal["manifold3d", "trimesh", "open3d", "pymeshlab"]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of every command."""

    threads: int | None = None
    """Threads of torch and of the kernels; all cores if not given."""


def write_and_check(mesh, path: Path) -> int:
    """Write a mesh, check the file, say what the check found; returns the exit code."""
    from implicit_warp.checking import check
    from implicit_warp.mesh_files import write_mesh

    write_mesh(mesh, path)
    report = check(path)
    say(str(report))
    return verdict(report)


def verdict(report: CheckReport, allowed: int = 0) -> int:
    """The exit code that a report deserves if so many self-intersections are allowed."""
    from implicit_warp.checking import BadMesh

    try:
        report.raise_if_bad(allowed)
    except BadMesh:
        return BAD_MESH
    return GOOD


def printable(text: str) -> str:
    """The text with what standard output cannot encode, as in odd file names, as escapes."""
    encoding = sys.stdout.encoding or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def say(text: str) -> None:
    """A line on standard output."""
    sys.stdout.write(text + "\n")


def read_points(path: Path):
    """The array of a .npy file."""
    import numpy as np

    try:
        return np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(
            "points", str(path), f"not a readable .npy file ({error})", "save it with numpy.save"
        ) from error
