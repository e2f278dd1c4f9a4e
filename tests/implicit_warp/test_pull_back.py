"""Fields carried forward by maps in closed form: one expression, and the same as by the map."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
import implicit_warp as iw
from tests.implicit_warp.registered_maps import random_affine, random_axis, random_warp

SHAPE = sdf.union(sdf.sphere(0.5), sdf.box(0.6).translate((0.3, 0, 0.1)), chamfer=0.1)

MAPS = {
    "affine": lambda seed: random_affine(seed),
    "twist": lambda seed: iw.Twist(50.0, **random_axis(seed)),
    "twist on a range": lambda seed: iw.Twist(-90.0, "y", between=(-0.5, 0.7)),
    "taper": lambda seed: iw.Taper((1.2, 0.4), **random_axis(seed), between=(-1.0, 1.5)),
    "shear": lambda seed: iw.Shear(0.7, **random_axis(seed)),
    "shear on a range": lambda seed: iw.Shear(-0.4, "y", "z", between=(-0.5, 0.7)),
    "bend": lambda seed: iw.Bend(100.0, "z", (0.1, 0, 0), (-1.0, 1.2), (1.0, 1.0, 0.2)),
    "bend away": lambda seed: iw.Bend(-170.0, "x", between=(-2.0, 2.0), towards="y"),
    "bend to a ring": lambda seed: iw.Bend(300.0, "z", between=(-4.0, 4.0)),
    "composition": lambda seed: iw.Twist(30.0) @ iw.Shear(0.3) @ random_affine(seed),
}


@pytest.mark.parametrize("build", MAPS.values(), ids=MAPS.keys())
def test_the_field_operation_and_the_map_agree(build, seed, rng):
    """At the images of points, the deformed field has the field's values there."""
    m = build(seed)
    warped = iw.deform(SHAPE, m)
    assert all(instruction.kind != "call" for instruction in warped.tape.instructions)
    points = rng.uniform(*SHAPE.bounds, (2000, 3))
    values = SHAPE(points)
    # Cut off at half of the clearance by a bend, and confined to its image's region by others.
    points, values = points[values < 0.05], values[values < 0.05]
    np.testing.assert_allclose(warped(m(points)), values, atol=1e-13)
    assert (values < 0).sum() > 500


@pytest.mark.parametrize("build", MAPS.values(), ids=MAPS.keys())
def test_its_bounds_and_lipschitz_bound_hold(build, seed, rng):
    m = build(seed)
    warped = iw.deform(SHAPE, m)
    low, high = warped.bounds
    image = m(rng.uniform(*SHAPE.bounds, (20_000, 3)))
    # The images of the bounds are in the bounds, which for compositions are wider.
    image = image[SHAPE(m.inv(image)) <= 0]
    assert ((image >= low - 1e-12) & (image <= high + 1e-12)).all()
    everywhere = rng.uniform(low - 2, high + 2, (20_000, 3))
    gradient = np.linalg.norm(warped.gradient(everywhere), axis=1)
    assert gradient.max() <= warped.lipschitz * (1 + 1e-9)
    assert gradient.max() > 0.3 * warped.lipschitz


def test_a_map_between_others_that_have_no_closed_form_is_called(seed, rng):
    m = iw.Twist(30.0) @ random_warp(seed)
    warped = iw.deform(SHAPE, m)
    points = rng.uniform(*SHAPE.bounds, (100, 3))
    np.testing.assert_allclose(warped(m(points)), SHAPE(points), atol=1e-10)
    assert any(instruction.kind == "call" for instruction in warped.tape.instructions)


def test_an_unbounded_field_is_still_bent(rng):
    """By calling the map, which refuses points outside of its domain."""
    floor = sdf.below(0.3)
    bend = iw.Bend(90.0, towards="x")
    points = rng.uniform(-0.5, 0.5, (100, 3))
    np.testing.assert_allclose(iw.deform(floor, bend)(bend(points)), floor(points), atol=1e-13)


def test_gradients_reach_the_points(seed):
    for build in MAPS.values():
        warped = iw.deform(sdf.sphere(0.5), build(seed))
        middle = build(seed)(torch.tensor([[0.3, 0.2, 0.1], [0.2, -0.3, 0.2]], dtype=torch.float64))
        assert torch.autograd.gradcheck(warped.evaluate, (middle.detach().requires_grad_(),))


def test_a_shear_slides_planes(rng):
    x = rng.normal(size=(50, 3))
    y = iw.Shear(0.5, "z", "x", (0, 0, 1.0), between=(-0.5, 0.25))(x)
    slid = 0.5 * (np.clip(x[:, 2] - 1, -0.5, 0.25) + 0.5)
    np.testing.assert_allclose(y, x + slid[:, None] * np.array([1.0, 0, 0]), atol=1e-15)
    constant = iw.Shear(1.0).lipschitz[0]
    assert constant == pytest.approx((1 + np.sqrt(5)) / 2)
    assert np.linalg.norm(iw.Shear(1.0).jacobian(x)[0], 2) == pytest.approx(constant)


# --- the twisted plate ---

PLATE = sdf.box((2, 0.2, 4)).twist(360)
"""Its faces are 0.03 thick at the rim, and its gradient is up to 6.36 there."""


def test_the_plate_is_closed_and_skipping_blocks_by_its_bound_changes_nothing():
    # Not sharp: gradients, on which edges depend, are rounded otherwise in a field without formula.
    mesh = iw.extract(PLATE, 128, sharp=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    plain = sdf.from_function(PLATE.evaluate, bounds=PLATE.bounds)
    np.testing.assert_array_equal(iw.extract(plain, 128, sharp=False).vertices, mesh.vertices)


@pytest.mark.slow
def test_the_volume_of_the_plate_is_kept():
    """det J = 1: 1.6, here within 0.3 %, as flat faces lose the square of a voxel."""
    mesh = iw.extract(PLATE, 512)
    assert mesh.is_watertight
    assert mesh.euler_number == 2
    assert mesh.volume == pytest.approx(1.6, rel=3e-3)


def test_the_volume_of_the_plate_converges():
    """Extrapolated from two resolutions by the declared order 2."""
    coarse, fine = (iw.extract(PLATE, n).volume for n in (192, 256))
    limit = (256**2 * fine - 192**2 * coarse) / (256**2 - 192**2)
    assert limit == pytest.approx(1.6, rel=3e-3)


EMPTY = {
    "symmetry": sdf.sphere(0.4, (-0.9, 0, 0)).symmetry("x"),
    "symmetric_difference": sdf.sphere(1) ^ sdf.sphere(1),
    "intersection, chamfered": sdf.sphere(0.5).intersection(sdf.sphere(0.5, (3, 0, 0)), chamfer=1),
    "repeat": (sdf.sphere(0.2) & sdf.above(1)).repeat((1, 0, 0), 3),
    "circular_array": (sdf.sphere(0.2, (1, 0, 0)) & sdf.above(1)).circular_array(5),
    "twist": (sdf.sphere(0.2) & sdf.above(1)).twist(90),
    "bend": (sdf.sphere(0.2) & sdf.above(1)).bend(30),
    "pipe": sdf.sphere(0.2).pipe(sdf.sphere(0.2, (3, 0, 0)), 0.1),
    "groove": (sdf.sphere(0.2) & sdf.above(1)).groove(sdf.sphere(1), 0.1, 0.1),
    "displace": sdf.sphere(0.1).displace(sdf.Field(sdf.sphere(1).expression), limit=0.5).offset(-1),
}


@pytest.mark.parametrize("field", EMPTY.values(), ids=EMPTY.keys())
def test_an_empty_result_always_raises(field):
    with pytest.raises(iw.InputError, match=r"no surface|no extent"):
        iw.extract(field, 16)
