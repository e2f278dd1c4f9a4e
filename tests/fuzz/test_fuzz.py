"""Past failures stay fixed, a few fresh cases of every kind, and the fuzzer's own laws."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.fuzz import runner
from tests.fuzz.cases import (
    build_mesh,
    build_scene,
    build_warp,
    draw_mesh,
    draw_scene,
    draw_warp,
)
from tests.fuzz.properties import PROPERTIES, Property
from tests.fuzz.shrinking import shrink, simpler

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.json"))
FEW = {"warp": 40, "flip": 60, "push_forward": 12, "extract": 25, "defect": 12}


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.stem)
def test_past_failures_stay_fixed(path):
    case = json.loads(path.read_text())
    PROPERTIES[case["kind"]].holds(case)


@pytest.mark.parametrize("kind", PROPERTIES)
def test_a_few_fresh_cases_hold(kind, seed):
    for number in range(seed, seed + FEW[kind]):
        case = PROPERTIES[kind].draw(number)
        error = runner.failure(case)
        assert error is None, f"seed {number}: {error}\n{json.dumps(case)}"


@pytest.mark.parametrize("kind", PROPERTIES)
def test_cases_are_plain_json_and_repeat(kind, seed):
    case = PROPERTIES[kind].draw(seed)
    assert json.loads(json.dumps(case)) == case == PROPERTIES[kind].draw(seed)
    assert any(case != PROPERTIES[kind].draw(seed + k) for k in (1, 2))


def test_the_same_description_builds_the_same_objects(seed):
    rng = np.random.default_rng(seed)
    mesh, warp, scene = draw_mesh(rng), draw_warp(rng), draw_scene(rng)
    mesh["shape"], mesh["scene"] = "torus", None
    first, second = build_mesh(mesh), build_mesh(mesh)
    assert (first.vertices == second.vertices).all()
    first, second = build_warp(warp), build_warp(warp)
    assert (first.embeddings == second.embeddings).all()
    fewer = build_warp({**warp, "layers": 1})
    assert (fewer.embeddings[0] == first.embeddings[0]).all()
    assert repr(build_scene(scene)) == repr(build_scene(scene))


def test_a_failure_shrinks_to_the_least_that_fails(seed):
    def fails(case):
        return case["warp"]["layers"] >= 3 and "torus" in json.dumps(case["scene"])

    case = next(
        case for case in map(PROPERTIES["extract"].draw, range(seed, seed + 500)) if fails(case)
    )
    small = shrink(case, fails, seconds=20.0)
    assert small["warp"]["layers"] == 3
    assert small["scene"]["op"] == "torus"
    assert not any(fails(candidate) for candidate in simpler(small))


def test_a_failure_is_printed_saved_and_replayed(tmp_path, monkeypatch, capsys):
    def draw(number):
        return {"kind": "planted", "detail": number}

    def holds(case):
        assert case["detail"] < 7, "planted"
        return {"fine": 1}

    monkeypatch.setitem(PROPERTIES, "planted", Property(draw, holds))
    assert runner.run(["planted"], 10, 0, 5.0, tmp_path) == 3
    printed = capsys.readouterr().out
    assert "planted fails with seed 7" in printed
    assert "3 of 10 failed" in printed
    assert "7 fine" in printed
    saved = json.loads((tmp_path / "planted-9.json").read_text())
    assert saved == {"kind": "planted", "detail": 7}
    assert isinstance(runner.failure(saved), AssertionError)
