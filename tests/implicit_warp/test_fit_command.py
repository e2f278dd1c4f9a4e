"""``implicit-warp fit``, run as users run it."""

from __future__ import annotations

import json

import numpy as np
import pytest

import implicit_warp as iw
from implicit_warp.cli import main
from implicit_warp.mesh_files import read_mesh, write_mesh
from tests.implicit_warp.test_fit import SOURCE, TARGET

QUICK = ["--layers", "6", "--resolution", "5", "--steps", "60"]


@pytest.fixture
def folder(tmp_path):
    write_mesh(SOURCE, tmp_path / "source.obj")
    write_mesh(TARGET, tmp_path / "target.obj")
    return tmp_path


def test_fit_writes_a_map_that_apply_and_info_take(folder, capsys):
    paths = [f"{folder}/source.obj", f"{folder}/target.obj", "-o", f"{folder}/warp.safetensors"]
    assert main(["fit", *paths, *QUICK, "--report", f"{folder}/r.json"]) == 0
    assert "vertices" in capsys.readouterr().out
    report = json.loads((folder / "r.json").read_text())
    warp = iw.load(folder / "warp.safetensors")
    assert report["vertex_error"] == warp.report.vertex_error < report["history"][0][3] / 5

    posed = f"{folder}/posed.ply"
    main(["apply", f"{folder}/warp.safetensors", f"{folder}/source.obj", "-o", posed])
    # PLY holds float32: half a unit in the last place of 400.
    assert np.allclose(read_mesh(posed).vertices, warp(SOURCE.vertices), atol=2e-4)
    capsys.readouterr()
    assert main(["info", f"{folder}/warp.safetensors"]) == 0
    assert "vertex_error" in capsys.readouterr().out


def test_fit_takes_points_and_landmarks(folder, capsys):
    np.save(folder / "a.npy", SOURCE.vertices)
    np.save(folder / "b.npy", TARGET.vertices)
    out = ["-o", f"{folder}/warp.safetensors"]
    assert main(["fit", f"{folder}/a.npy", f"{folder}/b.npy", *out, *QUICK]) == 0
    assert iw.load(folder / "warp.safetensors").report.gradient_error is None

    (folder / "marks.txt").write_text("0 0 0, 1 0 0\n1 0 0, 2 0 0\n0 1 0, 1 1 0\n0 0 1, 1 0 1.2\n")
    assert main(["fit", "--landmarks", f"{folder}/marks.txt", *out, *QUICK]) == 0
    moved = iw.load(folder / "warp.safetensors")(np.array([0.0, 0.0, 1.0]))
    assert np.linalg.norm(moved - [1.0, 0.0, 1.2]) < 0.05

    (folder / "marks.txt").write_text("0 0 0 1 0\n")
    assert main(["fit", "--landmarks", f"{folder}/marks.txt", *out]) == 2
    assert "six a line" in capsys.readouterr().err


def test_bad_input_is_named_before_any_work(folder, capsys):
    source, target = f"{folder}/source.obj", f"{folder}/target.obj"
    assert main(["fit", source, target, "-o", f"{folder}/warp.stl"]) == 2
    assert ".safetensors" in capsys.readouterr().err
    assert main(["fit", source, "-o", f"{folder}/warp.safetensors"]) == 2
    assert "target" in capsys.readouterr().err
    (folder / "cut.obj").write_text("v 0 0 0\nf 1")
    assert main(["fit", f"{folder}/cut.obj", target, "-o", f"{folder}/w.safetensors"]) == 2
    assert sorted(p.suffix for p in folder.iterdir()) == [".obj"] * 3


def test_an_interrupted_fit_leaves_the_best_map_and_code_130(folder, monkeypatch, capsys):
    from implicit_warp.fitting.solve import _Fit

    advance = _Fit._advance

    def interrupt(fit) -> None:
        if fit.step == 20:
            raise KeyboardInterrupt
        advance(fit)

    monkeypatch.setattr(_Fit, "_advance", interrupt)
    paths = [f"{folder}/source.obj", f"{folder}/target.obj", "-o", f"{folder}/warp.safetensors"]
    assert main(["fit", *paths, *QUICK]) == 130
    assert iw.load(folder / "warp.safetensors").report.status == "interrupted"
    assert "interrupted" in capsys.readouterr().out
