"""Operations: who is inside, which tags survive, and why some do not."""

from __future__ import annotations

import numpy as np
import pytest

import fields as sdf
from fields import InputError

A = sdf.sphere(1.0)
B = sdf.box((1.2, 2.4, 1.9), center=(0.4, 0, 0.3))
C = sdf.cylinder(0.3)


@pytest.mark.parametrize(
    ("combined", "rule"),
    [
        (A | B, lambda a, b, c: a | b),
        (A & B, lambda a, b, c: a & b),
        (A - B, lambda a, b, c: a & ~b),
        (A.negate(), lambda a, b, c: ~a),
        (sdf.union(A, B, C), lambda a, b, c: a | b | c),
        (sdf.intersection(A, B, C), lambda a, b, c: a & b & c),
        (sdf.difference(A, B, C), lambda a, b, c: a & ~b & ~c),
        (A - B - C, lambda a, b, c: a & ~b & ~c),
        (A - (B - C), lambda a, b, c: a & ~(b & ~c)),
        (A | B & C, lambda a, b, c: a | (b & c)),
        (A & B - C, lambda a, b, c: a & b & ~c),
    ],
    ids=lambda value: repr(value) if isinstance(value, sdf.Field) else "",
)
def test_inside_follows_the_truth_table(combined, rule, rng):
    points = rng.uniform(-1.6, 1.6, (4_000, 3))
    inside = [field(points) < 0 for field in (A, B, C)]
    assert len({*zip(*(part.tolist() for part in inside), strict=True)}) == 8
    np.testing.assert_array_equal(combined(points) < 0, rule(*inside))


def test_augmented_assignment_combines():
    shape = A
    shape |= B
    shape &= C
    shape -= sdf.box(0.5)
    assert shape.expression is (((A | B) & C) - sdf.box(0.5)).expression


def test_operators_refuse_what_is_no_field():
    with pytest.raises(TypeError, match="unsupported operand"):
        A | 3
    with pytest.raises(InputError, match="union takes fields"):
        sdf.union(A, 3)
    with pytest.raises(InputError, match="translate takes fields"):
        sdf.translate(3, (0, 0, 1))


# --- blends ---


def test_a_blend_of_radius_zero_is_the_sharp_operation():
    assert A.union(B, smooth=0).expression is (A | B).expression
    assert A.difference(B, smooth=0.0).expression is (A - B).expression


@pytest.mark.parametrize("k", [0.01, 0.3, 2.0])
def test_a_blend_differs_only_near_the_crease_and_by_a_quarter_radius(k, rng):
    points = rng.uniform(-2, 2, (20_000, 3))
    a, b = A(points), B(points)
    for blended, sharp, gap in (
        (A.union(B, smooth=k), np.minimum(a, b), a - b),
        (A.intersection(B, smooth=k), np.maximum(a, b), a - b),
        (A.difference(B, smooth=k), np.maximum(a, -b), a + b),
    ):
        change = np.abs(blended(points) - sharp)
        np.testing.assert_allclose(change[np.abs(gap) >= k], 0, atol=1e-15)
        assert change.max() <= k / 4 + 1e-15
        np.testing.assert_allclose(
            change, np.maximum(k - np.abs(gap), 0) ** 2 / (4 * k), atol=1e-14
        )


def test_a_blend_has_a_continuous_gradient(rng):
    """Also across the crease a = b, where the sharp union jumps."""
    left, right = sdf.sphere(1, (-0.5, 0, 0)), sdf.sphere(1, (0.5, 0, 0))
    points = rng.uniform((0, 1, -1), (0, 3, 1), (1_000, 3))
    step = np.array([1e-6, 0, 0])
    jump = [
        np.abs(f.gradient(points + step) - f.gradient(points - step)).max()
        for f in (left | right, left.union(right, smooth=0.2))
    ]
    assert jump[0] > 0.1
    # The blend's second derivative is at most |grad a - grad b|**2 / (2 k) + curvature.
    assert jump[1] < 2e-6 * (4 / 0.4 + 2)


# --- motions ---


def test_translate_moves_towards_the_offset():
    assert A.translate((3, 0, 0))((3, 0, 0)) == -1


@pytest.mark.parametrize(
    ("axis", "sends_to"),
    [("x", (0, 0, 1)), ("z", (-1, 0, 0)), ((0, 0, -2), (1, 0, 0)), ("-x", (0, 0, -1))],
)
def test_a_quarter_turn_is_right_handed_and_exact(axis, sends_to):
    """Where +y goes under 90 degrees."""
    bar = sdf.box((0.2, 0.2, 0.2), center=(0, 1, 0)).rotate(90, axis)
    assert bar(sends_to) == pytest.approx(-0.1, abs=1e-15)
    expected = np.array(sends_to) + np.array([[-0.1] * 3, [0.1] * 3])
    np.testing.assert_allclose(bar.bounds, expected, atol=1e-15)


@pytest.mark.parametrize("degrees", [-720, -270, -180, -90, 0, 90, 180, 270, 360, 450])
def test_turns_by_quarters_add_no_rounding(degrees):
    turned = sdf.cylinder(0.5, 3).orient("x").rotate(degrees, "z")
    along = np.array([1.5, 0, 0]) if degrees % 180 == 0 else np.array([0, 1.5, 0])
    np.testing.assert_array_equal(turned.bounds[1].max(), along.max())
    assert turned(along) == 0
    half = sdf.below(1).rotate(degrees, "x") & sdf.box(100)
    assert np.sum(np.abs(half.bounds) == 1) == 1


def test_rotation_by_angle_and_by_matrix_agree(rng):
    points = rng.normal(size=(100, 3))
    angle = np.radians(25)
    c, s = np.cos(angle), np.sin(angle)
    matrix = [[1, 0, 0], [0, c, -s], [0, s, c]]
    np.testing.assert_allclose(B.rotate(25, "x")(points), B.rotate(matrix)(points), atol=1e-14)


@pytest.mark.parametrize(
    "axis", ["x", "y", "z", "-x", "-y", "-z", (1, 2, 3), (1e-9, 0, -1), (1e-200, 1e-200, 0)]
)
def test_orient_sends_up_to_the_axis(axis):
    named = {name: np.eye(3)[i] for i, name in enumerate("xyz")}
    target = axis
    if isinstance(axis, str):
        target = named[axis[-1]] * (-1 if axis.startswith("-") else 1)
    target = np.array(target) / max(np.abs(target))
    target /= np.linalg.norm(target)
    arrow = sdf.cone(0.2, 2.0).orient(axis)
    assert arrow(target) == pytest.approx(0, abs=1e-12)  # the apex
    np.testing.assert_allclose(arrow(1.5 * target), 0.5, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: A.rotate(np.diag([1, 1, -1])), "it reflects"),
        (lambda: A.rotate(2 * np.eye(3)), "differs from the identity by 3.0e\\+00"),
        (lambda: A.rotate(np.eye(2)), "not a 3x3 matrix"),
        (lambda: A.rotate(np.full((3, 3), np.nan)), "not a 3x3 matrix"),
        (lambda: A.rotate(90, "w"), "no such axis"),
        (lambda: A.rotate(90, (0, 0, 0)), "no direction"),
        (lambda: A.rotate(np.inf), "finite"),
        (lambda: A.orient((0, 0)), "three numbers"),
        (lambda: A.translate(1.0), "three numbers"),
        (lambda: A.translate((0, 0, np.nan)), "finite"),
        (lambda: A.scale(0), "greater than zero"),
        (lambda: A.scale((1, -1, 1)), "greater than zero"),
        (lambda: A.offset("1"), "real number"),
        (lambda: A.shell(0), "greater than zero"),
        (lambda: A.union(B, smooth=-0.1), "negative"),
        (lambda: A.remap(3), "cannot be called"),
        (lambda: A.remap(abs, lipschitz=-1), "negative"),
        (lambda: A.remap(abs, bounds=((1, 1, 1), (0, 0, 0))), "minimum first"),
        (lambda: A.remap(abs, growth=0), "greater than zero"),
        (lambda: sdf.from_function(3), "cannot be called"),
        (lambda: sdf.Field(3), "made of an Expression"),
    ],
)
def test_bad_arguments_are_named(make, cause):
    with pytest.raises(InputError, match=cause) as caught:
        make()
    assert caught.value.remedy


def test_a_float32_rotation_matrix_is_made_orthogonal():
    matrix = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]], dtype=np.float32)
    far = 1e6 * np.array([0.6, 0.8, 0.0])
    assert A.rotate(matrix)(far) == pytest.approx(1e6 - 1, rel=1e-15)


# --- tags ---


@pytest.mark.parametrize(
    ("field", "exact"),
    [
        (A | sdf.sphere(1, (3, 0, 0)), True),
        (A | sdf.sphere(1, (1, 0, 0)), False),
        (A.union(sdf.sphere(1, (3, 0, 0)), smooth=0.1), False),
        (A & B, False),
        (A - B, False),
        (A.negate(), True),
        (A.translate((1, 2, 3)).rotate(20).orient("x").scale(2), True),
        (A.scale((1, 1, 2)), False),
        (A.offset(0.1), False),
        (A.offset(0), True),
        (A.shell(0.1), False),
        (A.remap(lambda p: p, lipschitz=1), False),
    ],
)
def test_the_exact_tag(field, exact):
    assert field.exact is exact


def test_why_these_are_not_exact():
    """Each value is not the distance to the zero set: the tag has to go."""
    peanut = sdf.sphere(1, (-0.5, 0, 0)) | sdf.sphere(1, (0.5, 0, 0))
    assert peanut((0, 0, 0)) == -0.5  # the nearest surface is the waist, at sqrt(0.75)
    assert (sdf.box(2) & sdf.left(0))((2, 3, 0)) == pytest.approx(np.sqrt(1 + 4))
    # ... although the nearest point of that half box is (0, 1, 0), at sqrt(4 + 4).
    notched = (sdf.box(2).negate()).offset(0.5)  # a cave, grown into by half
    assert notched((1.4, 1.4, 0)) == pytest.approx(np.hypot(0.4, 0.4) * -1 - 0.5)
    # ... although its surface is now the box of half edge 0.5, at hypot(0.9, 0.9).
    disc = sdf.box((4, 4, 0.2)).shell(0.5)  # the two walls have merged
    assert disc((0, 0, 0)) == pytest.approx(-0.15)
    # ... although the surface is at z = 0.35.


@pytest.mark.parametrize(
    ("field", "lipschitz"),
    [
        (A | B, 1),
        (A.remap(lambda p: p, lipschitz=2.5) - B, 2.5),
        (A.remap(lambda p: p) | B, None),
        (A.remap(lambda p: p).offset(0.1).shell(0.1).negate().scale(2), None),
        (A.remap(lambda p: p, lipschitz=2.5).scale((1, 2, 3)).rotate(10), 2.5),
    ],
)
def test_the_lipschitz_tag(field, lipschitz):
    assert field.lipschitz == lipschitz


@pytest.mark.parametrize(
    ("field", "bounds"),
    [
        (A | sdf.box(1, (2, 0, 0)), [[-1, -1, -1], [2.5, 1, 1]]),
        (A & sdf.box(1, (1, 0, 0)), [[0.5, -0.5, -0.5], [1, 0.5, 0.5]]),
        (A - sdf.box(10), [[-1] * 3, [1] * 3]),
        (A.union(B, smooth=0.4), [[-1.1, -1.3, -1.1], [1.1, 1.3, 1.35]]),
        (A.offset(0.5), [[-1.5] * 3, [1.5] * 3]),
        (A.offset(-0.25), [[-0.75] * 3, [0.75] * 3]),
        (A.shell(0.5), [[-1.25] * 3, [1.25] * 3]),
        (A.scale((1, 2, 3)), [[-1, -2, -3], [1, 2, 3]]),
        (A & sdf.sphere(1, (4, 0, 0)), [[2, -1, -1], [2, 1, 1]]),
        (A.negate(), None),
        (A | sdf.below(0), None),
        (sdf.below(0) - A, None),
        (sdf.cylinder(1).offset(1), None),
        (A.remap(lambda p: p, lipschitz=2), None),
    ],
)
def test_the_bounds_tag(field, bounds):
    if bounds is None:
        assert field.bounds is None
    else:
        np.testing.assert_allclose(field.bounds, bounds, atol=1e-15)


def test_bounds_of_unknown_growth_are_lost_not_guessed():
    box = ((-1, -1, -1), (1, 1, 1))
    unknown = A.remap(lambda p: p, lipschitz=1, bounds=box)
    np.testing.assert_array_equal((unknown | A).bounds, box)
    np.testing.assert_array_equal(unknown.offset(-0.1).bounds, np.multiply(0.9, box))
    for thickened in (unknown.offset(0.1), unknown.shell(0.1), unknown.union(A, smooth=0.1)):
        assert thickened.bounds is None
    known = A.remap(lambda p: p, lipschitz=1, bounds=box, growth=2)
    np.testing.assert_allclose(known.offset(0.1).bounds, np.multiply(1.2, box))


def test_bounds_cannot_be_changed_from_outside():
    A.bounds[:] = 7
    np.testing.assert_array_equal(A.bounds, [[-1] * 3, [1] * 3])
