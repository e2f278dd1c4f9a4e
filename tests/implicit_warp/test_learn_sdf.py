"""Learned fields beyond `fields`: extracted, deformed, and by command."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

import fields as sdf
import implicit_warp as iw
from implicit_warp.cli import main
from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.mesh_files import read_mesh, write_mesh
from implicit_warp.shapes import load_shape

SMALL = ["--architecture", "siren", "--samples", "6000", "--batch", "512"]

HANDLES = """
[[handle]]
region = "below(-0.6)"
hold = true

[[handle]]
region = "above(0.6)"
rotate = ["z", 30]

[solve]
layers = 6
resolution = 7
steps = 40
samples = 256
handle_samples = 64
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A mesh, and what the command learned from it."""
    folder = tmp_path_factory.mktemp("learned")
    write_mesh(trimesh.creation.icosphere(3), folder / "ball.obj")
    arguments = ["learn-sdf", f"{folder}/ball.obj", "-o", f"{folder}/sdf.safetensors"]
    arguments += [*SMALL, "--steps", "100", "--report", f"{folder}/r.json"]
    arguments += ["--checkpoint", f"{folder}/state.safetensors"]
    assert main(arguments) == 0
    return folder


def test_the_command_writes_the_field_and_its_figures(folder):
    report = json.loads((folder / "r.json").read_text())
    assert report["status"] == "finished"
    assert report["steps"] == 100
    assert report["architecture"]["kind"] == "siren"
    assert 0 < report["accuracy"]["near_error"] < 0.01
    shape = load_shape(folder / "sdf.safetensors")
    assert shape([0, 0, 0]) < 0 < shape([0, 0, 1.05])


def test_info_says_what_each_file_is(folder, capsys):
    assert main(["info", f"{folder}/sdf.safetensors"]) == 0
    text = capsys.readouterr().out
    assert "learned field: neural SIREN of" in text
    assert "near_error" in text
    assert main(["info", f"{folder}/state.safetensors"]) == 0
    assert "checkpoint: 100 of 100 steps" in capsys.readouterr().out
    iw.save(iw.Affine(np.eye(3)), folder / "map.safetensors")
    assert main(["info", f"{folder}/map.safetensors"]) == 0
    assert "map: Affine" in capsys.readouterr().out


def test_a_learned_field_is_extracted_clean(folder, capsys):
    out = f"{folder}/mesh.stl"
    assert main(["extract", f"{folder}/sdf.safetensors", "-o", out, "--resolution", "40"]) == 0
    mesh = read_mesh(out)
    assert mesh.volume == pytest.approx(4 / 3 * np.pi, rel=0.05)


def test_a_learned_field_deforms_as_any_other(folder):
    learned = sdf.load_neural(folder / "sdf.safetensors")
    twist = iw.Twist(40)
    image = iw.deform(learned, twist)
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    np.testing.assert_allclose(image(twist(points)), learned(points), atol=1e-9)
    mesh = iw.extract(image, 32)
    iw.check(mesh).raise_if_bad()


def test_the_deform_command_takes_a_learned_field(folder):
    (folder / "part.toml").write_text(HANDLES)
    deform = ["deform", f"{folder}/sdf.safetensors", "--handles", f"{folder}/part.toml"]
    deform += ["-o", f"{folder}/out.stl", "--resolution", "32"]
    assert main([*deform, "--warp", f"{folder}/w.safetensors"]) == 0
    apply = ["apply", f"{folder}/w.safetensors", f"{folder}/sdf.safetensors"]
    assert main([*apply, "-o", f"{folder}/again.stl", "--resolution", "32"]) == 0
    np.testing.assert_array_equal(
        read_mesh(folder / "out.stl").vertices, read_mesh(folder / "again.stl").vertices
    )


def test_a_map_never_replaces_the_field_it_deforms(folder, capsys):
    before = (folder / "sdf.safetensors").read_bytes()
    (folder / "part.toml").write_text(HANDLES)
    deform = ["deform", f"{folder}/sdf.safetensors", "--handles", f"{folder}/part.toml"]
    assert main([*deform, "-o", f"{folder}/sdf.stl"]) == 2
    assert "would replace the learned field" in capsys.readouterr().err
    assert (folder / "sdf.safetensors").read_bytes() == before


def test_a_fit_is_resumed_by_command(folder, capsys):
    resume = ["learn-sdf", f"{folder}/ball.obj", "-o", f"{folder}/longer.safetensors", "--resume"]
    resume += [*SMALL, "--checkpoint", f"{folder}/state.safetensors"]
    assert main([*resume, "--steps", "110"]) == 0
    assert "finished after 110 steps" in capsys.readouterr().out


def test_ctrl_c_leaves_the_best_on_disk(folder, monkeypatch, capsys):
    from fields.neural import training

    def stop(self, loss, progress):
        if self.record.step > 50:
            raise KeyboardInterrupt
        return review(self, loss, progress)

    review = training.Training._review
    monkeypatch.setattr(training.Training, "_review", stop)
    out = folder / "cut.safetensors"
    command = ["learn-sdf", f"{folder}/ball.obj", "-o", f"{out}", *SMALL]
    assert main([*command, "--steps", "100000"]) == 130
    assert "interrupted after" in capsys.readouterr().out
    assert sdf.load_neural(out)([0, 0, 0]) < 0


def test_files_of_the_other_kind_are_named(folder, capsys):
    iw.save(iw.Affine(np.eye(3)), folder / "map.safetensors")
    with pytest.raises(FileFormatError, match="holds no learned field; it is a map"):
        load_shape(folder / "map.safetensors")
    with pytest.raises(FileFormatError, match="holds no map"):
        iw.load(folder / "sdf.safetensors")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["-o", "sdf.pt"], "cannot write"),
        (["-o", "a.safetensors", "--checkpoint", "a.safetensors"], "share one name"),
        (["-o", "a.safetensors", "--resume"], "there is no checkpoint"),
        (["-o", "a.safetensors", "--steps", "0"], "steps"),
    ],
)
def test_bad_arguments_cost_no_fit(folder, options, message, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    assert main(["learn-sdf", "ball.obj", *options]) == 2
    assert message in capsys.readouterr().err


def test_an_open_mesh_is_refused_by_the_command(folder, capsys):
    ball = trimesh.creation.icosphere(2)
    holed = trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False)
    write_mesh(holed, folder / "holed.obj")
    assert main(["learn-sdf", f"{folder}/holed.obj", "-o", f"{folder}/h.safetensors"]) == 2
    assert "it is open" in capsys.readouterr().err
    assert not (folder / "h.safetensors").exists()


def test_the_errors_have_one_class():
    assert FileFormatError is sdf.FileFormatError
    assert InputError is sdf.InputError
