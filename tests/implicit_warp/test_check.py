"""`check` by sabotage: each defect raises its own flag and no other, clean meshes none."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from implicit_warp.checking import BadMesh, analyse, check
from implicit_warp.checking.equal_vertices import first_of_equal
from implicit_warp.errors import FileFormatError, InputError


def sphere() -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.creation.icosphere(2)
    return np.array(mesh.vertices), np.array(mesh.faces)


def two_spheres(distance: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = sphere()
    return (
        np.vstack([vertices, vertices + np.array([distance, 0.0, 0.0])]),
        np.vstack([faces, faces + len(vertices)]),
    )


def mesh_of(vertices, faces) -> SimpleNamespace:
    """Bare arrays, so that no library has a chance to tidy them up."""
    return SimpleNamespace(vertices=vertices, faces=faces)


def flags_of(vertices, faces) -> set[str]:
    report = check(mesh_of(vertices, faces), referees=())
    raised = {name for name, n in report.counts().items() if n and not name.startswith("self_")}
    if report.num_self_intersections:
        raised.add("self_intersections")
    harmless = {"unreferenced_vertices", "duplicate_vertices", "sliver_faces"}
    assert report.ok == (raised <= harmless), str(report)
    return raised


# --- sabotage ---------------------------------------------------------------------------------


def dropped_face(vertices, faces):
    return vertices, faces[1:]


def flipped_face(vertices, faces):
    faces[5] = faces[5, ::-1]
    return vertices, faces


def inside_out(vertices, faces):
    return vertices, faces[:, ::-1]


def duplicated_face(vertices, faces):
    return vertices, np.vstack([faces, faces[9]])


def vertex_through_a_wall(vertices, faces):
    vertices[3] *= -1.2
    return vertices, faces


def pinched_vertices(vertices, faces):
    """Two spheres that touch in one point, by one common vertex."""
    vertices, faces = two_spheres(2.0)
    half = len(vertices) // 2
    right, left = np.argmax(vertices[:half, 0]), half + np.argmin(vertices[half:, 0])
    faces[faces == left] = right
    return np.delete(vertices, left, axis=0), faces - (faces > left)


def welded_along_an_edge(vertices, faces):
    """Two tetrahedra with one edge in common, which then has four faces."""
    vertices = np.array([[0, 0, 1], [0, 0, -1], [2, 1, 0], [2, -1, 0], [-2, 1, 0], [-2, -1, 0]])
    tetrahedron = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
    other = np.array([0, 1, 5, 4])[tetrahedron]
    return vertices.astype(float), np.vstack([tetrahedron, other])


def coordinate_that_is_nan(vertices, faces):
    vertices[11, 2] = np.nan
    return vertices, faces


def coordinate_that_is_infinite(vertices, faces):
    vertices[11, 0] = -np.inf
    return vertices, faces


def unused_vertex(vertices, faces):
    return np.vstack([vertices, [7.0, 7.0, 7.0]]), faces


def face_that_uses_a_vertex_twice(vertices, faces):
    return vertices, np.vstack([faces, [4, 4, 8]])


def bipyramid(apex_offset: float) -> tuple[np.ndarray, np.ndarray]:
    """A square pyramid whose base is cut by a face with its third corner near the cut.

    The edge from corner 0 to corner 2 of the base carries the vertex 5, moved off it by
    `apex_offset`, and the thin face 0, 5, 2 fills the gap.
    """
    vertices = np.array(
        [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, -apex_offset, 0]], float
    )
    walls = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    base = [[0, 2, 1], [0, 5, 2], [0, 3, 5], [3, 2, 5]]
    return vertices, np.array(walls + base)


def zero_area(vertices, faces):
    return bipyramid(0.0)


def sliver(vertices, faces):
    return bipyramid(1e-9)


SABOTAGE: dict[Callable, set[str]] = {
    dropped_face: {"open_edges"},
    flipped_face: {"misoriented_edges"},
    inside_out: {"inside_out_components"},
    duplicated_face: {"nonmanifold_edges", "duplicate_faces", "self_intersections"},
    vertex_through_a_wall: {"self_intersections"},
    pinched_vertices: {"pinched_vertices"},
    welded_along_an_edge: {"nonmanifold_edges"},
    coordinate_that_is_nan: {"nonfinite_vertices"},
    coordinate_that_is_infinite: {"nonfinite_vertices"},
    unused_vertex: {"unreferenced_vertices"},
    face_that_uses_a_vertex_twice: {"repeated_vertex_faces"},
    zero_area: {"zero_area_faces", "self_intersections"},
    sliver: {"sliver_faces"},
}


@pytest.mark.parametrize("sabotage", SABOTAGE, ids=lambda f: f.__name__)
def test_each_sabotage_raises_its_own_flags(sabotage: Callable) -> None:
    assert flags_of(*sabotage(*sphere())) == SABOTAGE[sabotage]


@pytest.mark.parametrize(
    ("mesh", "genus"),
    [
        (trimesh.creation.icosphere(2), (0,)),
        (trimesh.creation.box(), (0,)),
        (trimesh.creation.torus(1.0, 0.3), (1,)),
        (trimesh.creation.annulus(0.5, 1.0, 1.0), (1,)),
        (trimesh.creation.capsule(), (0,)),
        (mesh_of(*two_spheres(3.0)), (0, 0)),
    ],
)
def test_clean_meshes_raise_none(mesh, genus: tuple[int, ...]) -> None:
    assert flags_of(mesh.vertices, mesh.faces) == set()
    report = check(mesh)
    assert report.watertight
    assert report.topology.genus == genus
    assert report.raise_if_bad() is report


def test_a_solid_around_nothing_has_no_positive_volume() -> None:
    """Two faces back to back are closed, and enclose exactly nothing."""
    report = check(mesh_of(np.eye(3), np.array([[0, 1, 2], [2, 1, 0]])), referees=())
    assert report.watertight
    assert report.topology.component_signs.tolist() == [0]
    assert any("not positive" in problem for problem in report.problems)


def test_offenders_are_named_by_index() -> None:
    vertices, faces = sphere()
    t = analyse(*dropped_face(vertices, faces))
    assert {tuple(e) for e in t.open_edges} == {
        tuple(sorted((faces[0, k], faces[0, k - 1]))) for k in range(3)
    }
    assert analyse(*duplicated_face(*sphere())).duplicate_faces.tolist() == [len(faces)]
    assert analyse(*coordinate_that_is_nan(*sphere())).nonfinite_vertices.tolist() == [11]
    assert analyse(*unused_vertex(*sphere())).unreferenced_vertices.tolist() == [len(vertices)]
    assert analyse(*zero_area(*sphere())).zero_area_faces.tolist() == [5]
    assert analyse(*sliver(*sphere())).sliver_faces.tolist() == [5]


# --- oracles: slow and plain ----------------------------------------------------------------


def random_soup(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Few vertices and many faces: every kind of bad edge and vertex occurs."""
    rng = np.random.default_rng(seed)
    faces = np.array([rng.permutation(9)[:3] for _ in range(rng.integers(1, 16))])
    return rng.standard_normal((9, 3)), faces


@pytest.mark.parametrize("seed", range(40))
def test_edges_and_vertices_of_random_soups_agree_with_a_plain_count(seed: int) -> None:
    vertices, faces = random_soup(seed)
    uses: dict[tuple[int, int], list[int]] = {}
    for face in faces:
        for k in range(3):
            tail, head = int(face[k]), int(face[(k + 1) % 3])
            uses.setdefault((min(tail, head), max(tail, head)), []).append(
                int(np.sign(head - tail))
            )
    t = analyse(vertices, faces)
    assert list(map(tuple, t.open_edges)) == sorted(e for e, u in uses.items() if len(u) == 1)
    assert list(map(tuple, t.nonmanifold_edges)) == sorted(e for e, u in uses.items() if len(u) > 2)
    assert list(map(tuple, t.misoriented_edges)) == sorted(
        e for e, u in uses.items() if len(u) == 2 and sum(u) != 0
    )
    assert t.watertight == all(sorted(u) == [-1, 1] for u in uses.values())
    pinched = [v for v in range(9) if plain_fans(faces, v) > 1]
    assert t.pinched_vertices.tolist() == pinched
    assert t.num_components == len(set(plain_components(faces)))


@pytest.mark.parametrize("seed", range(10))
def test_equal_vertices_of_random_lattices_agree_with_a_dictionary(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vertices = rng.integers(-2, 3, (rng.integers(0, 200), 3)) * rng.choice([1.0, -0.0, 1e-300])
    seen: dict[tuple[float, ...], int] = {}
    expected = [seen.setdefault(tuple(v), i) for i, v in enumerate(vertices.tolist())]
    assert first_of_equal(vertices).tolist() == expected
    faces = np.empty((0, 3), dtype=np.int64)
    repeats = [i for i, first in enumerate(expected) if first != i]
    assert analyse(vertices, faces).duplicate_vertices.tolist() == repeats


def test_vertices_that_are_not_finite_are_duplicates_of_none() -> None:
    vertices = np.array([[0, 0, np.nan], [0, 0, np.nan], [np.inf, 0, 0], [np.inf, 0, 0]])
    assert len(analyse(vertices, np.empty((0, 3), dtype=np.int64)).duplicate_vertices) == 0


def test_ten_thousand_faces_at_one_vertex_are_one_fan() -> None:
    """No step may be quadratic in the number of faces at a vertex."""
    n = 10_000
    ring = np.arange(n)
    angle = 2 * np.pi * ring / n
    vertices = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    vertices = np.concatenate([vertices, [[0, 0, 1], [0, 0, -1]]])
    after = (ring + 1) % n
    faces = np.concatenate(
        [
            np.column_stack([ring, after, np.full(n, n)]),
            np.column_stack([after, ring, np.full(n, n + 1)]),
        ]
    )
    t = analyse(vertices, faces)
    assert t.watertight
    assert t.vertex_manifold
    assert t.genus == (0,)


def plain_fans(faces: np.ndarray, vertex: int) -> int:
    """Fans of a vertex: its faces, grown together while they share another vertex."""
    groups = [set(map(int, f)) - {vertex} for f in faces if vertex in f]
    return count_grown_together(groups, shared=1)


def plain_components(faces: np.ndarray) -> list[int]:
    return list(range(count_grown_together([set(map(int, f)) for f in faces], shared=2)))


def count_grown_together(sets: list[set[int]], shared: int) -> int:
    """Classes of sets under the closure of `have at least so many members in common`."""
    rest = list(range(len(sets)))
    classes = 0
    while rest:
        frontier = [rest.pop()]
        classes += 1
        while frontier:
            current = sets[frontier.pop()]
            near = [i for i in rest if len(sets[i] & current) >= shared]
            frontier += near
            rest = [i for i in rest if i not in near]
    return classes


def test_volume_and_area_agree_with_trimesh() -> None:
    mesh = trimesh.creation.torus(1.0, 0.3).apply_translation([100.0, 50.0, -20.0])
    report = check(mesh)
    # Both sum 2048 rounded terms; ours about the centre, trimesh about the far origin.
    assert report.volume == pytest.approx(mesh.volume, rel=1e-8)
    assert report.area == pytest.approx(mesh.area, rel=1e-12)


def test_a_cavity_has_negative_volume_and_makes_no_mesh_bad() -> None:
    vertices, faces = sphere()
    hollow = mesh_of(
        np.vstack([vertices, 0.5 * vertices]), np.vstack([faces, faces[:, ::-1] + len(vertices)])
    )
    report = check(hollow)
    assert report.ok
    outer, inner = report.topology.component_volumes
    assert inner == pytest.approx(-outer / 8)
    assert report.volume == pytest.approx(outer * 7 / 8)


def test_genus_counts_pinched_vertices_apart() -> None:
    t = analyse(*pinched_vertices(*sphere()))
    assert t.genus == (0, 0)


# --- extremes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e-30, 1e30, 1e200, 1e300])
def test_tiny_and_huge_coordinates_are_judged_like_others(scale: float) -> None:
    vertices, faces = sphere()
    report = check(mesh_of(vertices * scale, faces))
    assert report.ok, str(report)
    json.loads(report.to_json())
    assert flags_of(vertices * scale, faces[:, ::-1]) == {"inside_out_components"}
    assert flags_of(*vertex_through_a_wall(vertices * scale, faces)) == {"self_intersections"}


@pytest.mark.parametrize("seed", range(4))
def test_components_of_all_sizes_in_one_mesh_are_judged_like_others(seed: int) -> None:
    """From 1e-30 to 1e30 in one array: the small are not drowned by the large."""
    rng = np.random.default_rng(seed)
    vertices, faces = sphere()
    sizes = 10.0 ** rng.permutation(np.arange(-30, 31, 12))
    # Each beside the larger ones, not round the same centre.
    parts = [vertices * size + np.array([4.0 * size, 0, 0]) for size in sizes]
    offsets = len(vertices) * np.arange(len(sizes))[:, None, None]
    every = (faces + offsets).reshape(-1, 3)
    assert flags_of(np.concatenate(parts), every) == set()
    chosen = int(rng.integers(len(sizes)))
    block = slice(chosen * len(faces), (chosen + 1) * len(faces))
    flipped = every.copy()
    flipped[block] = flipped[block, ::-1]
    report = check(mesh_of(np.concatenate(parts), flipped), referees=())
    assert report.nesting.inside_out_components.tolist() == [chosen]
    parts[chosen][3] -= 2.2 * (parts[chosen][3] - [4.0 * sizes[chosen], 0, 0])
    found = check(mesh_of(np.concatenate(parts), every), referees=())
    assert set(found.topology.component_of_face[found.self_intersections.pairs].ravel()) == {chosen}


@pytest.mark.parametrize("count", [0, 1])
def test_no_face_and_one_face_are_reported(count: int) -> None:
    report = check(mesh_of(np.eye(3)[: 3 * count], np.array([[0, 1, 2]])[:count]))
    assert not report.ok
    assert report.topology.num_faces == count
    assert ("no faces" if not count else "3 edges are open") in report.problems[0]
    json.loads(report.to_json())
    assert str(report)


def test_collapsed_mesh_is_reported() -> None:
    vertices, faces = sphere()
    report = check(mesh_of(0.0 * vertices, faces), limit=500)
    assert len(report.topology.zero_area_faces) == len(faces)
    assert any("limit" in problem for problem in report.problems)


def test_faces_without_finite_vertices_are_reported() -> None:
    vertices, faces = sphere()
    report = check(mesh_of(np.nan * vertices, faces))
    assert any("not finite" in problem for problem in report.problems)
    json.loads(report.to_json())


# --- the report -------------------------------------------------------------------------------


def test_raise_if_bad_names_the_problems_and_carries_the_report() -> None:
    vertices, faces = dropped_face(*sphere())
    report = check(mesh_of(vertices, faces))
    with pytest.raises(BadMesh, match="3 edges are open") as refusal:
        report.raise_if_bad()
    assert refusal.value.report is report
    assert list(refusal.value.problems) == report.problems


def test_tolerated_self_intersections_do_not_raise_but_one_more_does() -> None:
    report = check(mesh_of(*vertex_through_a_wall(*sphere())))
    count = report.num_self_intersections
    assert report.raise_if_bad(max_self_intersections=count) is report
    with pytest.raises(BadMesh, match=f"{count} pairs of faces intersect"):
        report.raise_if_bad(max_self_intersections=count - 1)


def test_json_holds_what_the_report_says() -> None:
    report = check(mesh_of(*vertex_through_a_wall(*sphere())))
    data = json.loads(report.to_json())
    assert data["ok"] is False
    assert data["problems"] == report.problems
    assert data["self_intersections"]["count"] == report.num_self_intersections
    assert sum(data["self_intersections"]["kinds"].values()) == report.num_self_intersections
    assert data["watertight"] is True
    assert data["volume"] == report.volume
    assert data["referees"][0]["referee"] == "manifold3d"


def test_counts_have_the_same_names_for_every_mesh_and_say_what_the_report_says() -> None:
    clean = check(mesh_of(*sphere()), referees=()).counts()
    assert not any(clean.values())
    for sabotage in SABOTAGE:
        report = check(mesh_of(*sabotage(*sphere())), referees=())
        counts = report.counts()
        assert list(counts) == list(clean)
        kinds = [n for name, n in counts.items() if name.startswith("self_intersections.")]
        assert sum(kinds) == counts["self_intersections"] == report.num_self_intersections
        listed = report.to_dict()
        for name, n in counts.items():
            if "." not in name:
                assert listed[name]["count"] == n, name


def test_the_arrays_of_a_mesh_are_not_copied() -> None:
    """A report of ten million faces must not hold them twice."""
    vertices, faces = sphere()
    report = check(mesh_of(vertices, faces), referees=())
    assert np.shares_memory(report.vertices, vertices)
    assert np.shares_memory(report.faces, faces)


def test_text_of_a_report_leads_with_the_verdict() -> None:
    assert str(check(mesh_of(*sphere()))).startswith("mesh: ok\n")
    bad = str(check(mesh_of(*flipped_face(*sphere()))))
    assert bad.startswith("mesh: BAD\n")
    assert "problem: 3 edges join faces of opposite orientation" in bad


def test_the_mesh_is_not_changed() -> None:
    vertices, faces = duplicated_face(*sphere())
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    check(mesh, referees=("manifold3d", "trimesh"))
    assert np.array_equal(mesh.vertices, vertices)
    assert np.array_equal(mesh.faces, faces)


# --- files ------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".off"])
def test_files_are_checked_as_the_meshes_they_hold(suffix: str, tmp_path) -> None:
    path = tmp_path / f"sphere{suffix}"
    trimesh.Trimesh(*sphere(), process=False).export(path)
    report = check(path).raise_if_bad()
    assert report.source == str(path)
    assert report.topology.num_vertices == len(sphere()[0])


def split(vertices, faces):
    """Each face with corners of its own, as normals and texture coordinates demand."""
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def test_formats_that_must_split_vertices_are_merged_and_others_are_told_about_it(tmp_path) -> None:
    mesh = trimesh.Trimesh(*split(*sphere()), process=False)
    for suffix in (".glb", ".ply"):
        mesh.export(tmp_path / f"split{suffix}")
    assert check(tmp_path / "split.glb", referees=()).ok
    report = check(tmp_path / "split.ply", referees=())
    assert len(report.topology.open_edges) == 3 * len(mesh.faces)
    assert any("merge_vertices=True" in note for note in report.notes)
    assert check(tmp_path / "split.ply", referees=(), merge_vertices=True).ok


def test_texture_coordinates_and_normals_of_an_obj_file_do_not_open_it(tmp_path) -> None:
    path = tmp_path / "textured.obj"
    corners = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1"]
    textures = ["vt 0 0", "vt 1 0", "vt 0 1", "vt 1 1"]
    normals = ["vn 0 0 -1", "vn 0 -1 0", "vn -1 0 0", "vn 1 1 1"]
    faces = [
        "f 1/1/1 3/2/1 2/3/1",
        "f 1/4/2 2/1/2 4/2/2",
        "f 1/3/3 4/2/3 3/4/3",
        "f 2/1/4 3/2/4 4/3/4",
    ]
    path.write_text("\n".join([*corners, *textures, *normals, *faces]) + "\n")
    report = check(path, referees=())
    assert report.ok, str(report)
    assert report.topology.num_vertices == 4


def test_duplicate_faces_in_a_file_are_not_tidied_away(tmp_path) -> None:
    path = tmp_path / "duplicate.ply"
    trimesh.Trimesh(*duplicated_face(*sphere()), process=False).export(path)
    assert len(check(path).topology.duplicate_faces) == 1


def test_missing_and_damaged_files_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="no such file"):
        check(tmp_path / "absent.stl")
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\n")
    with pytest.raises(FileFormatError, match="broken"):
        check(broken)


@pytest.mark.parametrize("thing", [None, 3, [1, 2], np.eye(3)])
def test_things_that_are_no_mesh_are_refused(thing) -> None:
    with pytest.raises(InputError, match="has no vertices and faces"):
        check(thing)


def test_unknown_referees_are_refused_with_the_list_of_known_ones() -> None:
    with pytest.raises(InputError, match=r"manifold3d.*trimesh.*open3d.*pymeshlab"):
        check(mesh_of(*sphere()), referees=("cgal",))
