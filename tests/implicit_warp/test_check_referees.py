"""Second opinions: trusted for what they can do, judged exactly, honest when missing."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import trimesh

from implicit_warp.checking import REFEREES, check
from implicit_warp.checking.referees import ask


def sphere() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(2)
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def overlapping_spheres() -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = sphere()
    shifted = vertices + np.array([0.71, 0.13, 0.05])
    return np.vstack([vertices, shifted]), np.vstack([faces, faces + len(vertices)])


@pytest.mark.parametrize("name", REFEREES)
def test_clean_mesh_passes(name: str) -> None:
    verdict = ask(name, *sphere())
    if not verdict.installed:
        pytest.skip(verdict.detail)
    assert verdict.passed


@pytest.mark.parametrize("name", ["open3d", "pymeshlab"])
def test_what_looks_for_self_intersections_finds_them_and_they_are_confirmed(name: str) -> None:
    verdict = ask(name, *overlapping_spheres())
    if not verdict.installed:
        pytest.skip(verdict.detail)
    assert verdict.passed is False
    assert verdict.facts["confirmed"] > 0


def test_false_alarms_of_pymeshlab_on_flat_sides_do_not_fail_a_mesh() -> None:
    """It flags coplanar neighbours of many rotated boxes, all of them clean."""
    flagged = 0
    for seed in range(20):
        box = trimesh.creation.box().subdivide()
        turn = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
        box.apply_transform(turn)
        verdict = ask("pymeshlab", np.array(box.vertices), np.array(box.faces, dtype=np.int64))
        if not verdict.installed:
            pytest.skip(verdict.detail)
        assert verdict.passed, verdict
        flagged += verdict.facts["false_alarms"]
    assert flagged, "no false alarm occurred: nothing was tested"


def test_manifold3d_refuses_an_open_mesh() -> None:
    vertices, faces = sphere()
    assert ask("manifold3d", vertices, faces[1:]).passed is False


def test_manifold3d_is_not_trusted_where_it_repaired() -> None:
    """A vertex that no face uses is dropped in silence: NoError, but of another mesh."""
    vertices, faces = sphere()
    verdict = ask("manifold3d", np.vstack([vertices, [9.0, 9.0, 9.0]]), faces)
    assert verdict.facts["status"] == "NoError"
    assert verdict.passed is None
    assert "repaired" in verdict.detail


def test_manifold3d_and_trimesh_see_an_inside_out_mesh() -> None:
    vertices, faces = sphere()
    for name in ("manifold3d", "trimesh"):
        assert ask(name, vertices, np.ascontiguousarray(faces[:, ::-1])).passed is False


@pytest.mark.parametrize("name", REFEREES)
def test_meshes_that_nobody_can_judge_give_no_opinion(name: str) -> None:
    vertices, faces = sphere()
    assert ask(name, vertices, faces[:0]).passed is None
    assert ask(name, vertices * np.nan, faces).passed is None


@pytest.mark.parametrize("name", REFEREES)
def test_missing_library_is_said_and_fails_nothing(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)  # makes `import name` fail
    vertices, faces = sphere()
    verdict = ask(name, vertices, faces)
    assert not verdict.installed
    assert "not installed" in verdict.detail
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    report = check(mesh, referees=(name,))
    assert report.ok
    assert any("not installed" in note for note in report.notes)


def test_a_check_imports_no_referee_that_was_not_asked_for() -> None:
    """pymeshlab is under the GPL: importing it must be the user's own decision."""
    program = (
        "import sys, numpy, types\n"
        "from implicit_warp.checking import check\n"
        "mesh = types.SimpleNamespace(vertices=numpy.eye(3), faces=[[0, 1, 2]])\n"
        "check(mesh, referees=())\n"
        "print(sorted({'pymeshlab', 'open3d', 'manifold3d', 'trimesh'} & set(sys.modules)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr
