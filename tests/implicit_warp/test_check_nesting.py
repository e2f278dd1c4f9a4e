"""Components inside components, exactly: against winding numbers, and at the exact limits."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from implicit_warp.checking import check
from implicit_warp.checking.nesting import UNDECIDED


def sphere(subdivisions: int = 1) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(subdivisions)
    return np.array(mesh.vertices), np.array(mesh.faces)


def joined(*parts):
    """One mesh of several `(vertices, faces)`."""
    offsets = np.cumsum([0, *(len(v) for v, _ in parts)])
    return SimpleNamespace(
        vertices=np.concatenate([v for v, _ in parts]),
        faces=np.concatenate([f + o for (_, f), o in zip(parts, offsets, strict=False)]),
    )


def shells(radii, outward):
    vertices, faces = sphere()
    return joined(
        *(
            (r * vertices, faces if out else faces[:, ::-1])
            for r, out in zip(radii, outward, strict=True)
        )
    )


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_shells_that_face_in_turns_are_nested_rightly(count: int) -> None:
    radii = np.linspace(1.0, 0.2, count)
    report = check(shells(radii, [k % 2 == 0 for k in range(count)]), referees=())
    assert report.ok, str(report)
    assert report.nesting.depth.tolist() == list(range(count))


def test_each_shell_that_faces_the_wrong_way_is_named() -> None:
    outward = [True, True, True, False, False]  # right would be: in turns
    nesting = check(shells([1.0, 0.8, 0.6, 0.4, 0.2], outward), referees=()).nesting
    assert nesting.misnested_components.tolist() == [1]
    assert nesting.inside_out_components.tolist() == [4]


def test_a_component_beside_an_other_and_inside_out_is_named() -> None:
    """The volumes' sum is positive: only the component itself gives it away."""
    vertices, faces = sphere()
    mesh = joined((vertices, faces), (0.5 * vertices + [3.0, 0.0, 0.0], faces[:, ::-1]))
    report = check(mesh, referees=())
    assert report.volume > 0
    assert report.nesting.inside_out_components.tolist() == [1]
    assert any("inside out" in problem for problem in report.problems)


def winding(vertices: np.ndarray, faces: np.ndarray, point: np.ndarray) -> float:
    """Solid angle over 4 pi (van Oosterom and Strackee 1983): nothing like a half-line."""
    a, b, c = (vertices[faces[:, k]] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
    denominator = (
        la * lb * lc
        + np.einsum("ij,ij->i", a, b) * lc
        + np.einsum("ij,ij->i", b, c) * la
        + np.einsum("ij,ij->i", c, a) * lb
    )
    return float(np.arctan2(numerator, denominator).sum() / (2 * np.pi))


@pytest.mark.parametrize("seed", range(6))
def test_depths_of_random_scatters_are_those_by_winding_numbers(seed: int) -> None:
    rng = np.random.default_rng(seed)
    torus = trimesh.creation.torus(1.0, 0.5, major_sections=16, minor_sections=8)
    parts = []
    for _ in range(40):
        vertices, faces = sphere() if rng.random() < 0.6 else (torus.vertices, torus.faces)
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        turn[:, 0] *= np.linalg.det(turn)
        size = 10 ** rng.uniform(-2.5, 0.3)
        parts.append((size * vertices @ turn.T + rng.uniform(-0.7, 0.7, 3), faces))
    report = check(joined(*parts), referees=())
    depth = report.nesting.depth
    decided = np.flatnonzero(depth != UNDECIDED)
    for i in decided:
        inside = [j for j in range(40) if j != i and abs(winding(*parts[j], parts[i][0][0])) > 0.5]
        assert depth[i] == len(inside), f"seed {seed}, component {i} in {inside}"
    assert (depth[decided] > 0).any(), "nothing lies in anything: nothing is tested"
    meeting = report.topology.component_of_face[report.self_intersections.pairs]
    assert set(np.flatnonzero(depth == UNDECIDED)) == set(meeting.ravel())


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e300])
def test_half_lines_through_corners_and_edges_count_once(scale: float) -> None:
    """Right above every vertex of the inner box are an edge, a corner or a wall of the outer."""
    lattice = trimesh.creation.box((2.0, 2.0, 2.0)).subdivide().subdivide()
    inner = trimesh.creation.box((1.0, 1.0, 1.0))
    for turn in (np.eye(3), np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]]):
        mesh = joined(
            (lattice.vertices @ turn * scale, lattice.faces),
            (inner.vertices @ turn * scale, inner.faces[:, ::-1]),
        )
        report = check(mesh, referees=())
        assert report.nesting.depth.tolist() == [0, 1], str(report)
        assert report.ok


def test_components_that_meet_others_are_left_undecided() -> None:
    vertices, faces = sphere()
    mesh = joined(
        (vertices, faces), (vertices + np.array([0.5, 0.1, 0.2]), faces), (vertices + 5.0, faces)
    )
    report = check(mesh, referees=())
    assert report.nesting.depth.tolist() == [UNDECIDED, UNDECIDED, 0]


def test_nothing_is_said_of_what_may_lie_inside_an_open_component() -> None:
    vertices, faces = sphere()
    mesh = joined((vertices, faces[1:]), (0.5 * vertices, faces[:, ::-1]), (vertices + 9.0, faces))
    report = check(mesh, referees=())
    assert report.nesting.depth.tolist() == [UNDECIDED, UNDECIDED, 0]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("size", [1e-3, 1e-9, 1e-30])
def test_the_sign_of_a_tiny_volume_far_from_the_origin_is_exact(size: float, sign: int) -> None:
    """Beside a large one, about whose centre rounding would drown its volume."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    tiny = size * corners + [float(size > 1e-15), 0, 0]  # as far out as it has a shape there
    large = corners * 3.0 + [-20.0, 0, 0]
    mesh = joined((large, faces), (tiny, faces[:, ::sign]))
    report = check(mesh, referees=())
    assert report.topology.component_signs.tolist() == [1, sign]
    assert report.nesting.inside_out_components.tolist() == ([1] if sign < 0 else [])


def test_a_thousand_components_take_no_time() -> None:
    vertices, faces = sphere(0)
    places = np.stack(np.meshgrid(*[np.arange(10.0)] * 3), axis=-1).reshape(-1, 3)
    small = [(0.2 * vertices + p, faces[:, ::-1]) for p in places]
    hull = trimesh.creation.box((12.0, 12.0, 12.0)).apply_translation([4.5] * 3)
    report = check(joined((np.array(hull.vertices), np.array(hull.faces)), *small), referees=())
    assert report.nesting.depth.tolist() == [0] + [1] * 1000
    assert report.ok
