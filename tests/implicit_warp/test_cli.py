"""The command line, run as users run it: exit codes, files, messages."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import numpy as np
import pytest
import trimesh

import implicit_warp as iw
from implicit_warp.cli import COMMANDS, main
from implicit_warp.errors import InputError
from implicit_warp.mesh_files import read_mesh, write_mesh
from implicit_warp.shapes import load_shape

SCRIPT = """
import fields as sdf
shape = sdf.box((1.0, 1.0, 3.0)) - sdf.cylinder(0.25)
"""

HANDLES = """
[[handle]]
region = "below(-1.1)"
hold = true

[[handle]]
region = "above(1.1)"
rotate = ["z", 45]

[solve]
layers = 6
resolution = 7
steps = 60
samples = 512
handle_samples = 128
"""


@pytest.fixture
def part(tmp_path):
    (tmp_path / "part.py").write_text(SCRIPT)
    (tmp_path / "part.toml").write_text(HANDLES)
    return tmp_path


@pytest.fixture
def deformed(part, capsys):
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml"]
    arguments += ["-o", f"{part}/out.stl", "--warp", f"{part}/w.safetensors"]
    arguments += ["--report", f"{part}/r.json", "--resolution", "48", "--seed", "5"]
    code = main(arguments)
    return part, code, capsys.readouterr().out


def test_deform_writes_everything_and_checks_the_file(deformed):
    folder, code, output = deformed
    assert code == 0
    report = json.loads((folder / "r.json").read_text())
    assert report["solve"]["options"]["seed"] == 5
    assert report["solve"]["options"]["layers"] == 6
    assert report["map"]["smallest_determinant"] > 0
    assert report["check"]["ok"] is True
    mesh = read_mesh(folder / "out.stl")
    assert len(mesh.faces) == report["extraction"]["faces"]
    assert mesh.is_watertight
    assert mesh.volume > 0
    warp = iw.load(folder / "w.safetensors")
    assert warp.report.handle_error == report["solve"]["handle_error"]
    assert sorted(p.name for p in folder.iterdir() if p.name != "__pycache__") == [
        "out.stl", "part.py", "part.toml", "r.json", "w.safetensors",
    ]  # fmt: skip
    assert "handle error" in output
    assert f"{folder}/out.stl: ok" in output


def test_apply_and_info_understand_what_deform_wrote(deformed, capsys):
    folder, _, _ = deformed
    warp = iw.load(folder / "w.safetensors")
    assert main(["info", f"{folder}/w.safetensors"]) == 0
    assert "Warp(layers=6, resolution=7)" in capsys.readouterr().out

    points = np.random.default_rng(0).normal(size=(7, 3))
    np.save(folder / "points.npy", points)
    apply = ["apply", f"{folder}/w.safetensors"]
    assert main([*apply, f"{folder}/points.npy", "-o", f"{folder}/moved.npy"]) == 0
    np.testing.assert_array_equal(np.load(folder / "moved.npy"), warp(points))
    assert main([*apply, f"{folder}/moved.npy", "-o", f"{folder}/back.npy", "--inverse"]) == 0
    np.testing.assert_allclose(np.load(folder / "back.npy"), points, rtol=0, atol=1e-12)

    write_mesh(trimesh.creation.icosphere(3, 0.5), folder / "ball.ply")
    assert main([*apply, f"{folder}/ball.ply", "-o", f"{folder}/ball.obj"]) == 0
    assert read_mesh(folder / "ball.obj").is_watertight
    again = [*apply, f"{folder}/part.py", "-o", f"{folder}/again.stl", "--resolution", "48"]
    assert main(again) == 0
    np.testing.assert_array_equal(
        read_mesh(folder / "again.stl").vertices, read_mesh(folder / "out.stl").vertices
    )


def test_extract_then_check_and_the_exit_codes(part, capsys):
    assert main(["extract", f"{part}/part.py", "-o", f"{part}/a.off", "--resolution", "32"]) == 0
    mesh = read_mesh(part / "a.off")
    holed = trimesh.Trimesh(mesh.vertices, mesh.faces[1:], process=False)
    write_mesh(holed, part / "holed.off")
    capsys.readouterr()
    assert main(["check", f"{part}/a.off"]) == 0
    assert main(["check", f"{part}/holed.off"]) == 1
    assert "open" in capsys.readouterr().out
    assert main(["check", f"{part}/a.off", f"{part}/holed.off", "--json"]) == 1
    reports = json.loads(capsys.readouterr().out)["files"]
    assert [r["ok"] for r in reports.values()] == [True, False]


def test_self_intersections_fail_a_check_unless_allowed(part, capsys):
    ball = trimesh.creation.icosphere(2)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0.1, 0.2))])
    write_mesh(two, part / "two.off")
    assert main(["check", f"{part}/two.off"]) == 1
    pairs = int(re.search(r"(\d+) pairs of faces intersect", capsys.readouterr().out)[1])
    assert pairs == iw.check(two, referees=()).num_self_intersections > 0
    assert main(["check", f"{part}/two.off", "--max-self-intersections", f"{pairs}"]) == 0
    assert main(["check", f"{part}/two.off", "--max-self-intersections", f"{pairs - 1}"]) == 1


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off", ".glb", ".3mf"])
def test_every_format_comes_back_closed(tmp_path, suffix):
    ball = trimesh.creation.icosphere(2)
    write_mesh(ball, tmp_path / f"ball{suffix}")
    again = read_mesh(tmp_path / f"ball{suffix}")
    assert len(again.faces) == len(ball.faces)
    assert len(again.vertices) == len(ball.vertices)
    assert again.is_watertight
    # STL, PLY, GLB hold float32; OBJ and 3MF eight decimals.
    assert np.abs(again.bounds - ball.bounds).max() < 1e-7


BROKEN = {
    "missing": (None, "no such file"),
    "no shape": ("x = 1", "defines no name 'shape'"),
    "wrong shape": ("shape = 3", "its 'shape' is 3"),
    "raises": ("a = 1\nb = a / 0\n", "failed in line 2: ZeroDivisionError"),
    "exits": ("import sys\nsys.exit(0)", "failed in line 2: SystemExit"),
    "syntax": ("shape = (", "failed in line 1: SyntaxError"),
}


@pytest.mark.parametrize(("text", "words"), BROKEN.values(), ids=BROKEN.keys())
def test_broken_scripts_are_explained(tmp_path, capsys, text, words):
    path = tmp_path / "part.py"
    if text is not None:
        path.write_text(text)
    assert main(["extract", str(path), "-o", f"{tmp_path}/a.stl"]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["extract", "{0}/part.py", "-o", "{0}/a.xyz"], "cannot write '.xyz'"),
        (["extract", "{0}/part.py", "-o", "{0}/no/a.stl"], "does not exist"),
        (["extract", "{0}/part.py", "-o", "{0}/a.stl", "--resolution", "0"], "resolution = 0"),
        (["extract", "{0}/part.py", "-o", "{0}/a.stl", "--threads", "0"], "threads = 0"),
        (["check", "{0}/none.stl"], "no such file"),
        (["check", "{0}/part.py"], "no mesh format"),
        (["check", "{0}/broken.stl"], "broken.stl"),
        (["check", "{0}/broken.ply"], "broken.ply"),
        (["check", "{0}/broken.3mf"], "broken.3mf"),
        (["info", "{0}/broken.safetensors"], "may be truncated"),
        (["apply", "{0}/none.safetensors", "{0}/part.py", "-o", "{0}/a.stl"], "no such file"),
        (
            ["deform", "{0}/part.py", "--handles", "{0}/no.toml", "-o", "{0}/a.stl"],
            "cannot be read",
        ),
    ],
)
def test_bad_input_is_exit_code_2_with_a_remedy(part, capsys, arguments, words):
    for name in ("broken.stl", "broken.ply", "broken.3mf", "broken.safetensors"):
        (part / name).write_bytes(b"solid but not really")
    assert main([a.format(part) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error
    assert not (part / "a.stl").exists()


@pytest.mark.parametrize(
    ("option", "target"),
    [
        ("-o", "a.xyz"),
        ("-o", "no/a.stl"),
        ("--warp", "no/w.safetensors"),
        ("--warp", "w.pt"),
        ("--report", "no/r.json"),
        ("--picture", "p.jpg"),
    ],
)
def test_targets_that_cannot_be_written_are_refused_before_the_solve(
    part, capsys, monkeypatch, option, target
):
    from implicit_warp import pipeline

    monkeypatch.setattr(pipeline, "elastic", lambda *a, **k: pytest.fail("the solve was started"))
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml"]
    arguments += [option, f"{part}/{target}"]
    if option != "-o":
        arguments += ["-o", f"{part}/a.stl"]
    assert main(arguments) == 2
    assert target in capsys.readouterr().err


def test_interrupting_the_solve_leaves_the_warp_on_disk(part, monkeypatch):
    from implicit_warp import elastic_solve

    review, calls = elastic_solve.ElasticSolve._review, []

    def interrupt(self):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return review(self)

    monkeypatch.setattr(elastic_solve.ElasticSolve, "_review", interrupt)
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml"]
    arguments += ["-o", f"{part}/a.stl", "--warp", f"{part}/w.safetensors"]
    assert main(arguments) == 130
    assert iw.load(part / "w.safetensors").report.status == "interrupted"
    assert not (part / "a.stl").exists()


def test_the_warp_is_saved_beside_the_mesh_unless_told_otherwise(part):
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml", "--steps", "2"]
    assert main([*arguments, "-o", f"{part}/a.stl", "--resolution", "32"]) == 0
    assert iw.load(part / "a.safetensors").report.steps == 2


def test_a_shape_is_deformed_after_a_saved_map_and_the_composition_is_saved(part):
    shift = iw.Affine.from_matrix(np.array([[1.0, 0, 0, 2], [0, 1, 0, 0], [0, 0, 1, 0]]))
    iw.save(shift, part / "before.safetensors")
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml", "--steps", "20"]
    arguments += ["-o", f"{part}/a.stl", "--resolution", "48"]
    assert main([*arguments, "--under", f"{part}/before.safetensors"]) == 0
    vertices = read_mesh(part / "a.stl").vertices
    foot = vertices[vertices[:, 2] < -1.4]
    np.testing.assert_allclose(foot.mean(axis=0)[0], 2.0, atol=0.1)
    saved = iw.load(part / "a.safetensors")
    np.testing.assert_array_equal(saved.maps[0](np.zeros(3)), shift(np.zeros(3)))
    shape = load_shape(part / "part.py")
    assert np.abs(shape(saved.inv(vertices))).max() < 0.02


def test_a_map_is_not_saved_over_the_one_that_is_read(part, capsys):
    iw.save(iw.Affine(), part / "a.safetensors")
    before = (part / "a.safetensors").read_bytes()
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml"]
    arguments += ["-o", f"{part}/a.stl", "--under", f"{part}/a.safetensors"]
    assert main(arguments) == 2
    assert "replace the map that is read" in capsys.readouterr().err
    assert (part / "a.safetensors").read_bytes() == before


def test_results_may_not_share_a_file(part, capsys):
    arguments = ["deform", f"{part}/part.py", "--handles", f"{part}/part.toml"]
    arguments += ["-o", f"{part}/a.stl", "--warp", f"{part}/a.stl"]
    assert main(arguments) == 2
    assert "share a file" in capsys.readouterr().err


def test_an_obj_brings_no_other_files(tmp_path):
    (tmp_path / "material.mtl").write_text("precious")
    ball = trimesh.creation.icosphere(1)
    ball.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(ball.vertices), 2)))
    write_mesh(ball, tmp_path / "ball.obj")
    assert (tmp_path / "material.mtl").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ball.obj", "material.mtl"]


def test_a_defect_is_exit_code_3(part, monkeypatch, capsys):
    from implicit_warp import shapes

    monkeypatch.setattr(shapes, "load_shape", lambda path: 1 / 0)
    assert main(["info", f"{part}/part.py"]) == 3
    assert "ZeroDivisionError" in capsys.readouterr().err


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches_each_command(command, capsys):
    with pytest.raises(SystemExit) as caught:
        main([command, "--help"])
    assert caught.value.code == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"implicit-warp {command}" in text


def test_unknown_options_are_refused_with_code_2():
    run = subprocess.run(
        [sys.executable, "-m", "implicit_warp.cli", "check", "--fast"], capture_output=True
    )
    assert run.returncode == 2


def test_reading_keeps_the_vertices_of_an_stl_that_share_a_place(tmp_path):
    path = tmp_path / "box.stl"
    write_mesh(trimesh.creation.box(), path)
    assert len(read_mesh(path).vertices) == 8
    with pytest.raises(InputError, match="no mesh format"):
        read_mesh(__file__)
