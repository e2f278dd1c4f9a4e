"""Mesh fields against plain float64 arithmetic, exact solids, and broken meshes."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError, MissingDependency
from fields.closed_mesh import closed_mesh
from tests.fields.plain_triangles import solid_angles

trimesh = pytest.importorskip("trimesh", reason="builds the meshes of these tests")

ICOSPHERE = trimesh.creation.icosphere(subdivisions=3)
CUBE = trimesh.creation.box((1.0, 2.0, 0.5))
RING = trimesh.creation.torus(1.0, 0.3, major_sections=24, minor_sections=12)


def _brute_distance(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """The least distance to any triangle, by dense sampling of barycentric coordinates
    refined by projection: slow, and shares no code with the package."""
    best = np.full(len(points), np.inf)
    for a, b, c in mesh.triangles:
        basis = np.stack([b - a, c - a], axis=1)
        solved = np.linalg.lstsq(basis, (points - a).T, rcond=None)[0].T
        inside = (solved.min(axis=1) >= 0) & (solved.sum(axis=1) <= 1)
        foot = a + solved @ basis.T
        plane = np.where(inside, np.linalg.norm(points - foot, axis=1), np.inf)
        best = np.minimum(best, plane)
        for p, q in ((a, b), (b, c), (c, a)):
            t = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - p - t[:, None] * (q - p), axis=1))
    return best


@pytest.mark.parametrize("solid", [ICOSPHERE, CUBE, RING], ids=["icosphere", "cube", "ring"])
def test_values_are_the_signed_distance(solid, rng):
    points = rng.uniform(-1.5, 1.5, (400, 3))
    values = sdf.mesh(solid)(points)
    np.testing.assert_allclose(np.abs(values), _brute_distance(solid, points), atol=1e-12)
    np.testing.assert_array_equal(values < 0, solid_angles(points, solid.triangles) > 0.5)


def test_a_box_mesh_equals_the_box_field_on_a_lattice(rng):
    """A lattice: its points are nearest to corners, edges and diagonals, where counting
    the crossings of a ray goes wrong."""
    lattice = np.stack(
        np.meshgrid(*[np.linspace(-1.5, 1.5, 25)] * 3, indexing="ij"), axis=-1
    ).reshape(-1, 3)
    field = sdf.mesh(CUBE)
    np.testing.assert_allclose(field(lattice), sdf.box((1, 2, 0.5))(lattice), atol=1e-12)
    np.testing.assert_array_equal(field.bounds, [[-0.5, -1, -0.25], [0.5, 1, 0.25]])
    assert field.exact
    assert field.lipschitz == 1


def test_gradients_are_unit_and_equal_central_differences(rng):
    field = sdf.mesh(RING)
    points = rng.uniform(-1.5, 1.5, (2_000, 3))
    gradient = field.gradient(points)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, atol=1e-12)
    h = 1e-5
    steps = h * np.eye(3)
    ahead = np.stack([field(points + s) for s in steps], axis=1) - field(points)[:, None]
    behind = field(points)[:, None] - np.stack([field(points - s) for s in steps], axis=1)
    smooth = (np.abs(ahead - behind) < 1e-4 * h).all(axis=1)
    assert smooth.mean() > 0.8
    central = (ahead + behind)[smooth] / (2 * h)
    np.testing.assert_allclose(gradient[smooth], central, atol=1e-4)


def test_gradients_on_the_surface_are_normals():
    field = sdf.mesh(CUBE)
    centres = CUBE.triangles_center
    np.testing.assert_allclose(field(centres), 0, atol=1e-15)
    np.testing.assert_allclose(field.gradient(centres), CUBE.face_normals, atol=1e-12)
    corners = field.gradient(np.asarray(CUBE.vertices))
    # Three right angles: weighted by angle, however the sides are cut into triangles.
    np.testing.assert_allclose(corners, np.sign(CUBE.vertices) / np.sqrt(3), atol=1e-12)


def test_a_mesh_takes_part_in_expressions():
    part = sdf.mesh(ICOSPHERE).translate((5, 0, 0)).scale(2) - sdf.box(1, (10, 0, 0))
    assert part([10, 0, 0.75]) == pytest.approx(-0.25)
    points = torch.tensor([[12.5, 0.1, 0.0]], requires_grad=True)
    part(points).sum().backward()
    assert points.grad.norm() == pytest.approx(1, abs=1e-5)
    assert points.grad.dtype == torch.float32
    assert repr(part).startswith("<mesh of 1280 faces>.translate(")


def test_second_derivatives_are_refused_not_wrong():
    points = torch.tensor([[0.3, 0.4, 2.0]], requires_grad=True)
    gradient = sdf.mesh(CUBE).gradient(points)
    with pytest.raises(NotImplementedError, match="not available"):
        gradient.sum().backward()


def test_a_mesh_far_from_the_origin_loses_no_digits(rng):
    """In float32 the mesh itself would be wrong by 0.06 here."""
    far = CUBE.copy()
    offset = np.array([1e6, -2e6, 5e5])
    far.apply_translation(offset)
    points = rng.uniform(-1.5, 1.5, (500, 3))
    values = sdf.mesh(far)(points + offset)
    np.testing.assert_allclose(values, sdf.box((1, 2, 0.5))(points), atol=1e-8)


def test_many_and_no_points():
    field = sdf.mesh(CUBE)
    assert field(np.zeros((0, 3))).shape == (0,)
    assert field(np.zeros((2, 0, 3))).shape == (2, 0)
    lattice = np.random.default_rng(3).uniform(-1, 1, ((1 << 18) + 5, 3))
    np.testing.assert_allclose(field(lattice), sdf.box((1, 2, 0.5))(lattice), atol=1e-12)


def test_parts_may_touch_in_a_vertex_and_hold_cavities(rng):
    """Two tetrahedra that share the index of their apex; a box in a box."""
    corners = [(0, 0, 0), (1, 0, 1), (-1, 1, 1), (-1, -1, 1), (1, 0, -1), (-1, 1, -1), (-1, -1, -1)]
    faces = [(0, 1, 3), (0, 3, 2), (0, 2, 1), (1, 2, 3), (0, 6, 4), (0, 5, 6), (0, 4, 5), (4, 6, 5)]
    pinched = trimesh.Trimesh(corners, faces, process=False)
    points = rng.uniform(-1.5, 1.5, (2_000, 3))
    values = sdf.mesh(pinched)(points)
    np.testing.assert_array_equal(values < 0, solid_angles(points, pinched.triangles) > 0.5)
    beside = [[0.3, 0.0, 0.0], [-0.3, 0.1, 0.0], [0, 0, 0]]
    assert (sdf.mesh(pinched)(beside) >= 0).all()

    inner = CUBE.copy()
    inner.apply_scale(0.5)
    inner.invert()
    hollow = sdf.mesh(trimesh.util.concatenate([CUBE, inner]))
    assert hollow([0, 0, 0]) == pytest.approx(0.125)
    assert hollow([0, 0, 0.1875]) == pytest.approx(-0.0625)


# --- broken meshes ---


class Plain:
    """No trimesh: only what the docstring asks for."""

    def __init__(self, vertices, faces):
        self.vertices, self.faces = vertices, faces


V, F = np.asarray(CUBE.vertices), np.asarray(CUBE.faces)
NAN = V.copy()
NAN[3, 1] = np.nan
FLIPPED = F.copy()
FLIPPED[4] = FLIPPED[4][::-1]


@pytest.mark.parametrize(
    ("vertices", "faces", "cause", "remedy"),
    [
        (V, F[:-1], "open: 3 edges", "close its holes"),
        (V[F].reshape(-1, 3), np.arange(36).reshape(-1, 3), "open: 36 edges", "merge"),
        (V, FLIPPED, "turned", "fix_normals"),
        (V, F[:, ::-1], "inside out", "invert"),
        (V, np.concatenate([F, F]), "doubled", "doubled"),
        (V, F[:0], "empty", "check"),
        (V[:0], F[:0], "empty", "check"),
        (NAN, F, "1 of 8 vertices are NaN or infinite, the first is number 3", "repair"),
        (V, F + 1, "only 8 vertices", "check"),
        (V, F - 1, "only 8 vertices", "check"),
        (V, F.astype(float), "integer triangles", "triangulate"),
        (V, F.reshape(-1, 4), "integer triangles", "triangulate"),
        (V, np.concatenate([F, [[0, 0, 1]]]), "use a vertex twice", "degenerate"),
        (V * [1, 1, 0], F, "encloses nothing", "solid"),
        (V, np.array([[0, 1, 2], [2, 1, 0]]), "encloses nothing", "solid"),
    ],
)
def test_broken_meshes_are_refused(vertices, faces, cause, remedy):
    with pytest.raises(InputError, match=cause) as caught:
        sdf.mesh(Plain(vertices, faces))
    assert remedy in caught.value.remedy


def test_plain_lists_are_a_mesh_too():
    assert sdf.mesh(Plain(V.tolist(), F.tolist()))([0, 0, 0]) == -0.25


def test_every_single_missing_face_is_found():
    for k in range(len(ICOSPHERE.faces)):
        with pytest.raises(InputError, match="open"):
            closed_mesh(ICOSPHERE.vertices, np.delete(ICOSPHERE.faces, k, axis=0))


def test_every_single_flipped_face_is_found():
    for k in range(0, len(ICOSPHERE.faces), 7):
        faces = ICOSPHERE.faces.copy()
        faces[k] = faces[k][::-1]
        with pytest.raises(InputError, match="turned"):
            closed_mesh(ICOSPHERE.vertices, faces)


def test_something_else_is_no_mesh():
    with pytest.raises(InputError, match="neither a mesh nor a path"):
        sdf.mesh(3)


# --- files ---


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "off", "glb", "3mf"])
def test_files_are_read(suffix, tmp_path, rng):
    path = tmp_path / f"ring.{suffix}"
    RING.export(path)
    points = rng.uniform(-1.5, 1.5, (300, 3))
    field = sdf.mesh(path)
    # STL stores float32.
    np.testing.assert_allclose(field(points), sdf.mesh(RING)(points), atol=1e-6)
    assert repr(field) == f"mesh({str(path)!r})"
    again = sdf.parse(f"{field!r}.offset(0.1)", allow_files=True)
    np.testing.assert_array_equal(again(points), field(points) - 0.1)


@pytest.mark.parametrize(
    ("name", "content", "cause"),
    [
        ("missing.stl", None, "no such file"),
        ("part.step", b"", "not read here"),
        ("part", b"", "not read here"),
        ("empty.stl", b"", "no triangles"),
        ("text.stl", b"solid nothing\nendsolid nothing\n", "no triangles"),
        ("text.obj", b"not a mesh", "no triangles"),
        ("points.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\n"
         b"property float y\nproperty float z\nend_header\n0 0 0\n", "no triangles"),
    ],
)  # fmt: skip
def test_files_that_cannot_be_used_are_named(name, content, cause, tmp_path):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=cause) as caught:
        sdf.mesh(str(path))
    assert name in str(caught.value.value)


def test_a_truncated_file_is_refused(tmp_path):
    whole = tmp_path / "ring.stl"
    RING.export(whole)
    cut = tmp_path / "cut.stl"
    cut.write_bytes(whole.read_bytes()[:9_000])
    with pytest.raises(InputError):
        sdf.mesh(cut)


def test_an_open_file_is_refused_after_merging(tmp_path):
    path = tmp_path / "open.stl"
    trimesh.Trimesh(V, F[:-1], process=False).export(path)
    with pytest.raises(InputError, match="open: 3 edges"):
        sdf.mesh(path)


def test_a_missing_trimesh_says_what_to_install(monkeypatch, tmp_path):
    path = tmp_path / "cube.stl"
    CUBE.export(path)
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingDependency, match="pip install trimesh") as caught:
        sdf.mesh(path)
    assert caught.value.library == "trimesh"
