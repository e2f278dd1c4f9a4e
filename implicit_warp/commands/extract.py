"""The command ``implicit-warp extract``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from tyro.conf import Positional

from implicit_warp.commands.common import (
    Common,
    Out,
    say,
    write_and_check,
)

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, kw_only=True)
class Extract(Common):
    """Turn a field script (or re-mesh a closed mesh) into a checked mesh.

    Example: implicit-warp extract part.py -o part.stl --resolution 256
    """

    shape: Positional[Path]
    """Field script (.py), learned field (.safetensors) or mesh file."""
    out: Out
    """The mesh: .stl, .obj, .ply, .off, .glb or .3mf."""
    resolution: int = 192
    """Voxels along the longest side of the shape's box."""
    sharp: bool = True
    """Keep the edges and corners of the shape; without, they are bevelled by half a voxel."""
    thin: Literal["warn", "refine", "ignore"] = "warn"
    """What to do about parts thinner than a voxel: warn, make the voxels smaller, or nothing."""
    at_wall: Literal["error", "close"] = "error"
    """What to do where the shape reaches the edge of its box: refuse, or close it there."""
    search: Literal["auto", "enclosures", "distance", "guided"] = "auto"
    """How the cells at the surface are found; see the module `implicit_warp.extraction.meshing`."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.extraction import extract_mesh
        from implicit_warp.files import refuse_target
        from implicit_warp.mesh_files import WRITABLE
        from implicit_warp.progress import progress_bar
        from implicit_warp.shapes import load_shape

        refuse_target(self.out, WRITABLE)
        shape = load_shape(self.shape)
        with progress_bar("extract") as update:
            mesh, report = extract_mesh(
                shape,
                self.resolution,
                sharp=self.sharp,
                thin=self.thin,
                at_wall=self.at_wall,
                search=self.search,
                progress=update,
            )
        say(
            f"extract: {report.faces} faces at {report.resolution} voxels by {report.search}, "
            f"{100 * report.share_sampled:.2g} % of the lattice sampled, {report.seconds:.2f} s"
        )
        return write_and_check(mesh, self.out)
