"""Every example runs, at small size, and reaches what it promises."""

from __future__ import annotations

import json
import runpy
from pathlib import Path

import pytest
import torch

import implicit_warp as iw
from implicit_warp.mesh_files import read_mesh

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = ("--resolution", "48", "--steps", "150", "--layers", "16")


def assert_good(out: Path, stem: str, genus: list[int]) -> None:
    report = json.loads((out / ("report.json" if stem == "part" else f"{stem}.json")).read_text())
    assert report["solve"]["handle_error_relative"] < 0.01
    assert report["map"]["smallest_determinant"] > 0
    assert report["check"]["ok"] is True
    warp = iw.load(out / ("warp.safetensors" if stem == "part" else f"{stem}.safetensors"))
    mesh = read_mesh(out / f"{stem}.stl")
    found = iw.check(mesh, referees=()).raise_if_bad().topology.genus
    assert list(found) == genus
    assert (out / f"{stem}.png").stat().st_size > 10_000
    # Every vertex is the image of a point near the rest surface, and back again.
    vertices = torch.tensor(mesh.vertices)
    assert (warp(warp.inv(vertices)) - vertices).abs().max() < 1e-9


@pytest.mark.parametrize("name", ["bar", "cylinder", "plate", "cactus"])
def test_standard_deformation_test(name, tmp_path):
    run = runpy.run_path(str(EXAMPLES / "standard/run.py"))["run"]
    assert run(name, tmp_path, *SMALL) == 0
    assert_good(tmp_path, name, [0])


def test_demo(tmp_path):
    run = runpy.run_path(str(EXAMPLES / "demo/run.py"))["run"]
    assert run(tmp_path, *SMALL) == 0
    assert_good(tmp_path, "part", [3])


def test_learned(tmp_path):
    run = runpy.run_path(str(EXAMPLES / "learned/run.py"))["run"]
    assert run(tmp_path, resolution=40, steps=150) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["accuracy"]["near_error"] < 0.002
    assert (tmp_path / "learned.png").stat().st_size > 10_000


def test_every_handle_file_has_its_shape():
    for path in EXAMPLES.rglob("*.toml"):
        handles, _ = iw.load_handles(path)
        assert len(handles) >= 2
        assert path.with_suffix(".py").exists() or (path.parent / "part.py").exists()


def test_the_readme_program_runs(tmp_path, monkeypatch):
    """The README's first program, at small size: the words are the README's own."""
    monkeypatch.chdir(tmp_path)
    text = (EXAMPLES.parent / "README.md").read_text(encoding="utf-8")
    program = text.split("```python\n")[1].split("```")[0]
    program = program.replace("resolution=256", "resolution=48")
    program = program.replace('rotate=("z", 60))]', 'rotate=("z", 60))], steps=60, layers=8')
    scope: dict = {}
    exec(compile(program, "README.md", "exec"), scope)
    assert scope["warp"].report.steps == 60
    assert read_mesh("twisted.stl").is_watertight
