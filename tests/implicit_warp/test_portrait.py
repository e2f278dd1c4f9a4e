"""What pictures show: colours, places, legends, cuts."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import fields
import implicit_warp as iw
from implicit_warp.portrait import cut_portrait, half_of, portrait
from implicit_warp.render.legend import legend_height
from implicit_warp.render.surface import CLAY

HANDLES = [iw.hold(fields.below(-0.4)), iw.move(fields.above(0.4), translate=(0, 0, 0.5))]


@pytest.fixture(scope="module")
def ball():
    return trimesh.creation.icosphere(subdivisions=3)


def test_without_a_map_there_is_clay(ball):
    shown = portrait(ball)
    assert shown.mesh is ball
    assert shown.color is shown.scale is None
    assert shown.picture((64, 48), 1).shape == (48, 64, 3)


def test_a_quantity_is_that_of_the_vertices_at_rest(ball):
    twist = iw.Twist(70)
    shown = portrait(ball, twist, quantity="stretch")
    np.testing.assert_allclose(shown.mesh.vertices, twist(ball.vertices))
    values = iw.measure_distortion(twist, ball.vertices).largest
    np.testing.assert_array_equal(shown.color, shown.scale(values)[:, :3] / 255)
    picture = shown.picture((160, 120), 1)
    assert picture.shape == (120, 160, 3)
    strip = picture[-legend_height((160, 120)) :].astype(int)
    assert np.ptp(strip, axis=-1).max() > 60  # colours in the legend


def test_handles_are_painted_where_they_were_at_rest(ball):
    shown = portrait(ball, iw.Affine(translation=(0, 0, 9.0)), HANDLES)
    colors = shown.color(shown.places)
    assert len(np.unique(colors, axis=0)) == 3
    np.testing.assert_array_equal(shown.places, ball.vertices)


def test_the_handles_error_is_their_distance_from_their_targets(ball):
    shown = portrait(ball, iw.Affine(translation=(0, 0, 0.5)), HANDLES, "error")
    assert shown.scale.high == pytest.approx(0.5)
    below = ball.vertices[:, 2] < -0.4
    np.testing.assert_array_equal(
        shown.color[below], np.tile(shown.scale.table[-1, :3] / 255, (below.sum(), 1))
    )


@pytest.mark.parametrize("outward", [(0, 0, 1.0), (0.6, 0.0, -0.8)])
def test_a_half_is_closed_and_has_the_cap_s_volume(ball, outward):
    half = half_of(ball, np.array(outward), 0.25)
    report = iw.check(half, referees=())
    assert report.watertight
    assert (half.vertices @ outward).max() == pytest.approx(0.25)
    inside = np.pi * (2 + 3 * 0.25 - 0.25**3) / 3
    assert half.volume == pytest.approx(inside, rel=0.02)
    other = half_of(ball, np.array(outward), 0.25, below=False)
    assert half.volume + other.volume == pytest.approx(ball.volume)


def test_a_cut_shows_the_field_and_the_skin_the_quantity(ball):
    stretch = iw.Affine(np.diag([1.0, 1.0, 2.0]))
    shown = cut_portrait(ball, fields.sphere(1), ("y", 0.1), stretch, quantity="stretch")
    assert np.dot(shown.direction, (0, -1, 0)) > 0.8  # it faces the cut
    points = np.array([[0.0, 0.1, 0.0], [0.2, 0.1, 1.2], [0.0, 0.6, 0.8]])
    middle, aside, skin = shown.color(points)
    assert middle[2] > middle[0]  # blue
    assert middle.sum() < aside.sum()  # darkest in the middle
    np.testing.assert_array_equal(skin, shown.scale(2.0)[:3] / 255)
    assert shown.picture((64, 48), 1).shape == (48, 64, 3)


def test_a_cut_at_rest_is_clay_with_lines(ball):
    shown = cut_portrait(ball, fields.sphere(1), ("z", 0.0))
    np.testing.assert_array_equal(shown.color(np.array([[0, 0, -1.0]])), [CLAY])
    line = shown.color(np.stack([np.linspace(0, 0.99, 400), *np.zeros((2, 400))], axis=1))
    # Ink comes and goes about ten times on the way from the middle to the surface.
    dark = np.diff((line.sum(axis=1) < line.sum(axis=1).mean()).astype(int))
    assert 8 < np.count_nonzero(np.diff(np.sign(np.diff(line[:, 2])))) < 80
    assert np.count_nonzero(dark) > 0


def test_a_turntable_goes_from_the_portrait_s_side(ball):
    from implicit_warp.films import Look

    shown = cut_portrait(ball, fields.sphere(1), ("x", 0.0))
    film = shown.turntable(Look((64, 48), 0.4, 10, supersampling=1))
    first, _, opposite, _ = list(film)
    blue = [np.count_nonzero(f[..., 2].astype(int) - f[..., 0] > 25) for f in (first, opposite)]
    assert blue[0] > 10 * max(blue[1], 1)


def test_bad_input_is_refused(ball):
    with pytest.raises(iw.InputError, match="nothing is deformed"):
        portrait(ball, quantity="det")
    with pytest.raises(iw.InputError, match="distance from the handles' targets"):
        portrait(ball, iw.Affine(), quantity="error")
    with pytest.raises(iw.InputError, match="does not cut the shape"):
        cut_portrait(ball, fields.sphere(1), ("x", 3.0))
    open_ball = ball.copy()
    open_ball.update_faces(np.arange(len(ball.faces)) > 3)
    with pytest.raises(iw.InputError, match="no solid that can be cut"):
        half_of(open_ball, np.array([0, 0, 1.0]), 0.0)
