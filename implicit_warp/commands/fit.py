"""The command ``implicit-warp fit``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from implicit_warp.commands.common import GOOD, INTERRUPTED, Common, Out, read_points, say
from implicit_warp.errors import InputError


@dataclass(frozen=True, kw_only=True)
class Fit(Common):
    """Find the injective map that takes one mesh to another of the same connectivity.

    Vertex i of the source goes to vertex i of the target, as closely as an injective map can.
    Points (.npy, shape (n, 3)) are fitted likewise, without faces. Landmarks are six numbers a
    line, a point of the source and its target; they may be all there is. Carry anything along
    with 'implicit-warp apply'.

    Example: implicit-warp fit source.obj target.obj -o warp.safetensors
    """

    source: Positional[Path | None] = None
    """Mesh file, or points (.npy)."""
    target: Positional[Path | None] = None
    """Mesh file of the same connectivity, or points (.npy)."""
    out: Out
    """The map (.safetensors)."""
    landmarks: Path | None = None
    """Text file of landmarks: x y z, and x y z of the target, on each line; commas are allowed."""
    checkpoint: Path | None = None
    """State of the fit (.safetensors); if the file is there, the fit goes on from it."""
    report: Path | None = None
    """Also save all figures here (.json)."""
    height: float | None = None
    """Length that counts as 1.4 in the errors; the source's longest side if not given."""
    steps: int | None = None
    """At most so many steps."""
    seconds: float | None = None
    """At most so many seconds."""
    vertex_goal: float | None = None
    """Stop at this vertex error (times 1000)."""
    gradient_goal: float | None = None
    """Stop at this gradient error (times 1000)."""
    layers: int | None = None
    """Layers of the warp."""
    resolution: int | None = None
    """Vertices a side of each layer's mesh."""
    seed: int | None = None
    """Seed of every random choice."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        import json

        from implicit_warp.files import atomic_write, refuse_target, save
        from implicit_warp.fitting import FitOptions, fit

        refuse_target(self.out, (".safetensors",))
        if self.report is not None:
            refuse_target(self.report, (".json",))
        names = ("height", "steps", "seconds", "vertex_goal", "gradient_goal", "layers")
        given = {name: getattr(self, name) for name in (*names, "resolution", "seed")}
        options = FitOptions().with_changes({n: v for n, v in given.items() if v is not None})
        warp = fit(
            _read(self.source),
            _read(self.target),
            options=options,
            landmarks=None if self.landmarks is None else _read_landmarks(self.landmarks),
            checkpoint=self.checkpoint,
        )
        save(warp, self.out)
        if self.report is not None:
            with atomic_write(self.report) as temporary:
                temporary.write_text(json.dumps(warp.report.to_dict(), indent=2))
        say(f"{self.out}: {warp.report}")
        return INTERRUPTED if warp.report.status == "interrupted" else GOOD


def _read(path: Path | None):
    """A mesh, the points of a .npy file, or nothing."""
    if path is None:
        return None
    if path.suffix.lower() == ".npy":
        return read_points(path)
    from implicit_warp.mesh_files import read_mesh

    return read_mesh(path)


def _read_landmarks(path: Path):
    import numpy as np

    try:
        rows = np.loadtxt(path.read_text().replace(",", " ").splitlines(), ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(
            "landmarks", str(path), f"not readable as numbers ({error})", "write six a line"
        ) from error
    if rows.ndim != 2 or rows.shape[1] != 6 or not len(rows):
        raise InputError(
            "landmarks", str(path), f"its rows and columns are {rows.shape}", "write six a line"
        )
    return rows[:, :3], rows[:, 3:]
