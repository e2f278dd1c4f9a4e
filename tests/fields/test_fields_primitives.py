"""Primitives against a second description of their surfaces that knows no distances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

import fields as sdf
from fields import InputError

SAMPLES = 100_000


def test_the_field_is_zero_on_the_surface(surface, rng):
    # Samples are rounded, some in several steps; none of them has coordinates above 10.
    atol = 1e-14 * surface.field.lipschitz
    np.testing.assert_allclose(surface.field(surface.sample(rng, SAMPLES)), 0, atol=atol)


def test_the_sign_is_that_of_the_solid(surface, rng):
    points = rng.uniform(-1.5, 1.5, (5_000, 3))
    inside = surface.inside(points)
    assert 0 < inside.sum() < len(points)
    # A point within 1e-6 of the surface could go either way by rounding; and by the
    # sampling of the capsule's axis.
    clear = np.abs(surface.field(points)) > 1e-6
    np.testing.assert_array_equal(surface.field(points[clear]) < 0, inside[clear])


def test_the_value_is_the_distance_to_the_nearest_surface_sample(surface, rng):
    """Or no more than its Lipschitz bound times that, if it is no distance."""
    samples = surface.sample(rng, SAMPLES)
    points = rng.uniform(-1.5, 1.5, (3_000, 3))
    brute, _ = cKDTree(samples).query(points)
    distance = np.abs(surface.field(points))
    assert (distance <= surface.field.lipschitz * brute + 1e-12).all()
    if not surface.field.exact:
        # Away from the surface it is not needlessly little.
        assert np.median((distance / brute)[brute > 0.1]) > 0.1
        return
    # How far samples are from arbitrary points of the surface, measured with others where
    # the nearest points of the test points are: these are within 1.5 sqrt(3) of the origin.
    # No surface point is farther from the samples than about twice what the others are.
    others = surface.sample(rng, 20_000)
    others = others[np.linalg.norm(others, axis=1) < 3]
    gap = 2 * cKDTree(samples).query(others)[0].max()
    assert gap < 0.25
    assert (distance >= brute - gap).all()
    # Away from the surface the nearest of dense samples is wrong by gap**2 / (2 d) only.
    assert np.median(brute - distance) < 0.01


def test_bounds_are_tight(surface, rng):
    if surface.field.bounds is None:
        pytest.skip("unbounded")
    samples = surface.sample(rng, SAMPLES)
    measured = np.stack([samples.min(axis=0), samples.max(axis=0)])
    assert (measured[0] >= surface.field.bounds[0] - 1e-12).all()
    assert (measured[1] <= surface.field.bounds[1] + 1e-12).all()
    np.testing.assert_allclose(measured, surface.field.bounds, atol=0.02)


def test_gradients_on_the_surface_are_the_outward_normals(surface, rng):
    """On it, not near it: normals are taken from extracted vertices."""
    samples = surface.sample(rng, 5_000)
    normal = surface.field.gradient(samples)
    norm = np.linalg.norm(normal, axis=1)
    # At an edge the gradient is a mean of normals; few random samples are that close.
    smooth = np.abs(norm - 1) < 1e-6 if surface.field.exact else norm > 0.1
    assert smooth.mean() > 0.99
    step = 1e-4 * (normal / norm.clip(1e-9)[:, None])[smooth]
    outwards = surface.field(samples[smooth] + step)
    # Inwards the step may cross to another face near an edge.
    inwards = surface.field(samples[smooth] - step)
    if surface.field.exact:
        # Outwards it may come nearer to another face at a concave edge, and at an edge itself
        # the gradient may be that of one face or the other.
        assert np.mean(np.abs(outwards - 1e-4) < 1e-9) > 0.998
        assert np.mean(np.abs(inwards + 1e-4) < 1e-9) > 0.98
    else:
        # Second derivatives in the catalogue are below 100: 1e-4 (norm - 100 * 1e-4 / 2).
        assert (outwards > 0.9e-4 * (norm[smooth] - 0.01)).mean() > 0.99
        assert (inwards < 0).mean() > 0.98


@pytest.mark.parametrize(
    ("field", "points", "values"),
    [
        (sdf.sphere(1), [(0, 0, 0), (2, 0, 0)], [-1, 1]),
        (sdf.box(1.5), [(0, 0, 0), (1.75, 0, 0), (1.75, 2.75, 0), (0.5, 0, 0)],
         [-0.75, 1, np.sqrt(5), -0.25]),
        (sdf.box((2, 4, 6)), [(0, 0, 0), (0, 0, 4), (0, -3, 0)], [-1, 1, 1]),
        (sdf.cylinder(1), [(0, 0, 99), (3, 4, -99)], [-1, 4]),
        (sdf.cylinder(1, 2), [(0, 0, 3), (4, 0, 5), (0, 0, 0)], [2, 5, -1]),
        (sdf.capsule((0, 0, 0), (0, 0, 1), 0.5), [(0, 0, 2), (2, 0, 0.5)], [0.5, 1.5]),
        (sdf.torus(2, 0.5), [(0, 0, 0), (2, 0, 0), (2, 0, 1)], [1.5, -0.5, 0.5]),
        (sdf.cone(3, 4), [(0, 0, 3), (0, 0, -3), (6, 0, -6), (0, 0, -1.5), (4, 0, 3)],
         [1, 1, 5, -0.5, 3.8]),
        (sdf.plane((0, 0, 2), (0, 0, 1)), [(5, 5, 3), (0, 0, 0)], [2, -1]),
        (sdf.below(1), [(0, 0, 0), (0, 0, 3)], [-1, 2]),
        (sdf.above(1), [(0, 0, 0), (0, 0, 3)], [1, -2]),
        (sdf.left(1), [(0, 0, 0), (3, 0, 0)], [-1, 2]),
        (sdf.right(1), [(0, 0, 0), (3, 0, 0)], [1, -2]),
        (sdf.front(1), [(0, 0, 0), (0, 3, 0)], [-1, 2]),
        (sdf.behind(1), [(0, 0, 0), (0, 3, 0)], [1, -2]),
    ],
    ids=lambda value: repr(value) if isinstance(value, sdf.Field) else "",
)  # fmt: skip
def test_values_worked_out_by_hand(field, points, values):
    np.testing.assert_allclose(field(points), values, atol=1e-14)


def test_a_half_space_has_no_bounds_but_its_ends_count():
    assert sdf.below(1).bounds is None
    slab = sdf.cylinder(0.5) & sdf.below(2) & sdf.plane("-z", (0, 0, -1))
    np.testing.assert_array_equal(slab.bounds, [[-0.5, -0.5, -1], [0.5, 0.5, 2]])


@pytest.mark.parametrize(
    ("make", "argument", "cause"),
    [
        (lambda: sdf.sphere(0), "radius", "greater than zero"),
        (lambda: sdf.sphere(-1), "radius", "greater than zero"),
        (lambda: sdf.sphere(float("nan")), "radius", "finite"),
        (lambda: sdf.sphere(10**400), "radius", "finite"),
        (lambda: sdf.sphere("1"), "radius", "real number"),
        (lambda: sdf.sphere(True), "radius", "real number"),
        (lambda: sdf.sphere(1, center=(0, 0)), "center", "three numbers"),
        (lambda: sdf.sphere(1, center=(0, 0, None)), "center[2]", "real number"),
        (lambda: sdf.box((1, 2)), "size", "three numbers"),
        (lambda: sdf.box((1, 0, 1)), "size", "greater than zero"),
        (lambda: sdf.rounded_box(1, 0.6), "radius", "half of the shortest edge"),
        (lambda: sdf.cylinder(1, -1), "height", "greater than zero"),
        (lambda: sdf.capsule((1, 1, 1), (1, 1, 1), 1), "b", "no axis"),
        (lambda: sdf.torus(1, 1), "minor", "closes the hole"),
        (lambda: sdf.cone(1, 0), "height", "greater than zero"),
        (lambda: sdf.plane((0, 0, 0)), "normal", "no direction"),
        (lambda: sdf.plane("up"), "normal", "no such axis"),
        (lambda: sdf.below("x"), "z", "real number"),
    ],
)
def test_bad_parameters_are_named(make, argument, cause):
    with pytest.raises(InputError, match=cause) as caught:
        make()
    assert caught.value.argument == argument
    assert caught.value.remedy
