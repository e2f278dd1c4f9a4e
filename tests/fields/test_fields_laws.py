"""Laws that every field of the catalogue must obey, whatever made it."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields.notation import Call
from fields.operations import RULES
from fields.primitives import PRIMITIVES
from fields.tags import grown

ROUNDING = 1e-12
"""Values in the catalogue are below 20 and take under 100 operations: 20 * 100 * 2**-53."""


def test_the_catalogue_misses_no_primitive_and_no_operation(catalogue, surfaces):
    made_by = {f.history.name for f in catalogue.values() if isinstance(f.history, Call)}
    assert set(PRIMITIVES) | set(RULES) <= made_by
    assert {s.field.history.name for s in surfaces.values()} == set(PRIMITIVES)


def test_every_primitive_and_operation_is_public():
    assert set(PRIMITIVES) | set(RULES) <= set(sdf.__all__)
    for name in RULES:
        assert getattr(sdf, name) is getattr(sdf.Field, name)
    for name in sdf.__all__:
        assert getattr(sdf, name).__doc__, name


def test_lipschitz_bound_holds_between_random_pairs(example, cloud, rng):
    near = cloud + rng.normal(size=cloud.shape) * 10 ** rng.uniform(-4, 0, (len(cloud), 1))
    for other in (near, rng.permutation(cloud)):
        change = np.abs(example(cloud) - example(other))
        distance = np.linalg.norm(cloud - other, axis=1)
        assert (change <= example.lipschitz * distance + ROUNDING).all()


def test_gradient_norm_is_within_the_lipschitz_bound(example, cloud):
    norm = np.linalg.norm(example.gradient(cloud), axis=1)
    assert norm.max() <= example.lipschitz + ROUNDING
    assert norm.max() > 0.1 * example.lipschitz  # else the gradient is not a gradient


def test_exact_fields_have_unit_gradients(exact_example, cloud):
    norm = np.linalg.norm(exact_example.gradient(cloud), axis=1)
    assert exact_example.lipschitz == 1
    # Random points miss the medial axis, where the norm is less; 1e-9 is rounding
    # divided by the least distance to a centre that 8,000 points are likely to reach.
    np.testing.assert_allclose(norm, 1, atol=1e-9)


def test_a_step_of_an_exact_distance_lands_on_the_surface(exact_example, cloud):
    """With the Lipschitz law this is exactness: |f| <= d by the bound, and >= d by this."""
    values = exact_example(cloud)
    foot = cloud - values[:, None] * exact_example.gradient(cloud)
    np.testing.assert_allclose(exact_example(foot), 0, atol=1e-9)


def test_bounds_hold_the_inside(example, cloud, rng):
    bounds = example.bounds
    points = cloud
    if bounds is not None:
        middle, half = bounds.mean(axis=0), np.ptp(bounds, axis=0) / 2
        around = middle + rng.uniform(-1.2, 1.2, (30_000, 3)) * (half + 0.05)
        points = np.concatenate([cloud, around])
    inside = points[example(points) <= 0]
    extent = grown(example._body.tags.extent, ROUNDING)
    assert ((inside >= extent[0]) & (inside <= extent[1])).all()


def test_examples_with_an_inside_show_it(catalogue, cloud):
    """So that the law above is not empty."""
    nothing = {name for name, field in catalogue.items() if not (field(cloud) < 0).any()}
    assert nothing == {"intersection, empty", "offset inwards, to nothing"}


def test_bounds_are_not_needlessly_large(catalogue, cloud):
    """Half as large again as what is inside, for shapes that fill their box."""
    for name in ("sphere", "box", "cylinder", "torus", "cone", "capsule", "offset", "shell"):
        inside = cloud[catalogue[name](cloud) <= 0]
        assert (np.ptp(catalogue[name].bounds, axis=0) < 1.5 * np.ptp(inside, axis=0)).all(), name


@pytest.mark.parametrize("level", [0.02, 0.1, 0.5, 1.5])
def test_level_sets_stay_within_the_grown_extent(example, cloud, level):
    tags = example._body.tags
    if tags.growth is None:
        assert repr(example) == "<ellipsoid>"
        pytest.skip("the only example that makes no such claim")
    within = cloud[example(cloud) <= level]
    extent = grown(tags.extent, tags.growth * level + ROUNDING)
    assert ((within >= extent[0]) & (within <= extent[1])).all()


def test_autograd_equals_central_differences(example, cloud):
    points, h = cloud[::8], 1e-5
    value, gradient = example(points), example.gradient(points)
    for axis in range(3):
        step = h * np.eye(3)[axis]
        ahead = (example(points + step) - value) / h
        behind = (value - example(points - step)) / h
        # The differences of both sides agree to h * f'', so where they do to 1e-4 the
        # field is smooth with f'' < 10, and the central difference is good to h**2 f'''
        # + rounding / h, some 1e-9. Where f'' jumps, in the few points that are within h of
        # the border of a region, the gradient is only between the two.
        gap = np.abs(ahead - behind)
        smooth = gap < 1e-4
        assert smooth.mean() > 0.95
        error = np.abs(gradient[:, axis] - (ahead + behind) / 2)[smooth]
        assert (error <= gap[smooth] + 1e-7).all()
        assert (error < 1e-7).mean() > 0.995


def test_gradients_are_finite_where_there_is_none(example):
    lattice = np.stack(np.meshgrid(*[np.linspace(-2, 2, 21)] * 3, indexing="ij"), axis=-1)
    for dtype in (np.float64, np.float32):
        gradient = example.gradient(lattice.astype(dtype))
        assert gradient.shape == lattice.shape
        assert np.isfinite(gradient).all()


def test_second_derivatives_are_finite(example):
    if repr(example) == "<ellipsoid>":
        pytest.skip("its formula is torch's own norm, which has none at the origin")
    lattice = torch.linspace(-2, 2, 9, dtype=torch.float64)
    points = torch.cartesian_prod(lattice, lattice, lattice).requires_grad_()
    gradient = example.gradient(points)
    if gradient.requires_grad:
        (second,) = torch.autograd.grad(gradient.square().sum(), points)
        assert second.isfinite().all()
    else:
        assert len(gradient.unique(dim=0)) < 50  # of 729: linear, in a few pieces


def test_float32_agrees_with_float64(example, cloud):
    single = cloud.astype(np.float32)
    values = example(single)
    assert values.dtype == np.float32
    # Inputs are equal; 100 operations on numbers below 20 round by 2**-24 each.
    np.testing.assert_allclose(values, example(single.astype(np.float64)), atol=1.2e-4)


def test_shapes_and_kinds_of_arrays(example):
    assert isinstance(example([0.1, 0.2, 0.3]), float)
    assert example(np.zeros((4, 0, 3))).shape == (4, 0)
    points = torch.full((2, 5, 3), 0.3, dtype=torch.float32)
    values = example(points)
    assert isinstance(values, torch.Tensor)
    assert values.shape == (2, 5)
    assert values.dtype == torch.float32
    assert example(points.double().numpy()).dtype == np.float64
    assert example.gradient(points).shape == (2, 5, 3)


def test_repr_parses_back_to_the_same_expression(example):
    text = repr(example)
    if "<" in text:
        with pytest.raises(InputError, match="not an expression"):
            sdf.parse(text)
        return
    copy = sdf.parse(text)
    assert copy.expression is example.expression
    assert repr(copy) == text
    np.testing.assert_array_equal(copy._body.tags.extent, example._body.tags.extent)
    assert (copy.exact, copy.lipschitz) == (example.exact, example.lipschitz)


def test_rigid_motions_move_the_field_and_keep_its_tags(example, cloud):
    turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
    offset = np.array([0.3, -0.7, 0.2])
    moved = example.rotate(turn).translate(offset)
    np.testing.assert_allclose(moved(cloud @ turn.T + offset), example(cloud), atol=ROUNDING)
    assert (moved.exact, moved.lipschitz) == (example.exact, example.lipschitz)
    if example.bounds is not None:
        inside = (cloud @ turn.T + offset)[example(cloud) <= 0]
        assert (inside >= moved.bounds[0] - ROUNDING).all()
        assert (inside <= moved.bounds[1] + ROUNDING).all()


def test_uniform_scale_scales_values(example, cloud):
    scaled = example.scale(1.6)
    np.testing.assert_allclose(scaled(1.6 * cloud), 1.6 * example(cloud), atol=ROUNDING)
    assert (scaled.exact, scaled.lipschitz) == (example.exact, example.lipschitz)
