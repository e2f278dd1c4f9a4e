"""Pictures and coloured meshes show every defect, at its place, in its colour."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from implicit_warp.checking import check, evidence_picture
from implicit_warp.checking.evidence import CLASSES, evidence
from implicit_warp.errors import InputError
from tests.implicit_warp.planted_defects import KINDS, planted

SMALL = (320, 256)
NUMBER = {c.count: n for n, c in enumerate(CLASSES)}
UNSEEN = {"unreferenced_vertices", "duplicate_vertices", "duplicate_faces", "self_intersections"}
"""What has no place on the surface, or is shown by another class."""


@pytest.fixture(autouse=True)
def _small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evidence_picture, "PANEL", SMALL)


def report_of(kind: str, seed: int = 0):
    defect = planted(kind, seed)
    mesh = SimpleNamespace(vertices=defect.vertices, faces=defect.faces)
    return check(mesh, referees=())


def test_every_count_has_a_class() -> None:
    assert set(NUMBER) == set(report_of("hole").counts()) - UNSEEN
    assert len({c.color for c in CLASSES}) == len({c.label for c in CLASSES}) == len(CLASSES)


@pytest.mark.parametrize("kind", KINDS)
def test_each_defect_colours_faces_of_its_own(kind: str) -> None:
    report = report_of(kind)
    found = evidence(report)
    shown = {CLASSES[n].count for n in np.unique(found.face_class) if n >= 0}
    raised = {name for name, n in report.counts().items() if n} - UNSEEN
    assert shown <= raised
    assert bool(shown) == bool(raised)


def test_faces_with_several_defects_have_the_colour_of_the_worst() -> None:
    report = report_of("duplicated_face")
    twice = evidence(report).face_class[report.self_intersections.pairs.ravel()]
    assert set(twice) == {NUMBER["self_intersections.duplicate"]}


@pytest.mark.parametrize("kind", ["hole", "fold", "nonfinite_vertex"])
def test_coloured_meshes_hold_the_mesh_and_its_colours(kind: str, tmp_path) -> None:
    report, path = report_of(kind), tmp_path / "bad.ply"
    report.write_coloured_mesh(path)
    mesh = trimesh.load(path, process=False)
    assert np.array_equal(mesh.vertices, report.vertices, equal_nan=True)
    assert np.array_equal(mesh.faces, report.faces)
    expected = np.rint(255 * evidence(report).face_colors())
    assert np.array_equal(mesh.visual.face_colors[:, :3], expected)
    assert b"comment defect 0: sliver" in path.read_bytes()[:2000]


def pixels_near(image: np.ndarray, color) -> int:
    """Pixels of one hue: shading changes how bright a colour is, hardly which it is."""
    levels = image.reshape(-1, 3).astype(float)
    wanted = np.array(color) / np.linalg.norm(color)
    bright = np.linalg.norm(levels, axis=1)
    return int(np.count_nonzero((levels @ wanted > 0.995 * bright) & (bright > 60)))


@pytest.mark.parametrize(
    ("kind", "count"),
    [
        ("crossing", "self_intersections.crossing"),
        ("fin", "nonmanifold_edges"),
        ("wrong_nesting", "misnested_components"),
    ],
)
def test_the_close_view_shows_the_defect_large(kind: str, count: str, tmp_path) -> None:
    """Even inside a solid, where the mesh must be cut open to show it."""
    from PIL import Image

    path = tmp_path / "bad.png"
    report_of(kind).write_picture(path)
    image = np.asarray(Image.open(path))
    close = image[: SMALL[1], image.shape[1] // 2 :]
    assert pixels_near(close, CLASSES[NUMBER[count]].color) > 0.01 * close[..., 0].size


def test_a_clean_mesh_and_a_huge_one_can_be_drawn(tmp_path) -> None:
    sphere = trimesh.creation.icosphere(1)
    mesh = SimpleNamespace(vertices=sphere.vertices, faces=sphere.faces)
    check(mesh, referees=()).write_picture(tmp_path / "clean.png")
    for scale in (1e-300, 1e300):
        mesh = SimpleNamespace(vertices=sphere.vertices * scale, faces=sphere.faces[3:])
        check(mesh, referees=()).write_picture(tmp_path / "open.png")


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        (np.empty((0, 3)), np.empty((0, 3), dtype=int)),
        (np.full((3, 3), np.nan), [[0, 1, 2]]),
        (np.ones((3, 3)), [[0, 1, 2]]),
    ],
)
def test_meshes_without_anything_to_see_are_refused_a_picture(vertices, faces, tmp_path) -> None:
    report = check(SimpleNamespace(vertices=vertices, faces=faces), referees=())
    with pytest.raises(InputError, match="nothing to show"):
        report.write_picture(tmp_path / "bad.png")
    report.write_coloured_mesh(tmp_path / "bad.ply")
    assert not list(tmp_path.glob("*.png"))


def test_names_that_do_not_say_the_format_are_refused(tmp_path) -> None:
    report = report_of("hole")
    with pytest.raises(InputError, match=r"\.png"):
        report.write_picture(tmp_path / "bad.jpg")
    with pytest.raises(InputError, match=r"\.ply"):
        report.write_coloured_mesh(tmp_path / "bad.obj")
