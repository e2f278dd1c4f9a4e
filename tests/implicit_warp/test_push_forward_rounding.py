"""Contacts that rounding makes in an exact image: there, counted, and removed."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import implicit_warp as iw
from implicit_warp.checking import analyse, self_intersections
from implicit_warp.cli import main
from implicit_warp.errors import InputError
from implicit_warp.mesh_files import merge_equal_vertices, read_mesh, write_mesh
from implicit_warp.push_forward.rounding import settle
from tests.implicit_warp.push_forward_pairs import arrays, compare, split_ball
from tests.implicit_warp.registered_maps import random_net


def shifted_warp(seed: int, shift: float) -> iw.Map:
    """Far from the origin floating-point numbers are coarse."""
    return iw.Affine(translation=(shift,) * 3) @ random_net(seed, layers=4, resolution=9).freeze()


@pytest.mark.parametrize(
    ("precision", "shift"), [("float32", 1e3), ("float32", 1e4), ("float64", 1e12)]
)
@pytest.mark.parametrize("kind", ["ball", "torus"])
def test_contacts_of_rounding_are_removed_and_topology_stays(precision, shift, kind, seed):
    mesh = (
        trimesh.creation.icosphere(2, 0.6)
        if kind == "ball"
        else trimesh.creation.torus(0.5, 0.2, 16, 9)
    )
    warp = shifted_warp(seed, shift)
    plain = iw.deform(mesh, warp, method="exact")
    rounded = arrays(plain)[0].astype(precision).astype(float)
    assert len(self_intersections(rounded, plain.faces)) > 0, f"no case: seed {seed}"
    image, report = iw.deform_mesh(mesh, warp, "exact", clean_for=precision)
    assert report.self_intersections == 0
    assert 0 < report.collapsed < 0.2 * len(plain.faces)
    assert len(image.faces) == len(plain.faces) - 2 * report.collapsed
    points = arrays(image)[0]
    np.testing.assert_array_equal(points, points.astype(precision).astype(float))
    assert not compare(mesh, image), f"seed {seed}"
    # Nothing has moved farther than the pieces that went.
    unit = np.finfo(precision).eps * np.abs(points).max()
    drift = np.linalg.norm(warp(report.rest_vertices) - points, axis=1).max()
    assert drift <= 4 * unit
    assert set(report.source_faces) <= set(range(len(mesh.faces)))
    assert analyse(*arrays(image)).volume == pytest.approx(
        analyse(*arrays(plain)).volume, abs=100 * unit * plain.area
    )


def test_a_mesh_without_contacts_is_only_rounded(seed):
    mesh = trimesh.creation.icosphere(1, 0.6)
    warp = random_net(seed, layers=2, resolution=5).freeze()
    plain = iw.deform(mesh, warp, method="exact")
    image, report = iw.deform_mesh(mesh, warp, "exact", clean_for="float32")
    assert report.collapsed == report.self_intersections == 0
    np.testing.assert_array_equal(image.faces, plain.faces)
    np.testing.assert_array_equal(image.vertices, arrays(plain)[0].astype(np.float32))


def test_seams_stay_closed_when_edges_on_them_collapse(seed):
    """Every face of one half has vertices of its own, so most collapsed edges lie on seams."""
    ball, split = split_ball()
    image, report = iw.deform_mesh(split, shifted_warp(seed, 1e4), "exact", clean_for="float32")
    assert report.collapsed > 20
    assert report.self_intersections == 0
    joined = trimesh.Trimesh(*merge_equal_vertices(*arrays(image)), process=False)
    assert not compare(ball, joined)
    assert len(image.vertices) > len(joined.vertices)


def test_what_is_no_fault_of_rounding_is_left_and_counted():
    ball = trimesh.creation.icosphere(2)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0.1, 0.2))])
    settled = settle(two.vertices, two.vertices, two.faces, "float32")
    assert settled.collapsed == 0
    rounded = arrays(two)[0].astype(np.float32).astype(float)
    assert settled.contacts == len(self_intersections(rounded, two.faces)) > 0
    # A tetrahedron thinner than a unit of rounding cannot lose an edge and stay one.
    corners = np.array([[0, 0, 0], [1e-9, 0, 0], [0, 1e-9, 0], [0, 0, 1e-9]]) + 1.0
    thin = trimesh.Trimesh(corners, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], process=False)
    settled = settle(corners, corners, thin.faces, "float32")
    assert settled.collapsed == 0
    assert settled.contacts > 0


def test_the_command_writes_an_stl_that_passes(tmp_path, capsys, seed):
    warp = iw.Warp(
        (net := random_net(seed, layers=4, resolution=9)).embeddings().detach(),
        net.frames(),
        after=iw.Affine(translation=(100.0,) * 3).matrix,
    )
    iw.save(warp, tmp_path / "warp.safetensors")
    write_mesh(trimesh.creation.icosphere(2, 0.6), tmp_path / "ball.ply")
    apply = ["apply", f"{tmp_path}/warp.safetensors", f"{tmp_path}/ball.ply"]
    assert main([*apply, "-o", f"{tmp_path}/exact.stl", "--method", "exact"]) == 0
    output = capsys.readouterr().out
    assert "convex pieces" in output
    assert "0 contacts left" in output
    assert f"{tmp_path}/exact.stl: ok" in output
    assert read_mesh(tmp_path / "exact.stl").is_watertight
    adaptive = [*apply, "-o", f"{tmp_path}/a.stl", "--method", "adaptive", "--tolerance", "0.01"]
    assert main(adaptive) == 0
    assert main([*adaptive, "--inverse"]) == 0
    capsys.readouterr()
    assert main([*apply, "-o", f"{tmp_path}/b.stl", "--method", "exact", "--inverse"]) == 2
    assert "adaptive" in capsys.readouterr().err
    np.save(tmp_path / "p.npy", np.zeros((2, 3)))
    points = ["apply", f"{tmp_path}/warp.safetensors", f"{tmp_path}/p.npy"]
    assert main([*points, "-o", f"{tmp_path}/q.npy", "--method", "exact"]) == 2
    assert "for meshes" in capsys.readouterr().err


def test_bad_precisions_are_named(seed):
    ball, warp = trimesh.creation.icosphere(0), shifted_warp(seed, 0.0)
    with pytest.raises(InputError, match="no such precision"):
        iw.deform(ball, warp, method="exact", clean_for="float16")
    with pytest.raises(InputError, match="for other reasons"):
        iw.deform(ball, warp, clean_for="float32")
