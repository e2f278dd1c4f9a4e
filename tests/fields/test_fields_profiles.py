"""Profiles: outlines against brute force, curves against their formulas, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields.profiles import outline
from fields.profiles.curves import _near, _through, chords
from fields.profiles.edges import closed_edges, edges_distance, open_edges
from fields.profiles.simple import first_contact, signed_area
from tests.fields.catalogue.profiles import FLOWER, KNOTS, L_SHAPE, _in_polygon


def brute_force(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Signed distances to a polygon: every edge, and the crossings of a ray."""
    start, along = corners, np.roll(corners, -1, axis=0) - corners
    relative = points[:, None, :2] - start
    t = ((relative * along).sum(-1) / (along**2).sum(-1)).clip(0, 1)
    distance = np.linalg.norm(relative - t[..., None] * along, axis=-1).min(axis=1)
    return np.where(_in_polygon(points, corners), -distance, distance)


def random_polygon(rng: np.random.Generator, count: int) -> np.ndarray:
    """Star-shaped about the origin, so simple, and as jagged as can be."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    radius = rng.uniform(0.1, 1.0, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


# --- what a profile is ---


def test_profiles_do_not_depend_on_z_and_other_fields_do(catalogue):
    from tests.fields.catalogue import profiles, solids

    of_the_plane = {"left", "right", "front", "behind", "cylinder, infinite", "slice"}
    of_the_plane |= (profiles.EXAMPLES.keys() - {"lathe"}) | {"plane square to an axis"}
    for name in {*profiles.EXAMPLES, *solids.EXAMPLES, *of_the_plane, "box", "sphere", "below"}:
        assert catalogue[name].is_profile is (name in of_the_plane), name


def test_a_profile_stays_one_in_the_plane_only():
    square = sdf.rectangle(1)
    both = square.rotate(30).translate((1, 2, 3)).scale((1, 2, 3)).shell(0.1) - sdf.circle(0.1)
    assert both.is_profile
    assert not square.rotate(30, "x").is_profile
    assert not (square & sdf.below(1)).is_profile
    assert not sdf.from_function(lambda p: p[..., 0]).is_profile
    assert sdf.from_function(lambda p: p[..., 0]).slice(2).is_profile
    assert sdf.polygon(FLOWER).is_profile  # called at (x, y, 0)


def test_profiles_have_tight_bounds_in_the_plane(surfaces, rng):
    checked = 0
    for surface in surfaces.values():
        extent = surface.field._body.tags.extent[:, :2]
        if surface.field.is_profile and np.isfinite(extent).all():
            samples = surface.sample(rng, 50_000)[:, :2]
            measured = np.stack([samples.min(axis=0), samples.max(axis=0)])
            np.testing.assert_allclose(extent, measured, atol=2e-3)
            checked += 1
    assert checked > 20


@pytest.mark.parametrize(
    ("field", "points", "values"),
    [
        (sdf.circle(1), [(3, 4, 9), (0, 0, 5)], [4, -1]),
        (sdf.rectangle((2, 4)), [(0, 0, 0), (4, 6, 1), (0, 3, 0)], [-1, 5, 1]),
        (sdf.hexagon(2), [(0, 0, 0), (0, 3, 0)], [-1, 2]),
        (sdf.octagon(2), [(0, 0, 0), (0, 3, 0), (3, 0, 0)], [-1, 2, 2]),
        (sdf.regular_polygon(4, np.sqrt(2)), [(0, 0, 0), (2, 2, 0)], [-1, np.hypot(2, 2) - 1]),
        (sdf.cross(4, 2), [(0, 0, 0), (2, 2, 0), (5, 0, 0)], [-np.sqrt(2), 1, 3]),
        (sdf.ellipse((2, 1)), [(0, 0, 0), (0, 3, 0), (4, 0, 0), (2, 0, 0)], [-1, 2, 2, 0]),
        (sdf.triangle(6, 4), [(0, -5, 0), (6, -6, 0), (0, 4, 0)], [3, 5, 2]),
        (sdf.ring(2, 1), [(0, 0, 0), (2, 0, 0), (3, 0, 0)], [1.5, -0.5, 0.5]),
        (sdf.lathe([(2, -1), (2, 1)]), [(0, 0, 0), (0, 0, 3), (5, 0, 5)], [-1, 2, 5]),
    ],
    ids=lambda value: repr(value) if isinstance(value, sdf.Field) else "",
)
def test_values_worked_out_by_hand(field, points, values):
    # 1e-13: the ellipse replaces a height of 0 over its long axis by 1e-14.
    np.testing.assert_allclose(field(points), values, atol=1e-13)


# --- polygons ---


@pytest.mark.parametrize("count", [3, 4, 7, 16, 17, 300, 1500])
def test_a_polygon_is_its_distance_by_brute_force(count, rng):
    """Arithmetic for few edges, the search for more."""
    corners = random_polygon(rng, count)
    points = rng.uniform(-1.5, 1.5, (1_000, 3))
    field = sdf.polygon(corners)
    np.testing.assert_allclose(field(points), brute_force(points, corners), atol=1e-14)
    np.testing.assert_array_equal(sdf.polygon(corners[::-1])(points), field(points))
    assert any(i.kind == "call" for i in field.tape.instructions) is (count > outline.FEW)


def test_arithmetic_and_search_agree_also_at_the_corners(rng):
    corners = random_polygon(rng, 40)
    edges = closed_edges(corners)
    oracle = outline.OutlineOracle(edges)
    points = np.zeros((4_000, 3))
    points[:, :2] = np.repeat(corners, 100, axis=0) + rng.normal(size=(4_000, 2)) * 1e-3
    points[:40, :2] = corners
    values = sdf.Field(edges_distance(edges))(points)
    np.testing.assert_allclose(oracle(torch.from_numpy(points))[:, 0], values, atol=1e-15)
    np.testing.assert_allclose(values, brute_force(points, corners), atol=1e-15)


def test_a_search_has_gradients_of_any_order(rng):
    field = sdf.polygon(FLOWER)
    points = torch.from_numpy(rng.uniform(-1.5, 1.5, (50, 3)))
    few = sdf.Field(edges_distance(closed_edges(FLOWER)))
    np.testing.assert_allclose(field.gradient(points), few.gradient(points), atol=1e-13)
    at = points[:5].clone().requires_grad_()
    assert torch.autograd.gradcheck(field.evaluate, (at,))
    assert torch.autograd.gradgradcheck(field.evaluate, (at,))
    np.testing.assert_array_equal(field.gradient(torch.from_numpy(FLOWER[:1] @ np.eye(2, 3))), 0)


def test_a_search_encloses_its_values_in_boxes(rng):
    low = rng.uniform(-1.5, 1, (200, 3))
    boxes = np.stack([low, low + rng.uniform(0, 0.5, (200, 3))], axis=1)
    oracle = outline.OutlineOracle(closed_edges(FLOWER))
    ranges = oracle.enclose(boxes)[:, 0]
    inside = boxes[:, :1] + rng.uniform(0, 1, (200, 50, 3)) * np.diff(boxes, axis=1)
    values = oracle(torch.from_numpy(inside))[..., 0].numpy()
    assert (values >= ranges[:, :1]).all()
    assert (values <= ranges[:, 1:]).all()
    # z plays no part: the width is twice the half diagonal in the plane.
    diagonal = np.hypot(*np.diff(boxes, axis=1)[:, 0, :2].T)
    np.testing.assert_allclose(np.ptp(ranges, axis=1), diagonal, rtol=1e-6)


def test_equal_outlines_are_one_leaf():
    assert sdf.polygon(FLOWER).expression is sdf.polygon(FLOWER.copy()).expression


def test_corners_in_line_and_nearly_in_line_do_not_upset_the_sign(rng):
    """Where neither edge may claim a point, its sign is that of the corner's normals."""
    x = np.linspace(-1, 1, 41)
    for bend in (0.0, 1e-17, 1e-12, 1e-9, 1e-6):
        top = np.stack([x[::-1], 0.5 + bend * (1 - x**2)], axis=1)
        corners = np.concatenate([[(-1, 0), (1, 0)], top])
        for dtype, tolerance in ((np.float64, 1e-14), (np.float32, 1e-6)):
            points = np.zeros((4_100, 3), dtype=dtype)
            points[:, 0] = np.repeat(x, 100)
            points[:, 1] = rng.uniform(-1, 2, 4_100)
            field = sdf.Field(edges_distance(closed_edges(corners)))
            expected = brute_force(points.astype(float), corners)
            np.testing.assert_allclose(field(points), expected, atol=tolerance)


def test_holes_and_touching_parts(rng):
    """Two squares that touch in a corner, and one with a square hole."""
    square = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], dtype=float)
    hole = (0.25 + 0.5 * square)[::-1]
    field = sdf.Field(outline.outline_body([square, hole, square - 1]).expression)
    points = rng.uniform(-1.5, 1.5, (5_000, 3))
    parts = [brute_force(points, c) for c in (square, hole[::-1], square - 1)]
    inside = (parts[0] < 0) & (parts[1] > 0) | (parts[2] < 0)
    distance = np.abs(parts).min(axis=0)
    np.testing.assert_allclose(field(points), np.where(inside, -distance, distance), atol=1e-15)


@pytest.mark.parametrize(
    ("corners", "cause"),
    [
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "touch or cross"),
        ([(0, 0), (2, 0), (1, 0), (1, 1)], "touch or cross"),
        ([(0, 0), (4, 0), (4, 4), (2, 0), (0, 4)], "touch or cross"),
        ([(0, 0), (1, 0), (2, 0)], "touch or cross"),
        ([(0, 0), (3, 0), (3, 3), (2, 3), (2, 0), (1, 0), (1, 3), (0, 3)], "touch or cross"),
        ([(0, 0), (1, 1), (2, 0), (2, 2), (1, 1), (0, 2)], "touch or cross"),
        ([(0, 0), (1, 0)], "too few"),
        ([(0, 0), (1, 0), (0, 0)], "too few"),
        ([], "too few"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "points 1 and 2 are the same"),
        ([(0, 0), (1, 0), (1, np.nan)], "finite"),
        ([(0, 0), (1, 0), (1, 0, 0)], "not a pair"),
        ("abc", "points are needed"),
        (7, "points are needed"),
    ],
)
def test_what_is_no_simple_polygon_is_refused(corners, cause):
    with pytest.raises(InputError, match=cause) as caught:
        sdf.polygon(corners)
    assert caught.value.argument.startswith("points")
    assert caught.value.remedy


def test_contacts_are_decided_exactly():
    """A corner on an edge, and 1 ulp to either side of it; the products round to the same."""
    third = 1 / 3
    above, below = np.nextafter(third, 1), np.nextafter(third, 0)
    for height, is_bad in ((third, True), (above, False), (below, True)):
        notch = [(0, 0), (3, 1), (3, 2), (1, height), (0, 2)]
        from fractions import Fraction

        exact = Fraction(height) * 3 <= 1
        assert (first_contact(np.array(notch, dtype=float)) is not None) is exact
        if height != third:  # 1/3 itself is rounded, downwards
            assert exact is is_bad


def test_contacts_are_those_of_all_pairs(rng):
    """The search by boxes misses none: random closed chains against all pairs."""
    found = {True: 0, False: 0}
    for _ in range(300):
        corners = rng.uniform(-1, 1, (rng.integers(3, 8), 2))
        ends = np.roll(corners, -1, axis=0)
        n = len(corners)
        crossing = False
        for i in range(n):
            for j in range(i + 2, n - (i == 0)):
                m = np.column_stack([ends[i] - corners[i], corners[j] - ends[j]])
                t = np.linalg.solve(m, corners[j] - corners[i])
                crossing |= bool(((t >= 0) & (t <= 1)).all())
        assert (first_contact(corners) is not None) is crossing
        found[crossing] += 1
    assert min(found.values()) > 30


def test_a_repeated_first_corner_is_dropped():
    assert sdf.polygon([*L_SHAPE, L_SHAPE[0]]).expression is sdf.polygon(L_SHAPE).expression


# --- other shapes ---


@pytest.mark.parametrize("sides", [3, 4, 5, 6, 8, 17, 64])
def test_regular_polygons_are_polygons(sides, rng):
    angle = np.arange(sides) * 2 * np.pi / sides
    corners = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = rng.uniform(-2, 2, (2_000, 3))
    field = sdf.regular_polygon(sides, 1)
    np.testing.assert_allclose(field(points), brute_force(points, corners), atol=1e-14)
    wide = {6: sdf.hexagon, 8: None}.get(sides)
    if wide is not None:
        flats = wide(2 * np.cos(np.pi / sides))
        np.testing.assert_allclose(flats(points), field(points), atol=1e-14)


@pytest.mark.parametrize("ratio", [1e-3, 0.1, 0.5, 0.99, 1.0])
def test_an_ellipse_is_the_distance_to_dense_samples(ratio, rng):
    field = sdf.ellipse((1, ratio))
    t = np.linspace(0, np.pi / 2, 8_001)
    samples = np.stack([np.cos(t), ratio * np.sin(t)], axis=1)
    # Everywhere, near the long axis, and about the ends of the ridge inside.
    ridge = 1 - ratio**2
    points = np.concatenate([
        rng.uniform(0, 1.5, (300, 2)),
        rng.uniform(0, 1, (200, 2)) * (1, 1e-6),
        np.stack([ridge * (1 + rng.normal(size=200) * 1e-4), rng.uniform(0, 1e-6, 200)], axis=1),
    ])  # fmt: skip
    distance = np.linalg.norm(points[:, None] - samples, axis=-1).min(axis=1)
    inside = (points[:, 0] ** 2 + (points[:, 1] / ratio) ** 2) < 1
    values = field(np.column_stack([points, np.zeros(len(points))]))
    # Samples are up to 2e-4 apart: the nearest is too far by (1e-4)^2 / (2 d), at most 1e-4.
    np.testing.assert_allclose(np.abs(values), distance, atol=1e-4)
    assert (np.abs(values) <= distance + 1e-13).all()
    np.testing.assert_array_equal(values[distance > 1e-9] < 0, inside[distance > 1e-9])


def test_polylines_may_cross_themselves_and_close(rng):
    loop = np.array([(-1, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)], dtype=float)
    field = sdf.polyline(loop, 0.2)
    points = rng.uniform(-2, 2, (2_000, 3))
    relative = points[:, None, :2] - loop[:-1]
    along = np.diff(loop, axis=0)
    t = ((relative * along).sum(-1) / (along**2).sum(-1)).clip(0, 1)
    distance = np.linalg.norm(relative - t[..., None] * along, axis=-1).min(axis=1)
    np.testing.assert_allclose(field(points), distance - 0.1, atol=1e-14)
    assert not field.exact


@pytest.mark.parametrize(("make", "kind"), [(_through, "catmull-rom"), (_near, "b-spline")])
@pytest.mark.parametrize("tolerance", [0.1, 1e-2, 1e-4])
def test_chords_are_within_their_tolerance_of_the_curve(make, kind, tolerance):
    contour = make(KNOTS)
    corners = chords(contour, tolerance)
    t = np.linspace(0, 1, 2_001)[:, None, None]
    s = 1 - t
    a, b, c, d = contour.transpose(1, 0, 2)
    curve = (s**3 * a + 3 * s * s * t * b + 3 * s * t * t * c + t**3 * d).reshape(-1, 2)
    points = np.column_stack([curve, np.zeros(len(curve))])
    error = np.abs(brute_force(points, corners)).max()
    assert 0.2 * tolerance < error <= tolerance or len(corners) == len(contour)
    field = sdf.spline(KNOTS, kind, tolerance)
    assert field.exact
    assert np.abs(field(points)).max() <= tolerance + 1e-15


def test_splines_pass_through_their_points_or_stay_inside(rng):
    at = np.column_stack([KNOTS, np.zeros(len(KNOTS))])
    assert np.abs(sdf.spline(KNOTS)(at)).max() < 1e-15
    hull = sdf.polygon([(0, 0), (4, 0), (4, 4), (0, 4)])
    smooth = sdf.spline([(0, 0), (4, 0), (4, 4), (0, 4)], "b-spline", 1e-5)
    points = rng.uniform(-1, 5, (2_000, 3))
    assert (smooth(points) >= hull(points)).all()
    # Four segments of a quarter turn: the middle of a side is at 11/12 of the hull's.
    circle = sdf.spline(
        [(1, 0), (1, 0.5523), (0.5523, 1), (0, 1), (-0.5523, 1), (-1, 0.5523), (-1, 0),
         (-1, -0.5523), (-0.5523, -1), (0, -1), (0.5523, -1), (1, -0.5523)], "bezier", 1e-5,
    )  # fmt: skip
    np.testing.assert_allclose(circle(points), np.hypot(*points[:, :2].T) - 1, atol=3e-4)


def test_a_lathe_takes_its_outline_in_either_direction(rng):
    outline_points = [(0.7, -0.9), (0.9, -0.2), (0, 1)]
    points = rng.uniform(-2, 2, (1_000, 3))
    forth, back = sdf.lathe(outline_points), sdf.lathe(outline_points[::-1])
    np.testing.assert_array_equal(forth(points), back(points))
    cone = sdf.cone(0.8, 1.6)
    np.testing.assert_allclose(sdf.lathe([(0.8, -0.8), (0, 0.8)])(points), cone(points), atol=1e-14)
    t = np.linspace(-np.pi / 2, np.pi / 2, 201)
    ball = sdf.lathe(np.stack([np.cos(t).clip(0), np.sin(t)], axis=1)[1:-1])
    # Chords of pi / 200 are within (pi / 200)^2 / 8 of the circle; the flat ends within that too.
    np.testing.assert_allclose(ball(points), sdf.sphere(1)(points), atol=1.3e-4)


@pytest.mark.parametrize(
    ("make", "argument", "cause"),
    [
        (lambda: sdf.circle(0), "radius", "greater than zero"),
        (lambda: sdf.circle(1, (0, 0, 0)), "center", "not a pair"),
        (lambda: sdf.rectangle((1, -1)), "size[1]", "greater than zero"),
        (lambda: sdf.rounded_rectangle(1, 0.6), "radius", "half of the shorter edge"),
        (lambda: sdf.rounded_rectangle(1, (0.1, 0.2)), "radius", "2 radii for four corners"),
        (lambda: sdf.cross(1, 1), "width", "as wide as long"),
        (lambda: sdf.regular_polygon(2, 1), "sides", "at least 3"),
        (lambda: sdf.regular_polygon(3.5, 1), "sides", "whole number"),
        (lambda: sdf.star(5, 1, 0.9), "inner", "would be tips"),
        (lambda: sdf.ring(1, 2), "width", "closes the hole"),
        (lambda: sdf.arc(1, 0.5, 350), "degrees", "round ends meet"),
        (lambda: sdf.pie(1, 360), "degrees", "full turn"),
        (lambda: sdf.vesica(2, 1), "width", "below the height"),
        (lambda: sdf.moon(1, 0.2, 0.5), "distance", "do not cross"),
        (lambda: sdf.line((1, 1), (1, 1), 1), "b", "no direction"),
        (lambda: sdf.uneven_capsule(1, 0.2, 0.5), "height", "inside the other"),
        (lambda: sdf.ellipse((1, 0)), "radii[1]", "greater than zero"),
        (lambda: sdf.polyline([(0, 0)], 1), "points", "too few"),
        (lambda: sdf.polyline([(0, 0), (0, 0)], 1), "points", "are the same"),
        (lambda: sdf.spline(KNOTS, "nurbs"), "kind", "no such curve"),
        (lambda: sdf.spline(KNOTS[:4], "bezier"), "points", "no closed chain"),
        (lambda: sdf.spline(KNOTS, tolerance=0), "tolerance", "greater than zero"),
        (lambda: sdf.spline([(0, 0), (1, 1), (1, 0), (0, 1)]), "points", "touch or cross"),
        (lambda: sdf.lathe([(0, 0), (-1, 1), (0, 2)]), "points", "crosses the axis"),
        (lambda: sdf.lathe([(0, 0), (1, 1), (0, 2), (1, 3)]), "points", "touches it"),
        (lambda: sdf.lathe([(1, 0), (2, 2), (2, 0), (1, 2)]), "points", "touch or cross"),
    ],
)  # fmt: skip
def test_bad_parameters_are_named(make, argument, cause):
    with pytest.raises(InputError, match=cause) as caught:
        make()
    assert caught.value.argument == argument
    assert caught.value.remedy


def test_open_chains_end_in_a_corner_of_their_own():
    edges = open_edges(np.array([(0.0, 0.0), (2.0, 0.0)]))
    distance = sdf.Field(abs(edges_distance(edges)))
    np.testing.assert_array_equal(distance([(1, 3, 0), (5, 4, 0), (-3, -4, 0)]), [3, 5, 5])
    assert signed_area(np.array([(0, 0), (0, 1), (1, 0)])) == -0.5
