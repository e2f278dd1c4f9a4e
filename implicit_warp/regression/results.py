"""A whole run of `implicit-warp check`: what it says, what it writes, what it stores."""

from __future__ import annotations

import datetime
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from implicit_warp.errors import InputError
from implicit_warp.regression.baseline import Baseline, Difference, difference_table, portable_key
from implicit_warp.regression.gate import Outcome, Target, examine


@dataclass(frozen=True, kw_only=True)
class Gate:
    """The rules of one run.

    Attributes:
        max_self_intersections: pairs tolerated in a file that no baseline knows.
        referees: libraries asked beside ours.
        baseline_path: where the stored counts are, or None.
        update: store the counts of this run in place of gating on the old ones.
        evidence: folder for pictures and coloured meshes of what fails, or None.
        baseline: the stored counts; read by `open`.
    """

    max_self_intersections: int = 0
    referees: Sequence[str] = ("manifold3d",)
    baseline_path: Path | None = None
    update: bool = False
    evidence: Path | None = None
    baseline: Baseline | None = None

    @classmethod
    def open(cls, baseline_path: Path | None = None, update: bool = False, **rules: Any) -> Gate:
        """Read the baseline and refuse rules that contradict each other.

        Raises:
            InputError: nothing to update, a negative limit, or no such baseline.
            FileFormatError: the baseline is damaged; it is never overwritten.
        """
        if update and baseline_path is None:
            raise InputError(
                "update", True, "there is no baseline to update", "add --baseline counts.json"
            )
        if rules.get("max_self_intersections", 0) < 0:
            raise InputError(
                "max_self_intersections",
                rules["max_self_intersections"],
                "a number of pairs is not negative",
                "pass 0 to tolerate none",
            )
        baseline = None
        if baseline_path is not None:
            fresh = update and not baseline_path.exists()
            baseline = Baseline() if fresh else Baseline.load(baseline_path)
        return cls(baseline_path=baseline_path, update=update, baseline=baseline, **rules)

    @property
    def folder(self) -> Path:
        """What the baseline's keys are relative to: the folder in which it lies."""
        return Path() if self.baseline_path is None else self.baseline_path.parent

    def examine(self, target: Target) -> Outcome:
        """Check and judge one file; under `update` nothing fails but what cannot be stored."""
        return examine(
            target,
            referees=self.referees,
            max_self_intersections=self.max_self_intersections,
            baseline=self.baseline,
            folder=self.folder,
            update=self.update,
            evidence=self.evidence,
        )


@dataclass
class Results:
    """The outcomes of one run under one gate.

    Attributes:
        gate: the rules.
        outcomes: one a file, in order.
        started: when the run began.
    """

    gate: Gate
    outcomes: list[Outcome] = field(default_factory=list)
    started: datetime.datetime = field(default_factory=lambda: datetime.datetime.now(datetime.UTC))

    def run(self, targets: Sequence[Target]) -> Iterator[Outcome]:
        """Check one file after the other, and yield each outcome as it comes."""
        for target in targets:
            outcome = self.gate.examine(target)
            self.outcomes.append(outcome)
            yield outcome

    def count(self, status: str) -> int:
        """Number of files with that status."""
        return sum(outcome.status == status for outcome in self.outcomes)

    @property
    def not_checked(self) -> list[str]:
        """Keys of the baseline that no file of this run has."""
        if self.gate.baseline is None:
            return []
        seen = {portable_key(outcome.path, self.gate.folder) for outcome in self.outcomes}
        return sorted(self.gate.baseline.entries.keys() - seen)

    @property
    def gone(self) -> list[str]:
        """Those of `not_checked` whose files do not exist any more."""
        return [key for key in self.not_checked if not (self.gate.folder / key).exists()]

    def store(self) -> None:
        """Write the baseline: what was checked replaces its entry, what is gone is removed.

        An unreadable file, one whose search did not end, and one that exists but was not checked
        keep the entries that they have.
        """
        if self.gate.baseline is None or self.gate.baseline_path is None:
            return
        entries = {
            outcome.key: outcome.entry
            for outcome in self.outcomes
            if outcome.entry is not None and not outcome.failures
        }
        self.gate.baseline.updated(entries, self.gone).save(self.gate.baseline_path)

    def to_dict(self, exit_code: int) -> dict[str, Any]:
        """Plain values for JSON: verdict, every file's report, and the baseline's side of it."""
        import implicit_warp

        gate, stored = self.gate, None
        if gate.baseline is not None:
            stored = {
                "path": str(gate.baseline_path),
                "library_version": gate.baseline.library_version,
                "updated": gate.update,
                "not_checked": self.not_checked,
                "gone": self.gone,
            }
        return {
            "exit_code": exit_code,
            "library_version": implicit_warp.__version__,
            "max_self_intersections": gate.max_self_intersections,
            "passed": self.count("passed"),
            "failed": self.count("failed"),
            "unreadable": self.count("unreadable"),
            "files": {str(outcome.path): outcome.to_dict() for outcome in self.outcomes},
            "baseline": stored,
        }

    def summary(self) -> str:
        """What remains to be said after the files: the comparison, the advice, the sum."""
        lines: list[str] = []
        if self.gate.baseline is not None:
            lines += self._updated() if self.gate.update else self._compared(self.gate.baseline)
        if len(self.outcomes) > 1 or self.gate.baseline is not None:
            number = len(self.outcomes)
            lines.append(
                f"{number} file{'s' if number != 1 else ''}: {self.count('passed')} passed, "
                f"{self.count('failed')} failed, {self.count('unreadable')} unreadable"
            )
        return "\n".join(lines)

    def _compared(self, baseline: Baseline) -> list[str]:
        path, lines = self.gate.baseline_path, []
        if rows := self._rows(lambda d: d.is_regression):
            lines += [f"{path}: counts that grew", difference_table(rows)]
            if note := baseline.version_note():
                lines.append(f"  note: {note}")
            lines.append("  if that is meant, accept it with --update")
        if rows := self._rows(lambda d: not d.is_regression):
            lines += [f"{path}: counts that shrank", difference_table(rows)]
            lines.append("  keep it so: store them with --update")
        if bad := [o.key for o in self.outcomes if o.is_new and o.failures]:
            lines.append(f"{path}: {_few(bad)} not stored and not clean; --update accepts them")
        if good := [o.key for o in self.outcomes if o.is_new and not o.failures]:
            lines.append(f"{path}: {_few(good)} not stored, and passed; --update stores them")
        if self.not_checked:
            lines.append(f"{path}: {_few(self.not_checked)} stored, but not checked in this run")
        return lines

    def _updated(self) -> list[str]:
        path, lines = self.gate.baseline_path, []
        if rows := self._rows(lambda _: True):
            lines += [f"{path}: counts that changed", difference_table(rows)]
        if new := [o.key for o in self.outcomes if o.is_new and not o.failures]:
            lines.append(f"{path}: {_few(new)} stored for the first time")
        if self.gone:
            lines.append(f"{path}: {_few(self.gone)} removed: no such file")
        return [*lines, f"{path}: written"]

    def _rows(self, wanted: Callable[[Difference], bool]) -> list[tuple[str, Difference]]:
        return [
            (outcome.comparison.key, difference)
            for outcome in self.outcomes
            if outcome.comparison is not None
            for difference in outcome.comparison.differences
            if wanted(difference)
        ]


def _few(keys: Sequence[str], shown: int = 3) -> str:
    """A number of files, with the first few named."""
    names = ", ".join(keys[:shown]) + (", ..." if len(keys) > shown else "")
    return f"{len(keys)} file{'s' if len(keys) != 1 else ''} ({names})"
