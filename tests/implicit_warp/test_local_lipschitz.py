"""Bounds on boxes: never below what is sampled, and sharp where they can be."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from implicit_warp.bend import Bend
from implicit_warp.certificate import certify
from implicit_warp.errors import InputError
from implicit_warp.local_lipschitz import _apart
from implicit_warp.maps import Inverse, Map
from implicit_warp.matrix_norms import quick_norm, spectral_norm
from implicit_warp.warp import Warp
from tests.implicit_warp.registered_maps import (
    BUILDERS,
    random_affine,
    random_net,
    random_warp,
)

MAPS = pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS.keys())
SIZES = [1e-3, 1e-2, 0.1, 0.5, 1.0, 4.0]

ROUNDING = 1e-12
"""Relative: sampled values are rounded as evaluation rounds, bounds speak about the exact map."""


def boxes_about(centres: np.ndarray, size) -> np.ndarray:
    half = 0.5 * np.broadcast_to(size, centres.shape)
    return np.stack([centres - half, centres + half], 1)


def bounded(m: Map, boxes: np.ndarray) -> np.ndarray:
    """Those of the boxes on which a map is defined: all, but for bends."""
    original = m.inv if isinstance(m, Inverse) else m
    if not isinstance(original, Bend):
        return boxes
    return boxes[[certify(m, box).proved for box in boxes]]


def sampled(m: Map, boxes: np.ndarray, rng, count: int = 60):
    """Points (n, count, 3) of the boxes, corners among them, with images and Jacobian norms."""
    shares = rng.random((len(boxes), count, 3))
    shares[:, :8] = np.indices((2, 2, 2)).reshape(3, 8).T
    x = boxes[:, None, 0] + shares * (boxes[:, None, 1] - boxes[:, None, 0])
    y, jacobian = m.call_and_jacobian(x)
    return x, y, np.linalg.norm(jacobian, 2, axis=(-2, -1))


@MAPS
@pytest.mark.parametrize("size", SIZES)
def test_no_sample_exceeds_the_bounds(build, size, seed):
    rng = np.random.default_rng(seed)
    m = build(seed)
    for there in (m, m.inv):
        boxes = boxes_about(rng.uniform(-1.5, 1.5, (40, 3)), size * rng.uniform(0.2, 1.0, (40, 3)))
        boxes = bounded(there, boxes)
        assert len(boxes) > 5
        bounds = there.local_bounds(boxes)
        x, y, norms = sampled(there, boxes, rng)
        assert (norms.max(1) <= bounds.lipschitz * (1.0 + ROUNDING)).all()
        # A difference quotient's rounding is that of the images over the distance.
        distance = np.linalg.norm(x[:, 1:] - x[:, :-1], axis=-1)
        moved = np.linalg.norm(y[:, 1:] - y[:, :-1], axis=-1)
        rounding = 1e-12 * (1.0 + np.abs(y).max((1, 2), keepdims=True)[..., 0])
        rounding = rounding * (1.0 + bounds.lipschitz[:, None])
        assert (moved <= bounds.lipschitz[:, None] * distance + rounding).all()
        assert (np.linalg.norm(y - bounds.centres[:, None], axis=-1)
                <= bounds.radii[:, None] + rounding).all()  # fmt: skip
        assert (y >= bounds.boxes[:, None, 0] - rounding[..., None]).all()
        assert (y <= bounds.boxes[:, None, 1] + rounding[..., None]).all()


@MAPS
def test_a_bound_never_exceeds_the_global_constant(build, seed):
    rng = np.random.default_rng(seed)
    m = build(seed)
    for there in (m, m.inv):
        if there.lipschitz[0] is not None:
            bounds = there.lipschitz_on(boxes_about(rng.uniform(-2, 2, (50, 3)), 4.0))
            # Compositions push boxes with their own rounding.
            assert (bounds <= there.lipschitz[0] * (1.0 + ROUNDING)).all()


@pytest.mark.parametrize("layers", [1, 24])
@pytest.mark.parametrize("inverse", [False, True])
def test_tiny_boxes_away_from_creases_give_the_norm_of_the_jacobian(layers, inverse, seed):
    rng = np.random.default_rng(seed)
    warp = random_warp(seed, layers=layers, resolution=7)
    m = warp.inv if inverse else warp
    boxes = boxes_about(rng.uniform(-1, 1, (500, 3)), 1e-9)
    norm = np.linalg.norm(m.jacobian(boxes.mean(1)), 2, axis=(-2, -1))
    equal = np.abs(m.lipschitz_on(boxes) / norm - 1.0) < 1e-9
    # A box of 1e-9 meets a crease of one of some dozens with that probability.
    assert equal.mean() > 0.99


def test_a_box_across_one_crease_gets_the_larger_side(seed):
    warp = random_net(seed, layers=1, resolution=3, frames="triplane").freeze()
    # The grid line x = 0, between the two triangles beside it; z is the normal.
    for at in ((0.0, 0.5), (0.0, -0.4)):
        centre = np.array([[*at, 0.0]])
        box = boxes_about(centre, 1e-3)
        beside = centre + np.array([[-1e-4, 0, 0], [1e-4, 0, 0]])
        sides = np.linalg.norm(warp.jacobian(beside), 2, axis=(-2, -1))
        (bound,) = warp.lipschitz_on(box)
        assert sides.max() <= bound <= sides.max() * (1.0 + ROUNDING)


def test_bounds_are_far_sharper_than_the_global_constant(seed):
    """Medians over random boxes for a warp of moderate parameters, as solves end with."""
    rng = np.random.default_rng(seed)
    warp = random_net(seed, layers=24, resolution=11, spread=0.1).freeze()
    for m in (warp, warp.inv):
        ratios = []
        for size in (0.01, 0.1):
            boxes = boxes_about(rng.uniform(-1, 1, (200, 3)), size)
            _, _, norms = sampled(m, boxes, rng)
            ratios.append(np.median(m.lipschitz_on(boxes) / norms.max(1)))
        _, _, norms = sampled(m, boxes_about(np.zeros((1, 3)), 2.0), rng, 2000)
        globally = m.lipschitz[0] / norms.max()
        assert globally > 20.0
        assert ratios[0] < 1.2
        assert ratios[1] < 4.0


def test_slivers_and_extreme_scales_keep_the_bounds(seed):
    rng = np.random.default_rng(seed)
    net = random_net(seed, layers=3, resolution=5)
    u = net.embeddings().detach()
    corner, side = net.mesh.triangles[20, 0], net.mesh.triangles[20, 1:].copy()
    middle = u[1, side].mean(0)
    u[1, corner] = middle + 1e-9 * (u[1, corner] - middle)
    for scale in (1.0, 1e-12, 1e12):
        before = torch.from_numpy(np.concatenate([np.eye(3) * scale, np.zeros((3, 1))], 1))
        warp = Warp(u, net.frames(), before)
        for m, unit in ((warp, 1.0 / scale), (warp.inv, 1.0)):
            for size in (1e-3, 0.3):
                boxes = boxes_about(rng.uniform(-1, 1, (100, 3)), size) * unit
                _, _, norms = sampled(m, boxes, rng)
                bounds = m.lipschitz_on(boxes)
                # The sampled norms suffer from the sliver's condition number of 1e9.
                assert (norms.max(1) <= bounds * (1.0 + 1e-6)).all()
                assert np.isfinite(bounds).all()


def test_distant_and_huge_boxes_are_bounded(seed):
    warp = random_warp(seed, resolution=6)
    rng = np.random.default_rng(seed)
    for m in (warp, warp.inv):
        for distance in (1e3, 1e9):
            boxes = boxes_about(distance * rng.normal(size=(50, 3)), 1e-3 * distance)
            bounds = m.local_bounds(boxes)
            _, y, norms = sampled(m, boxes, rng)
            assert (norms.max(1) <= bounds.lipschitz * (1.0 + ROUNDING)).all()
            assert (
                np.linalg.norm(y - bounds.centres[:, None], axis=-1) <= bounds.radii[:, None]
            ).all()
        overflowing = np.array([[[-1.5e308] * 3, [1.7e308] * 3], [[1e300] * 3, [1e308] * 3]])
        bounds = m.local_bounds(overflowing)
        assert (bounds.lipschitz <= m.lipschitz[0]).all()
        assert not np.isnan(bounds.boxes).any()
    assert warp.lipschitz_on(np.empty((0, 2, 3))).shape == (0,)


def test_a_point_is_a_box_of_size_zero(seed):
    warp = random_warp(seed)
    points = np.random.default_rng(seed).uniform(-1, 1, (50, 3))
    bounds = warp.local_bounds(np.stack([points, points], 1))
    np.testing.assert_allclose(bounds.centres, warp(points), rtol=0, atol=1e-12)
    assert (bounds.radii < 1e-11).all()
    np.testing.assert_array_equal(warp.enclose_image(np.stack([points, points], 1)), bounds.boxes)


def test_threads_and_order_do_not_change_the_bounds(seed):
    warp = random_warp(seed)
    boxes = boxes_about(np.random.default_rng(seed).uniform(-1, 1, (1000, 3)), 0.1)
    together = warp.lipschitz_on(boxes)
    one_by_one = np.concatenate([warp.lipschitz_on(box[None]) for box in boxes[::37]])
    np.testing.assert_array_equal(together[::37], one_by_one)


def test_spectral_norms_are_upper_bounds_and_tight(rng):
    matrices = rng.normal(size=(500, 3, 3)) * 10.0 ** rng.uniform(-3, 3, (500, 1, 3))
    matrices[::5] = np.linalg.qr(matrices[::5])[0]  # three equal singular values
    matrices[::7, 2] = matrices[::7, 1]
    matrices[::11] *= 1e-150
    for m in matrices:
        exact = np.linalg.svd(m, compute_uv=False)[0]
        assert exact * (1.0 - 1e-14) <= spectral_norm(m) <= exact * (1.0 + 1e-12)
        if exact > 1e-40:
            assert exact * (1.0 - 1e-14) <= quick_norm(m) <= exact * 3.0 ** (1 / 16) * (1 + 1e-12)
    assert spectral_norm(np.zeros((3, 3))) == 0.0
    assert spectral_norm(np.full((3, 3), np.inf)) == np.inf


def test_cells_are_apart_only_if_no_point_is_common(rng):
    """A hexagon spanned by three segments, widened along the axes, against sampled points."""
    apart = np.zeros(400, bool)
    for i in range(400):
        corners = rng.normal(size=(3, 2))
        (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
        if ax * by < ay * bx:
            corners[[1, 2]] = corners[[2, 1]]
        along = np.roll(corners, -2, 0) - np.roll(corners, -1, 0)
        sides = np.concatenate(
            [np.stack([-along[:, 1], along[:, 0]], 1), np.roll(corners, -1, 0)], 1
        )
        centre, g, wide = rng.normal(size=2), 0.3 * rng.normal(size=(3, 2)), rng.uniform(0, 0.5, 2)
        shares = np.sign(rng.normal(size=(2000, 3))) * rng.random((2000, 3)) ** 0.2
        points = centre + shares @ g + np.sign(rng.normal(size=(2000, 2))) * wide
        inside = [(points - side[2:]) @ side[:2] >= 0 for side in sides]
        apart[i] = _apart(*centre, g, *wide, sides)
        if apart[i]:
            assert not np.logical_and.reduce(inside).any()
        else:
            # No side of the triangle separates it from the hexagon's outermost point.
            for side in sides:
                reach = np.abs(g @ side[:2]).sum() + np.abs(side[:2]) @ wide
                assert (centre - side[2:]) @ side[:2] + reach >= -1e-12
    assert 50 < apart.sum() < 350


@pytest.mark.parametrize(
    ("boxes", "words"),
    [
        (np.zeros((2, 3)), "boxes = (2, 3)"),
        ("abc", "not numbers"),
        ([[[0, 0, 0], [np.inf, 1, 1]]], "not all corners are finite"),
        ([[[0, 0, 0], [1, 1, 1]], [[0, 2, 0], [1, 1, 1]]], "box 1 is above"),
    ],
)
def test_bad_boxes_are_named(boxes, words, seed):
    with pytest.raises(InputError) as caught:
        random_affine(seed).lipschitz_on(boxes)
    assert words in str(caught.value)


class Doubling(Map):
    """A map of a foreign kind."""

    def __init__(self, constants=(None, None)) -> None:
        self.constants = constants

    lipschitz = property(lambda self: self.constants)

    def _forward(self, points):
        return 2.0 * points

    def _inverse(self, points):
        return 0.5 * points

    def _forward_and_jacobian(self, points):
        return 2.0 * points, (2.0 * torch.eye(3).to(points)).expand(len(points), 3, 3)

    def _inverse_and_jacobian(self, points):
        return 0.5 * points, (0.5 * torch.eye(3).to(points)).expand(len(points), 3, 3)


def test_other_maps_are_bounded_by_their_constants_or_refuse():
    boxes = np.array([[[1.0, 2.0, 3.0], [2.0, 3.0, 4.0]]])
    known = Doubling((2.0, 0.5))
    assert known.lipschitz_on(boxes) == 2.0
    assert known.inv.lipschitz_on(boxes) == 0.5
    image = known.enclose_image(boxes)[0]
    assert (image[0] <= [2, 4, 6]).all()
    assert (image[1] >= [4, 6, 8]).all()
    with pytest.raises(InputError, match="knows no Lipschitz constant"):
        Doubling().lipschitz_on(boxes)
