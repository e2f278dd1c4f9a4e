"""Which files are meant, what each check found, and whether it passes."""

from __future__ import annotations

import glob
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from implicit_warp.errors import FileFormatError, InputError, MissingDependency
from implicit_warp.mesh_files import WRITABLE
from implicit_warp.regression.baseline import Baseline, Comparison, Entry, portable_key

if TYPE_CHECKING:
    from implicit_warp.checking import CheckReport

INCOMPLETE = (
    "the search for self-intersections stopped at its limit, so that its counts cannot be compared"
)


@dataclass(frozen=True)
class Target:
    """A file to check, or the reason why an argument names none."""

    path: Path
    error: InputError | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of one file.

    Attributes:
        path: as it was named.
        seconds: wall time of reading and checking.
        facts: `CheckReport.to_dict`; None if the file could not be read. The report itself holds
            the mesh's arrays, so a run over many files does not keep it.
        text: the report as text.
        entry: the figures of the report that a baseline stores.
        error: why the file could not be read.
        failures: why the gate fails it, a sentence each; empty if it passes.
        comparison: with the baseline, if there is one.
        evidence: files written that show where the defects are.
        no_evidence: why there are none although they were asked for.
    """

    path: Path
    seconds: float
    facts: Mapping[str, Any] | None = None
    text: str = ""
    entry: Entry | None = None
    error: Exception | None = None
    failures: tuple[str, ...] = ()
    comparison: Comparison | None = None
    evidence: tuple[Path, ...] = ()
    no_evidence: str = ""

    @property
    def status(self) -> Literal["passed", "failed", "unreadable"]:
        """The verdict in a word."""
        if self.facts is None:
            return "unreadable"
        return "failed" if self.failures else "passed"

    @property
    def key(self) -> str:
        """Of its entry in the baseline; "" where there is no baseline or no report."""
        return "" if self.comparison is None else self.comparison.key

    @property
    def is_new(self) -> bool:
        """Whether there is a baseline, and this file is not in it."""
        return self.comparison is not None and not self.comparison.known

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: verdict, counts that are not zero, and the whole report."""
        verdict: dict[str, Any] = {"status": self.status, "seconds": round(self.seconds, 3)}
        if self.facts is None or self.entry is None:
            return {**verdict, "ok": False, "error": str(self.error)}
        verdict |= {"failures": list(self.failures), "counts": dict(self.entry.counts)}
        if self.comparison is not None:
            verdict["baseline"] = self.comparison.to_dict()
        if self.evidence or self.no_evidence:
            verdict["evidence"] = [str(path) for path in self.evidence]
        return {**verdict, **self.facts}


def find_targets(
    arguments: Iterable[str | Path], *, exclude: str | Path | None = None
) -> list[Target]:
    """The files that the arguments mean, in order and each once.

    A folder means its meshes (the suffixes of `mesh_files.WRITABLE`) at any depth, sorted;
    names that begin with a dot and links to folders are passed over. A name that is no file and
    has a wildcard (`*`, `?`, `[...]`, and `**` for any depth) means what it matches. A folder or
    a pattern that holds nothing is an error of its own, since a gate that checks nothing must not
    pass.

    Args:
        arguments: files, folders, patterns.
        exclude: a folder whose meshes neither folders nor patterns mean, such as that of the
            evidence.
    """
    found: dict[str, Target] = {}
    left_out = None if exclude is None else os.path.realpath(exclude)
    for argument in arguments:
        for target in _targets(Path(argument), left_out):
            found.setdefault(os.path.abspath(target.path), target)
    return list(found.values())


def examine(
    target: Target,
    *,
    referees: Sequence[str] = ("manifold3d",),
    max_self_intersections: int = 0,
    baseline: Baseline | None = None,
    folder: str | Path = ".",
    update: bool = False,
    evidence: Path | None = None,
) -> Outcome:
    """Check one file and judge it.

    Without a baseline, or for a file that is not in it, every problem fails, with up to
    `max_self_intersections` intersecting pairs tolerated. For a file in the baseline its counts
    decide, and only they: what is stored is tolerated, whatever the limit and the referees say.

    Args:
        target: the file.
        referees: libraries asked beside ours.
        max_self_intersections: see above.
        baseline: stored counts.
        folder: where the baseline file lies; keys are relative to it.
        update: the counts are about to be stored, so that only those that cannot be fail.
        evidence: folder for a picture and a coloured mesh of each file that fails.

    Returns:
        The outcome. A file that cannot be read is one too.
    """
    from implicit_warp.checking import check

    if target.error is not None:
        return Outcome(target.path, 0.0, error=target.error)
    start = time.perf_counter()
    try:
        report = check(target.path, referees=referees)
    except (InputError, FileFormatError, MissingDependency, OSError) as error:
        return Outcome(target.path, time.perf_counter() - start, error=error)
    seconds = time.perf_counter() - start
    entry, comparison = Entry.of(report), None
    if baseline is not None:
        comparison = baseline.compare(portable_key(target.path, folder), entry)
    failures = _incomplete(report) if update else judge(report, max_self_intersections, comparison)
    shown, no_evidence = (), ""
    if evidence is not None and failures:
        shown, no_evidence = write_evidence(report, target.path, evidence)
    return Outcome(
        target.path,
        seconds,
        facts=report.to_dict(),
        text=str(report),
        entry=entry,
        failures=failures,
        comparison=comparison,
        evidence=shown,
        no_evidence=no_evidence,
    )


def judge(
    report: CheckReport, max_self_intersections: int = 0, comparison: Comparison | None = None
) -> tuple[str, ...]:
    """Why a mesh fails, a sentence each; nothing if it passes (the rules are at `examine`)."""
    from implicit_warp.checking import BadMesh

    if comparison is not None and comparison.known:
        grown = (f"{d.name}: {d.stored} -> {d.now}" for d in comparison.regressions)
        return (*grown, *_incomplete(report))
    try:
        report.raise_if_bad(max_self_intersections)
    except BadMesh as bad:
        return bad.problems
    return ()


def write_evidence(report: CheckReport, path: Path, folder: Path) -> tuple[tuple[Path, ...], str]:
    """Write NAME.ply and NAME.png below a folder, at the path that the mesh has.

    Returns:
        The files, and why one could not be made; the verdict does not depend on them.
    """
    # The path below the root or above the working directory would lead out of the folder.
    inner = [part for part in path.parts if part not in (path.anchor, os.pardir)]
    stem = folder.joinpath(*inner)
    mesh, picture = (stem.with_name(stem.name + suffix) for suffix in (".ply", ".png"))
    written = []
    try:
        stem.parent.mkdir(parents=True, exist_ok=True)
        report.write_coloured_mesh(mesh)
        written.append(mesh)
        report.write_picture(picture)
        written.append(picture)
    except (InputError, MissingDependency, OSError) as error:
        return tuple(written), str(error)
    return tuple(written), ""


def _incomplete(report: CheckReport) -> tuple[str, ...]:
    return () if report.self_intersections.complete else (INCOMPLETE,)


def _targets(path: Path, left_out: str | None) -> Iterator[Target]:
    if path.is_dir():
        files = _meshes_below(path, left_out)
        yield from map(Target, files)
        if not files:
            yield _nothing(path, "the folder holds no meshes", f"known are {', '.join(WRITABLE)}")
    elif not path.exists() and glob.has_magic(str(path)):
        files = sorted(Path(p) for p in glob.glob(str(path), recursive=True))
        files = [p for p in files if p.is_file() and not _is_below(p, left_out)]
        yield from map(Target, files)
        if not files:
            yield _nothing(path, "no file matches the pattern", "check the path")
    else:
        yield Target(path)


def _is_below(path: Path, folder: str | None) -> bool:
    return folder is not None and Path(folder) in path.resolve().parents


def _meshes_below(folder: Path, left_out: str | None) -> list[Path]:
    files = []
    for parent, folders, names in os.walk(folder):
        folders[:] = sorted(
            name
            for name in folders
            if not name.startswith(".") and os.path.realpath(Path(parent, name)) != left_out
        )
        files += [
            Path(parent, name)
            for name in sorted(names)
            if not name.startswith(".") and Path(name).suffix.lower() in WRITABLE
        ]
    return files


def _nothing(path: Path, cause: str, remedy: str) -> Target:
    return Target(path, InputError("files", str(path), cause, remedy))
