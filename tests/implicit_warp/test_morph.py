"""Paths from the identity to a map: ends, continuity, and a proof at every amount."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import implicit_warp as iw
from implicit_warp.layers import compose_affine
from implicit_warp.morph import Morph, _description
from implicit_warp.square_mesh import square_mesh
from tests.implicit_warp.registered_maps import BUILDERS, random_net, random_warp, within

AMOUNTS = (0.0, 1e-3, 0.3, 0.5, 0.8, 0.999)


@pytest.fixture
def points(rng):
    return rng.uniform(-0.7, 0.7, (200, 3))


@pytest.mark.parametrize("kind", BUILDERS)
def test_paths_begin_at_rest_and_end_at_the_map(kind, points, seed):
    map_ = BUILDERS[kind](seed)
    path = Morph(map_)
    points = within(map_, torch.from_numpy(points)).numpy()
    np.testing.assert_allclose(path(0.0)(points), points, atol=1e-10)
    np.testing.assert_allclose(path(1.0)(points), map_(points), atol=1e-12)
    np.testing.assert_allclose(path(1 - 1e-9)(points), map_(points), atol=1e-6)


@pytest.mark.parametrize("kind", BUILDERS)
def test_every_amount_is_an_injective_map(kind, points, seed):
    map_ = BUILDERS[kind](seed)
    path = Morph(map_)
    points = within(map_, torch.from_numpy(points)).numpy()
    for amount in AMOUNTS:
        found = path(amount)
        if "bend" not in kind:  # bends are injective on their domains only
            assert iw.certify(found).proved
        image, jacobian = found.call_and_jacobian(points)
        assert (np.linalg.det(jacobian) > 0).all()
        np.testing.assert_allclose(found.inv(image), points, atol=1e-7)


@pytest.mark.parametrize("boundary", ["free", "fixed"])
def test_strong_layers_stay_proved_all_the_way(boundary, seed):
    """Parameters ten times the paper's: weights near their bounds, triangles near zero area."""
    net = iw.TutteNet(6, 9, "triplane", boundary)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(10 * torch.randn(parameter.shape, generator=generator).double())
    path = Morph(net)
    for amount in np.linspace(0, 1, 21):
        assert path(float(amount)).smallest_area > 0


def test_paths_have_no_jumps(points):
    path = Morph(random_warp(2))
    places = np.stack([path(float(a))(points) for a in np.linspace(0, 1, 101)])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1).max(axis=1)
    assert steps.max() < 3 * steps.mean()


def test_mean_value_weights_reproduce_the_embedding():
    mesh, net = square_mesh(7), random_net(4, layers=3, resolution=7)
    images = net.embeddings().detach()
    weights, angles, radii = _description(images.numpy(), mesh)
    assert (weights > 0).all()
    assert (np.diff(angles) > 0).all()
    np.testing.assert_allclose(radii, 0, atol=1e-14)
    source, target = mesh.edges.T.copy()
    mean = torch.zeros_like(images)
    mean.index_add_(
        1, torch.from_numpy(source), torch.from_numpy(weights)[..., None] * images[:, target]
    )
    inner = np.unique(source)
    np.testing.assert_allclose(mean[:, inner], images[:, inner], atol=1e-12)


def test_a_layer_at_rest_stays_at_rest(points):
    still = iw.TutteNet(3, 5).freeze()
    for amount in AMOUNTS:
        np.testing.assert_allclose(Morph(still)(amount)(points), points, atol=1e-13)


def test_a_turn_goes_about_the_centre_and_stretches_by_factors():
    far = iw.rigid_motion(("z", 120), pivot=(5, 0, 0)) @ iw.Affine(translation=(0, 0, 2.0))
    affine = iw.Affine(far.jacobian(np.zeros(3)) @ np.diag([4.0, 1, 1]), far(np.zeros(3)))
    half = Morph(affine, center=(5, 0, 0))(0.5)
    np.testing.assert_allclose(half(np.array([5.0, 0, 0])), 0.5 * affine([5.0, 0, 0]) + [2.5, 0, 0])
    np.testing.assert_allclose(
        np.linalg.svd(half.jacobian(np.zeros(3)))[1], [2.0, 1, 1], atol=1e-12
    )


def test_held_points_stay(points):
    """They move by as much as the map itself moves them, and not more on the way."""
    part = random_warp(6)
    turn = iw.rigid_motion(("x", 70), (0.2, 0.1, 0.4)).matrix
    after = compose_affine(turn, part.after)
    map_ = iw.Warp(part.embeddings, part.frames, part.before, after)
    held = points[:40] * 0.1
    settled = map_(held)
    for amount in (0.0, 0.2, 0.6, 0.97):
        wanted = held + amount * (settled - held)
        free, kept = Morph(map_)(amount), Morph(map_, held=held)(amount)
        assert isinstance(kept, iw.Warp)
        gap = np.linalg.norm(kept(held) - wanted, axis=1).mean()
        assert gap <= np.linalg.norm(free(held) - wanted, axis=1).mean() + 1e-12


def test_bad_input_is_refused():
    class Strange(iw.Map):
        _forward = _forward_and_jacobian = _inverse = _inverse_and_jacobian = None

    with pytest.raises(iw.InputError, match="no path to the identity"):
        Morph(Strange())
    with pytest.raises(iw.InputError, match="not in 0 to 1"):
        Morph(iw.Affine())(1.5)
    with pytest.raises(iw.InputError, match="center"):
        Morph(iw.Affine(), center=(0, 0))
