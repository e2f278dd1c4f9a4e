"""One network for several shapes: spheres of three sizes, and what lies between them."""

from __future__ import annotations

import numpy as np
import pytest

import fields as sdf
from fields import FileFormatError, InputError, Siren

RADII = (0.5, 0.75, 1.0)
SPHERES = [sdf.sphere(radius) for radius in RADII]
SMALL = {"batch": 1536, "near_samples": 4_000, "box_samples": 4_000}


@pytest.fixture(scope="module")
def fitted():
    return sdf.fit_family(
        SPHERES, latent=4, architecture=Siren(32, 2, 5.0), steps=400, learning_rate=0.03, **SMALL
    )


def _radius(field):
    """Where the surface is along eight directions, by bisection: mean and spread."""
    directions = np.array(list(np.ndindex(2, 2, 2))) * 2.0 - 1
    directions /= np.sqrt(3)
    low, high = np.full(8, 0.01), np.full(8, 1.1)
    for _ in range(30):
        middle = (low + high) / 2
        inside = field(middle[:, None] * directions) < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    return low.mean(), np.ptp(low)


def test_each_shape_of_a_family_is_learned(fitted):
    family, report = fitted
    assert len(family) == 3
    assert report.status == "finished"
    for index, radius in enumerate(RADII):
        mean, spread = _radius(family.shape(index))
        assert mean == pytest.approx(radius, abs=0.02)
        assert spread < 0.06
        assert report.accuracies[index].near_error < 0.01


def test_shapes_between_two_of_a_family_are_between_them(fitted):
    family, _ = fitted
    radii = [_radius(family.between(0, 2, t))[0] for t in np.linspace(0, 1, 9)]
    assert (np.diff(radii) > 0).all()
    assert radii[0] == pytest.approx(RADII[0], abs=0.02)
    assert radii[-1] == pytest.approx(RADII[2], abs=0.02)
    for t in (0.25, 0.5, 0.75):  # and they are spheres
        assert _radius(family.between(0, 2, t))[1] < 0.1


def test_a_new_shape_is_encoded_by_its_nearest_latent(fitted):
    family, _ = fitted
    latent = family.encode(sdf.sphere(0.85))
    assert latent.shape == (4,)
    assert _radius(family.at(latent))[0] == pytest.approx(0.85, abs=0.03)
    np.testing.assert_array_equal(latent, family.encode(sdf.sphere(0.85)))


def test_a_member_is_a_field_like_any_other(fitted):
    family, _ = fitted
    member = family.shape(1)
    assert member.bounds.tolist() == family.box.tolist()
    assert (member - sdf.box(0.5))([0, 0, 0]) > 0
    assert "neural SIREN" in repr(member)


def test_members_are_the_decoder_with_a_latent_beside_every_layer(fitted, rng):
    """What `at` folds into the biases, computed as the formula says."""
    family, _ = fitted
    latent, points = family.latents[0], rng.uniform(-1, 1, (50, 3))
    network, box = family._network, family.box
    hidden = (points - box.mean(axis=0)) / (np.ptp(box, axis=0).max() / 2)
    for depth, (weight, bias, shift) in enumerate(
        zip(network.weights, network.biases, family._shifts, strict=True)
    ):
        hidden = hidden @ weight.double().numpy().T + bias.double().numpy()
        hidden = hidden + shift.double().numpy() @ latent
        if depth < len(network.weights) - 1:
            hidden = np.sin(5.0 * hidden)
    expected = hidden[:, 0] * np.ptp(box, axis=0).max() / 2
    np.testing.assert_allclose(family.shape(0)(points), expected, atol=1e-5)


def test_a_family_comes_back_bit_for_bit(fitted, tmp_path):
    family, _ = fitted
    path = tmp_path / "family.safetensors"
    family.save(path)
    loaded = sdf.Family.load(path)
    points = np.random.default_rng(0).uniform(-1, 1, (100, 3))
    np.testing.assert_array_equal(loaded.shape(2)(points), family.shape(2)(points))
    np.testing.assert_array_equal(loaded.latents, family.latents)
    assert repr(loaded) == "<Family of 3 shapes, latents of 4 numbers>"
    with pytest.raises(FileFormatError, match="it is a family"):
        sdf.load_neural(path)
    sdf.save_neural(family.shape(0), tmp_path / "member.safetensors")
    member = sdf.load_neural(tmp_path / "member.safetensors")
    np.testing.assert_array_equal(member(points), family.shape(0)(points))


def test_what_cannot_be_a_family_is_refused(fitted):
    family, _ = fitted
    with pytest.raises(InputError, match="two shapes or more"):
        sdf.fit_family([sdf.sphere(1)])
    with pytest.raises(InputError, match="learned by SIRENs"):
        sdf.fit_family(SPHERES, architecture=sdf.HashGrid())
    with pytest.raises(InputError, match="no bounds"):
        sdf.fit_family([sdf.sphere(1), sdf.cylinder(1)])
    with pytest.raises(InputError, match="whole number"):
        sdf.fit_family(SPHERES, latent=2.5)
    with pytest.raises(InputError, match="whole number from 0 to 2"):
        family.shape(3)
    with pytest.raises(InputError, match="4 finite numbers"):
        family.at([0.0, 1.0])
    with pytest.raises(InputError, match="4 finite numbers"):
        family.at([0.0, 1.0, np.nan, 0.0])
    with pytest.raises(InputError, match="beyond those of the family"):
        family.encode(sdf.sphere(3))
