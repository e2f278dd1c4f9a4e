"""The command ``implicit-warp check``."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from implicit_warp.commands.common import (
    BAD_INPUT,
    BAD_MESH,
    GOOD,
    Common,
    Referee,
    printable,
    say,
)
from implicit_warp.errors import InputError

if TYPE_CHECKING:
    from implicit_warp.regression import Outcome, Results, Target


@dataclass(frozen=True, kw_only=True)
class Check(Common):
    """Check meshes: closed, manifold, oriented, not degenerate, free of self-intersections.

    FILES are meshes, folders (their meshes at any depth) and patterns such as "parts/**/*.stl".
    Each is checked on its own; one that cannot be read does not stop the others. The exit code is
    2 if any could not be read, else 1 if any failed, else 0.

    With --baseline, a file in the baseline passes as long as no count of defects grew: what is
    stored is tolerated. --max-self-intersections then holds for files that are not in it.

    Example: implicit-warp check parts --baseline counts.json --junit report.xml
    """

    files: Positional[tuple[Path, ...]]
    """Meshes, folders of meshes, or patterns."""
    max_self_intersections: int = 0
    """Pairs of faces that may intersect before a file fails."""
    baseline: Path | None = None
    """Stored counts (.json); paths in it are relative to its folder."""
    update: bool = False
    """Store the counts of this run in the baseline; then only unreadable files fail."""
    junit: Path | None = None
    """Also write the verdicts as JUnit XML here (.xml)."""
    evidence: Path | None = None
    """Folder for a picture and a coloured mesh of each file that fails: where its defects are."""
    json: bool = False
    """Print everything as JSON, and nothing else."""
    referees: tuple[Referee, ...] = ("manifold3d",)
    """Libraries whose verdict is asked for beside ours."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.files import atomic_write, refuse_target
        from implicit_warp.regression import Gate, Results, find_targets, junit_xml

        if not self.files:
            raise InputError("files", (), "there is nothing to check", "name one or more meshes")
        if self.junit is not None:
            refuse_target(self.junit, (".xml",))
        if self.baseline is not None and self.update:
            refuse_target(self.baseline, (".json",))
        self._refuse_evidence()
        gate = Gate.open(
            self.baseline,
            self.update,
            max_self_intersections=self.max_self_intersections,
            referees=self.referees,
            evidence=self.evidence,
        )
        results = Results(gate)
        self._check(results, find_targets(self.files, exclude=self.evidence))
        if self.update:
            results.store()
        if self.junit is not None:
            with atomic_write(self.junit) as temporary:
                temporary.write_bytes(junit_xml(results.outcomes, results.started))
        code = BAD_MESH if results.count("failed") else GOOD
        code = BAD_INPUT if results.count("unreadable") else code
        if self.json:
            say(json.dumps(results.to_dict(code), indent=2))
        elif summary := results.summary():
            say(printable(summary))
        return code

    def _refuse_evidence(self) -> None:
        """Raise where the pictures cannot go, or would be taken for meshes to check."""
        folder = self.evidence
        if folder is None:
            return
        existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
        if not existing.is_dir() or not os.access(existing, os.W_OK):
            raise InputError(
                "evidence", str(folder), f"{existing} is no writable folder", "choose another one"
            )
        place = folder.resolve()
        for searched in filter(Path.is_dir, self.files):
            if place == searched.resolve() or place in searched.resolve().parents:
                raise InputError(
                    "evidence",
                    str(folder),
                    f"{searched} is searched for meshes, and would hold those of the evidence",
                    "choose a folder of its own, such as evidence/",
                )

    def _check(self, results: Results, targets: Sequence[Target]) -> None:
        """Check all, telling of each as it comes; after the last where a bar is in the way."""
        from implicit_warp.progress import progress_bar

        if not sys.stderr.isatty():
            for outcome in results.run(targets):
                self._tell(outcome, alone=len(targets) == 1)
            return
        with progress_bar("check", show=True) as update:
            update(0, len(targets), str(targets[0].path))
            for done, _ in enumerate(results.run(targets), 1):
                update(done, len(targets), "".join(str(t.path) for t in targets[done : done + 1]))
        for outcome in results.outcomes:
            self._tell(outcome, alone=len(targets) == 1)

    def _tell(self, outcome: Outcome, alone: bool) -> None:
        """A line for what passed among others, the whole report for the rest."""
        if outcome.facts is None:
            sys.stderr.write(f"implicit-warp: {outcome.error}\n")
            return
        if outcome.no_evidence:
            sys.stderr.write(f"implicit-warp: {outcome.path}: no picture: {outcome.no_evidence}\n")
        if self.json:
            return
        if outcome.failures or alone:
            say(printable(outcome.text))
        tolerated = not outcome.facts["ok"] and not outcome.failures
        verdict = outcome.status + (" with tolerated defects" if tolerated else "")
        say(printable(f"{outcome.path}: {verdict}, {outcome.seconds:.2f} s"))
        for path in outcome.evidence:
            say(printable(f"  see {path}"))
