"""Meshes in pytest: `assert_clean`, and a fixture that compares counts with stored ones.

    from implicit_warp.pytest_plugin import assert_clean

    def test_bracket_is_clean():
        assert_clean(build_bracket())

    def test_scan_gets_no_worse(mesh_baseline):
        mesh_baseline.check("scans/statue.ply")

The stored counts of `tests/test_scans.py` are in `tests/__mesh_baselines__/test_scans.json`, under
the name of each test; `pytest --update-mesh-baselines` writes those of the tests that ran, and
leaves the others. Tests in several processes (pytest-xdist) may update one file: each re-reads it
under a lock. Entries of tests that are renamed or removed stay: delete the file and update to be
rid of them.

Nothing but the standard library and pytest is imported until a mesh is checked: the plugin is
registered wherever the package is installed, and must not cost other projects' tests anything.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    import trimesh

    from implicit_warp.checking import CheckReport

FOLDER = "__mesh_baselines__"
OPTION = "--update-mesh-baselines"

_written = pytest.StashKey[dict[Path, int]]()


def assert_clean(
    mesh: trimesh.Trimesh | str | os.PathLike[str],
    max_self_intersections: int = 0,
    **check_options: Any,
) -> CheckReport:
    """Check a mesh or a mesh file, and fail the test if it has problems.

    Args:
        mesh: as `implicit_warp.check` takes it.
        max_self_intersections: this many intersecting pairs of faces are tolerated.
        check_options: passed on to `implicit_warp.check`, such as `referees`.

    Returns:
        The report.

    Raises:
        AssertionError: with the problems and the whole report.
        InputError, FileFormatError: as `implicit_warp.check`.
    """
    __tracebackhide__ = True
    from implicit_warp.checking import check
    from implicit_warp.regression import judge

    report = check(mesh, **check_options)
    failures = judge(report, max_self_intersections)
    if failures:
        listed = "\n".join(f"  {text}" for text in failures)
        raise AssertionError(f"{_name(report)} is not clean:\n{listed}\n\n{report}")
    return report


class MeshBaseline:
    """What the fixture `mesh_baseline` gives: the stored counts of one test.

    Attributes:
        path: of the file that holds them; it need not exist.
        key: of the test in that file.
        update: whether this run stores counts in place of comparing them.
    """

    def __init__(self, path: Path, key: str, *, update: bool) -> None:
        self.path = path
        self.key = key
        self.update = update
        self.stored = 0
        self._seen: set[str] = set()

    def check(
        self,
        mesh: trimesh.Trimesh | str | os.PathLike[str],
        name: str | None = None,
        *,
        topology: bool = False,
        **check_options: Any,
    ) -> CheckReport:
        """Check a mesh, and fail the test if any count grew against the stored one.

        Args:
            mesh: as `implicit_warp.check` takes it.
            name: tells several meshes of one test apart; part of the key.
            topology: also store the number of components and their genus; they must not change.
            check_options: passed on to `implicit_warp.check`. The referees' opinions do not
                gate, so none is asked unless named here.

        Returns:
            The report. Counts that shrank pass.

        Raises:
            AssertionError: counts grew, topology changed, there is no entry, or the search for
                self-intersections did not end; with a table, the report and the remedy.
            InputError: the name was used before in this test; else as `implicit_warp.check`.
            FileFormatError: the stored counts, or a mesh file, are damaged.
        """
        __tracebackhide__ = True
        from implicit_warp.checking import check
        from implicit_warp.errors import InputError
        from implicit_warp.regression import Baseline, Entry, difference_table, judge

        key = self.key if name is None else f"{self.key}/{name}"
        if key in self._seen:
            raise InputError(
                "name", name, f"the test compared another mesh as {key!r}", "give each a name"
            )
        self._seen.add(key)
        report = check(mesh, **{"referees": (), **check_options})
        now = Entry.of(report, topology=topology)
        if self.update:
            if not report.self_intersections.complete:
                raise AssertionError(f"{key} is not stored: {judge(report)[-1]}\n\n{report}")
            self._store(key, now)
            return report
        baseline = Baseline.load(self.path) if self.path.exists() else Baseline()
        comparison = baseline.compare(key, now)
        if not comparison.known:
            raise AssertionError(
                f"{key} is not in {self.path}. To store its counts, run pytest {OPTION}\n\n{report}"
            )
        failures = judge(report, comparison=comparison)
        if failures:
            parts = [f"{key}: the mesh got worse than what {self.path} stores"]
            if rows := [(key, difference) for difference in comparison.differences]:
                parts.append(difference_table(rows, heading="mesh"))
            parts += [f"  {text}" for text in failures[len(comparison.regressions) :]]
            if note := baseline.version_note():
                parts.append(f"  note: {note}")
            parts += [f"  if that is meant, run pytest {OPTION}", "", str(report)]
            raise AssertionError("\n".join(parts))
        return report

    def _store(self, key: str, entry: Any) -> None:
        from implicit_warp.regression import Baseline

        self.path.parent.mkdir(exist_ok=True)
        with _locked(self.path.parent):
            baseline = Baseline.load(self.path) if self.path.exists() else Baseline()
            baseline.updated({key: entry}).save(self.path)
        self.stored += 1


@pytest.fixture
def mesh_baseline(request: pytest.FixtureRequest) -> Iterator[MeshBaseline]:
    """Compares counts of a mesh's defects with those stored beside the test file."""
    file = request.path
    # The part of the node's id after the file: classes, function, parameters.
    key = request.node.nodeid.partition("::")[2]
    baseline = MeshBaseline(
        file.parent / FOLDER / f"{file.stem}.json", key, update=request.config.getoption(OPTION)
    )
    yield baseline
    if baseline.stored:
        written = request.config.stash.setdefault(_written, {})
        written[baseline.path] = written.get(baseline.path, 0) + baseline.stored


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option that rewrites."""
    parser.getgroup("implicit_warp").addoption(
        OPTION,
        action="store_true",
        help=f"store the counts of meshes' defects in {FOLDER}, for the tests that run",
    )


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Say which files were written (by this process, where pytest-xdist starts several)."""
    for path, number in sorted(config.stash.get(_written, {}).items()):
        terminalreporter.write_line(f"mesh baselines: {number} stored in {path}")


@contextlib.contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keep other processes out of the folder; the lock leaves no file behind."""
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        # Some network file systems cannot lock a folder; one process needs no lock.
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _name(report: CheckReport) -> str:
    return report.source or "the mesh"
