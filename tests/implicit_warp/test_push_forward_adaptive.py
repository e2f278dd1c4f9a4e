"""Dividing a mesh until it follows its image within a tolerance."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import implicit_warp as iw
from implicit_warp.checking import analyse, self_intersections
from implicit_warp.errors import InputError
from implicit_warp.mesh_files import merge_equal_vertices
from implicit_warp.push_forward import adaptive
from tests.implicit_warp.push_forward_pairs import arrays, compare, split_ball
from tests.implicit_warp.registered_maps import BUILDERS, random_warp


def samples(mesh: trimesh.Trimesh, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints of sides and centroids, at rest and on the image."""
    weights = np.array([[0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5], [1 / 3] * 3])
    return tuple((weights @ x[mesh.faces]).reshape(-1, 3) for x in (rest, arrays(mesh)[0]))


@pytest.mark.parametrize("name", BUILDERS)
def test_samples_are_within_the_tolerance_for_every_map(name, seed):
    map_ = BUILDERS[name](seed)
    ball = trimesh.creation.icosphere(1, 0.6)
    image, report = iw.deform_mesh(ball, map_, "adaptive", tolerance=0.02)
    at_rest, at_image = samples(image, report.rest_vertices)
    errors = np.linalg.norm(map_(at_rest) - at_image, axis=1)
    assert errors.max() <= 0.02
    assert errors.max() <= report.largest_error + 1e-12 <= 0.02 + 1e-12
    np.testing.assert_allclose(map_(report.rest_vertices), image.vertices, rtol=0, atol=1e-11)
    before, after = (analyse(*arrays(m)) for m in (ball, image))
    assert after.watertight
    assert before.genus == after.genus
    assert set(report.source_faces) == set(range(len(ball.faces)))
    assert not len(after.zero_area_faces)


def test_a_smaller_tolerance_gives_more_faces_and_a_truer_volume(seed):
    ball, warp = trimesh.creation.icosphere(1, 0.6), random_warp(seed, layers=3)
    exact = iw.deform(ball, warp, method="exact").volume
    counts, errors = [], []
    for tolerance in (0.1, 0.01, 0.001):
        image = iw.deform(ball, warp, method="adaptive", tolerance=tolerance)
        counts.append(len(image.faces))
        errors.append(abs(image.volume - exact))
    assert counts[0] < counts[1] < counts[2]
    assert errors[2] < 0.1 * errors[0]
    # A surface within the tolerance all over: the volume between is below area x tolerance.
    assert errors[2] < 0.001 * image.area


def test_the_default_tolerance_is_a_thousandth_of_the_diagonal(seed):
    ball, warp = trimesh.creation.icosphere(2, 0.6), random_warp(seed, layers=2)
    _, report = iw.deform_mesh(ball, warp, "adaptive")
    corners = warp(arrays(ball)[0])
    assert report.tolerance == pytest.approx(1e-3 * np.linalg.norm(np.ptp(corners, axis=0)))
    assert report.largest_error <= report.tolerance


def test_nothing_is_divided_where_the_map_is_affine():
    ball = trimesh.creation.icosphere(2)
    map_ = iw.Affine(np.diag([1.0, 2.0, 0.5]))
    image, report = iw.deform_mesh(ball, map_, "adaptive", tolerance=1e-9)
    assert report.rounds == 0
    np.testing.assert_array_equal(image.faces, ball.faces)


def test_faces_do_not_get_ever_thinner(seed):
    """The longest-edge rule in a metric that changes from place to place bounds what counts."""
    warp = random_warp(seed, layers=2, spread=0.3)
    ball = trimesh.creation.icosphere(1, 0.6)
    ratios = [
        analyse(
            *arrays(iw.deform(ball, warp, method="adaptive", tolerance=t))
        ).smallest_height_ratio
        for t in (0.03, 0.0003)
    ]
    assert ratios[1] > 0.25 * ratios[0]


def shells() -> trimesh.Trimesh:
    """A hollow ball with a thin wall, so coarse that moving its vertices pierces the wall."""
    outer, inner = trimesh.creation.icosphere(1, 0.6), trimesh.creation.icosphere(1, 0.56)
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


def test_until_clean_removes_self_intersections_that_vertices_leave(seed):
    mesh = shells()
    vertices, faces = arrays(mesh)
    cleaned = 0
    for number in range(seed, seed + 6):
        warp = random_warp(number, layers=4, resolution=5)
        if not len(self_intersections(warp(vertices), faces)):
            continue
        coarse, image = (
            iw.deform_mesh(mesh, warp, "adaptive", tolerance=0.3, until_clean=clean)
            for clean in (False, True)
        )
        assert coarse[1].self_intersections is None
        assert image[1].self_intersections == 0
        assert not compare(mesh, image[0]), f"seed {number}"
        cleaned += len(self_intersections(*arrays(coarse[0]))) > 0
    assert cleaned >= 2


def test_both_sides_of_a_seam_are_divided_alike(seed):
    _, split = split_ball()
    image, report = iw.deform_mesh(split, random_warp(seed), "adaptive", tolerance=0.01)
    assert report.rounds > 2
    joined = merge_equal_vertices(*arrays(image))
    assert analyse(*joined).watertight
    assert analyse(*joined).genus == (0,)


def test_empty_flat_and_pointlike_meshes():
    warp = random_warp(3, layers=2)
    assert not len(iw.deform(trimesh.Trimesh(), warp, method="adaptive").faces)
    point = trimesh.Trimesh(np.zeros((3, 3)), [[0, 1, 2]], process=False)
    assert len(iw.deform(point, warp, method="adaptive", tolerance=0.1).faces) == 1
    assert len(iw.deform(point, warp, method="adaptive").faces) == 1


@pytest.mark.parametrize("tolerance", [0.0, -1.0, np.nan, np.inf, "0.1", True, [0.1]])
def test_tolerances_must_be_positive(tolerance):
    with pytest.raises(InputError, match="not a positive distance"):
        iw.deform(trimesh.creation.box(), iw.Affine(), method="adaptive", tolerance=tolerance)


def test_impossible_wishes_are_refused_with_the_reason(monkeypatch, seed):
    ball = trimesh.creation.icosphere(1, 0.5)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.4, 0.1, 0.05))])
    with pytest.raises(InputError, match="intersect already"):
        iw.deform(two, iw.Affine(), method="adaptive", until_clean=True)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(InputError, match="no area"):
        iw.deform(flat, random_warp(seed), method="adaptive", until_clean=True)
    box = trimesh.creation.box()
    huge = trimesh.Trimesh(1e200 * box.vertices, box.faces, process=False)
    for method in ("adaptive", "exact"):
        with pytest.raises(InputError, match="overflow"):
            iw.deform(huge, random_warp(seed), method=method)
    monkeypatch.setattr(adaptive, "_MOST_FACES", 500)
    with pytest.raises(InputError, match="larger tolerance"):
        iw.deform(ball, random_warp(seed), method="adaptive", tolerance=1e-5)
    monkeypatch.setattr(adaptive, "_MOST_FACES", 10**6)
    monkeypatch.setattr(adaptive, "_CLEANING_ROUNDS", 0)
    mesh = shells()
    number = next(
        n
        for n in range(seed, seed + 20)
        if len(self_intersections(random_warp(n)(arrays(mesh)[0]), arrays(mesh)[1]))
    )
    with pytest.raises(InputError, match="still intersect"):
        iw.deform(mesh, random_warp(number), method="adaptive", tolerance=1e6, until_clean=True)


@pytest.mark.parametrize("method", ["vertices", "adaptive", "exact"])
@pytest.mark.parametrize("owner", ["vertex", "face"])
def test_attributes_of_the_wrong_length_are_named(method, owner, seed):
    box = trimesh.creation.box()
    getattr(box, f"{owner}_attributes")["charge"] = np.arange(5)
    with pytest.raises(InputError, match=r"mesh = 'charge'.*5 entries"):
        iw.deform_mesh(box, random_warp(seed), method)
