"""The pytest plugin, run by pytest on suites of its own."""

from __future__ import annotations

import importlib.metadata
import multiprocessing
import subprocess
import sys

import pytest
import trimesh

import implicit_warp as iw
from implicit_warp.pytest_plugin import MeshBaseline, assert_clean

# Loaded here, it is not loaded anew by every run of a suite.
from implicit_warp.regression import Baseline, Entry

PLUGIN = "implicit_warp.pytest_plugin"
UPDATE = "--update-mesh-baselines"

MESHES = """
import trimesh
from implicit_warp.pytest_plugin import assert_clean

def ball(x=0.0):
    return trimesh.creation.icosphere(1).apply_translation((x, 0.1, 0.2))

def two(distance):
    return trimesh.util.concatenate([ball(), ball(distance)])
"""


@pytest.fixture
def suite(pytester, monkeypatch):
    """Writes a test file and runs it with the plugin loaded, registered or not."""
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)

    def run(body, *options, file="test_parts.py"):
        if body is not None:
            # pytest's cache of compiled files looks at times in seconds and at sizes.
            pytester.path.joinpath(file).write_text(f"{MESHES}\n{body}\n# {run.count}" + "#" * 9)
        run.count += 1
        sys.modules.pop("test_parts", None)
        return pytester.runpytest_inprocess(
            "-p", PLUGIN, "-p", "no:cacheprovider", "--import-mode=importlib", *options
        )

    run.count = 0
    run.stored = pytester.path / "__mesh_baselines__" / "test_parts.json"
    return run


def entries(path):
    return Baseline.load(path).entries


def test_assert_clean_returns_the_report_of_a_clean_mesh(tmp_path):
    ball = trimesh.creation.icosphere(1)
    assert assert_clean(ball).ok
    ball.export(tmp_path / "ball.stl")
    assert assert_clean(tmp_path / "ball.stl", referees=()).referees == ()


def test_assert_clean_names_the_problems_and_tolerates_as_told():
    ball = trimesh.creation.icosphere(1)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0.1, 0.2))])
    pairs = iw.check(two).num_self_intersections
    with pytest.raises(AssertionError, match=rf"not clean:\n  {pairs} pairs of faces intersect"):
        assert_clean(two, pairs - 1)
    assert assert_clean(two, pairs).num_self_intersections == pairs
    with pytest.raises(iw.InputError, match="no such file"):
        assert_clean("none.stl")


def test_a_failure_shows_the_report_and_not_the_plugin(suite):
    result = suite("def test_two(): assert_clean(two(0.5))")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*not clean*", "*pairs of faces intersect*", "*watertight*yes*"])
    assert "pytest_plugin.py" not in result.stdout.str()


def test_a_missing_entry_fails_with_the_hint_even_for_a_clean_mesh(suite):
    result = suite("def test_ball(mesh_baseline): mesh_baseline.check(ball())")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([f"*test_ball is not in *test_parts.json*{UPDATE}*"])
    assert "pytest_plugin.py" not in result.stdout.str()
    assert not suite.stored.parent.exists()


def test_update_then_compare_then_growth_with_a_readable_difference(suite):
    body = "def test_two(mesh_baseline): assert mesh_baseline.check({0}).volume > 0"
    stored = suite(body.format("two(0.5)"), UPDATE)
    stored.assert_outcomes(passed=1)
    stored.stdout.fnmatch_lines(["mesh baselines: 1 stored in *test_parts.json"])
    pairs = entries(suite.stored)["test_two"].counts["self_intersections"]
    assert pairs > 0
    same = suite(None)
    same.assert_outcomes(passed=1)
    assert "mesh baselines" not in same.stdout.str()
    before = suite.stored.read_bytes()
    worse = suite(body.format("trimesh.util.concatenate([two(0.5), ball(0.9)])"))
    worse.assert_outcomes(failed=1)
    worse.stdout.fnmatch_lines(
        [f"*test_two*self_intersections*{pairs} -> *", f"*{UPDATE}*", "*watertight*"]
    )
    assert suite.stored.read_bytes() == before
    suite(body.format("two(5.0)")).assert_outcomes(passed=1)


def test_an_update_merges_only_the_tests_that_ran(suite):
    body = """
        import pytest

        @pytest.mark.parametrize("x", [0.3, 0.5])
        def test_two(mesh_baseline, x): mesh_baseline.check(two(x))

        class TestParts:
            def test_names(self, mesh_baseline):
                mesh_baseline.check(ball(), "ball")
                mesh_baseline.check(two(0.5), "two")
    """
    body = "\n".join(line.removeprefix(" " * 8) for line in body.splitlines())
    suite(body, UPDATE).assert_outcomes(passed=3)
    first = entries(suite.stored)
    names = ["TestParts::test_names/ball", "TestParts::test_names/two"]
    assert sorted(first) == [*names, "test_two[0.3]", "test_two[0.5]"]
    changed = body.replace("two(x)", "ball()").replace('two(0.5), "two"', 'ball(), "two"')
    suite(changed, UPDATE, "-k", "0.5").assert_outcomes(passed=1, deselected=2)
    assert entries(suite.stored) == {**first, "test_two[0.5]": Entry({})}


def test_topology_is_kept_when_asked_for(suite):
    body = "def test_it(mesh_baseline): mesh_baseline.check({0}, topology={1})"
    suite(body.format("ball()", True), UPDATE).assert_outcomes(passed=1)
    suite(body.format("two(5)", True)).assert_outcomes(failed=1)
    result = suite(body.format("trimesh.creation.torus(1, 0.3)", True))
    result.stdout.fnmatch_lines(["*components.genus_0 * 1 -> 0", "*components.genus_1 * 0 -> 1"])
    suite(body.format("two(5)", False)).assert_outcomes(passed=1)


def test_two_meshes_under_one_name_are_refused(suite):
    body = "def test_it(mesh_baseline):\n"
    body += "    mesh_baseline.check(ball())\n    mesh_baseline.check(ball())"
    result = suite(body, UPDATE)
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*InputError: name = None*another mesh as 'test_it'*"])


def test_a_damaged_file_is_refused_and_never_overwritten(suite):
    suite.stored.parent.mkdir()
    suite.stored.write_text("<<<<<<< ours")
    for options in ([], [UPDATE]):
        result = suite("def test_it(mesh_baseline): mesh_baseline.check(ball())", *options)
        result.assert_outcomes(failed=1)
        result.stdout.fnmatch_lines(["*FileFormatError*test_parts.json: a damaged baseline*"])
    assert suite.stored.read_text() == "<<<<<<< ours"


def store_twenty(path, process):
    baseline = MeshBaseline(path, f"test_{process}", update=True)
    for k in range(20):
        baseline.check("any mesh", f"{k:02}")


def test_processes_that_update_one_file_lose_nothing(tmp_path, monkeypatch):
    path = tmp_path / "__mesh_baselines__" / "test_parts.json"
    # Fresh processes would import for seconds, and forked ones must not enter parallel kernels.
    report = iw.check(trimesh.creation.icosphere(0))
    monkeypatch.setattr("implicit_warp.checking.check", lambda mesh, **options: report)
    fork = multiprocessing.get_context("fork")
    processes = [fork.Process(target=store_twenty, args=(path, k)) for k in range(3)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(timeout=60)
    assert [process.exitcode for process in processes] == [0, 0, 0]
    assert len(entries(path)) == 60
    assert [p.name for p in path.parent.iterdir()] == ["test_parts.json"]


def test_an_unfinished_search_is_neither_stored_nor_passed(tmp_path):
    ball = trimesh.creation.icosphere(2)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0.1, 0.2))])
    path = tmp_path / "a" / "counts.json"
    with pytest.raises(AssertionError, match=r"is not stored: .* stopped at its limit"):
        MeshBaseline(path, "test", update=True).check(two, limit=1)
    assert not path.exists()
    MeshBaseline(path, "test", update=True).check(two)
    with pytest.raises(AssertionError, match="stopped at its limit"):
        MeshBaseline(path, "test", update=False).check(two, limit=1)


def test_start_up_imports_nothing_but_pytest_and_the_standard_library():
    program = f"""
import sys, pytest
before = set(sys.modules)
import {PLUGIN}
new = {{name.partition(".")[0] for name in set(sys.modules) - before}}
print(sorted(new - set(sys.stdlib_module_names)))
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    new = ran.stdout.split()
    assert [name for name in new if "implicit_warp" not in name] == [], ran.stderr


def test_the_entry_point_has_the_name_that_pytest_loads_it_by():
    """Else `-p` and the entry point would register it twice, and pytest would not start."""
    # As pytest looks: at every distribution, also at a second one of the same name.
    points = [
        point
        for distribution in importlib.metadata.distributions()
        for point in distribution.entry_points
        if point.group == "pytest11" and point.value == PLUGIN
    ]
    if not points:
        pytest.skip("installed before the entry point existed: run pip install -e . again")
    assert {point.name for point in points} == {PLUGIN}


def test_it_can_be_switched_off(pytester):
    pytester.makepyfile("def test_it(mesh_baseline): pass")
    result = pytester.runpytest_subprocess("-p", f"no:{PLUGIN}", "-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*fixture 'mesh_baseline' not found*"])
