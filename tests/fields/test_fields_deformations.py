"""Twist, taper, shear and bend against the same maps written in numpy, and where they end."""

from __future__ import annotations

import math

import numpy as np
import pytest

import fields as sdf
from fields import InputError

BAR = sdf.box((0.4, 0.3, 2.0))
BRICK = sdf.box((1.2, 0.8, 0.6), center=(0.3, 0.1, 0.2))


def around(field, rng, n=3000):
    """Points in the bounds."""
    return rng.uniform(*field.bounds, (n, 3))


def positive_outside(field, rng):
    middle, half = field.bounds.mean(axis=0), np.ptp(field.bounds, axis=0) / 2
    points = middle + rng.uniform(-4, 4, (4000, 3)) * (half + 0.1)
    out = (np.abs(points - middle) > half).any(axis=1)
    distance = np.linalg.norm(np.maximum(np.abs(points - middle) - half, 0), axis=1)
    assert (field(points[out]) >= distance[out] - 1e-12).all()


def turned(points, angle):
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = points.T
    return np.stack([c * x + s * y, c * y - s * x, z], axis=1)


@pytest.mark.parametrize("between", [None, (-0.1, 0.3)])
def test_a_twist_turns_sections(between, rng):
    field = BRICK.twist(100, origin=(0.2, 0, -0.1), between=between)
    points = around(field, rng)
    z = points[:, 2] + 0.1
    along = z if between is None else np.clip(z, *between) - between[0]
    origin = np.array([0.2, 0, -0.1])
    expected = BRICK(turned(points - origin, math.radians(100) * along) + origin)
    # In the bounds' box, but not in its corners, which are beyond the cylinder.
    within = np.hypot(*(points - origin)[:, :2].T) <= field.bounds[1, 0] - 0.2
    np.testing.assert_allclose(field(points)[within], expected[within], atol=1e-14)
    np.testing.assert_array_equal(field(points) < 0, expected < 0)
    positive_outside(field, rng)


def test_the_twisted_plate_has_the_right_bound():
    """A plate 2 x 0.2 x 4 by a full turn a unit: |grad| reaches sqrt(1 + (2 pi)^2) = 6.36."""
    plate = sdf.box((2, 0.2, 4)).twist(360)
    rim = np.array([[1.0, 0.1, 0.0]])
    steepest = np.linalg.norm(plate.gradient(np.add(rim, [0, 1e-3, 0])))
    assert steepest == pytest.approx(math.hypot(1, 2 * math.pi), rel=1e-3)
    reach = math.hypot(1, 0.1) * (1 + 2 / 64)
    s = 2 * math.pi * reach
    assert plate.lipschitz == pytest.approx((s + math.sqrt(s * s + 4)) / 2)
    assert steepest < plate.lipschitz < 1.05 * steepest


def test_nothing_to_do_gives_the_field_itself():
    assert BRICK.twist(0) is BRICK
    assert BRICK.shear(0) is BRICK
    assert BRICK.bend_radial(0) is BRICK


def test_a_taper_scales_sections(rng):
    field = BRICK.taper((1.4, 0.5), between=(-0.2, 0.6))
    points = around(field, rng)
    scale = np.interp(points[:, 2], [-0.2, 0.6], [1.4, 0.5])
    expected = BRICK(points / np.stack([scale, scale, np.ones_like(scale)], axis=1))
    np.testing.assert_allclose(field(points), expected, atol=1e-14)
    positive_outside(field, rng)
    # The box is tight: the low end is scaled by 1.3, the high one by 0.6.
    low, high = (np.interp(z, [-0.2, 0.6], [1.4, 0.5]) for z in (-0.1, 0.5))
    assert field.bounds[1, 0] == pytest.approx(0.9 * low)
    assert field.bounds[0, 0] == pytest.approx(-0.3 * low)
    assert high < low


@pytest.mark.parametrize("between", [None, (-0.3, 0.2)])
def test_a_shear_slides_sections(between, rng):
    field = BRICK.shear(0.7, "x", towards="y", origin=(0.1, 0, 0), between=between)
    points = rng.uniform(-3, 3, (2000, 3))
    x = points[:, 0] - 0.1
    along = x if between is None else np.clip(x, *between) - between[0]
    expected = BRICK(points - 0.7 * along[:, None] * np.array([0, 1.0, 0]))
    np.testing.assert_allclose(field(points), expected, atol=1e-14)
    assert field.lipschitz == pytest.approx((0.7 + math.sqrt(0.49 + 4)) / 2)


def test_a_radial_bend_slides_cylinders(rng):
    field = BRICK.bend_radial(0.6, (0.2, 1.2), "z", (0.1, 0.2, 5.0))
    points = rng.uniform(-3, 3, (2000, 3))
    radius = np.hypot(points[:, 0] - 0.1, points[:, 1] - 0.2)
    raised = np.interp(radius, [0.2, 1.2], [0, 0.6])
    expected = BRICK(points - raised[:, None] * np.array([0, 0, 1.0]))
    np.testing.assert_allclose(field(points), expected, atol=1e-14)
    assert field.lipschitz == pytest.approx((0.6 + math.sqrt(0.36 + 4)) / 2)
    with pytest.raises(InputError, match="distances from the axis"):
        BRICK.bend_radial(0.6, (-0.2, 1.2))


def test_an_unbounded_field_is_twisted_without_a_lipschitz_bound(rng):
    points = rng.uniform(-3, 3, (500, 3))
    half_space = sdf.left(0.5)
    field = half_space.twist(90)
    np.testing.assert_allclose(
        field(points), half_space(turned(points, math.pi / 2 * points[:, 2])), atol=1e-14
    )
    assert field.lipschitz is None
    assert field.bounds is None
    # An endless bar is bounded across the axis, and that is enough.
    assert (sdf.left(0.5) & sdf.right(-0.5) & sdf.front(1) & sdf.behind(-1)).twist(90).lipschitz


# --- bend ---


def test_a_bent_bar_is_a_sector_of_a_ring(rng):
    """A bar of 0.4 x 0.3 whose middle part of length pi/2 is bent by 90 degrees: radius 1."""
    length = math.pi / 2
    bar = sdf.box((0.4, 0.3, length), center=(0, 0, length / 2))
    field = bar.bend(90, between=(0, length), towards="x")
    points = rng.uniform((-0.4, -0.3, -0.2), (1.2, 0.3, 1.4), (5000, 3))
    x, y, z = points.T
    rho, phi = np.hypot(1 - x, z), np.arctan2(z, 1 - x)
    inside = (np.abs(rho - 1) < 0.2) & (np.abs(y) < 0.15) & (phi > 0) & (phi < math.pi / 2)
    np.testing.assert_array_equal(field(points) < 0, inside)
    np.testing.assert_allclose(field.bounds, [[-0.2, -0.15, 0], [1, 0.15, 1.2]], atol=1e-15)
    positive_outside(field, rng)


def test_the_ends_of_a_bend_go_straight(rng):
    """From z = 0.5 on, turned by 90 degrees: the bar leaves along +y."""
    field = BAR.bend(90, between=(-0.5, 0.5), towards="y")
    radius = 2 / math.pi
    end = np.array([0, radius, -0.5 + radius])  # where the arc ends, now along +y
    across, along = rng.uniform(-0.3, 0.3, (2, 500))
    points = end + np.stack([across, 0.25 + along / 2, 0 * across], axis=1)
    at_rest = np.stack([across, 0 * across, 0.5 + 0.25 + along / 2], axis=1)
    np.testing.assert_allclose(field(points), BAR(at_rest), atol=1e-14)


@pytest.mark.parametrize("degrees", [20, -90, 180, 250, -300])
def test_a_bend_is_continuous_also_where_space_is_torn(degrees, rng):
    """Between the two sides of a strong bend, and about the centres of its arc."""
    bar = sdf.box((0.2, 0.3, 3.2)) | sdf.sphere(0.2, (0, 0.05, 1.4))
    field = bar.bend(degrees, between=(-1.5, 1.5), towards=(1, 1, 0))
    start, end = rng.uniform(-2.5, 2.5, (2, 60, 1, 3))
    t = np.linspace(0, 1, 4001)[:, None]
    step = np.linalg.norm(end - start, axis=-1) / 4000
    slope = np.abs(np.diff(field(start + t * (end - start)), axis=1)) / step
    assert slope.max() <= field.lipschitz + 1e-9
    positive_outside(field, rng)


def test_a_bend_that_folds_space_is_refused():
    """fogleman/sdf folds at a distance 1/k from the axis; the bounds say whether that matters."""
    radius = 1.0 / math.radians(90)
    for reach in (0.9 * radius, 1.1 * radius):
        block = sdf.box((2 * reach, 0.3, 1.0), center=(0, 0, 0.5))
        if reach < radius:
            block.bend(90, towards="x")
        else:
            with pytest.raises(InputError, match=r"space would fold.*0\.6366.*reach 0\.7003"):
                block.bend(90, towards="x")
        # On the outside of the bend there is room.
        block.translate((-2 * radius, 0, 0)).bend(90, towards="x")
    with pytest.raises(InputError, match="straight ends beyond the arc"):
        sdf.box((0.1, 0.1, 9.0)).bend(300, between=(-0.5, 0.5))


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: BAR.twist(math.inf), "finite"),
        (lambda: BAR.twist(10, "w"), "no such axis"),
        (lambda: BAR.twist(10, between=(1, 1)), "an empty range"),
        (lambda: BAR.twist(10, between=3), "not a pair"),
        (lambda: BAR.taper(2.0), "not a pair"),
        (lambda: BAR.taper((1, 0)), "greater than zero"),
        (lambda: BAR.taper((1, 2), between=None), "not a pair"),
        (lambda: BAR.shear(0.5, "z", towards="z"), "along the axis"),
        (lambda: BAR.bend(0), "less than a full turn"),
        (lambda: BAR.bend(360), "less than a full turn"),
        (lambda: BAR.bend(90, between=(0, 0)), "an empty range"),
        (lambda: sdf.cylinder(0.2).bend(90), "no bounds along the axis"),
        (lambda: BAR.affine(np.zeros((3, 3))), "singular"),
        (lambda: BAR.affine([[1, 2, 3]]), "not a 3x3 matrix"),
    ],
)
def test_bad_arguments_are_named(make, cause):
    with pytest.raises(InputError, match=cause):
        make()


def test_an_affine_map_carries_values_along(rng):
    points = rng.uniform(-2, 2, (500, 3))
    matrix, shift = rng.normal(size=(3, 3)) + 2 * np.eye(3), np.array([0.1, -0.2, 0.3])
    field = BRICK.affine(matrix, shift)
    np.testing.assert_allclose(field(points @ matrix.T + shift), BRICK(points), atol=1e-13)
    assert field.lipschitz == pytest.approx(np.linalg.norm(np.linalg.inv(matrix), 2))


def test_long_chains_take_time_and_text_in_proportion():
    field = sdf.box((0.4, 0.2, 1))
    for i in range(300):
        field = field.twist(0.01, between=(i, i + 1)).shear(1e-4).translate((0, 0, 1e-3))
    assert len(field.tape) < 60 * 300
    assert np.isfinite(field.gradient(np.zeros((1, 3)))).all()


def test_a_union_of_thousands_is_written_and_read_again():
    """As a call, whose arguments are a list: operators would nest deeper than Python parses."""
    balls = [sdf.sphere(0.1, (i % 100, i // 100, 0)) for i in range(4000)]
    many = sdf.union(*balls)
    text = repr(many)
    assert sdf.parse(text).expression is many.expression
    np.testing.assert_allclose(many([[0, 0, 0], [99.0, 39, 0], [50, 20, 0.5]]), [-0.1, -0.1, 0.4])
