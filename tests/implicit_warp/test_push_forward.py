"""The exact image of a mesh: every law it must obey, against independent arithmetic."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest
import torch
import trimesh

import fields as sdf
import implicit_warp as iw
from implicit_warp.checking import analyse, self_intersections
from implicit_warp.errors import InputError
from implicit_warp.mesh_files import merge_equal_vertices
from implicit_warp.push_forward.exact import cut_and_push, layers_of
from implicit_warp.push_forward.triangulation import triangulate
from implicit_warp.square_mesh import rest_forms, square_mesh
from tests.implicit_warp.push_forward_pairs import arrays, compare, failures, random_pair
from tests.implicit_warp.registered_maps import random_affine, random_net, random_warp

PAIRS = 300


def cells_of(points: np.ndarray, resolution: int) -> np.ndarray:
    """(n,) the rest cell of each plane point, by trying all; and no two share their inside."""
    mesh = square_mesh(resolution)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], 1)
    inside = np.einsum("ckj,nj->nck", rest_forms(mesh), homogeneous).min(-1)
    return inside.argmax(1)


def depth_in(cells: np.ndarray, points: np.ndarray, resolution: int) -> np.ndarray:
    """(n,) the smallest barycentric coordinate of each point in its given rest cell."""
    forms = rest_forms(square_mesh(resolution))[cells]
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], 1)
    return np.einsum("nkj,nj->nk", forms, homogeneous).min(-1)


def plane_maps(warp: iw.Warp) -> np.ndarray:
    """(K, C, 6) by plain torch, independent of the kernels' tables."""
    return warp.stack.tables.numpy()


def apply_affine(matrix, points: np.ndarray) -> np.ndarray:
    return points @ np.asarray(matrix)[:, :3].T + np.asarray(matrix)[:, 3]


# ------------------------------------------------------------------ the whole, at random


def test_exact_images_of_random_clean_meshes_are_clean_where_moving_vertices_is_not():
    bad = {seed: found for seed in range(PAIRS) if (found := failures(seed))}
    assert not bad, f"by seed of push_forward_pairs.failures: {bad}"
    crossing = 0
    for seed in range(PAIRS):
        mesh, warp = random_pair(seed)
        vertices, faces = arrays(mesh)
        crossing += len(self_intersections(warp(vertices), faces)) > 0
    # What moving the vertices alone does to the same pairs; 48 when this was written.
    assert crossing > PAIRS // 10


@pytest.mark.statistical
def test_ten_thousand_pairs():
    bad = {seed: found for seed in range(10_000, 20_000) if (found := failures(seed))}
    assert not bad, f"by seed of push_forward_pairs.failures: {bad}"


@pytest.mark.slow
@pytest.mark.parametrize("case", range(20))
def test_large_pairs(case):
    assert not failures(30_000 + case, size=10.0)


# ------------------------------------------------------------------ the image is exact


@pytest.mark.parametrize("case", range(12))
def test_every_face_is_mapped_linearly(case, seed):
    seed = seed + case
    rng = np.random.default_rng(seed)
    mesh, warp = random_pair(seed)
    image, report = iw.deform_mesh(mesh, warp, "exact")
    vertices, faces = arrays(image)
    scale = 1.0 + np.abs(vertices).max()
    rest = report.rest_vertices
    # Rounding at rest is stretched by the map.
    stretch = np.linalg.norm(warp.jacobian(rest), 2, axis=(1, 2)).max()
    error = np.abs(warp(rest) - vertices).max()
    assert error < 1e-13 * stretch * scale * warp.n_layers, f"seed {seed}"
    weights = rng.dirichlet(np.ones(3), len(faces))[..., None]
    at_rest, at_image = ((weights * x[faces]).sum(1) for x in (rest, vertices))
    error = np.abs(warp(at_rest) - at_image).max()
    assert error < 1e-13 * stretch * scale * warp.n_layers, f"seed {seed}"


@pytest.mark.parametrize("case", range(8))
def test_every_polygon_lies_in_one_cell_of_every_layer(case, seed):
    seed = seed + case
    mesh, warp = random_pair(seed)
    polygons, uncut = cut_and_push(*arrays(mesh), warp)
    assert uncut == 0
    loops = [
        polygons.corner_vertices[s : s + n]
        for s, n in zip(
            polygons.starts[: polygons.n_polygons],
            polygons.lengths[: polygons.n_polygons],
            strict=True,
        )
    ]
    owners = np.repeat(np.arange(len(loops)), [len(loop) for loop in loops])
    corners = np.concatenate(loops)
    q = apply_affine(warp.stack.transitions[0], polygons.lineage.interpolate(arrays(mesh)[0]))
    tables = plane_maps(warp)
    for k in range(warp.n_layers):
        centroids = np.stack(
            [np.bincount(owners, q[corners, d]) / np.bincount(owners) for d in range(2)], -1
        )
        cells = cells_of(centroids, warp.resolution)
        far = np.maximum(1.0, np.abs(q).max()) * warp.resolution
        depth = depth_in(cells[owners], q[corners, :2], warp.resolution)
        assert depth.min() > -1e-11 * far, f"seed {seed}, layer {k}"
        # All polygons around a vertex move it alike.
        a = tables[k][cells[owners]]
        u, v = q[corners, 0], q[corners, 1]
        moved = np.stack([a[:, 0] * u + a[:, 1] * v + a[:, 4], a[:, 2] * u + a[:, 3] * v + a[:, 5]])
        new = q.copy()
        new[corners, :2] = moved.T
        assert np.abs(new[corners, :2] - moved.T).max() < 1e-10 * far
        q = apply_affine(warp.stack.transitions[k + 1], new)
    np.testing.assert_allclose(
        q[corners], polygons.points[corners], rtol=0, atol=1e-9 * (1 + np.abs(q[corners]).max())
    )


def test_volume_is_the_integral_of_the_determinant_in_every_layer(seed):
    """Within the prism over cell c the volume is the sum of w n_w dA over the pieces in c."""
    warp = random_net(seed, layers=24, resolution=5, spread=1.0).freeze()
    ball = trimesh.creation.icosphere(1, 0.3)
    points, faces = arrays(ball)
    first, layers = layers_of(warp)
    points = apply_affine(first, points)
    tables = plane_maps(warp)
    for k, layer in enumerate(layers):
        one = iw.Warp(warp.embeddings[k : k + 1], torch.eye(3)[None])
        polygons, _ = cut_and_push(points, faces, one)
        pieces, _ = triangulate(polygons)
        q = polygons.lineage.interpolate(points)
        a, b, c = (q[pieces[:, j]] for j in range(3))
        area = 0.5 * np.cross(b - a, c - a)[:, 2]
        below = area * (a + b + c)[:, 2] / 3.0
        cells = cells_of(((a + b + c) / 3.0)[:, :2], warp.resolution)
        t = tables[k][cells]
        expected = float((below * (t[:, 0] * t[:, 3] - t[:, 1] * t[:, 2])).sum())
        image = polygons.points[: polygons.n_vertices]
        got = analyse(image, pieces).volume
        assert abs(got - expected) <= 1e-9 * expected, f"layer {k}, seed {seed}"
        after = torch.from_numpy(layer.tables.transitions[1]).view(3, 4)
        points, faces = apply_affine(after, image), pieces
    assert len(faces) > 100 * len(ball.faces)
    whole = iw.deform(ball, warp, method="exact")
    assert analyse(points, faces).volume == pytest.approx(analyse(*arrays(whole)).volume, rel=1e-9)


def test_the_identity_changes_nothing_but_the_triangles():
    ball = trimesh.creation.icosphere(3, 0.8)
    image, report = iw.deform_mesh(ball, iw.TutteNet(6, 9), "exact")
    assert report.faces_out > 2 * len(ball.faces)
    np.testing.assert_allclose(image.vertices, report.rest_vertices, rtol=0, atol=1e-14)
    before, after = (analyse(*arrays(m)) for m in (ball, image))
    assert abs(after.volume - before.volume) <= 1e-12 * before.volume
    assert abs(after.area - before.area) <= 1e-12 * before.area


def test_a_composition_is_the_composition_of_images(seed):
    mesh = trimesh.creation.icosphere(1, 0.5)
    a, m, b = random_warp(seed, layers=2), random_affine(seed), random_net(seed + 1, layers=2)
    image, report = iw.deform_mesh(mesh, b @ m @ a, "exact")
    np.testing.assert_allclose(
        (b @ m @ a)(report.rest_vertices), image.vertices, rtol=0, atol=1e-11
    )
    step = mesh
    for part in (a, m, b):
        step = iw.deform(step, part, method="exact")
    assert analyse(*arrays(step)).volume == pytest.approx(analyse(*arrays(image)).volume, rel=1e-12)
    moved, report = iw.deform_mesh(mesh, m, "exact")
    assert report.faces_out == len(mesh.faces)
    np.testing.assert_allclose(moved.vertices, m(arrays(mesh)[0]), rtol=0, atol=1e-14)


def test_given_vertices_go_where_the_map_takes_them(seed):
    mesh = trimesh.creation.icosphere(2, 0.7)
    warp = random_warp(seed)
    image = iw.deform(mesh, warp, method="exact")
    np.testing.assert_array_equal(image.vertices[: len(mesh.vertices)], warp(arrays(mesh)[0]))


DIGEST = """
import hashlib, trimesh, implicit_warp as iw
from tests.implicit_warp.registered_maps import random_net
ball = trimesh.creation.icosphere(5, 0.6)
image = iw.deform(ball, random_net(3, layers=3, resolution=6).freeze(), method="exact")
digest = hashlib.sha256(image.vertices.tobytes() + image.faces.tobytes()).hexdigest()
"""


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_the_result_does_not_depend_on_the_number_of_threads():
    here: dict[str, str] = {}
    exec(DIGEST, here)
    environment = os.environ | {"NUMBA_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
    there = subprocess.run(
        [sys.executable, "-c", DIGEST + "import numba\nprint(numba.get_num_threads(), digest)"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert there.stdout.split() == ["2", here["digest"]]


# ------------------------------------------------------------------ difficult places


@pytest.mark.parametrize("factor", [2.0, 30.0, 1e4, 1e9])
def test_far_away_and_large_meshes_meet_the_cones(factor, seed):
    warp = random_net(seed, layers=6, resolution=5).freeze()
    for mesh in (trimesh.creation.icosphere(2), trimesh.creation.box((1.0, 1.3, 0.9))):
        for shift in (np.zeros(3), np.array([0.7, -0.4, 0.2])):
            vertices = factor * (arrays(mesh)[0] + shift)
            large = trimesh.Trimesh(vertices, mesh.faces, process=False)
            image, report = iw.deform_mesh(large, warp, "exact")
            assert report.uncut == 0
            assert not compare(large, image), f"factor {factor}, seed {seed}"
            error = np.abs(warp(report.rest_vertices) - arrays(image)[0]).max()
            assert error < 1e-11 * factor * warp.lipschitz[0] ** 0.5


@pytest.mark.parametrize("resolution", [2, 3, 5, 6, 11])
@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_walls_along_normals_and_vertices_on_lines(resolution, spread, seed):
    """Boxes whose corners are vertices of the square mesh and whose walls stand on its lines."""
    warp = random_net(
        seed, layers=6, resolution=resolution, spread=spread, frames="triplane"
    ).freeze()
    ticks = np.linspace(-1.0, 1.0, resolution)
    last, middle = resolution - 1, resolution // 2
    for low, high in {(0, last), (0, middle), ((resolution - 1) // 2, last)}:
        for noise in (0.0, 1e-16, 1e-13):
            box = trimesh.creation.box(bounds=[[ticks[low]] * 3, [ticks[high]] * 3]).subdivide()
            shake = np.random.default_rng(seed).uniform(-noise, noise, box.vertices.shape)
            box = trimesh.Trimesh(box.vertices + shake, box.faces, process=False)
            image, report = iw.deform_mesh(box, warp, "exact")
            assert not compare(box, image), (resolution, spread, low, high, noise, seed)
            if spread == 0.0:
                # Coinciding lines of the layers are one line: nothing finer than the mesh appears.
                assert report.smallest_edge > 0.1 / resolution


def test_walls_on_the_diagonals_and_beyond_the_square(seed):
    warp = random_net(seed, layers=3, resolution=5, frames="triplane").freeze()
    corners = np.array([[-1, -1, -1], [1, 1, -1], [1, 1, 1], [-1, -1, 1.0]]) * 1.5
    wall = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    image, report = iw.deform_mesh(wall, warp, "exact")
    np.testing.assert_allclose(warp(report.rest_vertices), image.vertices, rtol=0, atol=1e-12)
    weights = np.full((1, 3, 1), 1 / 3)
    at_rest = (weights * report.rest_vertices[image.faces]).sum(1)
    at_image = (weights * arrays(image)[0][image.faces]).sum(1)
    np.testing.assert_allclose(warp(at_rest), at_image, rtol=0, atol=1e-12)


def test_vertices_doubled_along_a_seam_stay_together_bit_for_bit(seed):
    """A ball cut in two along a zigzag: both copies of the rim are cut alike."""
    ball = trimesh.creation.icosphere(3, 0.6)
    ball.apply_transform(trimesh.transformations.random_rotation_matrix(np.full(3, 0.3)))
    upper = ball.triangles_center[:, 2] > 0.0
    halves = [ball.faces[upper], ball.faces[~upper]]
    own = []
    vertices, offset = [], 0
    for half in halves:
        used, local = np.unique(half, return_inverse=True)
        # Other numbers in another order, so that nothing matches by accident of indices.
        order = np.random.default_rng(seed + offset).permutation(len(used))
        vertices.append(np.asarray(ball.vertices)[used[np.argsort(order)]])
        own.append(order[local.reshape(-1, 3)] + offset)
        offset += len(used)
    split = trimesh.Trimesh(np.concatenate(vertices), np.concatenate(own), process=False)
    assert len(analyse(*arrays(split)).open_edges) > 50
    image, report = iw.deform_mesh(split, random_warp(seed), "exact")
    joined = trimesh.Trimesh(image.vertices, image.faces, process=False)
    vertices, faces = merge_equal_vertices(joined.vertices, joined.faces)
    assert not compare(ball, trimesh.Trimesh(vertices, faces, process=False))
    assert len(np.unique(report.rest_vertices, axis=0)) == len(vertices)


def test_open_and_non_manifold_meshes_stay_what_they_are(seed):
    warp = random_warp(seed, layers=3, resolution=6)
    ball = trimesh.creation.icosphere(2, 0.5)
    bowl = trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < 0.1])
    fin = np.array([[0, 0, -1], [0, 0, 1], [1, 0, 0], [-1, 0.3, 0], [0, -1, 0.2]]) * 0.4
    three_walls = trimesh.Trimesh(fin, [[0, 1, 2], [0, 1, 3], [0, 1, 4]], process=False)
    for mesh in (bowl, three_walls):
        image = iw.deform(mesh, warp, method="exact")
        before, after = (analyse(*arrays(m)) for m in (mesh, image))
        assert before.num_components == after.num_components
        assert (len(before.nonmanifold_edges) > 0) == (len(after.nonmanifold_edges) > 0)
        assert (len(before.open_edges) > 0) == (len(after.open_edges) > 0)
        assert not len(after.pinched_vertices)
        assert not len(self_intersections(*arrays(image)))


def test_no_face_one_face_and_faces_that_are_none(seed):
    warp = random_warp(seed, layers=3, resolution=6)
    nothing, report = iw.deform_mesh(trimesh.Trimesh(), warp, "exact")
    assert len(nothing.faces) == report.faces_out == 0
    corners = [[0, 0, 0.1], [1, 0, 0], [0, 1, 0], [0.5, 0.5, 1]]
    one = trimesh.Trimesh(corners, [[0, 1, 2], [2, 2, 1]], process=False)
    image, report = iw.deform_mesh(one, warp, "exact")
    np.testing.assert_array_equal(report.dropped_faces, [1])
    assert set(report.source_faces) == {0}
    assert analyse(*arrays(image)).num_components == 1
    # Of no area at all: cut all the same, and no crash.
    line = trimesh.Trimesh([[-1, 0, 0], [0, 0, 0], [1, 0, 0]], [[0, 1, 2]], process=False)
    iw.deform(line, warp, method="exact")
    point = trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False)
    iw.deform(point, warp, method="exact")


@pytest.mark.parametrize("size", [1e-30, 1e-12, 1e30])
def test_tiny_and_huge_meshes_do_not_crash_and_stay_closed(size, seed):
    warp = random_warp(seed, layers=3, resolution=6)
    unit = trimesh.creation.icosphere(1)
    ball = trimesh.Trimesh(size * arrays(unit)[0], unit.faces, process=False)
    image = iw.deform(ball, warp, method="exact")
    assert analyse(*arrays(image)).watertight


# ------------------------------------------------------------------ what comes along


def test_triangles_of_a_polygon_cover_it_and_none_is_flat(rng):
    """A triangle with further vertices on all sides: straight angles never become triangles."""
    corners = np.array([[0, 0, 0], [4, 0, 1], [1, 3, 0.5]])
    sides = zip(corners, np.roll(corners, -1, 0), strict=True)
    loop = np.concatenate([a + np.linspace(0, 1, 4)[:3, None] * (b - a) for a, b in sides])
    mesh, _ = cut_and_push(loop, np.array([[0, 3, 6]]), iw.Affine())
    mesh.make_room(9, 9, 9, 1)
    mesh.corner_vertices[:9], mesh.lengths[0], mesh.n_corners = np.arange(9), 9, 9
    faces, _ = triangulate(mesh)
    assert len(faces) == 7
    normals = np.cross(loop[faces[:, 1]] - loop[faces[:, 0]], loop[faces[:, 2]] - loop[faces[:, 0]])
    whole = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    shares = normals @ whole / (whole @ whole)
    assert shares.min() > 0.05
    assert shares.sum() == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("method", ["exact", "adaptive"])
def test_attributes_are_carried(method, seed):
    ball = trimesh.creation.icosphere(1, 0.5)
    n, m = len(ball.vertices), len(ball.faces)
    rng = np.random.default_rng(seed)
    ball.metadata["name"] = "ball"
    ball.vertex_attributes["height"] = np.asarray(ball.vertices)[:, 2].astype(np.float32)
    ball.vertex_attributes["label"] = rng.integers(0, 9, n)
    ball.face_attributes["group"] = np.arange(m)
    warp = random_warp(seed, layers=3, resolution=5)

    uv = rng.uniform(size=(n, 2))
    ball.visual = trimesh.visual.TextureVisuals(uv=uv)
    image, report = iw.deform_mesh(ball, warp, method)
    assert image.metadata["name"] == "ball"
    np.testing.assert_array_equal(image.face_attributes["group"], report.source_faces)
    np.testing.assert_allclose(
        image.vertex_attributes["height"], report.rest_vertices[:, 2], rtol=0, atol=1e-6
    )
    assert image.vertex_attributes["height"].dtype == np.float32
    assert set(image.vertex_attributes["label"]) <= set(ball.vertex_attributes["label"])
    # On each piece, UV is what the source face has at the same barycentric coordinates.
    corners = np.asarray(ball.triangles)[report.source_faces]
    at = report.rest_vertices[image.faces]
    for k in range(3):
        weights = np.linalg.lstsq(
            np.concatenate([corners.transpose(0, 2, 1)], 1)[0], at[0, k], rcond=None
        )[0]
        expected = weights @ uv[ball.faces[report.source_faces[0]]]
        np.testing.assert_allclose(image.visual.uv[image.faces[0, k]], expected, atol=1e-12)

    ball.visual = trimesh.visual.ColorVisuals(ball, face_colors=rng.integers(0, 255, (m, 4)))
    image, report = iw.deform_mesh(ball, warp, method)
    np.testing.assert_array_equal(
        image.visual.face_colors, ball.visual.face_colors[report.source_faces]
    )
    ball.visual = trimesh.visual.ColorVisuals(ball, vertex_colors=np.full((n, 4), 77))
    image = iw.deform(ball, warp, method=method)
    assert (image.visual.vertex_colors == 77).all()
    assert len(image.visual.vertex_colors) == len(image.vertices)


def test_the_report_counts(seed):
    mesh, warp = random_pair(seed)
    done = []
    image, report = iw.deform_mesh(mesh, warp, "exact", progress=lambda k, n: done.append((k, n)))
    assert done == [(k + 1, warp.n_layers) for k in range(warp.n_layers)]
    assert report.faces_in == len(mesh.faces)
    assert report.faces_out == len(image.faces) >= report.polygons >= report.faces_in
    assert report.smallest_edge == pytest.approx(image.edges_unique_length.min(), rel=1e-9)
    assert set(report.source_faces) == set(range(len(mesh.faces)))
    assert f"{len(mesh.faces)} faces -> {len(image.faces)}" in str(report)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": "magic"}, "no such method"),
        ({"tolerance": 0.1}, "no such option"),
        ({"until_clean": True}, "no such option"),
        ({"map_": "inverse"}, "adaptive"),
        ({"map_": "mixed"}, "adaptive"),
        ({"map_": 3}, "not a map"),
        ({"mesh": "nan"}, "NaN or infinite"),
        ({"mesh": sdf.sphere(1)}, "vertices and faces"),
    ],
)
def test_bad_arguments_are_named(change, words, seed):
    warp = random_warp(seed, layers=2)
    broken = trimesh.Trimesh([[0, 0, 0], [1, 0, np.nan], [0, 1, 0]], [[0, 1, 2]], process=False)
    named = {"inverse": warp.inv, "mixed": warp @ warp.inv, "nan": broken}
    arguments = {"mesh": trimesh.creation.box(), "map_": warp, "method": "exact"}
    for name, value in change.items():
        known = isinstance(value, str) and value in named
        arguments[name] = named[value] if known else value
    with pytest.raises(InputError, match=words):
        iw.deform_mesh(**arguments)


def test_methods_are_for_meshes_only(seed):
    for thing in (sdf.sphere(1), np.zeros((2, 3))):
        with pytest.raises(InputError, match="for meshes only"):
            iw.deform(thing, random_warp(seed), method="exact")
