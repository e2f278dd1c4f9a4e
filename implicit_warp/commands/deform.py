"""The command ``implicit-warp deform``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from implicit_warp.commands.common import (
    INTERRUPTED,
    Common,
    Out,
    Referee,
    say,
    verdict,
)
from implicit_warp.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Deform(Common):
    """Bend a shape by handles: solve for an injective warp, extract the mesh, check the file.

    SHAPE is a Python script that defines `shape` (it is run: use only scripts you trust), a field
    that learn-sdf learned, or a closed mesh. The handle file says which regions stay and which
    move:

        [[handle]]
        region = "below(-0.6)"
        hold = true

        [[handle]]
        region = "above(0.6)"
        rotate = ["z", 60]

    Example: implicit-warp deform part.py --handles part.toml -o part.stl --picture part.png
    """

    shape: Positional[Path]
    """Field script (.py), learned field (.safetensors) or mesh file."""
    handles: Path
    """Handle file (.toml); its [solve] table may set options of the solve."""
    out: Out
    """The deformed mesh: .stl, .obj, .ply, .off, .glb or .3mf."""
    under: Path | None = None
    """A saved map (.safetensors) that deforms the shape first, as in `view --warp`: the handles are
    on what it leaves, and the map that is saved is the composition."""
    resolution: int = 192
    """Voxels along the longest side of the result's box."""
    sharp: bool = True
    """Keep the edges and corners of the shape; without, they are bevelled by half a voxel."""
    warp: Path | None = None
    """Where to save the map (.safetensors); beside the mesh if not given."""
    report: Path | None = None
    """Also save all figures here (.json)."""
    picture: Path | None = None
    """Also save a picture before | after here (.png)."""
    steps: int | None = None
    """At most so many steps of the solve."""
    layers: int | None = None
    """Layers of the warp."""
    seed: int | None = None
    """Seed of every random choice."""
    referees: tuple[Referee, ...] = ("manifold3d",)
    """Libraries whose verdict on the mesh is asked for beside ours."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.elastic_solve import ElasticOptions
        from implicit_warp.files import load
        from implicit_warp.handles import load_handles
        from implicit_warp.pipeline import deform_to_files
        from implicit_warp.shapes import load_shape

        warp_path = self.warp or self.out.with_suffix(".safetensors")
        for read, what in ((self.shape, "learned field"), (self.under, "map")):
            if read is not None and warp_path.resolve() == read.resolve():
                raise InputError(
                    "warp",
                    str(warp_path),
                    f"the map would replace the {what} that is read",
                    "name the map's file with --warp",
                )
        shape = load_shape(self.shape)
        handles, solve = load_handles(self.handles)
        given = {"steps": self.steps, "layers": self.layers, "seed": self.seed}
        solve.update({name: value for name, value in given.items() if value is not None})
        outcome = deform_to_files(
            shape,
            handles,
            self.out,
            under=None if self.under is None else load(self.under),
            options=ElasticOptions.from_mapping(solve),
            resolution=self.resolution,
            sharp=self.sharp,
            warp_path=warp_path,
            report_path=self.report,
            picture_path=self.picture,
            referees=self.referees,
        )
        solved = outcome.warp.report
        say(
            f"solve: {solved.status} after {solved.steps} steps, {solved.seconds:.1f} s; handle "
            f"error {solved.handle_error:.4g} ({100 * solved.handle_error_relative:.3f} % of the "
            f"diagonal), smallest det J {outcome.report['map'].get('smallest_determinant', 0):.3g}"
        )
        if outcome.verdict is None:
            say(f"interrupted: no mesh was extracted, the best warp is in {warp_path}")
            return INTERRUPTED
        say(str(outcome.verdict))
        return verdict(outcome.verdict)
