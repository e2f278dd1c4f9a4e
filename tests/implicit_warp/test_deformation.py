"""Carrying points, fields and meshes forward."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh

import fields as sdf
import implicit_warp as iw
from implicit_warp.errors import InputError
from tests.implicit_warp.registered_maps import random_net, random_warp

SHAPE = sdf.union(sdf.sphere(0.5), sdf.box(0.6).translate((0.3, 0, 0.1)), smooth=0.1)


@pytest.fixture
def warp(seed) -> iw.Warp:
    return random_warp(seed, spread=0.5)


def test_a_deformed_field_takes_its_values_along(warp, rng):
    x = rng.uniform(-1, 1, (500, 3))
    warped = iw.deform(SHAPE, warp)
    np.testing.assert_allclose(warped(warp(x)), SHAPE(x), rtol=0, atol=1e-10)


def test_a_deformed_field_says_what_it_knows(warp, rng):
    warped = iw.deform(SHAPE, warp)
    assert not warped.exact
    assert warped.lipschitz == pytest.approx(SHAPE.lipschitz * warp.lipschitz[1])
    x = torch.tensor(rng.uniform(-1, 1, (50_000, 3)))
    low, high = torch.tensor(warped.bounds)
    image = warp(x[SHAPE(x) <= 0])
    assert ((image >= low) & (image <= high)).all()
    # The box is not wasteful either: at most a tenth of its size on any side.
    slack = torch.maximum(image.amin(0) - low, high - image.amax(0))
    assert (slack < 0.1 * (high - low) + 0.05).all()


def test_bounds_hold_for_a_field_without_a_lipschitz_tag(warp):
    low, high = SHAPE.bounds
    opaque = sdf.from_function(lambda p: SHAPE.evaluate(p), bounds=SHAPE.bounds)
    assert opaque.lipschitz is None
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    box = iw.deform(opaque, warp).bounds
    image = warp(corners)
    assert (image >= box[0]).all()
    assert (image <= box[1]).all()


def test_gradients_flow_through_a_deformed_field(seed):
    net = random_net(seed, layers=2, resolution=5)
    x = torch.tensor([[0.3, 0.2, 0.1], [-0.4, 0.1, 0.3]], dtype=torch.float64)
    values = iw.deform(SHAPE, net).evaluate(x.requires_grad_())
    into_points, into_net = torch.autograd.grad(values.sum(), (x, net.theta_weights))
    backwards, jacobian = net.inv.call_and_jacobian(x.detach())
    expected = SHAPE.gradient(backwards)[:, None] @ jacobian
    torch.testing.assert_close(into_points, expected[:, 0], rtol=1e-8, atol=1e-10)
    assert into_net.abs().max() > 0


def test_a_mesh_keeps_its_faces_and_moves_its_vertices(warp):
    ball = trimesh.creation.icosphere(2, 0.5)
    moved = iw.deform(ball, warp)
    np.testing.assert_array_equal(moved.faces, ball.faces)
    np.testing.assert_array_equal(moved.vertices, warp(ball.vertices.view(np.ndarray)))
    assert ball.bounds[1].max() == pytest.approx(0.5)


def test_points_of_every_kind(warp):
    points = [[0.0, 0.1, 0.2]]
    expected = warp(torch.tensor(points, dtype=torch.float64))
    assert torch.equal(iw.deform(torch.tensor(points, dtype=torch.float64), warp), expected)
    np.testing.assert_array_equal(iw.deform(np.array(points), warp), expected.numpy())
    np.testing.assert_array_equal(iw.deform(points, warp), expected.numpy())


def test_the_surface_of_a_deformed_field_is_the_image_of_the_surface(warp):
    mesh = iw.extract(iw.deform(SHAPE, warp), 40)
    iw.check(mesh, referees=()).raise_if_bad()
    step = np.ptp(mesh.bounds, axis=0).max() / 40
    at_rest = np.abs(SHAPE(warp.inv(mesh.vertices.view(np.ndarray))))
    # A vertex lies within a voxel of the surface; f^-1 stretches that by its local Jacobian.
    stretch = np.linalg.norm(warp.inv.jacobian(mesh.vertices.view(np.ndarray)), 2, axis=(1, 2))
    assert (at_rest <= step * stretch * 1.5).all()
    assert np.median(at_rest) < 0.05 * step


@pytest.mark.parametrize(
    ("thing", "map_", "words"),
    [
        (SHAPE, SHAPE, "not a map"),
        ("part.stl", "identity", "neither a field, a mesh nor points"),
        (np.array([[0.0, np.nan, 0.0]]), "identity", "NaN or infinite"),
    ],
)
def test_bad_arguments_are_named(thing, map_, words):
    with pytest.raises(InputError) as caught:
        iw.deform(thing, iw.Affine() if map_ == "identity" else map_)
    assert words in str(caught.value)


def test_gradients_of_a_warped_field_take_the_maps_own_jacobians():
    net = iw.TutteNet(3, resolution=5)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter += 0.3 * torch.randn(parameter.shape, dtype=parameter.dtype)
    field = iw.deform(sdf.box((1.0, 0.7, 0.5)), net.freeze())
    points = torch.rand(2000, 3, dtype=torch.float64) * 2 - 1
    value, gradient = field.value_and_gradient(points)
    with sdf.back_end("torch"):
        expected_value, expected = field.value_and_gradient(points)
    assert torch.allclose(value, expected_value, rtol=0, atol=1e-12)
    # On a crease either side's gradient is right; hardly any random point is that close to one.
    same = (gradient - expected).norm(dim=-1) < 1e-9
    assert same.double().mean() > 0.999
