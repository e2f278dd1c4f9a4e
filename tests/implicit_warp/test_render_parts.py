"""The renderer's parts: camera, normals, colours, sample patterns, filter, light."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from implicit_warp.errors import InputError
from implicit_warp.render import Camera
from implicit_warp.render.camera import NEAREST
from implicit_warp.render.lighting import (
    GROUND_HALF,
    KEY_SPREAD,
    Ground,
    Stage,
    _smoothed_visibility,
)
from implicit_warp.render.sampling import (
    TILE,
    cone,
    cosine_lobe,
    in_tiles,
    ordered,
    smooth_on_surface,
    turned,
    unit_square,
)
from implicit_warp.render.scene import Scene
from implicit_warp.render.surface import (
    Paint,
    corner_normals,
    linear_to_srgb,
    srgb_to_linear,
)

SIZE = (320, 240)


# --- camera ---------------------------------------------------------------------------


def random_cloud(rng: np.random.Generator) -> np.ndarray:
    """A lopsided cloud anywhere, of any size between a micrometre and a thousand kilometres."""
    scale = 10.0 ** rng.uniform(-6, 6)
    return scale * (rng.normal(size=(30, 3)) * rng.uniform(0.01, 1, 3) + rng.normal(size=3) * 5)


@pytest.mark.parametrize("case", range(40))
def test_the_fitted_camera_holds_every_point_and_none_could_be_closer(rng, case):
    rng = np.random.default_rng([rng.integers(1 << 32), case])
    points, margin = random_cloud(rng), rng.uniform(0, 0.3)
    size = tuple(int(n) for n in rng.integers(100, 2000, 2))
    camera = Camera.fit_points(
        points,
        direction=rng.normal(size=3),
        size=size,
        up=rng.normal(size=3),
        fov=rng.uniform(5, 100),
        margin=margin,
    )
    inside = camera.project(points, size) / size
    # Projection divides two numbers of the cloud's size: a few hundred roundings at most, and the
    # cloud is up to twenty times as far from the origin as it is large.
    assert inside.min() > margin - 1e-9
    assert inside.max() < 1 - margin + 1e-9
    touched = np.minimum(inside, 1 - inside).min(axis=0) < margin + 1e-9
    if not touched.any():
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        radius = np.linalg.norm(points - middle, axis=1).max()
        ahead = (camera.eye - points) @ camera.axes()[2]
        assert ahead.min() == pytest.approx(NEAREST * radius, rel=1e-6)
        return
    # Centred along both axes: what is free on one side is free on the other.
    tight = np.flatnonzero(touched)[0]
    assert inside[:, tight].min() == pytest.approx(1 - inside[:, tight].max(), abs=1e-9)


def test_fit_to_a_box_is_fit_to_its_corners(rng):
    low = rng.normal(size=3)
    box = np.stack([low, low + rng.uniform(0.1, 3, 3)])
    corners = trimesh.bounds.corners(box)
    assert np.allclose(Camera.fit(box).eye, Camera.fit_points(corners).eye, rtol=1e-12)


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1), (0, 0, 5), (1e-9, 0, 1)])
def test_a_camera_may_look_along_up(direction):
    camera = Camera.fit([[-1, -2, -3], [1, 2, 3]], direction=direction, size=SIZE)
    axes = camera.axes()
    assert np.allclose(axes @ axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    assert np.isfinite(camera.project([[1, 2, 3], [-1, -2, -3]], SIZE)).all()


def test_projecting_undoes_casting(rng):
    camera = Camera(eye=(3, -4, 2), target=(0.3, 0.1, -0.2), up=(0.1, 0.2, 1), fov=40)
    columns, rows = rng.uniform(0, 320, 50), rng.uniform(0, 240, 50)
    points = camera.eye + rng.uniform(1, 9, (50, 1)) * camera.directions(columns, rows, SIZE)
    assert np.allclose(camera.project(points, SIZE), np.stack([columns, rows], -1), atol=1e-9)


def test_the_target_is_in_the_middle_and_points_behind_are_nan():
    camera = Camera(eye=(3, -4, 2), target=(0.3, 0.1, -0.2))
    assert np.allclose(camera.project(camera.target, SIZE), (160, 120))
    behind = 2 * np.array(camera.eye) - camera.target
    assert np.isnan(camera.project(behind, SIZE)).all()


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Camera((1, 2, 3), (1, 2, 3)), "eye"),
        (lambda: Camera((1, 2, math.nan), (0, 0, 0)), "eye"),
        (lambda: Camera((1, 2, 3), (0, 0, 0), up=(0, 0, 0)), "up"),
        (lambda: Camera((1, 2, 3), (0, 0, 0), fov=180), "fov"),
        (lambda: Camera.fit([[0, 0, 0], [0, 0, 0]]), "points"),
        (lambda: Camera.fit([[0, 0, 0], [1, 1, math.inf]]), "bounds"),
        (lambda: Camera.fit([[0, 0, 0], [1, 1, 1]], margin=0.5), "margin"),
        (lambda: Camera.fit([[0, 0, 0], [1, 1, 1]], direction=(0, 0, 0)), "direction"),
        (lambda: Camera.fit([[0, 0, 0], [1, 1, 1]], size=(0, 3)), "size"),
        (lambda: Camera.fit_points([]), "points"),
    ],
)
def test_an_impossible_camera_is_refused_by_name(make, named):
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.argument.partition("[")[0] == named


# --- normals --------------------------------------------------------------------------


def corner_normals_slowly(vertices, faces, crease_angle):
    """The definition, corner by corner; compares positions, not indices."""
    triangles = vertices[faces]
    flat = [np.cross(t[1] - t[0], t[2] - t[0]) for t in triangles]
    flat = [n / np.linalg.norm(n) for n in flat]
    result = np.zeros(triangles.shape)
    for f, triangle in enumerate(triangles):
        for c in range(3):
            for g, other in enumerate(triangles):
                cosine = np.clip(flat[f] @ flat[g], -1, 1)
                if g != f and math.degrees(math.acos(cosine)) > crease_angle:
                    continue
                for d in range(3):
                    if (other[d] == triangle[c]).all():
                        e, h = other[d - 2] - other[d], other[d - 1] - other[d]
                        cosine = e @ h / np.linalg.norm(e) / np.linalg.norm(h)
                        result[f, c] += math.acos(np.clip(cosine, -1, 1)) * flat[g]
    return result / np.linalg.norm(result, axis=-1, keepdims=True)


@pytest.mark.parametrize("crease_angle", [0.0, 20.0, 50.0, 95.0, 179.0])
@pytest.mark.parametrize("soup", [False, True])
def test_corner_normals_equal_the_definition(rng, crease_angle, soup):
    mesh = trimesh.creation.icosphere(subdivisions=1)
    vertices = mesh.vertices * (1 + 0.3 * rng.uniform(size=(len(mesh.vertices), 1)))
    faces = np.asarray(mesh.faces)
    if soup:
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    fast = corner_normals(vertices, faces, crease_angle)
    # arccos near one loses half the digits, in both; angles between faces that happen to be
    # within 1e-8 of the crease are the only thing that could differ more.
    assert np.allclose(fast, corner_normals_slowly(vertices, faces, crease_angle), atol=1e-7)


def test_a_box_keeps_its_edges_and_a_sphere_is_round():
    box = trimesh.creation.box()
    flat = corner_normals(box.vertices, box.faces, 50.0)
    assert np.allclose(flat, box.face_normals[:, None], atol=1e-12)
    ball = trimesh.creation.icosphere(subdivisions=3)
    round_ = corner_normals(ball.vertices, ball.faces, 50.0)
    # The mean of the faces around a vertex deviates from the sphere's normal by less than one face
    # does: by less than the longest edge, in radians.
    longest = ball.edges_unique_length.max()
    assert np.abs(round_ - ball.vertices[ball.faces]).max() < longest


def test_a_face_without_area_has_no_normal_and_harms_no_other():
    box = trimesh.creation.box()
    faces = np.vstack([box.faces, [[0, 1, 1]]])
    normals = corner_normals(box.vertices, faces, 50.0)
    assert np.isfinite(normals).all()
    assert np.allclose(normals[:-1], box.face_normals[:, None], atol=1e-12)


# --- colours --------------------------------------------------------------------------


def test_srgb_there_and_back():
    values = np.linspace(0, 1, 1001)
    # The standard's two pieces meet only to about 1e-7.
    assert np.allclose(linear_to_srgb(srgb_to_linear(values)), values, atol=1e-6)
    assert srgb_to_linear(np.array([0.0, 1.0])) == pytest.approx([0, 1])


def test_each_kind_of_colour_at_a_known_place():
    mesh = trimesh.creation.box()
    face, weights = np.array([4]), np.array([[0.2, 0.3, 0.5]])
    points = np.einsum("nc,nci->ni", weights, mesh.vertices[mesh.faces[face]])

    def at(color):
        return Paint(color, mesh.vertices, mesh.faces)(face, weights, points)

    per_vertex = np.linspace(0, 1, 24).reshape(8, 3)
    per_face = np.linspace(1, 0, 36).reshape(12, 3)
    assert np.allclose(at((0.2, 0.4, 0.6)), srgb_to_linear(np.array([0.2, 0.4, 0.6])))
    assert np.allclose(at(per_vertex), weights @ srgb_to_linear(per_vertex[mesh.faces[4]]))
    assert np.allclose(at(per_face), srgb_to_linear(per_face[4]))
    assert np.allclose(at(lambda p: p + 0.5), srgb_to_linear(points + 0.5))


# --- patterns and filter --------------------------------------------------------------


@pytest.mark.parametrize("side", [1, 2, 4, 8, 16])
def test_the_ordered_matrix_holds_each_rank_once(side):
    assert sorted(ordered(side).ravel()) == list(range(side * side))


def test_every_window_of_the_tiles_size_sees_the_whole_pattern(rng):
    pattern = unit_square(3)
    for _ in range(10):
        top, left = rng.integers(0, 100, 2)
        rows, columns = np.indices((TILE, TILE)).reshape(2, -1)
        seen = in_tiles(pattern, rows + top, columns + left).reshape(-1, 2)
        assert np.array_equal(np.unique(seen, axis=0), np.unique(pattern.reshape(-1, 2), axis=0))


def test_the_cosine_lobe_has_the_mean_of_a_cosine_lobe():
    square = unit_square(4)
    lobe = cosine_lobe(square).reshape(-1, 3)
    u = np.sort(square[..., 0].ravel())
    n = len(u)
    # z = sqrt(1 - u) is monotone with total variation one, so by Koksma's inequality its mean is
    # off by no more than the discrepancy of u.
    discrepancy = np.maximum(np.arange(1, n + 1) / n - u, u - np.arange(n) / n).max()
    assert discrepancy < 0.02
    assert lobe[:, 2].mean() == pytest.approx(2 / 3, abs=discrepancy)
    assert np.allclose(np.linalg.norm(lobe, axis=1), 1, atol=1e-6)


def test_the_cone_stays_within_its_spread():
    axis = np.array([2, -3, 6]) / 7
    directions = cone(unit_square(2), axis, 0.1)
    assert np.allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-6)
    assert (directions @ axis).min() > math.cos(math.atan(0.1)) - 1e-6
    assert (directions @ axis).min() < math.cos(math.atan(0.09))


def test_turning_is_a_rotation_that_takes_up_to_the_normal(rng):
    normals = rng.normal(size=(50, 3))
    normals = np.vstack([normals / np.linalg.norm(normals, axis=1, keepdims=True), np.eye(3)])
    normals = np.vstack([normals, -np.eye(3)])
    frames = turned(np.broadcast_to(np.eye(3), (len(normals), 3, 3)), normals)
    assert np.allclose(frames[:, 2], normals)
    assert np.allclose(frames @ frames.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(frames), 1)


def smooth_slowly(values, positions, normals, covered, thickness):
    """The filter's definition for one axis at a time, pixel by pixel."""
    for axis in (0, 1):
        result = np.zeros_like(values)
        for here in np.ndindex(covered.shape):
            if not covered[here]:
                continue
            parts = []
            for shift in range(-TILE // 2, TILE // 2):
                there = (here[0] + shift, here[1]) if axis == 0 else (here[0], here[1] + shift)
                if not all(0 <= t < n for t, n in zip(there, covered.shape, strict=True)):
                    continue
                offset = normals[here] @ (positions[there] - positions[here])
                agree = normals[here] @ normals[there] > 0.9
                if covered[there] and (shift == 0 or (agree and abs(offset) < thickness)):
                    parts.append(values[there])
            result[here] = np.mean(parts, axis=0)
        values = result
    return values


def test_the_filter_equals_its_definition(rng):
    shape = (13, 17)
    covered = rng.uniform(size=shape) < 0.8
    values = rng.uniform(size=(*shape, 2))
    positions = rng.uniform(size=(*shape, 3)) * [1, 1, 0.02]
    tilt = rng.normal(size=(*shape, 3)) * 0.2 + [0, 0, 1]
    normals = tilt / np.linalg.norm(tilt, axis=-1, keepdims=True)
    single = [a.astype(np.float32) for a in (values, positions, normals)]
    fast = smooth_on_surface(*single, covered, 0.3)
    slow = smooth_slowly(values, positions, normals, covered, 0.3)
    assert np.allclose(fast[covered], slow[covered], atol=1e-5)  # sums of 8 in float32


def test_the_filter_does_not_mix_two_surfaces():
    positions = np.zeros((16, 16, 3), np.float32)
    positions[:, 8:, 2] = 1  # a step
    normals = np.broadcast_to(np.float32([0, 0, 1]), (16, 16, 3))
    values = np.where(positions[..., 2:] > 0, 1, 0).astype(np.float32)
    smoothed = smooth_on_surface(values, positions, normals, np.ones((16, 16), bool), 0.1)
    assert np.array_equal(smoothed, values)


# --- light ----------------------------------------------------------------------------


def scene_of(mesh: trimesh.Trimesh) -> Scene:
    paint = Paint(None, mesh.vertices, mesh.faces)
    return Scene(mesh.vertices, mesh.faces, paint, center=np.zeros(3), size=1.0, crease_angle=50.0)


def visibility(mesh: trimesh.Trimesh, direction="-y") -> tuple[np.ndarray, np.ndarray, Stage]:
    """Positions hit in a small picture, what `_smoothed_visibility` says of them, the stage."""
    scene = scene_of(mesh)
    camera = Camera.fit_points(mesh.vertices, direction=direction, size=(64, 64))
    stage = Stage.around(camera, float(mesh.vertices[:, 2].min()), ground=True)
    rows, columns = np.indices((64, 64)).reshape(2, -1)
    hits = scene.cast(np.array(camera.eye), camera.directions(columns + 0.5, rows + 0.5, (64, 64)))
    found = _smoothed_visibility(scene, stage, hits, rows[hits.ray], columns[hits.ray])
    return hits.position, found, stage


def test_a_convex_body_hides_nothing_from_itself():
    position, light, stage = visibility(trimesh.creation.icosphere(subdivisions=4, radius=0.5))
    assert (light[:, 2] == 0).all()
    # The whole of the key light is above the horizon where its middle is more than its radius
    # above; twice that leaves room for the filter, which averages over neighbours.
    high = position @ stage.key / 0.5 > 2 * KEY_SPREAD
    assert high.any()
    assert (light[high, 3] == 1).all()


def test_a_pit_is_darker_at_its_bottom():
    pit = trimesh.creation.annulus(r_min=0.2, r_max=0.3, height=0.4)
    floor = trimesh.creation.box(extents=(0.6, 0.6, 0.02))
    floor.apply_translation((0, 0, -0.21))
    pit = trimesh.util.concatenate([pit, floor])
    position, light, _ = visibility(pit, direction=(0.1, -0.2, 1))
    bottom = (np.linalg.norm(position[:, :2], axis=1) < 0.19) & (position[:, 2] < -0.1)
    top = (np.abs(np.linalg.norm(position[:, :2], axis=1) - 0.25) < 0.04) & (position[:, 2] > 0.199)
    assert bottom.any()
    assert top.any()
    assert light[bottom, 2].min() > 0.3
    assert light[top, 2].max() == 0


def test_the_ground_is_dark_under_a_body_and_bright_far_away():
    body = trimesh.creation.box(extents=(0.4, 0.4, 0.4))
    body.apply_translation((0, 0, 0.2))
    camera = Camera(eye=(0, -3, 3), target=(0, 0, 0))
    stage = Stage.around(camera, 0.0, ground=True)
    ground = Ground(scene_of(body), stage, 0.0)
    eye = np.array(camera.eye)

    def light(*place):
        towards = np.array([place]) - eye
        return float(ground.light_along(eye, towards / np.linalg.norm(towards))[0])

    assert light(0, 0, 0) < 0.05
    shadow_of_middle = np.array([0, 0, 0.2]) - 0.2 / stage.key[2] * stage.key
    assert light(*shadow_of_middle) < 0.6
    assert light(0, 2 * GROUND_HALF, 0) == 1
    assert light(0, 0, 100) == 1  # upwards: never meets the ground


def test_there_is_no_ground_for_a_camera_below_it():
    below = Camera(eye=(0, -3, -3), target=(0, 0, 0))
    assert Stage.around(below, -0.5, ground=True).ground is None
    above = Camera(eye=(0, -3, 3), target=(0, 0, 0))
    assert Stage.around(above, -0.5, ground=True).ground == -0.5
    assert Stage.around(above, -0.5, ground=False).ground is None
