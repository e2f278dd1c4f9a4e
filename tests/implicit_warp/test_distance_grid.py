"""Re-distancing against distances known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
import implicit_warp as iw
from implicit_warp.errors import InputError

POLYNOMIAL = sdf.from_function(
    lambda p: (p * p).sum(-1) ** 2 - 1, bounds=((-1,) * 3, (1,) * 3), name="polynomial"
)
"""The unit ball's surface, and values that are no distances: slope 4 there, 0 in the middle."""


def _around(rng, count, least):
    """Points of the box [-1, 1]^3 that keep away from the middle, where distances have a peak."""
    points = rng.uniform(-1, 1, (count, 3))
    return points[np.linalg.norm(points, axis=1) > least]


@pytest.mark.parametrize("kind", ["linear", "cubic"])
def test_errors_are_of_second_order(kind, rng):
    points = _around(rng, 4_000, 0.4)
    truth = np.linalg.norm(points, axis=1) - 1
    errors = []
    for resolution in (12, 24, 48):
        field, report = iw.redistance_report(POLYNOMIAL, resolution, interpolation=kind)
        error = np.abs(field(points) - truth)
        errors.append((error.max(), error.mean(), report.surface_error))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # Lattices of different phase against the sphere shake single ratios.
    assert (orders > 1.4).all()
    assert (np.log2(np.array(errors[0]) / errors[-1]) / 2 > 1.7).all()


def test_the_gradient_becomes_one(rng):
    points = _around(rng, 2_000, 0.4)
    before = np.linalg.norm(POLYNOMIAL.gradient(points), axis=1)
    after = np.linalg.norm(iw.redistance(POLYNOMIAL, 40).gradient(points), axis=1)
    assert np.ptp(before) > 4
    np.testing.assert_allclose(after, 1, atol=0.1)


def test_a_warped_field_is_a_distance_again(rng):
    """A ball bent out of shape by shear has an ellipsoid's distance; a turned one the ball's."""
    ball = sdf.sphere(0.6, (0.5, 0, 0))
    turned = iw.deform(ball, iw.Twist(180, between=(-5, 5)))
    stretched = sdf.sphere(0.6, (0.5, 0, 0)).scale((1, 1, 2))
    for field in (turned, stretched):
        new, report = iw.redistance_report(field, 40)
        foot = new.gradient(points := rng.uniform(-0.5, 0.5, (1_000, 3)))
        landed = points - new(points)[:, None] * foot
        inside = (landed >= new.bounds[0]).all(axis=1) & (landed <= new.bounds[1]).all(axis=1)
        # A step of a distance along its gradient ends on the surface, of the old field too.
        assert np.median(np.abs(field(landed[inside]))) < report.spacing / 20
        assert not new.exact


def test_the_report_says_what_is_wrong(rng):
    field, report = iw.redistance_report(POLYNOMIAL, 24)
    assert report.shape == (29, 29, 29)
    assert report.spacing == pytest.approx(1 / 12)
    mesh = iw.extract(POLYNOMIAL, 24, dtype=torch.float64)
    assert report.faces == len(mesh.faces)
    directions = rng.normal(size=(20_000, 3))
    on_ball = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    seen = np.abs(field(on_ball)).max()
    assert seen < 1.5 * report.surface_error
    assert report.surface_error < 1.5 * seen
    assert report.distance_error_mean < report.distance_error < report.spacing
    assert repr(field) == "<redistanced on 29 x 29 x 29 samples>"


def test_a_band_cuts_distances_off(rng):
    points = rng.uniform(-1, 1, (3_000, 3))
    whole = iw.redistance(POLYNOMIAL, 32)
    cut, report = iw.redistance_report(POLYNOMIAL, 32, band=0.2)
    values = cut(points)
    assert np.abs(values).max() <= 0.2 + 1e-12
    near = np.abs(whole(points)) < 0.2 - 2 * report.spacing
    np.testing.assert_allclose(values[near], whole(points)[near], atol=1e-12)
    far = np.abs(whole(points)) > 0.2 + 2 * report.spacing
    np.testing.assert_allclose(values[far], 0.2 * np.sign(whole(points)[far]), atol=1e-12)
    assert report.surface_error < 0.01


def test_boxes_can_be_given():
    box = ((-1.5, -1.2, -1.2), (1.5, 1.2, 1.2))
    field, report = iw.redistance_report(POLYNOMIAL, 30, bounds=box)
    assert report.shape == (31, 25, 25)
    assert field([1.45, 0, 0]) == pytest.approx(0.45, abs=0.01)


def test_progress_ends_at_the_whole():
    calls = []
    iw.redistance(POLYNOMIAL, 16, progress=lambda done, of: calls.append((done, of)))
    assert calls[-1] == (21, 21)


@pytest.mark.parametrize("band", [0, -1.0, np.nan, np.inf, "wide"])
def test_bad_bands_are_named(band):
    with pytest.raises(InputError, match="not a positive distance"):
        iw.redistance(POLYNOMIAL, 16, band=band)


def test_what_cannot_be_extracted_cannot_be_redistanced():
    with pytest.raises(InputError, match="unbounded"):
        iw.redistance(sdf.below(0), 16)
    with pytest.raises(InputError, match="no surface"):
        iw.redistance(sdf.sphere(0.5, (-1, 0, 0)) & sdf.sphere(0.5, (1, 0, 0)), 16)
