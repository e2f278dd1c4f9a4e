"""Films: their frames, their loops, the maps behind them, and the files read back."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
import trimesh
from PIL import Image

import implicit_warp as iw
from implicit_warp.color_scales import color_scale
from implicit_warp.film_files import refuse_film, write_film
from implicit_warp.films import Film, Look, animation, loop_order, motion, turntable
from implicit_warp.morph import Morph
from implicit_warp.render import render
from implicit_warp.render.legend import legend_height, with_legend
from tests.implicit_warp.registered_maps import random_warp

SMALL = Look(size=(96, 64), seconds=1.0, fps=10, supersampling=1)


def foreground(frame):
    """Which pixels differ from the background, whose rows are of one colour to a dither."""
    return (np.abs(frame.astype(int) - frame[:, :1]) > 12).any(axis=-1)


def difference(a, b):
    return np.abs(a.astype(int) - b.astype(int)).mean()


@pytest.fixture(scope="module")
def bar():
    return trimesh.creation.box((2.0, 0.6, 0.4)).subdivide().subdivide()


@pytest.fixture(scope="module")
def turn(bar):
    return list(turntable(bar, look=SMALL))


@pytest.fixture(scope="module")
def bend():
    return random_warp(3)


def test_a_turntable_goes_around_once_and_closes(turn):
    assert len(turn) == SMALL.frames == 10
    assert {frame.shape for frame in turn} == {(64, 96, 3)}
    steps = [difference(turn[k], turn[(k + 1) % 10]) for k in range(10)]
    # The step from the last frame to the first is one like the others.
    assert min(steps[:-1]) * 0.8 < steps[-1] < max(steps[:-1]) * 1.2
    assert difference(turn[0], turn[5]) < difference(turn[0], turn[2])  # half a turn of a bar


def test_no_frame_of_a_turntable_is_cut_off(turn):
    for frame in turn:
        seen = foreground(frame)
        assert not seen[0].any()
        assert not seen[:, [0, 1, -2, -1]].any()
        assert seen[:-4].any()


def test_loops_go_there_and_back_without_a_jerk():
    order, amounts = loop_order(12)
    assert order == (0, 1, 2, 3, 4, 5, 6, 5, 4, 3, 2, 1)
    assert amounts[0] == 0.0
    assert amounts[-1] == 1.0
    way = amounts[list(order)]
    steps = np.abs(np.diff(np.append(way, way[0])))
    assert steps.argmax() in (2, 3, 8, 9)
    assert steps[0] < 0.3 * steps.max()


def test_every_frame_of_an_animation_shows_a_proved_map(bar, bend):
    amounts = loop_order(10)[1]
    made = []

    def path(amount):
        map_ = Morph(bend)(amount)
        assert iw.certify(map_).proved
        made.append(amount)
        return map_

    film = animation(bar, path, quantity="stretch", look=SMALL)
    frames = list(film)
    assert made == pytest.approx(amounts)
    assert len(frames) == len(film) == 10
    assert {frame.shape for frame in frames} == {(64, 96, 3)}
    for k in range(1, 5):
        np.testing.assert_array_equal(frames[k], frames[10 - k])
    assert difference(frames[0], frames[-1]) < difference(frames[0], frames[5])
    # Less moves next to a turning point than half-way between them.
    assert difference(frames[0], frames[1]) < difference(frames[2], frames[3])


def test_motion_carries_vertices_and_values(bar, bend):
    done = []
    moved = motion(
        bar, Morph(bend), [0, 0.5, 1], quantity="det", progress=lambda *what: done.append(what[:2])
    )
    np.testing.assert_allclose(moved.vertices[0], bar.vertices, atol=1e-6)
    np.testing.assert_allclose(moved.vertices[2], bend(bar.vertices), atol=1e-5)
    np.testing.assert_allclose(moved.values[0], 1.0, atol=1e-9)
    expected = iw.measure_distortion(bend, bar.vertices).determinant
    np.testing.assert_allclose(moved.values[2], expected)
    assert done == [(1, 3), (2, 3), (3, 3)]
    assert moved.scale.low * moved.scale.high == pytest.approx(1.0)


def test_odd_numbers_of_frames_still_reach_the_whole_motion(bar, bend):
    made = []
    animation(
        bar,
        lambda amount: made.append(amount) or bend,
        look=Look((64, 48), seconds=1, fps=7, supersampling=1),
    )
    assert made[-1] == 1.0
    assert len(made) == 5


def test_pictures_that_come_again_are_made_once():
    asked = []

    def picture(number):
        asked.append(number)
        return np.full((16, 16, 3), number, np.uint8)

    film = Film((16, 16), 10, (0, 1, 2, 1), picture)
    assert [int(frame[0, 0, 0]) for frame in film] == [0, 1, 2, 1]
    assert asked == [0, 1, 2]


def test_an_mp4_read_back_has_the_frames(turn, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="needs the extra film")
    film, path, done = (
        Film((96, 64), 10, tuple(range(10)), turn.__getitem__),
        tmp_path / "a.mp4",
        [],
    )
    write_film(film, path, lambda k, n, text: done.append((k, n)))
    reader = ffmpeg.read_frames(str(path))
    about = next(reader)
    assert about["size"] == (96, 64)
    assert about["fps"] == pytest.approx(10)
    frames = [np.frombuffer(raw, np.uint8).reshape(64, 96, 3) for raw in reader]
    assert len(frames) == 10
    for got, sent in zip(frames, turn, strict=True):
        assert difference(got, sent) < 4
    assert done == [(k, 10) for k in range(1, 11)]


@pytest.mark.parametrize("fps", [10, 24, 30])
def test_a_gif_read_back_has_the_frames_the_time_and_the_loop(turn, tmp_path, fps):
    path = tmp_path / "a.gif"
    write_film(Film((96, 64), fps, tuple(range(10)), turn.__getitem__), path)
    with Image.open(path) as image:
        assert image.size == (96, 64)
        assert image.n_frames == 10
        assert image.info["loop"] == 0
        total = 0
        for k, sent in enumerate(turn):
            image.seek(k)
            total += image.info["duration"]
            assert difference(np.asarray(image.convert("RGB")), sent) < 4
    assert total == pytest.approx(10_000 / fps, abs=10)


def test_a_film_that_fails_leaves_the_old_file(turn, tmp_path):
    def broken(number):
        if number == 3:
            raise RuntimeError("no light")
        return turn[number]

    for name in ("a.gif", "a.mp4"):
        path = tmp_path / name
        path.write_text("old")
        with pytest.raises(RuntimeError, match="no light"):
            write_film(Film((96, 64), 10, tuple(range(10)), broken), path)
        assert path.read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.gif", "a.mp4"]


def test_a_missing_ffmpeg_names_the_extra(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **options):
        if name == "imageio_ffmpeg":
            raise ImportError(name)
        return real(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(iw.MissingDependency, match=r"implicit_warp\[film\]"):
        refuse_film(tmp_path / "a.mp4", (96, 64), 24)
    refuse_film(tmp_path / "a.gif", (96, 64), 24)


def test_bad_input_is_refused(bar, tmp_path):
    with pytest.raises(iw.InputError, match="even width"):
        refuse_film(tmp_path / "a.mp4", (97, 64), 24)
    with pytest.raises(iw.InputError, match=r"use \.mp4, \.gif"):
        refuse_film(tmp_path / "a.avi", (96, 64), 24)
    with pytest.raises(iw.InputError, match="50 frames"):
        refuse_film(tmp_path / "a.gif", (96, 64), 60)
    with pytest.raises(iw.InputError, match="0 frames"):
        turntable(bar, look=Look(seconds=0.01, fps=10))
    with pytest.raises(iw.InputError, match="seconds"):
        turntable(bar, look=Look(seconds=-1))
    with pytest.raises(iw.InputError, match="places"):
        render(bar, places=np.zeros((3, 3)))
    with pytest.raises(iw.InputError, match="within"):
        render(bar, within=np.zeros((3, 3)))


def test_a_legend_has_the_scale_s_colours():
    scale = color_scale("energy", high=2.0)
    size = (320, 200)
    rows = legend_height(size)
    image = with_legend(np.full((200 - rows, 320, 3), 235, np.uint8), scale, rows)
    assert image.shape == (200, 320, 3)
    strip = image[200 - rows :].reshape(-1, 3).astype(int)
    for color in scale.table[8:-8:16, :3].astype(int):
        assert np.abs(strip - color).sum(axis=1).min() < 12


def test_the_box_within_decides_where_the_ground_is(bar):
    """A mesh that floats has its shadow below it, and not at its feet."""
    low, high = bar.bounds
    camera = iw.render.Camera.fit([low - [1, 1, 2], high + 1.0], size=(96, 64))
    standing = render(bar, size=(96, 64), camera=camera)
    floating = render(bar, size=(96, 64), camera=camera, within=[low - [0, 0, 2], high])
    assert difference(standing, floating) > 0.5
