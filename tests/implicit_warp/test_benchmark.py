"""The benchmark: every row is there and true to its arithmetic. Nothing here asserts a speed."""

from __future__ import annotations

import itertools
import json
import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

import implicit_warp
from implicit_warp import cli
from implicit_warp.benchmark import Machine, Report, Row, Settings, run_benchmark, workloads
from implicit_warp.benchmark.fresh_process import PEAK_MEMORY, run_fresh
from implicit_warp.benchmark.report import number
from implicit_warp.benchmark.timing import Contender, race, wall
from implicit_warp.commands.common import BAD_INPUT, GOOD
from implicit_warp.errors import InputError
from implicit_warp.files import save

TINY = Settings(
    layers=2,
    resolution=5,
    points=200,
    reference_points=50,
    searched_points=20,
    vertices=40,
    samples=64,
    elastic_steps=2,
    reference_elastic_steps=1,
    extraction_resolution=48,
    fine_resolution=50,
    searched_resolution=8,
    solve_resolutions=(3, 4),
    largest_reference_solve=3,
    memory_points=5_000,
    reference_memory_points=5_000,
    rounds=2,
    few_rounds=1,
)

KEYS = [
    *itertools.chain.from_iterable(
        (f"{name}_float32", f"{name}_float64")
        for name in ("map", "inverse", "jacobian", "inverse_jacobian")
    ),
    "fit_step",
    "elastic_step",
    "solve_3",
    "solve_4",
    "field_evaluation",
    "extract_canonical_scene_48",
    "extract_canonical_scene_sharp_48",
    "extract_twisted_plate_48",
    "extract_twisted_plate_sharp_48",
    "extract_warped_canonical_scene_48",
    "extract_warped_canonical_scene_sharp_48",
    "extract_warped_canonical_scene_50",
    "memory",
    "first_call",
    "import",
]


@pytest.fixture(scope="module")
def report() -> Report:
    return run_benchmark(TINY)


def test_every_row_is_there_with_finite_positive_numbers(report):
    assert [row.key for row in report.rows] == KEYS
    for row in report.rows:
        # So few points may need no memory at all.
        smallest = 0.0 if row.key == "memory" else 1e-9
        for value in (row.value, row.best, row.reference):
            if value is None:
                assert row.key == "solve_4", row  # above largest_reference_solve
            else:
                assert smallest <= value < math.inf, row
        assert row.best >= row.value if row.more_is_better else row.best <= row.value


def test_goals_are_those_of_the_project(report):
    rows = {row.key: row for row in report.rows}
    goals = {key: rows[key].goal for key in KEYS if not key.endswith("float64")}
    assert goals == {
        "map_float32": 30, "inverse_float32": 10, "jacobian_float32": 15,
        "inverse_jacobian_float32": 15, "fit_step": 5, "elastic_step": 12, "solve_3": None,
        "solve_4": None, "memory": 50, "first_call": 1, "import": 0.3, "field_evaluation": 3,
        "extract_canonical_scene_48": 0.6, "extract_canonical_scene_sharp_48": None,
        "extract_twisted_plate_48": 1, "extract_twisted_plate_sharp_48": 1,
        "extract_warped_canonical_scene_48": 1.5, "extract_warped_canonical_scene_sharp_48": 1.5,
        "extract_warped_canonical_scene_50": 8,
    }  # fmt: skip
    for name in ("map", "inverse", "jacobian", "inverse_jacobian"):
        assert rows[f"{name}_float64"].goal == pytest.approx(0.5 * rows[f"{name}_float32"].value)


def test_json_holds_everything_and_comes_back(report):
    text = json.dumps(report.to_dict(), allow_nan=True)
    values = json.loads(text)
    assert values.keys() == {"machine", "settings", "rows"}
    fields = {"key", "what", "unit", "value", "best", "more_is_better", "goal", "reference",
              "note", "ratio", "met"}  # fmt: skip
    assert all(row.keys() == fields for row in values["rows"])
    assert values["settings"]["points"] == 200
    assert values["machine"]["threads"] == report.settings.threads
    assert values["machine"]["versions"]["implicit_warp"] == implicit_warp.__version__
    again = Report.from_dict(values)
    assert again == report
    assert json.dumps(again.to_dict()) == text


def test_printed_forms_show_every_row(report):
    table, markdown = report.table(), report.markdown()
    for row in report.rows:
        assert f"{row.what}, {row.unit}" in table
        assert f"| {row.what}, {row.unit} | {number(row.value)} |" in markdown
    for text in (table, markdown):
        assert f"OMP_WAIT_POLICY {report.machine.wait_policy}" in text
    assert all(line.count("|") == 8 for line in markdown.splitlines() if line[:1] == "|")


@pytest.mark.parametrize("more_is_better", [True, False])
def test_ratio_and_goal_know_which_way_is_better(more_is_better):
    row = Row("k", "what", "u", 4.0, 4.0, more_is_better, goal=5.0, reference=2.0)
    assert row.ratio == (2.0 if more_is_better else 0.5)
    assert row.met is not more_is_better
    assert replace(row, goal=4.0).met is True
    assert replace(row, goal=None).met is None
    assert replace(row, reference=None).ratio is None
    assert replace(row, reference=0.0).ratio is None


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (0.0012345, "0.00123"), (1.0, "1.00"), (33.64, "33.6"), (999.9, "1,000"),
     (10_000.0, "10,000"), (math.nan, "nan")],
)  # fmt: skip
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_race_takes_turns_and_counts_medians():
    order = []

    def contender(name, seconds, rounds):
        values = iter(seconds)

        def measure() -> float:
            order.append(name)
            return next(values)

        return Contender(measure, rounds)

    found = race({"a": contender("a", [5.0, 1.0, 2.0], 3), "b": contender("b", [7.0, 8.0], 2)})
    assert order == ["a", "b", "a", "b", "a"]
    assert (found["a"].median, found["a"].best) == (2.0, 1.0)
    assert (found["b"].median, found["b"].best) == (7.5, 7.0)


def test_wall_measures_the_work_and_nothing_else(monkeypatch):
    clock = iter([10.0, 10.25])
    monkeypatch.setattr("time.perf_counter", lambda: next(clock))
    done = []
    assert wall(lambda: done.append(1), "cpu")() == 0.25
    assert done == [1]


@pytest.mark.parametrize("vertices", [4, 5, 40, 6890])
def test_the_sphere_is_closed_oriented_and_of_genus_zero(vertices):
    points, faces = workloads.sphere_mesh(vertices)
    mesh = trimesh.Trimesh(points, faces, process=False)
    assert len(np.unique(faces)) == vertices
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 2
    assert mesh.volume > 0
    assert all(np.array_equal(a, b) for a, b in zip(workloads.sphere_mesh(vertices),
                                                    (points, faces), strict=True))  # fmt: skip


def test_fit_steps_do_fit():
    step = workloads.fit_step(100, 4, 5, seed=0, device="cpu")
    losses = [step() for _ in range(60)]
    assert losses[-1] < 0.5 * losses[0]


def test_fast_and_dense_solve_are_given_the_same_problem(monkeypatch):
    results = []

    def recorded(outputs, inputs, pull):
        results.append([outputs.detach(), *inputs, pull])
        return original(outputs, inputs, pull)

    original = torch.autograd.grad
    monkeypatch.setattr(torch.autograd, "grad", recorded)
    for dense in (False, True):
        workloads.embedding_solve(3, 6, seed=1, device="cpu", dense=dense)()
    for fast, slow in zip(*results, strict=True):
        torch.testing.assert_close(fast, slow, rtol=0, atol=1e-12)


def test_points_and_warps_repeat():
    for dtype in (torch.float32, torch.float64):
        points = workloads.cube_points(1000, 3, dtype, "cpu")
        assert points.dtype == dtype
        assert float(points.min()) < -0.95
        assert float(points.max()) > 0.95
        assert torch.equal(points, workloads.cube_points(1000, 3, dtype, "cpu"))
    one, two = (workloads.random_warp(3, 5, 7, "cpu") for _ in range(2))
    assert torch.equal(one.embeddings, two.embeddings)


def test_peak_memory_sees_what_a_call_allocates(tmp_path):
    """The reference holds temporaries of several times the points' 12 bytes each."""
    path = tmp_path / "warp.safetensors"
    save(workloads.random_warp(2, 5, 0, "cpu"), path)
    points = 1_000_000
    job = {"device": "cpu", "warp": str(path), "points": points, "back_end": "torch"}
    assert run_fresh(PEAK_MEMORY, job, threads=1) > 12 * points


def test_a_failing_process_shows_its_last_words():
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        run_fresh("1 / 0", {}, threads=1)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"device": "tpu"}, "use one of cpu, cuda"), ({"points": 0}, "points = 0"),
     ({"solve_resolutions": (11, 0)}, "solve_resolutions"), ({"vertices": 3}, "closed mesh"),
     ({"rounds": 1.5}, "rounds = 1.5")],
)  # fmt: skip
def test_bad_settings_are_explained(changes, message):
    with pytest.raises(InputError, match=message):
        Settings(**changes)
    with pytest.raises(InputError, match=message):
        Settings.quick(**changes)


@pytest.mark.skipif(torch.cuda.is_available(), reason="needs a machine without CUDA")
def test_a_missing_gpu_is_bad_input(capsys):
    assert cli.main(["bench", "--device", "cuda"]) == BAD_INPUT
    assert "torch sees no CUDA device" in capsys.readouterr().err


@pytest.mark.parametrize("as_json", [True, False])
def test_the_command_prints_the_report(as_json, report, monkeypatch, capsys):
    asked = []

    def pretend(settings, progress):
        asked.append(settings)
        return report

    monkeypatch.setattr("implicit_warp.benchmark.run_benchmark", pretend)
    arguments = ["--json"] if as_json else ["--memory-points", "123"]
    assert cli.main(["bench", "--quick", *arguments]) == GOOD
    output = capsys.readouterr().out
    if as_json:
        assert Report.from_dict(json.loads(output)) == report
        assert asked == [Settings.quick()]
    else:
        assert output == report.table() + "\n"
        assert asked == [Settings.quick(memory_points=123)]


@pytest.mark.parametrize("own", [None, "ACTIVE"])
def test_the_command_line_lets_waiting_threads_sleep_unless_told_otherwise(own):
    environment = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
    environment |= {} if own is None else {"OMP_WAIT_POLICY": own}
    program = """
import os, sys
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "torch":
            print(os.environ.get("OMP_WAIT_POLICY"), flush=True)
            os._exit(0)  # torch is about to be imported: that is all there is to see
sys.meta_path.insert(0, Watch())
import implicit_warp.cli
"""
    result = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert result.stdout.strip() == (own or "PASSIVE")


def test_the_machine_is_described(report):
    machine = report.machine
    assert machine == Machine(**json.loads(json.dumps(report.to_dict()))["machine"])
    assert machine.cpu
    assert machine.cores >= 1
    assert machine.gpu == ""
    assert set(machine.versions) == {"python", "torch", "numba", "implicit_warp"}
