"""What is special to single solids: values by hand, iterations, mirrors, bad parameters."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import brentq

import fields as sdf
from fields import InputError
from fields.expression import X, Y
from fields.formulas import folded_to_sector
from fields.polyhedra import _icosahedral, _octahedral, _tetrahedral
from fields.prisms import prism
from tests.fields.catalogue.polyhedra import GEM, _cyclic

G = (1 + np.sqrt(5)) / 2
BEND = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]


@pytest.mark.parametrize(
    ("field", "points", "values"),
    [
        (sdf.octahedron(1), [(0, 0, 0), (2, 0, 0), (1, 1, 0)], [-1 / 3**0.5, 1, 0.5**0.5]),
        (sdf.tetrahedron(3), [(0, 0, 0), (-3, -3, -3)], [-1, np.sqrt(27) - 1]),
        (sdf.pyramid(2, 1), [(0, 0, -1.5), (0, 0, 1.5), (4, 5, -0.5)], [1, 1, 5]),
        (sdf.prism(4, np.sqrt(2), 2), [(0, 0, 3), (0, 0, 0), (2, 2, 0)], [2, -1, 2 * 2**0.5 - 1]),
        (sdf.hexagonal_prism(2, 4), [(0, 3, 0), (0, 0, 0)], [2, -1]),
        (sdf.triangular_prism(2, 9), [(-2, 0, 0), (0, 0, 0)], [2 - 1 / 3**0.5, -1 / 3**0.5]),
        (sdf.slab(z0=1), [(5, 5, 0), (0, 0, 3)], [1, -2]),
        (sdf.slab(x1=0, y0=0), [(3, -4, 9), (-1, 2, 0)], [5, -1]),
        (sdf.wedge(2, 2, 2), [(0, 0, 0), (0, -3, -1), (1, 0, 1)], [0, 2, 2**0.5]),
        (sdf.tube(2, 1, 2), [(0, 0, 0), (1.5, 0, 0), (0, 0, 2)], [1, -0.5, 2**0.5]),
        (sdf.sector(2, 90, 2), [(-3, 0, 0), (1, 1, 0), (5, 0, 0)], [3, 0, 3]),
        (sdf.box_frame(2, 0.5), [(0, 0, 0), (1, 1, 1), (0.75, 0.75, 0)], [0.5**0.5, 0, -0.25]),
        (sdf.infinite_cone(90), [(0, 0, -2), (0, 0, 2), (2, 0, 0)], [2, -(2**0.5), 2**0.5]),
        (sdf.capped_cone((0, 0, 0), (0, 0, 2), 1, 1), [(0, 0, 3), (4, 0, 6)], [1, 5]),
        (sdf.rounded_cone((0, 0, 0), (0, 0, 5), 3, 1), [(0, 0, 8), (0, 0, -5)], [2, 2]),
        (sdf.solid_angle(2, 60), [(0, 0, 3), (0, 0, -1), (0, 0, 1)], [1, 1, -0.5]),
        (sdf.cut_sphere(5, 3), [(0, 0, 0), (4, 0, 0), (0, 0, 4), (8, 0, 0)], [3, 3, -1, 5]),
        (sdf.cut_hollow_sphere(5, 3, 2), [(0, 0, 0), (0, 0, -5), (4, 0, 5)], [4, -1, 1]),
        (sdf.death_star(5, 5, 6), [(0, 0, 6), (0, 0, 0), (0, 0, -6), (4, 0, 3)], [5, -1, 1, 0]),
        (sdf.lens(8, 4), [(0, 0, 3), (7, 0, 0), (0, 0, 0)], [1, 3, -2]),
        (sdf.spindle(8, 4), [(0, 0, 5), (4, 0, 0), (0, 0, 0)], [1, 2, -2]),
        (sdf.egg(2, 1, 2), [(0, 0, 4), (0, 0, -3), (3, 0, 0)], [1, 1, 1]),
        (sdf.ellipsoid((3, 2, 1), exact=True), [(0, 0, 0), (4, 0, 0), (0, 0, 3)], [-1, 1, 2]),
        (sdf.ellipsoid((3, 2, 1)), [(0, 0, 0), (6, 0, 0)], [-1, 1]),
        (sdf.superellipsoid(1, 1), [(0, 0, 0), (2, 0, 0), (1, 1, 1)], [-1, 1, 2]),
        (sdf.capped_torus(3, 1, 180), [(3, 0, 0), (-2, 3, 0), (5, 0, 0)], [-1, 1, 1]),
        (sdf.link(4, 2, 1), [(0, 2, 0), (5, 0, 0), (0, 0, 0)], [-1, 0, 1]),
        (sdf.polyline_tube([(0, 0, 0), (4, 0, 0), (4, 4, 0)], 1), [(4, 6, 0), (2, 2, 0)], [1, 1]),
        (sdf.triangle_plate((0, 0, 0), (4, 0, 0), (0, 4, 0), 2), [(1, 1, 3), (-2, 1, 0)], [2, 1]),
        (sdf.bezier_tube((-1, 1, 0), (0, -1, 0), (1, 1, 0), 0.1), [(0, -1, 0), (0, 0, 2)],
         [0.9, 1.9]),
        (sdf.helix(2, 0.5, 3, 4), [(2, 0, 0), (2, 0, 3), (0, 0, 0)], [-0.5, -0.5, 1.5]),
        (sdf.thread(8, 1.25, 10), [(0, 0, 7), (6, 0, 0)], [2, 2]),
        (sdf.torus_knot(1, 1, 4, 1, 0.5), [(5, 0, 0), (-3, 0, 0)], [-0.5, -0.5]),
        (sdf.gyroid(1), [(0, 0, 0)], [0]),
        (sdf.schwarz_p(2 * np.pi), [(0, 0, 0), (np.pi,) * 3], [3**0.5, -(3**0.5)]),
    ],
    ids=lambda value: repr(value) if isinstance(value, sdf.Field) else "",
)  # fmt: skip
def test_values_worked_out_by_hand(field, points, values):
    np.testing.assert_allclose(field(points), values, atol=1e-12)


# --- mirrors ---


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 7, 12, 17, 64])
def test_a_fold_ends_in_one_sector_and_is_a_symmetry(sides, rng):
    points = rng.normal(size=(2000, 3))
    u, v = (sdf.Field(part)(points) for part in folded_to_sector(X, Y, sides))
    angle = np.arctan2(v, u)
    assert (angle >= -1e-12).all()
    assert (angle <= np.pi / sides + 1e-12).all()
    np.testing.assert_allclose(np.hypot(u, v), np.hypot(*points.T[:2]))
    # The angle from the nearest multiple of the sector is all that a mirror group keeps.
    whole = np.arctan2(points[:, 1], points[:, 0])
    step = 2 * np.pi / sides
    np.testing.assert_allclose(angle, np.abs(whole - step * np.rint(whole / step)), atol=1e-12)


@pytest.mark.parametrize(
    ("chamber", "mirrors", "order"),
    [
        (_octahedral, [*np.eye(3), *_cyclic(0, 1, 1)], 48),
        (_tetrahedral, [*_cyclic(0, 1, 1)], 24),
        (_icosahedral, [*np.eye(3), *_cyclic(G, 1, 1 / G)], 120),
    ],
)
def test_mirrors_leave_one_chamber(chamber, mirrors, order, rng):
    points = rng.normal(size=(20_000, 3))
    image = np.stack([sdf.Field(part)(points) for part in chamber().point], axis=1)
    np.testing.assert_allclose(
        np.linalg.norm(image, axis=1), np.linalg.norm(points, axis=1), rtol=1e-12
    )
    sides = np.sign(image @ np.transpose(mirrors))
    assert len(np.unique(sides, axis=0)) == 1
    assert len(np.unique(np.sign(points @ np.transpose(mirrors)), axis=0)) == order
    # Points that a reflection of the group exchanges have one image.
    for mirror in np.array(mirrors) / np.linalg.norm(mirrors, axis=1, keepdims=True):
        other = points - 2 * (points @ mirror)[:, None] * mirror
        again = np.stack([sdf.Field(part)(other) for part in chamber().point], axis=1)
        np.testing.assert_allclose(again, image, atol=1e-12)


# --- one solid by two formulas ---


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (sdf.slab(-1, -2, 0, 1, 1, 0.5), sdf.box((2, 3, 0.5), center=(0, -0.5, 0.25))),
        (sdf.prism(4, 1, 2), sdf.box((2**0.5, 2**0.5, 2)).rotate(45)),
        (sdf.rhombic_prism(2, 2, 1), sdf.prism(4, 1, 1)),
        (sdf.wedge(1, 2, 3, top=1), sdf.box((1, 2, 3))),
        (sdf.capped_cone((0, 0, -1), (0, 0, 1), 0.6, 0.6), sdf.cylinder(0.6, 2)),
        (sdf.capped_cone((0, 0, 1), (0, 0, -1), 0, 0.6), sdf.cone(0.6, 2)),
        (sdf.rounded_cone((1, 0, 0), (0, 1, 2), 0.4, 0.4), sdf.capsule((1, 0, 0), (0, 1, 2), 0.4)),
        (sdf.polyline_tube([(1, 0, 0), (0, 1, 2)], 0.4), sdf.capsule((1, 0, 0), (0, 1, 2), 0.4)),
        (sdf.bezier_tube((0, 0, 0), (1, 0, 1), (2, 0, 2), 0.4),
         sdf.capsule((0, 0, 0), (2, 0, 2), 0.4)),
        (sdf.bezier_tube((0, 0, 0), (2, 0, 0), (0, 0, 0), 0.4),
         sdf.capsule((0, 0, 0), (1, 0, 0), 0.4)),
        (sdf.convex_hull(list(product((-1, 1), (-0.5, 0.5), (-2, 2)))), sdf.box((2, 1, 4))),
        (sdf.octahedron(1), sdf.convex_hull([*np.eye(3), *-np.eye(3)])),
        (sdf.ellipsoid(1.2, exact=True), sdf.sphere(1.2)),
        (sdf.superellipsoid((1.5, 1, 0.5), 2), sdf.ellipsoid((1.5, 1, 0.5))),
        (sdf.infinite_cone(180), sdf.above(0)),
        (sdf.solid_angle(1.0, 180), sdf.cut_sphere(1.0, 0.0)),
        (sdf.helix(1, 0.2, 1e-9, 0.5), sdf.capped_torus(1, 0.2, 180)),
    ],
    ids=lambda value: repr(value)[:40],
)  # fmt: skip
def test_two_formulas_agree(one, other, cloud):
    np.testing.assert_allclose(one(cloud), other(cloud), atol=1e-9)


def test_a_gauge_of_exponent_infinity_would_be_a_box(cloud):
    near = sdf.superellipsoid((1.0, 0.8, 0.6), 400)
    clear = np.abs(sdf.box((2.0, 1.6, 1.2))(cloud)) > 0.01
    box = sdf.box((2.0, 1.6, 1.2))(cloud)
    np.testing.assert_array_equal(near(cloud)[clear] < 0, box[clear] < 0)
    assert np.isfinite(near(cloud.astype(np.float32))).all()


# --- iterations ---


def _by_bisection(p, r):
    """The distance to an ellipsoid by Lagrange's multiplier and Brent's method."""

    def excess(t):
        return np.sum((r * p / (t + r**2)) ** 2) - 1

    low = np.max(r * np.abs(p) - r**2)
    t = brentq(excess, low, np.linalg.norm(r * p), xtol=1e-15) if excess(low) > 0 else low
    return t * np.linalg.norm(p / (t + r**2))


@pytest.mark.parametrize("radii", [(1, 1, 3), (1, 10, 100), (2, 1, 1000), (1, 1.001, 1.002)])
def test_the_exact_ellipsoid_at_any_ratio(radii, rng):
    r = np.array(radii, float)
    points = np.concatenate(
        [
            rng.uniform(-2, 2, (100, 3)) * r,
            rng.normal(size=(200, 3)) * r * 10 ** rng.uniform(-3, 0, (200, 3)),
        ]
    )
    expected = [_by_bisection(p, r) for p in points]
    found = sdf.ellipsoid(radii, exact=True)(points)
    np.testing.assert_allclose(found, expected, atol=1e-12 * r.max())


def test_the_exact_ellipsoid_where_two_points_are_nearest():
    """In the middle plane, inside the curve of centres, the multiplier is at its pole."""
    a, b = 1.5, 0.5
    x = np.linspace(0, (a**2 - b**2) / a, 50)
    # The foot has x a^2 / (a^2 - b^2); the ellipse's equation gives the rest.
    foot = x * a**2 / (a**2 - b**2)
    expected = -np.hypot(foot - x, b * np.sqrt(np.maximum(1 - (foot / a) ** 2, 0)))
    points = np.stack([x, 0 * x, 0 * x], axis=1)
    field = sdf.ellipsoid((a, 1.0, b), exact=True)
    np.testing.assert_allclose(field(points), expected, atol=1e-11)


def test_a_helix_against_dense_points_of_it(rng):
    """All regimes: flat and steep, a part of a turn and many, near the axis and far away."""
    for pitch, turns in ((0.3, 3.0), (6.0, 1.0), (2.0, 0.3), (40.0, 0.5), (6.5, 2.5)):
        t = np.pi * turns * np.linspace(-1, 1, 60_001)
        curve = np.stack([np.cos(t), np.sin(t), pitch * t / (2 * np.pi)], axis=1)
        points = rng.uniform(-1, 1, (60, 3)) * [3, 3, pitch * turns + 1]
        points[::4, :2] *= 0.01
        nearest = np.sqrt([((curve - p) ** 2).sum(axis=1).min() for p in points])
        found = sdf.helix(1.0, 0.1, pitch, turns)(points) + 0.1
        step = np.linalg.norm(curve[1] - curve[0])
        assert (found <= nearest + 1e-12).all()
        assert (np.sqrt(found**2 + step**2) >= nearest - 1e-12).all()


def test_a_curve_against_dense_points_of_it(rng):
    t = np.linspace(0, 1, 60_001)
    weights = np.stack([(1 - t) ** 2, 2 * t * (1 - t), t**2], axis=1)
    for scale in (1.0, 1e-3, 1e-7, 1e-11):
        corners = np.array([(-1, 0, 0), (0.2, 0, 0), (1, 0, 0)]) + scale * rng.normal(size=(3, 3))
        points = rng.uniform(-2, 2, (60, 3))
        curve = weights @ corners
        nearest = np.sqrt([((curve - p) ** 2).sum(axis=1).min() for p in points])
        found = sdf.bezier_tube(*corners, 0.1)(points) + 0.1
        assert (found <= nearest + 1e-9).all()
        assert (np.sqrt(found**2 + 1e-8) >= nearest - 1e-9).all()


# --- which are exact ---


@pytest.mark.parametrize(
    ("exact", "bound"),
    [
        (sdf.polyline_tube(BEND[:2], 0.2), sdf.polyline_tube(BEND, 0.2)),
        (sdf.capped_torus(1, 0.2, 300), sdf.capped_torus(1, 0.6, 300)),
        (sdf.cut_hollow_sphere(1, 0.8, 0.4), sdf.cut_hollow_sphere(1, 0.95, 0.8)),
        (sdf.bezier_tube(*BEND, 0.7), sdf.bezier_tube(*BEND, 0.71)),
        (sdf.helix(1, 0.2, 0.5, 3), sdf.helix(1, 0.26, 0.5, 3)),
        (sdf.ellipsoid((1, 1, 2), exact=True), sdf.ellipsoid((1, 1, 2))),
    ],
    ids=lambda value: repr(value)[:30],
)  # fmt: skip
def test_tubes_are_exact_up_to_the_reach_of_their_curves(exact, bound):
    assert exact.exact
    assert not bound.exact
    assert bound.lipschitz == 1


# --- refusals ---


@pytest.mark.parametrize(
    ("make", "argument", "cause"),
    [
        (lambda: sdf.convex_hull([(0, 0, 0), (1, 0, 0), (0, 1, 0)]), "points", "at least 4"),
        (lambda: sdf.convex_hull([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]), "points", "plane"),
        (lambda: sdf.convex_hull([(0, 0, 0)] * 5), "points", "plane"),
        (lambda: sdf.convex_hull(np.ones((99, 3))), "points", "more than 60"),
        (lambda: sdf.convex_hull([(0, 0)] * 4), "points[0]", "three numbers"),
        (lambda: sdf.pyramid(1, 0), "height", "greater than zero"),
        (lambda: sdf.icosahedron(-1), "radius", "greater than zero"),
        (lambda: sdf.prism(2, 1, 1), "sides", "at least 3"),
        (lambda: sdf.prism(4.5, 1, 1), "sides", "whole number"),
        (lambda: sdf.slab(), "x0", "all of space"),
        (lambda: sdf.slab(y0=1, y1=1), "y1", "not above y0"),
        (lambda: sdf.wedge(1, 1, 1, top=1.5), "top", "more than width"),
        (lambda: sdf.tube(1, 1, 1), "inner", "no wall"),
        (lambda: sdf.sector(1, 360, 1), "angle", "below 360"),
        (lambda: sdf.box_frame(1, 0.5), "thickness", "no window"),
        (lambda: sdf.rounded_cylinder(1, 1, 0.6), "rounding", "height / 2"),
        (lambda: sdf.capped_cone((0, 0, 0), (0, 0, 0), 1, 1), "b", "equals a"),
        (lambda: sdf.capped_cone((0, 0, 0), (0, 0, 1), 0, 0), "radius_b", "both radii"),
        (lambda: sdf.rounded_cone((0, 0, 0), (0, 0, 1), 2, 1), "b", "holds the other"),
        (lambda: sdf.cut_sphere(1, 1), "height", "below 1"),
        (lambda: sdf.cut_hollow_sphere(1, 0, 2), "thickness", "below 2"),
        (lambda: sdf.death_star(1, 1, 2), "distance", "do not cross"),
        (lambda: sdf.death_star(3, 1, 1), "distance", "do not cross"),
        (lambda: sdf.lens(1, 1), "thickness", "below 1"),
        (lambda: sdf.spindle(1, 2), "width", "below 1"),
        (lambda: sdf.egg(1, 1, 1), "top_radius", "below 1"),
        (lambda: sdf.egg(1, 0.5, 0.5), "height", "lies in the lower"),
        (lambda: sdf.ellipsoid((1, 0, 1)), "radii", "greater than zero"),
        (lambda: sdf.ellipsoid(1, exact=1), "exact", "neither True nor False"),
        (lambda: sdf.superellipsoid(1, 0.5), "exponent", "cusps"),
        (lambda: sdf.superellipsoid(1, 2, vertical=0.9), "vertical", "cusps"),
        (lambda: sdf.capped_torus(1, 1, 90), "minor", "closes the hole"),
        (lambda: sdf.link(1, 1, 2), "minor", "closes the hole"),
        (lambda: sdf.polyline_tube([(0, 0, 0)], 1), "points", "at least 2"),
        (lambda: sdf.polyline_tube([(0, 0, 0), (1, 0, 0), (1, 0, 0)], 1), "points[2]",
         "one before"),
        (lambda: sdf.triangle_plate((0, 0, 0), (1, 1, 1), (2, 2, 2), 1), "c", "one line"),
        (lambda: sdf.quad_plate((0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 0), 1), "d", "one plane"),
        (lambda: sdf.quad_plate((0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0), 1), "d",
         "convex|one line"),
        (lambda: sdf.bezier_tube((1, 0, 0), (1, 0, 0), (1, 0, 0), 1), "c", "the same"),
        (lambda: sdf.helix(1, 1, 1, 1), "tube", "below 1"),
        (lambda: sdf.helix(1, 0.1, 1, 1, ends="square"), "ends", "round or flat"),
        (lambda: sdf.helix(1, 0.1, 1, 1, hand=1), "hand", "right or left"),
        (lambda: sdf.thread(1, 1, 5), "pitch", "deeper"),
        (lambda: sdf.thread(8, 1, 5, starts=0), "starts", "at least 1"),
        (lambda: sdf.torus_knot(2, 4, 1, 0.3, 0.1), "q", "divisor in common"),
        (lambda: sdf.torus_knot(2, 3, 1, 0.8, 0.2), "tube", "closes"),
        (lambda: sdf.gyroid(0), "cell", "greater than zero"),
        (lambda: sdf.schwarz_d(1, thickness=-1), "thickness", "greater than zero"),
    ],
)  # fmt: skip
def test_bad_parameters_are_named(make, argument, cause):
    with pytest.raises(InputError, match=cause) as caught:
        make()
    assert caught.value.argument == argument
    assert caught.value.remedy


def test_a_hull_knows_only_its_corners():
    """Points inside, twice, in faces and on edges change nothing but rounding."""
    more = [*GEM, *GEM[:3], *(0.5 * GEM), (GEM[0] + GEM[1]) / 2]
    found, expected = sdf.convex_hull(more), sdf.convex_hull(GEM)
    assert len(found.tape) <= len(expected.tape) + 2
    points = np.random.default_rng(1).normal(size=(500, 3)) * 2
    np.testing.assert_allclose(found(points), expected(points), atol=1e-12)


def test_flags_and_words_are_written_and_read():
    for field, text in (
        (sdf.ellipsoid((3, 2, 1), exact=True), "ellipsoid((3.0, 2.0, 1.0), exact=True)"),
        (sdf.helix(1, 0.1, 1, 2, hand="left"), "helix(1.0, 0.1, 1.0, 2.0, hand='left')"),
        (sdf.slab(z1=2), "slab(z1=2.0)"),
        (prism(5, 1, 1), "prism(5.0, 1.0, 1.0)"),
    ):
        assert repr(field) == text
        assert sdf.parse(text).expression is field.expression


def test_the_gradients_of_lattices_are_within_their_bounds_but_not_far(rng):
    points = rng.uniform(0, 1, (200_000, 3))
    for make, least in ((sdf.gyroid, 0.99), (sdf.schwarz_p, 0.99), (sdf.schwarz_d, 0.99),
                        (sdf.neovius, 0.97)):  # fmt: skip
        steepest = np.linalg.norm(make(1.0).gradient(points), axis=1).max()
        assert least < steepest <= 1 + 1e-12


def test_a_lattice_has_the_bounds_of_what_it_fills():
    assert sdf.gyroid(1.0, 0.1).bounds is None
    np.testing.assert_array_equal((sdf.gyroid(1.0, 0.1) & sdf.box(2)).bounds, sdf.box(2).bounds)
