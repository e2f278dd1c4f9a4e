"""Twist, taper and bend against their formulas, and the bend's domain."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from implicit_warp.axial import Taper, Twist
from implicit_warp.bend import Bend
from implicit_warp.certificate import certify
from implicit_warp.errors import InputError
from tests.implicit_warp.registered_maps import random_axis


def test_a_twist_turns_planes_about_its_axis(rng):
    x = rng.normal(size=(50, 3))
    for degrees, between in ((30.0, None), (-200.0, (-0.5, 0.25))):
        y = Twist(degrees, "z", (1.0, 2.0, 0.5), between)(x)
        z = x[:, 2] - 0.5
        angle = degrees * (z if between is None else np.clip(z, *between) - between[0])
        turn = Rotation.from_euler("z", angle[:, None], degrees=True)
        origin = np.array([1.0, 2.0, 0.0])
        np.testing.assert_allclose(y, turn.apply(x - origin) + origin, atol=1e-14)


def test_a_twist_keeps_volume_and_its_inverse_is_the_twist_back(rng):
    x = rng.normal(size=(50, 3))
    axis = random_axis(3)
    twist = Twist(77.0, **axis)
    np.testing.assert_allclose(np.linalg.det(twist.jacobian(x)), 1.0, atol=1e-12)
    np.testing.assert_allclose(twist.inv(x), Twist(-77.0, **axis)(x), atol=1e-14)


def test_a_taper_scales_across_its_axis(rng):
    x = rng.normal(size=(50, 3))
    y = Taper((2.0, 0.5), "y", (0.0, 1.0, 0.0), (-1.0, 2.0))(x)
    scale = np.interp(x[:, 1] - 1.0, [-1.0, 2.0], [2.0, 0.5])
    expected = np.stack([scale * x[:, 0], x[:, 1], scale * x[:, 2]], 1)
    np.testing.assert_allclose(y, expected, atol=1e-14)


def test_a_bend_by_a_quarter_turn_puts_the_axis_on_an_arc():
    bend = Bend(90.0, "z", between=(0.0, math.pi / 2), towards="x")  # radius 1
    image = bend(np.array([[0, 0, -1.0], [0, 0, 0], [0, 0, math.pi / 4], [0, 0, math.pi / 2],
                           [0, 0, math.pi / 2 + 3], [0.5, 7, math.pi / 2]]))  # fmt: skip
    half = math.sqrt(0.5)
    expected = [[0, 0, -1], [0, 0, 0], [1 - half, 0, half], [1, 0, 1], [4, 0, 1], [1, 7, 0.5]]
    np.testing.assert_allclose(image, expected, atol=1e-15)
    # A negative angle leans the other way.
    away = Bend(-90.0, "z", between=(0.0, math.pi / 2), towards="x")
    np.testing.assert_allclose(away([[0, 0, math.pi / 2]]), [[-1, 0, 1]], atol=1e-15)


@pytest.mark.parametrize("degrees", [1e-6, -40.0, 90.0, 179.0, 181.0, -270.0, 359.0])
def test_a_bend_is_injective_on_its_domain(degrees, rng):
    """Round trips from all over the domain, whose inverse has to name the right piece."""
    bend = Bend(degrees, **random_axis(5), between=(-0.4, 0.9))
    reach = 2.0 + 1.0 / bend._curvature
    x = rng.uniform(-reach, reach, (4000, 3))
    x = x[bend.contains(x)]
    assert len(x) > 200
    # Within rounding of the centre line and of the seams the pieces cannot be told apart.
    y = bend(x)
    inside = bend.image_contains(y)
    assert inside.mean() > 0.999
    error = np.linalg.norm(bend.inv(y[inside]) - x[inside], axis=1)
    stretch = np.linalg.norm(bend.inv.jacobian(y[inside]), 2, axis=(-2, -1))
    assert (error <= 1e-14 * (1.0 + reach) * (10.0 + stretch)).all()


@pytest.mark.parametrize("degrees", [90.0, 181.0, 300.0])
def test_images_outside_of_the_bend_are_told_apart(degrees, rng):
    bend = Bend(degrees, between=(0.0, 2.0))
    y = rng.uniform(-4, 4, (2000, 3))
    inside = bend.image_contains(y)
    # Up to half a turn a quadrant of directions stays free; beyond, the straight ends meet.
    assert (0.1 < inside.mean() < 0.9) if degrees < 180.0 else inside.all()
    x = bend.inv(y[inside])
    np.testing.assert_allclose(bend(x[bend.contains(x)]), y[inside][bend.contains(x)], atol=1e-12)
    assert bend.contains(x).mean() > 0.99
    if not inside.all():
        with pytest.raises(InputError, match="no images under the bend"):
            bend.inv(y)


def test_points_beyond_the_centre_line_are_refused():
    bend = Bend(90.0, "z", between=(0.0, math.pi / 2), towards="x")
    with pytest.raises(InputError, match=r"1 of 2 rows, the first is row 1.*outside"):
        bend([[0.9, 0.0, 0.0], [1.1, 0.0, 0.0]])
    strong = Bend(300.0, "z", between=(0.0, 1.0), towards="x")
    strong([[0.0, 0.0, -0.05]])
    with pytest.raises(InputError, match="outside of the bend's domain"):
        strong([[0.0, 0.0, -5.0]])  # its straight end would run into the other one


def test_a_bend_is_certified_where_it_is_injective_only():
    bend = Bend(90.0, "z", between=(0.0, math.pi / 2), towards="x")
    assert not certify(bend).proved
    assert "one side of its centre line" in str(certify(bend))
    good = [[-1, -1, -1], [0.9, 1, 3]]
    certificate = certify(bend, good)
    assert certificate.proved
    assert certificate.region == tuple(map(tuple, np.array(good, dtype=float).tolist()))
    assert certificate.lipschitz[0] == pytest.approx(2.0)
    beyond = certify(bend, [[-1, -1, -1], [1.1, 1, 3]])
    assert str(beyond) == "no certificate: the box is not within the bend's domain"
    # An image box in the open quadrant that nothing is bent to.
    assert not certify(bend.inv, [[1.5, -1, -1], [2, 1, 0.5]]).proved
    assert certify(bend.inv, [[-1, -1, -1], [0.5, 1, 0.5]]).proved
    assert not certify(bend.inv).proved


def test_boxes_in_the_domain_are_certified_and_others_are_not(rng):
    """The certificate's answer is that of the box's corners, but within rounding of the edge."""
    for degrees in (100.0, 250.0):
        bend = Bend(degrees, **random_axis(8), between=(-0.5, 0.5))
        low = rng.uniform(-1.5, 1.5, (300, 3))
        boxes = np.stack([low, low + rng.uniform(0.05, 0.5, (300, 3))], 1)
        corners = boxes[:, np.indices((2, 2, 2)).reshape(3, 8), np.arange(3)[:, None]]
        inside = [bend.contains(c.T).all() for c in corners]
        assert [certify(bend, box).proved for box in boxes] == inside
        assert 30 < sum(inside) < 270
        for box in boxes[np.logical_not(inside)][:3]:
            with pytest.raises(InputError, match="box 0 is not within the bend's domain"):
                bend.lipschitz_on(box[None])
        # No box of images is accepted that holds a point without a preimage.
        for box in boxes:
            if certify(bend.inv, box).proved:
                assert bend.image_contains(rng.uniform(*box, (50, 3))).all()


def test_global_constants_exist_only_where_the_stretch_is_bounded():
    assert Twist(10.0).lipschitz == (None, None)
    assert Twist(0.0).lipschitz == pytest.approx((1.0, 1.0))
    assert Taper((1.0, 2.0)).lipschitz == (None, None)
    assert Taper((0.5, 0.5)).lipschitz == pytest.approx((1.0, 2.0))
    assert Bend(90.0).lipschitz == (None, None)


def test_bounds_on_boxes_are_attained(rng):
    """Twist and taper: the norm at the farthest corner. Bend: at the outside of the arc."""
    box = np.array([[[0.5, 0.2, 0.1], [0.8, 0.3, 0.2]]])
    corner = np.array([[0.8, 0.3, 0.2]])
    for m in (Twist(70.0), Taper((1.0, 1.5)), Bend(80.0, towards=(-1, 0, 0))):
        norm = np.linalg.norm(m.jacobian(corner), 2, axis=(-2, -1))
        np.testing.assert_allclose(m.lipschitz_on(box), norm, rtol=1e-12)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Twist(math.nan), "degrees"),
        (lambda: Twist(10.0, "w"), "axis = 'w'"),
        (lambda: Twist(10.0, between=(1.0, 1.0)), "an empty range"),
        (lambda: Twist(10.0, between=3.0), "not a pair"),
        (lambda: Twist(10.0, origin=(0.0, 1.0)), "not three numbers"),
        (lambda: Taper((1.0, 0.0)), r"factors\[1\]"),
        (lambda: Taper((1.0, -2.0)), r"factors\[1\]"),
        (lambda: Taper(2.0), "not a pair"),
        (lambda: Taper((1.0, 2.0), between=None), "not a pair"),
        (lambda: Bend(0.0), "more than nothing"),
        (lambda: Bend(360.0), "less than a full turn"),
        (lambda: Bend(90.0, between=None), "needs a range"),
        (lambda: Bend(90.0, "z", towards=(0, 0, 2)), "along the axis"),
    ],
)
def test_bad_arguments_are_named(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_gradients_reach_the_points(seed):
    for m in (Twist(50.0, between=(-0.3, 0.3)), Taper((1.0, 0.5)), Bend(60.0)):
        x = 0.4 * torch.rand(
            5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)
        )
        assert torch.autograd.gradcheck(m, (x.requires_grad_(),))
        assert torch.autograd.gradcheck(m.inv, (m(x).detach().requires_grad_(),))
