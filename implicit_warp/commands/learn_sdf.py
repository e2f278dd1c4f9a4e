"""The command ``implicit-warp learn-sdf``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from implicit_warp.commands.common import GOOD, INTERRUPTED, Common, Out, say
from implicit_warp.errors import InputError


@dataclass(frozen=True, kw_only=True)
class LearnSdf(Common):
    """Learn the signed distance of a mesh or field as a small network.

    The result deforms and extracts like any other shape. Ctrl-C writes the best network so far.
    With --checkpoint, the state of the fit is kept on disk every ten seconds, and --resume goes on
    from it.

    Example: implicit-warp learn-sdf mesh.obj -o sdf.safetensors --seconds 60
    """

    shape: Positional[Path]
    """Closed mesh, or field script (.py)."""
    out: Out
    """The network (.safetensors)."""
    architecture: Literal["hash", "siren"] = "hash"
    """A multi-resolution hash grid, which learns fastest, or a SIREN, which is smooth and small."""
    steps: int | None = None
    """Steps of the fit; 3000 if neither this nor --seconds is given."""
    seconds: float | None = None
    """Stop after so many seconds of training."""
    samples: int | None = None
    """Points drawn near the surface, 300,000 if not given; a third as many are drawn in the box."""
    batch: int | None = None
    """Points of the distance term a step, 4096 if not given."""
    seed: int = 0
    """Seed of every random choice."""
    report: Path | None = None
    """Also save all figures here (.json)."""
    checkpoint: Path | None = None
    """Where to keep the state of the fit (.safetensors)."""
    resume: bool = False
    """Go on from --checkpoint."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from fields import NeuralOptions, fit_neural, save_neural
        from implicit_warp.files import refuse_target
        from implicit_warp.pipeline import write_json
        from implicit_warp.progress import progress_bar
        from implicit_warp.shapes import load_shape
        from implicit_warp.threads import threads_for_steps

        self._refuse_bad_targets(refuse_target)
        options = NeuralOptions().with_changes(self._changes())
        shape = load_shape(self.shape)
        with progress_bar("learn") as update, threads_for_steps(options.batch):
            learned, report = fit_neural(
                shape,
                self.architecture,
                options=options,
                checkpoint=self.checkpoint,
                resume=self.resume,
                progress=update,
            )
        save_neural(learned, self.out, report)
        if self.report is not None:
            write_json(report.to_dict(), self.report)
        say(f"{self.out}: {report}")
        return INTERRUPTED if report.status == "interrupted" else GOOD

    def _changes(self) -> dict[str, int | float]:
        """The options that were given."""
        given = {
            "steps": self.steps,
            "seconds": self.seconds,
            "batch": self.batch,
            "near_samples": self.samples,
            "box_samples": None if self.samples is None else self.samples // 3,
            "seed": self.seed,
        }
        if self.steps is None and self.seconds is not None:
            given["steps"] = 1_000_000  # the time decides alone
        return {name: value for name, value in given.items() if value is not None}

    def _refuse_bad_targets(self, refuse_target) -> None:
        """Before the work: a path that will be refused must not cost a fit."""
        targets = [(self.out, (".safetensors",)), (self.report, (".json",))]
        targets.append((self.checkpoint, (".safetensors",)))
        given = [(path, suffixes) for path, suffixes in targets if path is not None]
        for path, suffixes in given:
            refuse_target(path, suffixes)
        if len({path.resolve() for path, _ in given} | {self.shape.resolve()}) <= len(given):
            raise InputError(
                "out", str(self.out), "two files would share one name", "name them apart"
            )
