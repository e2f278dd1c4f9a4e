"""The command ``implicit-warp render``: files it writes, and what it refuses before the work."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import implicit_warp as iw
from implicit_warp.cli import main
from tests.implicit_warp.registered_maps import random_net

PART = """
import fields as sdf
shape = sdf.rounded_box((0.5, 0.5, 1.6), 0.1).translate((0.1, 0, 0))
"""
HANDLES = """
[[handle]]
name = "foot"
region = "below(-0.5)"
hold = true

[[handle]]
name = "head"
region = "above(0.5)"
rotate = ["y", 25]

[solve]
steps = 12
layers = 4
"""
FILM = ("--size", "96x64", "--seconds", "0.5", "--fps", "8")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "part.py").write_text(PART)
    (tmp_path / "part.toml").write_text(HANDLES)
    iw.save(random_net(3, layers=3, resolution=5).freeze(), tmp_path / "warp.safetensors")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def render(*arguments):
    return main(["render", *arguments, "--resolution", "24"])


def test_a_field_becomes_a_picture(folder, capsys):
    assert render("part.py", "-o", "a.png", "--size", "120x90") == 0
    with Image.open("a.png") as image:
        assert image.size == (120, 90)
        assert np.asarray(image).std() > 10
    assert "a.png: the picture" in capsys.readouterr().out


def test_all_outputs_at_once_from_handles(folder, capsys):
    code = render(
        *("part.py", "--handles", "part.toml", "-o", "a.png", "--color", "energy"),
        *("--turntable", "t.gif", "--animate", "a.gif", "--layers", "l.png", *FILM),
    )
    assert code == 0
    said = capsys.readouterr().out
    for name in ("a.png: the picture", "t.gif: the turntable, 4 frames", "l.png: the layers"):
        assert name in said
    for name in ("a.png", "t.gif", "a.gif"):
        with Image.open(name) as image:
            assert image.size == (96, 64)
            assert getattr(image, "n_frames", 1) == (1 if name == "a.png" else 4)
    with Image.open("l.png") as image:
        assert image.width > 500
    assert sorted(p.suffix for p in folder.iterdir()) == sorted(
        [".py", ".toml", ".safetensors", ".png", ".png", ".gif", ".gif"]
    )


def test_an_animation_as_mp4(folder):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs the extra film")
    warp = ("--warp", "warp.safetensors")
    assert render("part.py", *warp, "--animate", "a.mp4", "--color", "det", *FILM) == 0
    reader = ffmpeg.read_frames("a.mp4")
    assert next(reader)["size"] == (96, 64)
    assert len(list(reader)) == 4


@pytest.mark.parametrize("color", ["none", "error", "squeeze"])
def test_a_section_of_a_warped_part(folder, color):
    code = render(
        *("part.py", "--warp", "warp.safetensors", "--handles", "part.toml", "--color", color),
        *("-o", "a.png", "--section", "y=0.02", "--size", "120x90"),
    )
    assert code == 0
    picture = np.asarray(Image.open("a.png")).astype(int)
    assert np.count_nonzero(picture[..., 2] - picture[..., 0] > 25) > 50  # the blue of the cut


def test_meshes_are_drawn_as_they_are_also_open_ones(folder):
    mesh = iw.extract(iw.shapes.load_shape("part.py"), 20)
    mesh.update_faces(np.arange(len(mesh.faces)) > 10)
    mesh.export("open.stl")
    warp = ("--warp", "warp.safetensors", "--color", "stretch")
    assert render("open.stl", *warp, "-o", "a.png", "--size", "96x64") == 0
    assert render("open.stl", "-o", "a.png", "--section", "z=0", "--size", "96x64") == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "nothing is to be drawn"),
        (("-o", "a.jpg"), "use .png"),
        (("-o", "a.png", "--color", "det"), "no deformation to show"),
        (("--animate", "a.mp4"), "no deformation to show"),
        (("--layers", "a.png"), "no deformation to show"),
        (("-o", "a.png", "--warp", "warp.safetensors", "--color", "error"), "pass --handles"),
        (("-o", "a.png", "--size", "big"), "write e.g. 1280x960"),
        (("-o", "a.png", "--size", "4x4"), "16 to 16384"),
        (("-o", "a.png", "--section", "w=2"), "plane"),
        (("--layers", "l.png", "--warp", "warp.safetensors", "--section", "z=0"), "turntables"),
        (("--turntable", "a.avi"), "use .mp4, .gif"),
        (("--turntable", "a.gif", "--fps", "80"), "50 frames"),
        (("--turntable", "a.gif", "--seconds", "0"), "seconds"),
        (("--turntable", "none/a.gif"), "its folder does not exist"),
        (("--turntable", "a.gif", "--animate", "a.gif"), "two share a file"),
        (("-o", "a.png", "--handles", "none.toml"), "cannot be read"),
        (("-o", "a.png", "--warp", "part.toml"), "not a readable .safetensors"),
    ],
)
def test_bad_requests_are_refused_before_the_work(folder, capsys, monkeypatch, arguments, words):
    monkeypatch.setattr("implicit_warp.render.render", lambda *a, **o: pytest.fail("it was drawn"))
    assert render("part.py", *arguments) == 2
    assert words in capsys.readouterr().err
    assert not list(folder.glob("a.*"))


def test_an_mp4_of_odd_size_is_refused(folder, capsys):
    pytest.importorskip("imageio_ffmpeg", reason="needs the extra film")
    assert render("part.py", "--turntable", "a.mp4", "--size", "97x64") == 2
    assert "even width and height" in capsys.readouterr().err
