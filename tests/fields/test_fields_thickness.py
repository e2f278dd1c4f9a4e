"""Walls, elongation, displacement, and the way from one field to another."""

from __future__ import annotations

import numpy as np
import pytest

import fields as sdf
from fields import InputError
from fields.expression import X, constant, sin

BALL = sdf.sphere(1.0)
BLOCK = sdf.box((1.0, 0.8, 0.6), center=(0.2, 0, 0.1))


def along_x(field, x):
    return field(np.stack([x, 0 * x, 0 * x], axis=-1))


def test_a_hollow_keeps_the_outside_and_has_a_wall(rng):
    points = rng.uniform(-1.5, 1.5, (2000, 3))
    value, hollow = BALL(points), BALL.hollow(0.2)(points)
    np.testing.assert_allclose(hollow, np.maximum(value, -value - 0.2), atol=1e-15)
    np.testing.assert_allclose(BALL.onion(0.2, 1)(points), hollow, atol=1e-15)
    np.testing.assert_array_equal(BALL.hollow(0.2).bounds, BALL.bounds)


@pytest.mark.parametrize(("gap", "period"), [(None, 0.2), (0.05, 0.15)])
def test_an_onion_is_the_union_of_its_walls(gap, period, rng):
    points = rng.uniform(-1.2, 1.2, (2000, 3))
    onion = BALL.onion(0.1, 4, gap)
    walls = [BALL.offset(-i * period).hollow(0.1) for i in range(4)]
    np.testing.assert_allclose(onion(points), sdf.union(*walls)(points), atol=1e-14)
    x = np.linspace(0, 1, 2001)
    changes = np.diff((along_x(onion, x) < 0).astype(int))
    assert (changes != 0).sum() == 8  # the last change is at x = 1, which is not inside


def test_elongating_a_sphere_gives_known_distances(rng):
    points = rng.uniform(-3, 3, (3000, 3))
    for field, expected in (
        (sdf.sphere(0.5).elongate((1, 2, 0.6)), sdf.rounded_box((2, 3, 1.6), 0.5)),
        (sdf.sphere(0.5).elongate((0, 0, 2)), sdf.capsule((0, 0, -1), (0, 0, 1), 0.5)),
    ):
        np.testing.assert_allclose(field(points), expected(points), atol=1e-14)
        np.testing.assert_allclose(field.bounds, expected.bounds, atol=1e-15)


def test_elongation_inserts_the_middle_section(rng):
    points = rng.uniform(-2, 2, (3000, 3))
    shape = sdf.torus(0.6, 0.2).rotate(30, "y").translate((0.1, 0, 0))
    longer = shape.elongate((1.0, 0, 0))
    pulled = points - np.clip(points, [-0.5, 0, 0], [0.5, 0, 0])
    np.testing.assert_allclose(longer(points), shape(pulled), atol=1e-14)


def test_a_thick_elongation_of_a_ring_keeps_its_hole():
    """The correction in the middle has the sign of the field there: the hole stays a hole."""
    ring = sdf.torus(0.8, 0.2).elongate(3.0)
    assert ring((0, 0, 0)) == pytest.approx(0.6 + 1.5)
    through = sdf.sphere(0.6, (0.6, 0, 0)).elongate(0.5)
    assert through((0.1, 0, 0)) > 0  # not a block of zeros


def test_no_elongation_is_no_operation():
    assert BALL.elongate(0) is BALL


def test_displacement_subtracts_a_clamped_amount(rng):
    points = rng.uniform(-1.5, 1.5, (1000, 3))
    waves = sdf.Field(0.3 * sin(4 * X), lipschitz=1.2)
    amount = 0.3 * np.sin(4 * points[:, 0])
    free, held = BALL.displace(waves), BALL.displace(waves, limit=0.1)
    np.testing.assert_allclose(free(points), BALL(points) - amount, atol=1e-15)
    clamped = np.clip(amount, -0.1, 0.1)
    np.testing.assert_allclose(held(points), BALL(points) - clamped, atol=1e-15)
    assert free.lipschitz == held.lipschitz == 1 + 1.2
    assert free.bounds is None
    np.testing.assert_allclose(held.bounds, np.multiply(1.1, BALL.bounds))
    assert BALL.displace(sdf.Field(X * X)).lipschitz is None


def test_displacement_by_a_constant_is_an_offset(rng):
    points = rng.uniform(-1.5, 1.5, (100, 3))
    moved = BALL.displace(sdf.Field(constant(0.2), lipschitz=0), limit=0.5)
    np.testing.assert_allclose(moved(points), BALL.offset(0.2)(points), atol=1e-15)


# --- from one field to another ---


def test_a_morph_runs_from_one_field_to_the_other(rng):
    points = rng.uniform(-1.5, 1.5, (1000, 3))
    assert BALL.morph(BLOCK, 0) is BALL
    assert BALL.morph(BLOCK, 1).expression is BLOCK.expression
    assert BALL.morph(BLOCK, 1).exact
    between = BALL.morph(BLOCK, 0.25)
    np.testing.assert_allclose(
        between(points), 0.75 * BALL(points) + 0.25 * BLOCK(points), atol=1e-15
    )
    steep = BLOCK.remap(lambda p: 3 * p, lipschitz=3)
    assert BALL.morph(steep, 0.25).lipschitz == pytest.approx(0.75 + 0.25 * 3)


def test_a_linear_transition_is_one_field_at_each_end(rng):
    start, end = (-0.4, 0, 0), (0.6, 0, 0)
    field = BALL.transition_linear(BLOCK, start, end)
    points = rng.uniform(-1, 1, (2000, 3))  # the bounds, in which nothing is confined
    t = np.clip(points[:, 0] + 0.4, 0, 1)
    np.testing.assert_allclose(
        field(points), (1 - t) * BALL(points) + t * BLOCK(points), atol=1e-14
    )
    low, high = points[:, 0] < -0.4, points[:, 0] > 0.6
    np.testing.assert_allclose(field(points[low]), BALL(points[low]), atol=1e-15)
    np.testing.assert_allclose(field(points[high]), BLOCK(points[high]), atol=1e-15)


def test_a_radial_transition_is_one_field_near_the_axis_and_one_far_away(rng):
    disc, plate = sdf.cylinder(1.0, 0.6), sdf.box((2.0, 2.0, 0.2))
    points = rng.uniform((-1, -1, -0.3), (1, 1, 0.3), (2000, 3))
    for axis, fold in (("z", [0, 1, 2]), ("x", [1, 2, 0])):
        field = disc.transition_radial(plate, 0.2, 0.7, axis)
        t = np.clip((np.hypot(*points[:, fold[:2]].T) - 0.2) / 0.5, 0, 1)
        np.testing.assert_allclose(
            field(points), (1 - t) * disc(points) + t * plate(points), atol=1e-14
        )


def test_a_transition_without_bounds_knows_no_lipschitz_bound():
    assert sdf.below(0).transition_linear(BALL, (0, 0, 0), (1, 0, 0)).lipschitz is None
    far = BALL.transition_linear(BLOCK, (0, 0, 0), (1e-3, 0, 0))
    assert far.lipschitz > 1000  # it is steep, and says so


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: BALL.hollow(0), "greater than zero"),
        (lambda: BALL.onion(0.1, 0), "whole number"),
        (lambda: BALL.onion(0.1, 2, gap=0), "greater than zero"),
        (lambda: BALL.elongate((0, -1, 0)), "negative"),
        (lambda: BALL.displace(0.1), "displace takes fields"),
        (lambda: BALL.displace(BLOCK, limit=0), "greater than zero"),
        (lambda: BALL.morph(BLOCK, 1.5), "no part of 1"),
        (lambda: BALL.transition_linear(BLOCK, (0, 0, 0), (0, 0, 0)), "equals start"),
        (lambda: BALL.transition_radial(BLOCK, 0.5, 0.5), "not beyond inner"),
    ],
)
def test_bad_arguments_are_named(make, cause):
    with pytest.raises(InputError, match=cause):
        make()
