"""The command ``implicit-warp apply``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from implicit_warp.commands.common import (
    GOOD,
    Common,
    Out,
    read_points,
    say,
    write_and_check,
)
from implicit_warp.errors import InputError

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, kw_only=True)
class Apply(Common):
    """Carry a mesh, a field script or points forward by a saved map.

    A mesh keeps its faces and moves its vertices: a coarse one can come out with
    self-intersections, and the check says so. --method exact cuts its faces along the creases of
    the map, so that the result is the exact image; --method adaptive divides them until they follow
    it within a tolerance, also for --inverse. A field, from a script or learned, is pulled back and
    extracted. Points
    are a .npy file of shape (n, 3).

    Example: implicit-warp apply warp.safetensors scan.ply -o posed.ply --method exact
    """

    warp: Positional[Path]
    """Map file (.safetensors)."""
    thing: Positional[Path]
    """Mesh file, field script (.py), learned field (.safetensors) or points (.npy)."""
    out: Out
    """A mesh file, or .npy for points."""
    inverse: bool = False
    """Apply the inverse map."""
    method: Literal["vertices", "adaptive", "exact"] = "vertices"
    """For meshes: move vertices only, divide faces adaptively, or cut them exactly."""
    tolerance: float | None = None
    """For --method adaptive: distance from the image; by default 1/1000 of its diagonal."""
    resolution: int = 192
    """For fields: voxels along the longest side of the result's box."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.deformation import deform
        from implicit_warp.extraction import extract
        from implicit_warp.files import atomic_write, load, refuse_target
        from implicit_warp.mesh_files import WRITABLE, read_mesh
        from implicit_warp.shapes import FIELDS, load_shape

        suffix = self.thing.suffix.lower()
        refuse_target(self.out, (".npy",) if suffix == ".npy" else WRITABLE)
        if suffix in (".npy", *FIELDS) and (
            self.method != "vertices" or self.tolerance is not None
        ):
            raise InputError(
                "method",
                self.method,
                f"methods and tolerances are for meshes, and {self.thing} is none",
                "leave them out: points and fields are carried exactly",
            )
        map_ = load(self.warp)
        map_ = map_.inv if self.inverse else map_
        if suffix == ".npy":
            import numpy as np

            moved = map_(read_points(self.thing))
            with atomic_write(self.out) as temporary, temporary.open("wb") as file:
                np.save(file, moved)
            say(f"{self.out}: {len(moved)} points")
            return GOOD
        if suffix in FIELDS:
            mesh = extract(deform(load_shape(self.thing), map_), self.resolution)
        else:
            mesh = self._push_forward(read_mesh(self.thing), map_)
        return write_and_check(mesh, self.out)

    def _push_forward(self, mesh, map_):
        from implicit_warp.progress import progress_bar
        from implicit_warp.push_forward import deform_mesh

        with progress_bar(self.method) as update:
            image, report = deform_mesh(
                mesh,
                map_,
                self.method,
                tolerance=self.tolerance,
                # Nearly all formats hold float32, in which small pieces would fall together.
                clean_for=None if self.method == "vertices" else "float32",
                progress=update,
            )
        say(str(report))
        return image
