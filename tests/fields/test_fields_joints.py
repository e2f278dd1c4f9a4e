"""Joints of booleans and operations along seams, against their geometry and their sources."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import fields as sdf
from fields import InputError
from fields.joints import JOINTS, chosen
from tests.fields.catalogue.operations import JOINTS as SIZED

A = sdf.sphere(0.8, (-0.3, 0.1, 0))
B = sdf.box((1.2, 1.0, 0.8), center=(0.4, 0, 0.2))
C = sdf.capsule((-0.4, 0, -0.3), (0.4, 0.2, 0.3), 0.25)
WALL, FLOOR = sdf.left(0), sdf.below(0)
"""Two half-spaces whose values are x and z: the union's edge is a concave corner at the origin."""

OVER_ALL = pytest.mark.parametrize("name", JOINTS)


def corner(x, z, **joint):
    """The union of wall and floor at points (x, z) of a cross section."""
    return WALL.union(FLOOR, **joint)(np.stack([x, np.zeros_like(x), z], axis=-1))


def test_every_joint_is_in_the_catalogue():
    assert set(SIZED) == set(JOINTS)


# --- cross sections in closed form ---


def test_a_round_joint_is_an_arc_tangent_to_both_surfaces():
    r, angle = 0.3, np.linspace(0, np.pi / 2, 50)
    value = corner(r - r * np.cos(angle), r - r * np.sin(angle), round=r)
    np.testing.assert_allclose(value, 0, atol=1e-15)
    t = np.linspace(r, 2, 20)  # beyond the arc the surfaces are as they were
    np.testing.assert_allclose(corner(t, 0 * t, round=r), 0, atol=1e-15)


def test_a_chamfer_is_a_straight_bevel():
    r, t = 0.3, np.linspace(0, 0.3, 20)
    np.testing.assert_allclose(corner(t, r - t, chamfer=r), 0, atol=1e-15)
    # Where planes are square to each other it is a distance over sqrt(2), see the module.
    np.testing.assert_allclose(corner(t + 0.01, r - t + 0.01, chamfer=r), 0.01, atol=1e-15)


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_stairs_have_treads_and_rises_of_equal_size(count, rng):
    """n rises, the last one at the wall: the boxes below and behind n - 1 edges on the bevel."""
    r, step = 0.6, 0.6 / count
    x, z = rng.uniform(-0.2, 0.8, (2, 4000))
    solid = (x < 0) | (z < 0)
    for j in range(1, count):
        solid |= (x < r - j * step) & (z < j * step)
    np.testing.assert_array_equal(corner(x, z, stairs=(r, count)) < 0, solid)


def test_stairs_are_those_of_hg_sdf(rng):
    """fOpUnionStairs of hg_sdf, in its own terms."""
    a, b = rng.uniform(-1, 1, (2, 2000))
    r, n = 0.7, 4
    s, u = r / n, b - r
    expected = np.minimum(np.minimum(a, b), 0.5 * (u + a + np.abs(np.mod(u - a + s, 2 * s) - s)))
    np.testing.assert_allclose(corner(a, b, stairs=(r, n)), expected, atol=1e-14)


def test_blends_are_those_of_quilez(rng):
    """The formulas of https://iquilezles.org/articles/smin/, without their last scaling."""
    a, b = rng.uniform(-1, 1, (2, 2000))
    k = 0.6
    h = np.maximum(k - np.abs(a - b), 0) / k
    least = np.minimum(a, b)
    for name, expected in {
        "smooth": least - h * h * k / 4,
        "cubic": least - h * h * h * k / 6,
        "root": 0.5 * (a + b - np.sqrt((b - a) ** 2 + k * k)),
        "exponential": -k * np.log(np.exp(-a / k) + np.exp(-b / k)),
        "round": least - k * 0.5 * (1 + h - np.sqrt(1 - h * (h - 2))),
    }.items():
        np.testing.assert_allclose(corner(a, b, **{name: k}), expected, atol=1e-14, err_msg=name)


# --- laws of all joints ---


@OVER_ALL
def test_no_joint_is_steeper_than_its_operands_at_any_angle(name, rng):
    """Planes at random angles, some parallel: the classic chamfer reaches sqrt(2) there."""
    points = rng.uniform(-1, 1, (300, 3))
    for turn in (0, 1e-3, 0.5, 2, np.pi - 1e-3, np.pi):
        other = sdf.plane((np.sin(turn), 0, np.cos(turn)), (0.02, 0.03, 0.05))
        for combine in (sdf.union, sdf.intersection, sdf.difference):
            gradient = combine(FLOOR, other, **SIZED[name]).gradient(points)
            assert np.linalg.norm(gradient, axis=1).max() <= 1 + 1e-12


@OVER_ALL
def test_a_joint_adds_at_most_its_depth_and_dwindles_with_its_size(name, rng):
    points = rng.uniform(-1.5, 1.5, (3000, 3))
    value = SIZED[name][name]
    for shrink in (1, 1e-3, 1e-9):
        size = (value[0] * shrink, value[1]) if name == "stairs" else value * shrink
        depth = chosen({name: size}).depth
        for joined, sharp, sign in (
            (A.union(B, **{name: size}), A | B, -1),
            (A.intersection(B, **{name: size}), A & B, 1),
            (A.difference(B, **{name: size}), A - B, 1),
        ):
            change = sign * (joined(points) - sharp(points))
            assert change.min() >= -1e-15
            assert change.max() <= depth + 1e-15
            assert shrink < 1 or change.max() > 0.2 * depth


@OVER_ALL
def test_a_joint_of_size_zero_is_a_sharp_edge(name):
    assert A.union(B, **{name: 0}).expression is (A | B).expression
    assert repr(A.union(B, **{name: 0})) == repr(A | B)


@OVER_ALL
def test_the_depth_is_the_material_where_both_values_agree(name):
    """But for stairs: whether a tread or a rise is in the middle depends on their number."""
    if name == "stairs":
        assert corner(np.zeros(1), np.zeros(1), stairs=(0.4, 4)) == pytest.approx(-0.2)
    else:
        depth = chosen(SIZED[name]).depth
        assert corner(np.zeros(1), np.zeros(1), **SIZED[name]) == pytest.approx(-depth)


@OVER_ALL
def test_many_fields_are_joined_from_left_to_right(name, rng):
    points = rng.uniform(-1, 1, (500, 3))
    joint = SIZED[name]
    at_once = A.union(B, C, **joint)
    one_by_one = A.union(B, **joint).union(C, **joint)
    np.testing.assert_allclose(at_once(points), one_by_one(points), atol=1e-14)


def test_the_exponential_joint_does_not_depend_on_the_order(rng):
    points = rng.uniform(-1, 1, (500, 3))
    parts = (A, B, C, sdf.sphere(0.3))
    for combine in (sdf.union, sdf.intersection):
        values = [combine(*order, exponential=0.2)(points) for order in _orders(parts)]
        np.testing.assert_allclose(values, values[:1] * len(values), atol=1e-14)
    # ... while others do.
    values = [sdf.union(*order, smooth=0.4)(points) for order in _orders(parts)]
    assert np.ptp(values, axis=0).max() > 1e-3


def _orders(parts):
    return list(itertools.permutations(parts))[::5]


def test_the_exponential_joint_survives_values_far_beyond_its_size():
    far = np.array([[1e6, 0.0, 0.0]])
    for dtype in (np.float32, np.float64):
        joined = A.union(B, C, exponential=1e-3)
        assert joined(far.astype(dtype)) == pytest.approx(1e6, rel=1e-5)
        assert np.isfinite(joined.gradient(far.astype(dtype))).all()


def test_one_field_needs_no_joint():
    assert sdf.union(A, exponential=0.2) is A
    assert sdf.intersection(A, chamfer=0.2) is A


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: A.union(B, smooth=0.1, chamfer=0.2), "smooth and chamfer are both given"),
        (lambda: A.difference(B, round=-0.1), "negative"),
        (lambda: A.union(B, stairs=0.2), "a size and a number of steps"),
        (lambda: A.union(B, stairs=(0.2, 0)), "whole number of at least 1"),
        (lambda: A.union(B, stairs=(0.2, 2.5)), "whole number of at least 1"),
        (lambda: A.union(B, bevel=0.2), "no joint of that name"),
        (lambda: A.pipe(B, 0), "greater than zero"),
        (lambda: A.engrave(B, -1), "greater than zero"),
        (lambda: A.groove(B, 0.1, 0), "greater than zero"),
        (lambda: A.tongue(3, 0.1, 0.1), "tongue takes fields"),
    ],
)
def test_bad_arguments_are_named(make, cause):
    with pytest.raises(InputError, match=cause):
        make()


def test_parsing_names_the_joints():
    assert sdf.parse("sphere(1).union(box(1), stairs=(0.2, 3))").expression is (
        sdf.sphere(1).union(sdf.box(1), stairs=(0.2, 3)).expression
    )
    with pytest.raises(InputError, match="others, smooth, cubic, exponential, root, round"):
        sdf.parse("sphere(1).union(box(1), bevel=0.2)")


# --- set algebra ---


def test_the_symmetric_difference_is_the_parity(rng):
    points = rng.uniform(-1.2, 1.2, (4000, 3))
    a, b, c = (field(points) < 0 for field in (A, B, C))
    np.testing.assert_array_equal((A ^ B)(points) < 0, a ^ b)
    np.testing.assert_array_equal((A ^ B ^ C)(points) < 0, a ^ b ^ c)
    assert (A ^ B ^ C).expression is sdf.symmetric_difference(A, B, C).expression
    assert not (A ^ sdf.sphere(1, (9, 0, 0))).exact


def test_operators_bind_as_in_python():
    for text in ("~sphere(1) | box(1) ^ box(2) & box(3) - box(4)", "(sphere(1) | box(1)) ^ box(2)"):
        field = sdf.parse(text)
        assert sdf.parse(repr(field)).expression is field.expression
    assert (~A).expression is A.negate().expression
    assert (A | B ^ C).expression is (A | (B ^ C)).expression
    with pytest.raises(TypeError):
        A ^ 3


# --- seams ---


def test_seams_have_the_cross_sections_of_their_names(rng):
    x, z = rng.uniform(-0.5, 0.5, (2, 4000))
    points = np.stack([x, np.zeros_like(x), z], axis=-1)
    floor, wall = z < 0, np.abs(x)
    for field, solid in (
        (FLOOR.pipe(WALL, 0.2), np.hypot(x, z) < 0.2),
        (FLOOR.groove(WALL, 0.2, 0.3), floor & ~((z > -0.2) & (wall < 0.15))),
        (FLOOR.tongue(WALL, 0.2, 0.3), floor | ((z < 0.2) & (wall < 0.15))),
        (FLOOR.engrave(WALL, 0.2), floor & ~(z > wall - 0.2)),
    ):
        np.testing.assert_array_equal(field(points) < 0, solid)


def test_the_bound_of_a_pipe_is_attained_between_parallel_surfaces():
    both = sdf.below(0).pipe(sdf.below(0.1), 0.05)
    gradient = np.linalg.norm(both.gradient([[0.0, 0, 5.0]]))
    assert both.lipschitz == pytest.approx(np.sqrt(2))
    assert 0.99 * both.lipschitz < gradient <= both.lipschitz
