"""What the selection tools pick, against brute force, and the laws of picks."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

import fields
from implicit_warp.errors import InputError
from implicit_warp.viewer import regions
from implicit_warp.viewer.regions import Camera, selected

SPHERE = trimesh.creation.icosphere(subdivisions=4)  # 2,562 vertices, edges about 0.07
VERTICES, FACES = np.asarray(SPHERE.vertices), np.asarray(SPHERE.faces)


def looking(eye, at=(0.0, 0.0, 0.0), fov: float = 0.9, aspect: float = 1.6) -> Camera:
    """A camera at a place that looks at another, with z up."""
    eye = np.asarray(eye, np.float64)
    ahead = np.asarray(at, np.float64) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(ahead, right), ahead], axis=1)
    return Camera(eye, Rotation.from_matrix(axes).as_quat(scalar_first=True), fov, aspect)


def masks(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Picks of the sphere's vertices, of every kind that a hand makes and some that none does."""
    height, one = VERTICES[:, 2], np.zeros(len(VERTICES), np.bool_)
    one[17] = True
    return {
        "half": VERTICES @ (0.6, 0.3, 0.2) > 0.1,
        "band": np.abs(height) < 0.06,
        "cap": height > 0.9,
        "two areas": np.abs(VERTICES[:, 0]) > 0.8,
        "one vertex": one,
        "all but one": ~one,
        "all": np.ones(len(VERTICES), np.bool_),
        "scattered": rng.random(len(VERTICES)) < 0.05,
        "holes": (height > 0) & (rng.random(len(VERTICES)) < 0.9),
    }


KINDS = list(masks(np.random.default_rng(0)))


# --- brush, box, ball ---


def test_brush_picks_the_vertices_within_its_radius(rng):
    for _ in range(20):
        center, radius = VERTICES[rng.integers(len(VERTICES))], rng.uniform(0.05, 1.5)
        expected = np.linalg.norm(VERTICES - center, axis=1) <= radius
        unclear = np.abs(np.linalg.norm(VERTICES - center, axis=1) - radius) < 1e-4
        picked = selected(regions.ball(center, radius), VERTICES)
        np.testing.assert_array_equal(picked[~unclear], expected[~unclear])


def test_box_picks_what_lies_in_it_at_any_pose(rng):
    for turn in [Rotation.identity(), *Rotation.random(20, rng=rng)]:
        position, size = rng.uniform(-0.5, 0.5, 3), rng.uniform(0.3, 1.5, 3)
        margin = np.abs(turn.inv().apply(VERTICES - position)) - 0.5 * size
        region = regions.block(position, turn.as_quat(scalar_first=True), size)
        clear = np.abs(margin).min(axis=1) > 1e-4
        expected = (margin < 0).all(axis=1)
        np.testing.assert_array_equal(selected(region, VERTICES)[clear], expected[clear])


def test_picks_far_from_the_origin_are_as_sharp(rng):
    far = np.array([4.0e5, -7.0e5, 1.0e5])
    near = selected(regions.ball(VERTICES[5], 0.5), VERTICES)
    np.testing.assert_array_equal(
        selected(regions.ball(VERTICES[5] + far, 0.5), VERTICES + far), near
    )
    pose, size = Rotation.random(rng=rng).as_quat(scalar_first=True), (0.7, 0.8, 0.9)
    near = selected(regions.block(VERTICES[5], pose, size), VERTICES)
    moved = selected(regions.block(VERTICES[5] + far, pose, size), VERTICES + far)
    np.testing.assert_array_equal(moved, near)


def test_no_region_picks_nothing_and_no_vertices_are_no_error():
    assert not selected(None, VERTICES).any()
    assert selected(fields.sphere(1), np.empty((0, 3))).shape == (0,)


# --- the algebra of picks ---


def test_picks_combine_as_their_masks_do():
    first, second = regions.ball((0, 0, 1), 0.913), regions.ball((0, 1, 0.3), 0.829)
    a, b = selected(first, VERTICES), selected(second, VERTICES)
    assert (a & b).any()
    assert (a & ~b).any()
    assert (b & ~a).any()

    def picked(old, how):
        return selected(regions.combined(old, second, how), VERTICES)

    np.testing.assert_array_equal(picked(first, "new"), b)
    np.testing.assert_array_equal(picked(first, "add"), a | b)
    np.testing.assert_array_equal(picked(first, "subtract"), a & ~b)
    np.testing.assert_array_equal(picked(None, "add"), b)
    assert regions.combined(None, second, "subtract") is None
    with pytest.raises(InputError, match="how"):
        regions.combined(first, second, "intersect")


def test_inverting_is_the_complement_and_its_own_inverse():
    region, bounds = regions.ball((0, 0, 1), 0.913), SPHERE.bounds
    mask = selected(region, VERTICES)
    other = regions.inverted(region, bounds)
    np.testing.assert_array_equal(selected(other, VERTICES), ~mask)
    np.testing.assert_array_equal(selected(regions.inverted(other, bounds), VERTICES), mask)
    assert selected(regions.inverted(None, bounds), VERTICES).all()


@pytest.mark.parametrize("distance", [0.03, 0.1, 0.4])
@pytest.mark.parametrize("kind", ["ball", "union", "cover", "difference"])
def test_growing_holds_all_that_is_near_and_shrinking_brings_back_no_less(kind, distance):
    region = {
        "ball": regions.ball((0, 0, 1), 0.5),
        "union": regions.ball((0, 0, 1), 0.5) | regions.ball((0, 0.6, 0.8), 0.4),
        "cover": regions.covering(VERTICES, VERTICES[:, 2] > 0.5),
        "difference": regions.ball((0, 0, 1), 0.5) - regions.ball((0, 0.6, 0.8), 0.4),
    }[kind]
    mask = selected(region, VERTICES)
    bigger = regions.grown(region, distance, VERTICES)
    near = cdist(VERTICES, VERTICES[mask]).min(axis=1) < 0.999 * distance
    assert selected(bigger, VERTICES)[mask | near].all()
    assert selected(regions.grown(bigger, -distance, VERTICES), VERTICES)[mask].all()


def test_shrinking_a_cover_takes_its_border_and_leaves_no_gaps():
    mask = VERTICES[:, 2] > 0.2
    smaller = selected(regions.grown(regions.covering(VERTICES, mask), -0.2, VERTICES), VERTICES)
    gap = cdist(VERTICES, VERTICES[~mask]).min(axis=1)
    np.testing.assert_array_equal(smaller, gap > 0.2)


@pytest.mark.parametrize("other", [(0, 0, 1), (1, 0, 0)])
def test_shrinking_to_nothing_is_refused(other):
    region = regions.combined(regions.ball((0, 0, 1), 0.2), regions.ball(other, 0.2), "add")
    with pytest.raises(InputError, match="nothing would be left"):
        regions.grown(region, -0.4, VERTICES)


# --- covers of single vertices ---


@pytest.mark.parametrize("far", [0.0, 1e4], ids=["at the origin", "far away"])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 500.0])
@pytest.mark.parametrize("kind", KINDS)
def test_cover_holds_the_picked_vertices_and_no_others(kind, scale, far, rng):
    vertices, mask = scale * (VERTICES + far * np.array([1.0, -1.0, 0.5])), masks(rng)[kind]
    region = regions.covering(vertices, mask)
    np.testing.assert_array_equal(selected(region, vertices), mask)


@pytest.mark.parametrize("kind", KINDS)
def test_cover_as_text_is_the_same_region(kind, rng):
    region = regions.covering(VERTICES, masks(rng)[kind])
    again = fields.parse(repr(region))
    np.testing.assert_array_equal(again(VERTICES), region(VERTICES))


def test_cover_of_an_area_takes_few_balls():
    region = regions.covering(VERTICES, masks(np.random.default_rng(0))["half"])
    assert repr(region).count("sphere") < 60


def test_cover_of_too_scattered_vertices_is_refused_and_never_cut_short(rng):
    fine = np.asarray(trimesh.creation.icosphere(subdivisions=5).vertices)
    with pytest.raises(InputError, match="too scattered"):
        regions.covering(fine, rng.random(len(fine)) < 0.5)
    with pytest.raises(InputError, match="nothing in it"):
        regions.covering(fine, np.zeros(len(fine), np.bool_))


# --- the screen ---


def test_camera_projects_as_a_pinhole_with_y_down():
    camera = looking((4.0, 0.0, 0.0), fov=np.pi / 2, aspect=2.0)
    points = np.array([(0, 0, 0), (0, 0, 4), (0, 4, 0), (0, -8, 0), (5, 0, 0)], np.float64)
    places, ahead = camera.on_screen(points)
    np.testing.assert_array_equal(ahead, [True, True, True, True, False])
    # Straight ahead; the upper edge; y points right of an eye on +x; the left edge.
    expected = [(0.5, 0.5), (0.5, 0.0), (0.75, 0.5), (0.0, 0.5)]
    np.testing.assert_allclose(places[:4], expected, atol=1e-12)


@pytest.mark.parametrize("far", [0.0, 1e6], ids=["at the origin", "far away"])
def test_rectangle_takes_what_is_seen_in_it_or_all_that_is_there(far):
    eye = np.array([3.0, 1.0, 1.5])
    camera = looking(eye + far, (far, far, far))
    vertices = VERTICES + far
    places, _ = camera.on_screen(vertices)
    low, high = np.array([0.45, 0.3]), np.array([0.75, 0.6])
    inside = ((places >= low) & (places <= high)).all(axis=1)
    assert 50 < inside.sum() < 2000

    def picked(through):
        return regions.in_rectangle(vertices, FACES, camera, low, high, through=through)

    np.testing.assert_array_equal(picked(True), inside)
    facing = ((eye - VERTICES) * VERTICES).sum(axis=1)  # of a convex shape: seen where positive
    clear = np.abs(facing) > 0.15
    np.testing.assert_array_equal(picked(False)[clear], (inside & (facing > 0))[clear])


def test_rectangle_leaves_out_what_another_part_hides():
    front, back = SPHERE.copy(), SPHERE.copy()
    front.apply_translation((2.5, 0, 0))
    both = trimesh.util.concatenate([front, back])
    camera = looking((30.0, 0.0, 0.0), fov=0.2)
    picked = regions.in_rectangle(
        np.asarray(both.vertices), np.asarray(both.faces), camera, (0, 0), (1, 1), through=False
    )
    n = len(VERTICES)
    assert picked[:n].any()
    assert not picked[n:][np.hypot(VERTICES[:, 1], VERTICES[:, 2]) < 0.8].any()


def test_rectangle_sees_one_side_of_a_thin_plate():
    plate = trimesh.creation.box((1, 1, 1e-3)).subdivide_loop(0).subdivide().subdivide()
    vertices = np.asarray(plate.vertices)
    picked = regions.in_rectangle(
        vertices, np.asarray(plate.faces), looking((0.0, 0.1, 3.0)), (0, 0), (1, 1), through=False
    )
    inner = np.abs(vertices[:, :2]).max(axis=1) < 0.4
    np.testing.assert_array_equal(picked[inner], vertices[inner, 2] > 0)


def test_rectangle_behind_the_camera_picks_nothing():
    away = looking((3.0, 0.0, 0.0), at=(6.0, 0.0, 0.0))
    for through in (False, True):
        assert not regions.in_rectangle(
            VERTICES, FACES, away, (0, 0), (1, 1), through=through
        ).any()


# --- connected parts ---


def test_part_is_what_hangs_together_with_the_pick():
    parts = [SPHERE.copy() for _ in range(3)]
    for number, part in enumerate(parts):
        part.apply_translation((3.0 * number, 0, 0))
    both = trimesh.util.concatenate(parts)
    owner = np.repeat(np.arange(3), len(VERTICES))
    mask = np.zeros(len(owner), np.bool_)
    mask[[3, 2 * len(VERTICES) + 5]] = True
    part = regions.part_of(np.asarray(both.faces), mask)
    np.testing.assert_array_equal(part, owner != 1)
    region = regions.covering(np.asarray(both.vertices), part)
    np.testing.assert_array_equal(selected(region, np.asarray(both.vertices)), part)
    assert not regions.part_of(np.asarray(both.faces), np.zeros_like(mask)).any()


# --- picking by a ray ---


def test_ray_finds_the_point_at_rest_under_the_pointer(rng):
    turn, away = Rotation.from_euler("xyz", (0.4, 1.0, -0.7)), np.array([5.0, -2.0, 1.0])
    shown = turn.apply(1.7 * VERTICES) + away
    for _ in range(20):
        rest = np.array(SPHERE.triangles_center)[rng.integers(len(FACES))]
        there = turn.apply(1.7 * rest) + away
        out = turn.apply(rest)
        point = regions.picked_point(SPHERE, shown, there + 4.0 * out, -out)
        np.testing.assert_allclose(point, rest, atol=1e-5)


def test_ray_takes_the_nearer_side_and_misses_give_nothing():
    point = regions.picked_point(SPHERE, VERTICES, (0.1, 0.05, 5.0), (0, 0, -1))
    assert point is not None
    assert point[2] > 0.9
    assert regions.picked_point(SPHERE, VERTICES, (2.0, 0, 5.0), (0, 0, -1)) is None


def test_ray_is_as_exact_far_from_the_origin():
    far = np.array([1e6, -2e6, 3e6])
    origin = np.array([0.1, 0.05, 5.0])
    near = regions.picked_point(SPHERE, VERTICES, origin, (0, 0, -1))
    point = regions.picked_point(SPHERE, VERTICES + far, origin + far, (0, 0, -1))
    np.testing.assert_allclose(point, near, atol=1e-5)
