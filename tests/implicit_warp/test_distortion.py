"""Distortion against torch in float64, finite differences and closed forms; colours."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from skimage.color import deltaE_ciede2000, rgb2lab

import fields
import implicit_warp as iw
from implicit_warp.color_scales import KINDS, MISSING, color_scale
from implicit_warp.distortion import QUANTITIES, handle_distance, measure_distortion
from tests.implicit_warp.registered_maps import BUILDERS, random_warp


@pytest.fixture
def points(rng):
    return rng.uniform(-0.8, 0.8, (300, 3))


@pytest.mark.parametrize("kind", ["warp", "net cubic", "inverse", "composition", "affine", "bend"])
def test_all_quantities_agree_with_torch(kind, points, seed):
    map_ = BUILDERS[kind](seed)
    found = measure_distortion(map_, points)
    with iw.back_end("torch"), torch.no_grad():
        image, jacobian = map_.call_and_jacobian(torch.from_numpy(points))
        gram = jacobian.mT @ jacobian
        energy = (gram - torch.eye(3)).square().sum((-1, -2))
        stretches = torch.linalg.svdvals(jacobian)
        determinant = torch.linalg.det(jacobian)
    np.testing.assert_allclose(found.image, image, atol=1e-10)
    np.testing.assert_allclose(found.stretches, stretches, rtol=1e-8)
    np.testing.assert_allclose(found.determinant, determinant, rtol=1e-8)
    np.testing.assert_allclose(found.energy, energy, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.ratio, stretches[:, 0] / stretches[:, 2], rtol=1e-8)
    assert (found.determinant > 0).all()


def test_determinants_are_the_growth_of_small_tetrahedra(points):
    map_, step = random_warp(3), 1e-6
    found = measure_distortion(map_, points)
    moved = map_(points[:, None] + step * np.concatenate([np.zeros((1, 3)), np.eye(3)]))
    grown = np.linalg.det(moved[:, 1:] - moved[:, :1]) / step**3
    # A few tetrahedra straddle a crease of the map.
    agree = np.isclose(grown, found.determinant, rtol=1e-5)
    assert agree.mean() > 0.98


def test_blocks_change_nothing(points, monkeypatch):
    map_ = random_warp(4)
    whole = measure_distortion(map_, points)
    monkeypatch.setattr("implicit_warp.distortion.BLOCK", 7)
    parts = measure_distortion(map_, points)
    for name in QUANTITIES:
        np.testing.assert_array_equal(whole.quantity(name), parts.quantity(name))


def test_tiny_singular_values_keep_their_digits():
    turn, other = (iw.rigid_motion(((1, 2, 3), d)).matrix[:, :3].numpy() for d in (40, 77))
    linear = turn @ np.diag([1e3, 1.0, 1e-4]) @ other
    found = measure_distortion(iw.Affine(linear), np.zeros((1, 3)))
    np.testing.assert_allclose(found.stretches[0], [1e3, 1.0, 1e-4], rtol=1e-8)


def test_rigid_motions_do_not_distort(points):
    found = measure_distortion(iw.rigid_motion(("z", 50), (1, 2, 3)), points)
    assert np.abs(found.stretches - 1).max() < 1e-12
    assert found.energy.max() < 1e-24
    assert np.abs(found.determinant - 1).max() < 1e-12


def test_handle_distance_is_measured_where_a_handle_selects():
    handles = [
        iw.hold(fields.below(-0.5)),
        iw.move(fields.above(0.5), translate=(0, 0, 1.0)),
    ]
    points = np.array([[0.1, 0, -0.6], [0, 0, 0], [0, 0.2, 0.7]])
    distance, handle = handle_distance(iw.Affine(translation=(0, 0, 0.75)), handles, points)
    assert handle.tolist() == [0, -1, 1]
    np.testing.assert_allclose(distance, [0.75, np.nan, 0.25])


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: measure_distortion(3, np.zeros((2, 3))), "not a map"),
        (lambda: measure_distortion(iw.Affine(), np.zeros(3)), r"not of shape \(n, 3\)"),
        (lambda: measure_distortion(iw.Affine(), np.full((2, 3), np.nan)), "NaN or infinite"),
        (lambda: measure_distortion(iw.Affine(), np.zeros((1, 3))).quantity("x"), "no such"),
        (lambda: color_scale("hue", [1]), "no such quantity"),
        (lambda: color_scale("det", low=2.0), "from below 1 to above 1"),
        (lambda: color_scale("energy", low=2.0, high=1.0), "not a range"),
        (lambda: color_scale("energy", high=np.nan), "must be finite"),
    ],
)
def test_bad_input_is_refused(call, words):
    with pytest.raises(iw.InputError, match=words):
        call()


def test_every_quantity_has_a_scale():
    assert set(QUANTITIES) | {"error"} == set(KINDS)


@pytest.mark.parametrize("name", ["det", "stretch", "squeeze"])
def test_factors_are_centred_at_one_on_a_logarithmic_scale(name):
    scale = color_scale(name, [0.9, 1.0, 2.95])
    assert (scale.low, scale.high) == (pytest.approx(1 / 3.0), 3.0)
    np.testing.assert_allclose(scale.position([0.5, 1.0, 2.0]).sum(), 1.5)
    assert scale.position(1.0) == pytest.approx(0.5)
    neutral = scale(1.0)[:3].astype(int)
    assert np.ptp(neutral) < 10
    assert neutral.min() > 200


def test_ranges_leave_out_slivers_but_cover_the_rest(rng):
    energy = np.append(rng.uniform(0, 0.2, 10_000), [1e6, np.nan, np.inf])
    scale = color_scale("energy", energy)
    assert scale.low == 0
    assert 0.19 < scale.high <= 0.21


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("values", [[], [1.0], [0.0, 0.0], [1e-9, 3e5]])
def test_any_values_give_a_usable_scale(name, values):
    scale = color_scale(name, values)
    assert scale.low < scale.high
    ticks = scale.ticks()
    assert 2 <= len(ticks) <= 5
    assert all(0 <= at <= 1 for at, _ in ticks)
    assert len({text for _, text in ticks}) == len(ticks)


def test_ticks_stand_where_their_text_says():
    scale = color_scale("det", low=0.25)
    for at, text in scale.ticks():
        assert scale.position(float(text)) == at


def test_colours_of_arrays_and_of_missing_values():
    scale = color_scale("energy", high=1.0)
    rgba = scale([[0.0, 1.0], [np.nan, 5.0]])
    assert (rgba.shape, rgba.dtype) == ((2, 2, 4), np.uint8)
    assert tuple(rgba[1, 0]) == MISSING
    np.testing.assert_array_equal(rgba[0, 1], rgba[1, 1])


def test_bars_run_along_their_longer_side():
    scale = color_scale("energy", high=1.0)
    np.testing.assert_array_equal(scale.bar(256, 3)[1], scale.table)
    np.testing.assert_array_equal(scale.bar(3, 256)[:, 1], scale.table[::-1])


@pytest.mark.parametrize("name", ["det", "energy"])
def test_equal_steps_look_about_equal(name):
    """Judged by CIEDE2000, another measure than the one the colours were made with."""
    lab = rgb2lab(color_scale(name, [2.0]).table[None, :, :3] / 255)[0]
    step = deltaE_ciede2000(lab[:-8], lab[8:])
    # It sees about twice as much in a step next to grey as OKLab does.
    assert step.max() < 3.5 * step.min()
    lightness = lab[:, 0] if name == "energy" else lab[128:, 0]
    assert (np.diff(lightness) < 0.3).all()
    assert lightness[0] - lightness[-1] > 60
