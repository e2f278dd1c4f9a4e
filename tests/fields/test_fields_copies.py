"""Arrays of copies against explicit unions of the copies, and reflections."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import fields as sdf
from fields import Field, InputError
from fields.arguments import direction
from fields.operations import axis_frame

PILL = sdf.capsule((-0.4, 0, -0.3), (0.4, 0.2, 0.3), 0.25)
EGG = sdf.sphere(0.3, (0.2, -0.1, 0.1))
BRICK = sdf.box((0.5, 0.3, 0.2), center=(0.35, 0.1, 0))
OPAQUE = PILL.remap(lambda p: 1.3 * p, lipschitz=1.3, bounds=((-0.5,) * 3, (0.5,) * 3))


def agree(field: Field, copies: list[Field], points: np.ndarray, sure: float) -> None:
    """A field is the union of copies up to a value, and from there on a lower bound of it.

    `sure` is that value; the copies' own fields are distances.
    """
    union = np.min([copy(points) for copy in copies], axis=0)
    values = field(points)
    near = union < sure
    np.testing.assert_allclose(values[near], union[near], atol=1e-13)
    assert (values[~near] >= sure - 1e-13).all()
    assert (values <= union + 1e-13).all()
    assert near.any()
    assert (union < 0).any()


def lattice(spacing, low, high):
    ranges = [range(low, high + 1) if step else (0,) for step in spacing]
    return [np.multiply(spacing, index) for index in itertools.product(*ranges)]


@pytest.mark.parametrize("shape", [PILL, EGG, BRICK], ids=["pill", "egg", "brick"])
@pytest.mark.parametrize(
    "spacing", [(1.2, 0, 0), (0.9, 0.7, 0), (0.5, 0, 0.8), (0.21, 0, 0)], ids=str
)
def test_endless_copies_are_the_union_of_all_of_them(shape, spacing, rng):
    """Near the origin 9 copies on each side are as good as all; some overlap several others."""
    points = rng.uniform(-1, 1, (1500, 3))
    copies = [shape.translate(place) for place in lattice(spacing, -9, 9)]
    agree(shape.repeat(spacing), copies, points, min(s for s in spacing if s) / 2)


@pytest.mark.parametrize(
    ("spacing", "count"),
    [(1.2, 2), ((0.9, 0.7, 0), (3, 2, 5)), ((0.3, 0, 0), 6), ((0, 2, 0), 4)],
    ids=str,
)
def test_counted_copies_are_centred_and_are_their_union(spacing, count, rng):
    steps, counts = np.broadcast_to(spacing, 3), np.broadcast_to(count, 3)
    ranges = [
        [(i - (n - 1) / 2) * s for i in range(n)] if s else [0.0]
        for s, n in zip(steps, counts, strict=True)
    ]
    copies = [PILL.translate(place) for place in itertools.product(*ranges)]
    field = PILL.repeat(spacing, count)
    points = rng.uniform(-4, 4, (3000, 3))
    agree(field, copies, points, steps[steps > 0].min() / 2)
    np.testing.assert_allclose(field.bounds, sdf.union(*copies).bounds, atol=1e-14)


def test_a_few_copies_that_are_all_seen_are_the_union_everywhere(rng):
    points = rng.uniform(-4, 4, (1000, 3))
    copies = [EGG.translate((x, 0, 0)) for x in (-0.5, 0.5)]
    np.testing.assert_allclose(
        EGG.repeat((1, 0, 0), 2)(points), sdf.union(*copies)(points), atol=1e-15
    )


def test_mirrored_copies_face_each_other(rng):
    points = rng.uniform((-2, -1, -1), (2, 1, 1), (3000, 3))
    copies = [
        (EGG if i % 2 == 0 else EGG.mirror("x")).translate((1.1 * i, 0, 0)) for i in range(-4, 5)
    ]
    agree(EGG.repeat((1.1, 0, 0), mirrored=True), copies, points, 0.55)
    # Tiles meet without a seam: the field is even about their borders.
    offset = rng.uniform(-0.5, 0.5, (500, 3))
    tiled = EGG.repeat((1.1, 0, 0), mirrored=True)
    border = np.array([0.55, 0, 0])
    np.testing.assert_allclose(
        tiled(border + offset), tiled(border + offset * [-1, 1, 1]), atol=1e-14
    )


@pytest.mark.parametrize(
    "field",
    [
        EGG.repeat((0.7, 0.8, 0)),  # off centre: the nearest copy is often the neighbour's
        PILL.repeat((0.4, 0, 0)),  # larger than its cell
        OPAQUE.repeat((0.9, 0.9, 0), count=4),
        BRICK.translate((0.6, 0, 0)).circular_array(8),
        BRICK.linear_array(6, (0.3, 0.2, 0.1)),
    ],
    ids=repr,
)
def test_there_is_no_jump_where_cells_meet(field, rng):
    """Along lines across many cells; a jump of 1e-3 would be a slope of 100."""
    start, end = rng.uniform(-2, 2, (2, 40, 1, 3))
    t = np.linspace(0, 1, 4001)[:, None]
    points = start + t * (end - start)
    step = np.linalg.norm(end - start, axis=-1) / 4000
    slope = np.abs(np.diff(field(points), axis=1)) / step
    assert slope.max() <= field.lipschitz + 1e-9


@pytest.mark.parametrize("count", [2, 5, 40])
def test_a_row_along_any_direction_is_the_union(count, rng):
    by = np.array([0.4, 0.3, -0.2])
    copies = [PILL.translate(i * by) for i in range(count)]
    points = rng.uniform(-1, 1, (2000, 3)) + rng.uniform(0, count, (2000, 1)) * by
    field = PILL.linear_array(count, by)
    agree(field, copies, points, np.linalg.norm(by) / 2)
    np.testing.assert_allclose(field.bounds, sdf.union(*copies).bounds, atol=1e-14)
    assert PILL.linear_array(1, by) is PILL


@pytest.mark.parametrize("axis", ["z", "x", (1, 2, -1)], ids=str)
@pytest.mark.parametrize("count", [2, 3, 7, 24])
def test_copies_around_an_axis_are_the_union(axis, count, rng):
    points = rng.uniform(-2, 2, (3000, 3))
    turns = [360 / count * i for i in range(count)]
    for shape in (BRICK.translate((0.9, 0.2, 0.3)), PILL):
        field = shape.circular_array(count, axis)
        distance = _distance_from(axis, shape)
        sure = distance * np.sin(np.pi / count) if distance else np.inf
        agree(field, [shape.rotate(turn, axis) for turn in turns], points, sure)


def _distance_from(axis, shape):
    """Of the box around the shape's bounds, in coordinates with z along the axis."""
    frame = axis_frame(direction("axis", axis))
    corners = np.array(list(itertools.product(*shape.bounds.T))) @ frame
    low, high = corners.min(axis=0), corners.max(axis=0)
    return np.hypot(*np.clip(0, low, high)[:2])


def test_copies_around_an_axis_are_few_when_seen_from_any_point():
    """A thousand copies of a small shape take three evaluations of it, not a thousand."""
    one = sdf.sphere(0.002, (1, 0, 0))
    many = one.circular_array(1000)
    assert len(many.tape) < 100
    angle = 2 * np.pi / 1000 * np.array([0, 1, 499, 500, 501, 999])
    centres = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    np.testing.assert_allclose(many(centres), -0.002, atol=1e-15)


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: PILL.repeat(0), "all copies are in one place"),
        (lambda: PILL.repeat((1, -1, 0)), "negative"),
        (lambda: PILL.repeat(1, 0), "whole number"),
        (lambda: PILL.repeat(1, 2.5), "whole number"),
        (lambda: sdf.below(0).repeat(1), "no bounds along x"),
        (lambda: sdf.below(0).repeat((0, 0, 1), 3), "no bounds along z"),
        (lambda: PILL.repeat(0.05), "overlap at one point"),
        (lambda: PILL.linear_array(3, (0, 0, 0)), "all copies are in one place"),
        (lambda: sdf.below(0).linear_array(2, (1, 1, 1)), "no bounds along the offset"),
        (lambda: PILL.linear_array(0, (1, 0, 0)), "whole number"),
        (lambda: PILL.circular_array(0), "whole number"),
        (lambda: PILL.circular_array(3, (0, 0, 0)), "no direction"),
        (lambda: PILL.circular_array(2000), "overlap at one point"),
        (lambda: PILL.mirror("w"), "no such axis"),
        (lambda: PILL.symmetry("x", (0, 0)), "three numbers"),
    ],
)
def test_bad_arguments_are_named(make, cause):
    with pytest.raises(InputError, match=cause):
        make()


# --- reflections ---


def test_a_mirror_moves_the_shape_and_keeps_what_is_known(rng):
    points = rng.uniform(-2, 2, (500, 3))
    normal, place = np.array([1, 2, -2]) / 3, np.array([0.3, 0, 0.1])
    image = points - 2 * ((points - place) @ normal)[:, None] * normal
    mirrored = BRICK.mirror((1, 2, -2), place)
    np.testing.assert_allclose(mirrored(points), BRICK(image), atol=1e-14)
    assert mirrored.exact
    # Twice is nothing, and across an axis bounds are tight.
    again = mirrored.mirror((1, 2, -2), place)
    np.testing.assert_allclose(again(points), BRICK(points), atol=1e-14)
    np.testing.assert_allclose(
        BRICK.mirror("x").bounds, [[-0.6, -0.05, -0.1], [-0.1, 0.25, 0.1]], atol=1e-15
    )


@pytest.mark.parametrize("axis", ["x", "-x", "y", (1, -2, 0.5)], ids=str)
def test_symmetry_keeps_the_front_and_shows_it_twice(axis, rng):
    points = rng.uniform(-1.5, 1.5, (3000, 3))
    place = (0.1, 0.05, 0)
    half = PILL & ~sdf.plane(axis, place)
    both = half | half.mirror(axis, place)
    folded = PILL.symmetry(axis, place)
    np.testing.assert_array_equal(folded(points) < 0, both(points) < 0)
    np.testing.assert_allclose(
        folded(points), PILL.symmetry(axis, place).mirror(axis, place)(points), atol=1e-14
    )
    front = sdf.plane(axis, place)(points) > 0
    np.testing.assert_allclose(folded(points[front]), PILL(points[front]), atol=1e-14)


def test_symmetry_of_what_is_apart_from_the_plane_is_exact(rng):
    points = rng.uniform(-2, 2, (1000, 3))
    ball = sdf.sphere(0.4, (0.9, 0.2, 0))
    folded = ball.symmetry("x")
    assert folded.exact
    assert not ball.symmetry("-x").exact
    np.testing.assert_allclose(folded(points), (ball | ball.mirror("x"))(points), atol=1e-15)
    # Nothing in front: nothing is left, and the bounds say so.
    nothing = ball.symmetry("-x")
    assert (nothing(points) > 0).all()
    assert np.ptp(nothing.bounds, axis=0)[0] == 0
