"""Layers as meshes, segments and pictures."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

import implicit_warp as iw
from implicit_warp.layer_pictures import layer_meshes, layer_picture, layer_segments, normal_text
from tests.implicit_warp.registered_maps import random_net, random_warp


@pytest.fixture(scope="module")
def warp():
    return random_warp(5, layers=6, resolution=5)


def test_layers_tile_the_square_without_folds(warp):
    for layer in layer_meshes(warp):
        assert (layer.growth > 0).all()
        # The boundary's polygon cuts the square's corners, so it is smaller.
        loop = layer.image[layer.boundary]
        ahead = np.roll(loop, -1, axis=0)
        area = 0.5 * np.sum(loop[:, 0] * ahead[:, 1] - ahead[:, 0] * loop[:, 1])
        assert layer.growth.mean() * 4 == pytest.approx(area)
        assert len(layer.edges) == len(layer.triangles) * 3 // 2 + len(layer.boundary) // 2
        cones = layer.cones()
        np.testing.assert_array_equal(cones[:, 0], loop)


def test_a_layer_in_space_lies_in_its_plane_at_rest(warp):
    for layer in layer_meshes(warp, [1, 4]):
        segments = layer_segments(warp, layer.number)
        before = warp.before.numpy()
        local = (segments @ before[:, :3].T + before[:, 3]) @ layer.axes
        np.testing.assert_allclose(local[..., 2], 0, atol=1e-12)
        np.testing.assert_allclose(local[..., :2], layer.segments(), atol=1e-12)


def test_the_picture_has_a_panel_a_layer_and_one_at_rest(warp, tmp_path):
    path = tmp_path / "layers.png"
    figure = layer_picture(warp, path)
    titles = [ax.get_title() for ax in figure.axes if ax.get_title()]
    assert titles[0] == "at rest"
    assert [title.split(" ")[0] for title in titles[1:]] == list("123456")
    with Image.open(path) as image:
        assert image.width > 800
        assert np.asarray(image).std() > 10
    two = layer_picture(warp, layers=[2, 6], columns=3)
    assert [ax.get_title()[0] for ax in two.axes if ax.get_title()] == ["a", "2", "6"]


@pytest.mark.parametrize(
    ("normal", "text"),
    [
        ((0, 0, 1), "z"),
        ((0, -1, 0), "\u2212y"),
        (np.array([1, -1, 1]) / 3**0.5, "(1, \u22121, 1)"),
        ((0.6, 0, -0.8), "(0.60, 0.00, \u22120.80)"),
    ],
)
def test_normals_are_said_shortly(normal, text):
    assert normal_text(np.array(normal, dtype=np.float64)) == text


def test_bad_input_is_refused(warp, tmp_path):
    with pytest.raises(iw.InputError, match="1 to 6"):
        layer_meshes(warp, [7])
    with pytest.raises(iw.InputError, match="only warps have layers"):
        layer_picture(random_net(1))
    with pytest.raises(iw.InputError, match="none to show"):
        layer_picture(warp, layers=[])
    with pytest.raises(iw.InputError, match="path"):
        layer_picture(warp, tmp_path / "layers.txt")
