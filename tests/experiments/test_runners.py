"""Small versions of the three experiments: what they find is good, kept, and told as it is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from experiments import ablate, fit, timing
from experiments.bodies import FigureBody, pairs
from experiments.study import jobs as jobs_module
from experiments.study.fitters import FITTERS, NAMES
from experiments.study.jobs import Job, run_jobs, stored, time_to_accuracy
from experiments.study.other_solvers import refined
from experiments.study.pictures import comparison
from experiments.study.quality import errors
from experiments.study.results import (
    DOCUMENT,
    RESULTS,
    compact,
    read_results,
    with_rows_of,
    write_results,
)
from experiments.study.tables import by_name, number, quartiles
from experiments.study.variations import STUDIES, base_of
from implicit_warp import TutteNet
from implicit_warp.errors import FileFormatError, InputError

LOSS = {"vertex": 1, "gradient": 2}
"""Columns of a trace."""


def quiet(line: str) -> None:
    """Progress that nobody reads."""


@pytest.fixture(scope="module", autouse=True)
def _own_cache(tmp_path_factory):
    """Pairs are made anew, away from the user's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IMPLICIT_WARP_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def fitting(tmp_path_factory) -> tuple[fit.FitExperiment, dict]:
    """The fitting experiment on one pair of a figure of 600 vertices."""
    options = fit.FitExperiment(
        out=tmp_path_factory.mktemp("fit"), methods=("tuttenet", "realnvp", "cage", "arap"),
        bodies="small-figure", count=1, steps=200, seconds=2.0,
    )  # fmt: skip
    return options, fit.run(options, quiet)


def falls(record: dict, column: int) -> float:
    """How many times smaller an error was at the end of a trace than at its beginning."""
    return record["trace"][0][column] / record["trace"][-1][column]


def test_fits_are_good_and_keep_the_laws(fitting):
    records = {record["name"]: record for record in fitting[1]["records"]}
    net, coupling = records["tuttenet"], records["realnvp"]
    assert falls(net, LOSS["vertex"]) > 200
    assert falls(net, LOSS["gradient"]) > 10
    assert falls(coupling, LOSS["vertex"]) > 3
    for record in (net, coupling):
        assert record["round_trip"] < 1e-8
        assert record["det_vertices"] > 0
        assert record["det_box"] > 0
    assert net["exact_contacts"] == 0
    assert net["exact_faces"] > 2000
    for name in ("cage", "arap"):
        assert records[name]["vertex_error"] < net["trace"][0][LOSS["vertex"]] / 3
        assert records[name]["round_trip"] is None
    for record in records.values():
        assert record["contacts"] >= 0
        assert 0 < record["cpu_seconds"] < 60
        assert record["load"][0] >= 0


def test_nothing_is_done_twice(fitting, monkeypatch):
    options, found = fitting
    before = {path: path.stat().st_mtime_ns for path in options.out.rglob("records/*/*")}

    def refuse(*arguments):
        raise AssertionError("a fit that is on disk was made again")

    monkeypatch.setattr(jobs_module, "fit", refuse)
    again = fit.run(replace(options, pictures=False), quiet)
    assert json.dumps(again) == json.dumps(found)
    assert before == {path: path.stat().st_mtime_ns for path in options.out.rglob("records/*/*")}


def test_what_is_missing_is_made_and_what_is_foreign_refused(fitting, tmp_path):
    options, _ = fitting
    job = fit.jobs_of(options)[0]
    path = job.path(tmp_path)
    path.parent.mkdir()
    record = json.loads(job.path(options.out / "records").read_text())
    path.write_text(json.dumps(record))
    assert stored(job, tmp_path)["vertex_error"] == record["vertex_error"]
    path.write_text(json.dumps({**record, "job": {**record["job"], "seed": 7}}))
    with pytest.raises(InputError, match="other options, seeds or budgets"):
        run_jobs([job], tmp_path, progress=quiet)
    path.write_text(json.dumps(record)[:-20])
    with pytest.raises(FileFormatError, match="not a record of a job"):
        run_jobs([job], tmp_path, progress=quiet)
    path.unlink()
    with pytest.raises(InputError, match="no record is there"):
        run_jobs([job], tmp_path, workers=0, progress=quiet)
    with pytest.raises(InputError, match="workers"):
        run_jobs([job], tmp_path, workers=-1, progress=quiet)
    with pytest.raises(InputError, match=r"no such method.*tuttenet"):
        run_jobs([Job("x", "magic", 0, "small-figure")], tmp_path, progress=quiet)
    with pytest.raises(InputError, match=r"no such bodies.*anny"):
        run_jobs([Job("x", "cage", 0, "ghosts")], tmp_path, progress=quiet)


def test_tables_hold_the_numbers_of_the_results(fitting):
    options, found = fitting
    text = (options.out / "fit.md").read_text()
    assert read_results(options.out / "fit.json") == json.loads(json.dumps(found))
    for record in found["records"]:
        line = next(
            row for row in text.splitlines() if row.startswith(f"| {NAMES[record['name']]} ")
        )
        for key in ("parameters", "vertex_error", "gradient_error", "cpu_seconds"):
            assert number(record[key]) in line
    assert "seed 2026" in text


def test_pictures_show_what_was_found(fitting):
    options, _ = fitting
    curves = np.asarray(Image.open(options.out / "convergence.png").convert("RGB"))
    assert curves.shape[1] > 2 * curves.shape[0]
    picture = np.asarray(Image.open(options.out / "comparison.png").convert("RGB")).astype(int)
    warm = (picture[..., 0] - picture[..., 2] > 60).mean(axis=0)
    panels = np.array_split(warm, 6)  # source, four methods, target
    assert panels[0].max() < 0.3 * max(p.max() for p in panels[1:5])
    with pytest.raises(InputError, match="no such pair was fitted"):
        comparison(fit.jobs_of(options), options.out / "records", options.out / "x.png", (5,))


def test_the_errors_are_the_papers(fitting):
    """In plain numpy, from the definition."""
    (pair,) = pairs(1, 2026, FigureBody(28))
    rng = np.random.default_rng(0)
    image = pair.target.vertices + 0.02 * rng.standard_normal(pair.target.vertices.shape)
    scale, faces = 1.4 / pair.height, pair.source.faces
    found = errors(pair, image)
    difference = scale * (image - pair.target.vertices)
    assert found["vertex_error"] == pytest.approx(1e3 * np.mean(difference**2))
    edges = scale * (pair.source.vertices[faces[:, 1:]] - pair.source.vertices[faces[:, :1]])
    moved = difference[faces[:, 1:]] - difference[faces[:, :1]]
    # The least gradient with the given edges: (edges^+) applied from the right.
    gradients = np.einsum("fki,fjk->fij", moved, np.linalg.pinv(edges))
    assert found["gradient_error"] == pytest.approx(1e3 * np.mean(gradients**2))


def test_ablations_share_their_base_and_say_which_is_better(tmp_path, monkeypatch):
    def few(study: str) -> tuple:
        return tuple(v for v in STUDIES[study] if v.name in KEPT)

    KEPT = ("6 layers", "24 layers", "identity", "paper's, random", "as `fit` does it",
            "coarse to fine, 6 then 11", "L-BFGS in place of Adam")  # fmt: skip
    studies = ("layers", "initialisation", "ideas")
    with monkeypatch.context() as patch:
        for study in studies:
            patch.setitem(STUDIES, study, few(study))
        options = ablate.Ablation(
            out=tmp_path, studies=studies, bodies="small-figure", count=1, steps=80
        )
        found = ablate.run(options, quiet)
        tables = ablate.tables_of(found)
    folders = {path.name for path in (tmp_path / "records").iterdir()}
    assert len(folders) == 5
    assert "defaults" in folders
    errors = {(r["study"], r["name"]): r["vertex_error"] for r in found["records"]}
    base = errors["layers", "24 layers"]
    assert base == errors["initialisation", "identity"] == errors["ideas", "as `fit` does it"]
    assert errors["layers", "6 layers"] > 2 * base
    assert errors["initialisation", "paper's, random"] > 3 * base
    (pair,) = pairs(1, 2026, FigureBody(28))
    unmoved = 1e3 * np.mean(
        (1.4 / pair.height * (pair.source.vertices - pair.target.vertices)) ** 2
    )
    assert all(error < unmoved / 10 for error in errors.values())
    for (study, name), error in errors.items():
        row = next(line for line in tables[study].splitlines() if line.startswith(f"| {name}"))
        assert number(error) in row
        assert ("(base)" in row) == (name == base_of(study).name)
    assert (tmp_path / "ablate.png").stat().st_size > 10_000
    with pytest.raises(InputError, match="no such study"):
        ablate.run(ablate.Ablation(out=tmp_path, studies=("colour",)), quiet)


def test_every_study_has_one_base_and_known_methods():
    for study, variations in STUDIES.items():
        assert len({v.name for v in variations}) == len(variations)
        assert sum(not v.options and v.method == "tuttenet" for v in variations) == 1
        assert base_of(study) in variations
        assert all(v.method in FITTERS for v in variations)
    # Two rows may share a file only if they are the same fit.
    options = ablate.Ablation(out=Path())
    files: dict[Path, Job] = {}
    for variations in STUDIES.values():
        for variation in variations:
            job = ablate.job_of(variation, 0, options)
            assert files.setdefault(job.path(Path()), job) == job


def test_a_refined_net_is_nearly_the_same_map():
    coarse = TutteNet(4, 6, "cubic", init="paper", seed=3)
    x = torch.rand(500, 3, generator=torch.Generator().manual_seed(0)).double() * 1.6 - 0.8
    fine = refined(coarse, 11)
    with torch.no_grad():
        moved = (coarse(x) - x).norm(dim=-1).mean()
        assert (fine(x) - coarse(x)).norm(dim=-1).mean() < 0.15 * moved


def test_timing_times_what_it_says(tmp_path):
    options = timing.TimingExperiment(
        out=tmp_path, methods=("tuttenet", "realnvp"), points=300, threads=(1,), rounds=1,
        bodies="small-figure", seconds=0.5, steps=20,
    )  # fmt: skip
    found = timing.run(options, quiet)
    rows = {(row["method"], row["operation"]): row for row in found["records"]}
    assert set(rows) == {(m, o) for m in options.methods for o in timing.OPERATIONS}
    text = (tmp_path / "timing.md").read_text()
    assert all(
        0 < row["seconds"] < 5 and number(1e3 * row["seconds"]) in text for row in rows.values()
    )
    assert (tmp_path / "timing.png").stat().st_size > 5_000
    assert timing.run(replace(options, measuring=False), quiet) == json.loads(json.dumps(found))

    pair = jobs_module.pair_of(Job("timing", "tuttenet", 0, "small-figure"))
    points = timing._points_of(pair, 300)
    for method, given in (("tuttenet", {"steps": 20}), ("realnvp", {})):
        fitted = timing.fit(method, pair, 0.5, 0, given)
        work = timing.operations_of(method, fitted.map, points, options)
        exact = fitted.map(points.double())
        torch.testing.assert_close(work["forward"]().double(), exact, atol=1e-4, rtol=0)
        value, jacobian = work["value and Jacobian"]()
        torch.testing.assert_close(value.double(), exact, atol=1e-4, rtol=0)
        expected = fitted.map.jacobian(points.double())
        assert (jacobian.double() - expected).abs().median() < 1e-4
        torch.testing.assert_close(work["inverse"](), points.double(), atol=1e-6, rtol=0)
        first = work["training step"]()
        for _ in range(20):
            last = work["training step"]()
        assert last < first


def test_the_document_says_what_the_results_say():
    text = DOCUMENT.read_text(encoding="utf-8")
    fitted, varied = (read_results(RESULTS / f"{name}.json") for name in ("fit", "ablate"))
    tables = {**fit.tables_of(fitted), **ablate.tables_of(varied)}
    tables["timing"] = timing.table_of(read_results(RESULTS / "timing.json"))
    for name, table in tables.items():
        assert f"<!-- table {name} -->\n\n{table}\n\n<!-- end of table {name} -->" in text
    assert len(by_name(fitted["records"])["tuttenet"]) >= 20
    assert sum(path.stat().st_size for path in RESULTS.glob("*.json")) < 300_000
    for picture in ("convergence.png", "comparison.png", "ablate.png", "timing.png"):
        assert (RESULTS / picture).is_file()
        assert f"results/{picture}" in text


def test_results_are_small_and_come_back(tmp_path):
    record = {
        "name": "m", "index": 1, "vertex_error": 0.123456789, "secret": 1, "load": [0.5, 1.0],
        "trace": [[float(i), 1.0 / (i + 1), 2.0] for i in range(100)],
    }  # fmt: skip
    kept = compact(record)
    assert kept["vertex_error"] == 0.1235
    assert "secret" not in kept
    assert len(kept["trace"]) == 12
    assert kept["trace"][0][0] == 0.0
    assert kept["trace"][-1][0] == 99.0
    write_results(tmp_path / "r.json", {"a": 1, "records": [kept, kept]})
    assert read_results(tmp_path / "r.json") == {"a": 1, "records": [kept, kept]}


def test_methods_that_were_not_run_keep_their_rows():
    def results(cpu: str, load: list[float], **pairs: int) -> dict:
        records = [
            {"name": n, "index": i, "cpu": cpu} for n, count in pairs.items() for i in range(count)
        ]
        machine = {
            "cpu": [cpu],
            "torch": ["2"],
            "dates": ["2024-06-12"],
            "load": load,
            "threads": 1,
        }
        return {"pairs": 3, "seconds": 60.0, "machine": machine, "records": records}

    earlier = results("old", [1.0, 5.0], a=3, b=3)
    found = results("new", [0.5, 2.0], a=3, b=1, c=1)
    both = with_rows_of(found, earlier)
    assert [(r["name"], r["index"], r["cpu"]) for r in both["records"]] == [
        *(("a", i, "new") for i in range(3)), *(("b", i, "old") for i in range(3)), ("c", 0, "new"),
    ]  # fmt: skip
    assert both["machine"] == {**found["machine"], "cpu": ["new", "old"], "load": [0.5, 5.0]}
    assert with_rows_of(earlier, found) == earlier | {
        "records": [*earlier["records"], found["records"][-1]]
    } | {"machine": both["machine"]}
    assert with_rows_of(found, results("old", [1.0, 5.0], a=3)) == found
    with pytest.raises(InputError, match=r"keep.*seconds"):
        with_rows_of({**found, "seconds": 1.0}, earlier)


def test_small_statistics():
    assert quartiles([4.0, 1.0, 2.0, 3.0, 5.0]) == (2.0, 3.0, 4.0)
    assert [number(v) for v in (None, 0.0, 1234.5, 0.012345, 3.21e-13)] == [
        "-", "0", "1,234", "0.0123", "3.2e-13",
    ]  # fmt: skip
    trace = [[1.0, 0.2, 3.0], [2.0, 0.1, 5.0], [3.0, 0.1, 4.0], [4.0, 0.1, 1.0]]
    assert time_to_accuracy(trace) == 3.0
    assert time_to_accuracy(trace[:2]) is None


@pytest.mark.slow
def test_workers_find_what_one_process_finds(tmp_path):
    jobs = [Job("arap", "arap", index, "small-figure", measured=False) for index in range(2)]
    alone = run_jobs(jobs, tmp_path / "one", 1, quiet)
    shared = run_jobs(jobs, tmp_path / "two", 2, quiet)
    assert [r["vertex_error"] for r in alone] == [r["vertex_error"] for r in shared]
