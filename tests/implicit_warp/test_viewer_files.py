"""What the editor reads and writes: shapes, exports, and what a crash would lose."""

from __future__ import annotations

import os
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

import fields
import implicit_warp as iw
from fields.grid_files import save_grid
from implicit_warp.cli import main
from implicit_warp.elastic_solve import ElasticOptions
from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.handles import load_handles
from implicit_warp.shapes import load_shape
from implicit_warp.viewer.autosave import Autosave
from implicit_warp.viewer.export import MESHES, export_mesh, inside
from implicit_warp.viewer.guard import guarded, tell, text_of
from implicit_warp.viewer.live_solver import LiveSolver
from implicit_warp.viewer.session import (
    EditHandle,
    EditSession,
    EditState,
    load_edit,
    save_edit,
    solve_handles,
)
from implicit_warp.viewer.source import PREVIEW_VERTICES, ShapeSource, preview_mesh
from tests.viewer.bar import BAR

HANDLES = (
    EditHandle("foot", fields.below(-0.7), (0.0, 0.0, -0.85), held=True),
    EditHandle("head", fields.above(0.7), (0.0, 0.0, 0.85), False, (0, 40, 0), (0.3, 0, 0)),
)
SOLVE = {"layers": 6, "resolution": 5, "steps": 50, "samples": 256, "handle_samples": 64, "seed": 3}


@pytest.fixture
def script(tmp_path) -> Path:
    path = tmp_path / "part.py"
    path.write_text(BAR)
    return path


# --- where files may go ---


def folder_with_ways_out(tmp_path: Path) -> Path:
    folder, outside = tmp_path / "work", tmp_path / "outside"
    (folder / "sub").mkdir(parents=True)
    outside.mkdir()
    (outside / "kept.stl").write_text("kept")
    (folder / "link.stl").symlink_to(outside / "kept.stl")
    (folder / "dangling.stl").symlink_to(outside / "new.stl")
    (folder / "away").symlink_to(outside)
    (folder / "round").symlink_to(folder / "sub")
    return folder


@pytest.mark.parametrize(
    "name",
    ["../x.stl", "sub/../../x.stl", "/etc/x.stl", "link.stl", "dangling.stl", "away/x.stl",
     "away/../../x.stl", "..", ".", "sub/..", "work/../../outside/kept.stl", "/"],
)  # fmt: skip
def test_no_path_leads_out_of_the_working_folder(tmp_path, name):
    folder = folder_with_ways_out(tmp_path)
    with pytest.raises(InputError) as caught:
        inside(folder, name, MESHES)
    assert caught.value.argument == "file"
    assert "outside of the working folder" in str(caught.value)
    assert str(folder) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize(
    "name", ["x.stl", " x.stl ", "sub/x.STL", "./x.ply", "sub/../x.obj", "round/x.stl"]
)
def test_paths_within_the_working_folder_are_taken(tmp_path, name):
    folder = folder_with_ways_out(tmp_path)
    path = inside(folder, name, MESHES)
    assert path.is_relative_to(folder)
    assert path.parent.is_dir()


def test_the_working_folder_may_itself_be_a_link(tmp_path):
    folder = folder_with_ways_out(tmp_path)
    (tmp_path / "link").symlink_to(folder)
    assert inside(tmp_path / "link", "x.stl", MESHES) == folder / "x.stl"


@pytest.mark.parametrize(
    ("name", "message"),
    [("", "no name"), ("  ", "no name"), ("x", "cannot write"), ("x.exe", "cannot write"),
     ("missing/x.stl", "folder does not exist"), ("a\0.stl", "null character")],
)  # fmt: skip
def test_names_that_no_mesh_file_can_have_are_refused(tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        inside(tmp_path, name, MESHES)


@given(st.text(alphabet=st.sampled_from("./\\~ab \0:*é\n"), max_size=20))
def test_whatever_is_typed_stays_inside_or_is_refused(tmp_path_factory, name):
    folder = tmp_path_factory.getbasetemp()
    try:
        path = inside(folder, name + ".stl", MESHES)
    except InputError:
        return
    assert path.is_relative_to(folder.resolve())


def test_the_file_that_is_edited_is_never_replaced(tmp_path):
    (tmp_path / "scan.stl").write_text("the original")
    (tmp_path / "same.stl").symlink_to(tmp_path / "scan.stl")
    keep = (tmp_path / "scan.stl", None)
    for name in ("scan.stl", "./scan.stl", "same.stl"):
        with pytest.raises(InputError, match="replace the file that is edited"):
            inside(tmp_path, name, MESHES, keep)
    assert inside(tmp_path, "scan-deformed.stl", MESHES, keep).name == "scan-deformed.stl"


# --- exports ---


@pytest.fixture(scope="module", params=["as it is", "under a map"])
def edited(tmp_path_factory, request):
    """The bar, or what an earlier edit left of it, edited in the page's way; its export and its
    handle file."""
    folder = tmp_path_factory.mktemp("edited")
    (folder / "part.py").write_text(BAR)
    before = None
    if request.param == "under a map":
        before = folder / "before.safetensors"
        turned = EditState((HANDLES[0], replace(HANDLES[1], rotvec=(0, 0, 50), shift=(0, 0, 0))))
        options = ElasticOptions.from_mapping(SOLVE)
        shape = load_shape(folder / "part.py")
        iw.save(iw.elastic(shape, solve_handles(turned), options=options), before)
    source, state, finals = ShapeSource(folder / "part.py", before), EditState(HANDLES), []
    shape = source.field
    solver = LiveSolver(
        shape, np.zeros((1, 3)), lambda u: finals.append(u) if u.final else None,
        finals.append, ElasticOptions.from_mapping(SOLVE),
    )  # fmt: skip
    solver.follow(solve_handles(state, 0.5))
    solver.wait()
    solver.solve(solve_handles(state))
    solver.wait()
    solver.close()
    (final,) = finals
    calls: list[tuple[int, int]] = []
    report = export_mesh(
        shape, final.warp, folder / "page.stl", 40, lambda done, total: calls.append((done, total))
    )
    save_edit(state, folder / "page.toml", SOLVE)
    warp = final.warp if source.map is None else final.warp @ source.map
    return folder, warp, report, calls


def test_an_export_is_a_checked_mesh_that_says_how_far_it_is(edited):
    folder, _, report, calls = edited
    assert report.ok
    mesh = trimesh.load(folder / "page.stl")
    assert mesh.is_watertight
    assert len(iw.check(mesh).self_intersections.pairs) == 0
    done = [d for d, _ in calls]
    assert done == sorted(done)
    assert calls[-1][0] == calls[-1][1]


def test_replaying_the_handle_file_on_the_command_line_gives_the_same_files(edited, capsys):
    folder, warp, _, _ = edited
    before = folder / "before.safetensors"
    under = ("--under", str(before)) if before.exists() else ()
    code = main(["deform", f"{folder}/part.py", "--handles", f"{folder}/page.toml",
                 "-o", f"{folder}/line.stl", "--resolution", "40", *under])  # fmt: skip
    assert code == 0, capsys.readouterr()
    assert (folder / "line.stl").read_bytes() == (folder / "page.stl").read_bytes()
    iw.save(warp, folder / "page.safetensors")
    x = np.random.default_rng(0).normal(size=(100, 3))
    np.testing.assert_array_equal(iw.load(folder / "line.safetensors")(x), warp(x))


def test_an_edit_at_rest_is_exported_as_it_is(script, tmp_path):
    report = export_mesh(load_shape(script), None, tmp_path / "rest.ply", 32)
    assert report.ok
    np.testing.assert_allclose(
        trimesh.load(tmp_path / "rest.ply").bounds, [(-0.2, -0.2, -1), (0.2, 0.2, 1)], atol=1e-3
    )


def test_an_export_that_is_broken_off_leaves_the_old_file(script, tmp_path):
    (tmp_path / "old.stl").write_text("old")

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export_mesh(load_shape(script), None, tmp_path / "old.stl", 32, stop)
    assert (tmp_path / "old.stl").read_text() == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["old.stl", "part.py"]


# --- the shape and its preview ---


def test_a_script_that_changes_is_noticed_and_a_broken_one_keeps_the_last_shape(script):
    source = ShapeSource(script)
    assert not source.changed()
    field, preview = source.field, source.preview
    os.utime(script)
    assert not source.changed(), "its content is the same"

    script.write_text("shape = 1 / 0")
    assert source.changed()
    with pytest.raises(InputError, match="ZeroDivisionError"):
        source.reload()
    assert source.field is field
    assert source.preview is preview
    assert not source.changed(), "it is told of once"

    script.unlink()
    assert source.changed()
    with pytest.raises(InputError, match="no such file"):
        source.reload()
    assert not source.changed()

    script.write_text(BAR.replace("2.0", "3.0"))
    assert source.changed()
    source.reload()
    assert not source.changed()
    np.testing.assert_allclose(source.preview.bounds[1, 2], 1.5, atol=1e-3)


@pytest.mark.parametrize(
    "shape", [fields.sphere(1.0), fields.box((0.4, 0.4, 2.0)), fields.torus(1.0, 0.1)],
    ids=["ball", "bar", "ring"],
)  # fmt: skip
def test_a_preview_has_about_as_many_vertices_as_asked_for(shape):
    for count in (2_000, PREVIEW_VERTICES):
        assert 0.5 * count < len(preview_mesh(shape, count).vertices) < 1.6 * count


def test_meshes_and_volumes_are_shapes_too(tmp_path):
    trimesh.creation.icosphere(3).export(tmp_path / "ball.stl")
    save_grid(fields.box((1.0, 2.0, 1.0)), tmp_path / "box.npz", spacing=0.1)
    for name, size in (("ball.stl", (2, 2, 2)), ("box.npz", (1, 2, 1))):
        source = ShapeSource(tmp_path / name)
        np.testing.assert_allclose(np.ptp(source.preview.bounds, axis=0), size, atol=0.1)
        assert source.preview.is_watertight


def test_wrong_files_are_refused_with_their_reason(tmp_path):
    (tmp_path / "noise.stl").write_bytes(b"solid" + bytes(range(200)))
    with pytest.raises(FileFormatError):
        ShapeSource(tmp_path / "noise.stl")
    with pytest.raises(InputError, match="there is no such file"):
        ShapeSource(tmp_path / "missing.py")
    (tmp_path / "endless.py").write_text("import fields\nshape = fields.below(0)\n")
    with pytest.raises(InputError, match="bounds"):
        ShapeSource(tmp_path / "endless.py")
    sheet = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)])
    sheet.export(tmp_path / "open.ply")
    with pytest.raises(InputError):
        ShapeSource(tmp_path / "open.ply")


# --- what a crash would lose ---


def edit(folder: Path) -> tuple[EditSession, Autosave]:
    session = EditSession()
    return session, Autosave(session, Path("somewhere/part.py"), folder)


def test_an_edit_is_saved_when_it_has_changed_and_only_then(tmp_path):
    session, autosave = edit(tmp_path)
    assert not autosave.save_if_changed()
    session.change(lambda s: s.with_handle(HANDLES[0]))
    assert autosave.save_if_changed()
    assert not autosave.save_if_changed()
    session.change(lambda s: s.with_handle(HANDLES[1]))
    assert autosave.save_if_changed()
    state, _ = load_edit(autosave.path, np.zeros((1, 3)))
    assert [h.name for h in state.handles] == ["foot", "head"]
    autosave.end()
    assert not list(tmp_path.iterdir())


def test_what_a_crash_left_is_offered_until_it_is_taken_or_refused(tmp_path):
    session, crashed = edit(tmp_path)
    session.change(lambda s: s.with_handle(HANDLES[1]))
    crashed.save_if_changed()

    session, second = edit(tmp_path)  # it crashed, and was started again
    assert second.left_over is not None
    session.change(lambda s: s.with_handle(HANDLES[0]))
    second.save_if_changed()  # other work, before anything was decided
    state, _ = load_edit(second.left_over, np.zeros((1, 3)))
    assert [h.name for h in state.handles] == ["head"]
    second.end()

    _, third = edit(tmp_path)  # nothing was decided: it is still there
    assert third.left_over is not None
    third.forget_left_over()
    third.forget_left_over()
    assert third.left_over is None
    assert edit(tmp_path)[1].left_over is None


def test_of_two_crashes_the_newer_edit_is_offered(tmp_path):
    for handle in HANDLES:
        session, autosave = edit(tmp_path)
        session.change(lambda s, handle=handle: s.with_handle(handle))
        autosave.save_if_changed()
    _, autosave = edit(tmp_path)
    state, _ = load_edit(autosave.left_over, np.zeros((1, 3)))
    assert [h.name for h in state.handles] == ["head"]


def test_the_selection_comes_back_with_and_without_handles(tmp_path):
    points = np.random.default_rng(0).normal(size=(500, 3))
    picked = fields.sphere(0.7, (0.1, 1 / 3, 0.0)) | fields.box(0.5)
    for handles in ((), HANDLES):
        session, crashed = edit(tmp_path)
        session.change(lambda _, h=handles: EditState(h, picked))
        assert crashed.save_if_changed()
        _, autosave = edit(tmp_path)
        state = autosave.read_left_over(points)
        assert [h.name for h in state.handles] == [h.name for h in handles]
        np.testing.assert_array_equal(state.selection(points), picked(points))
        autosave.forget_left_over()
        with pytest.raises(InputError, match="no unfinished edit"):
            autosave.read_left_over(points)
    session.change(lambda s: replace(s, selection=None))
    crashed.save_if_changed()
    assert edit(tmp_path)[1].read_left_over(points).selection is None


def test_a_damaged_edit_is_told_of(tmp_path):
    (tmp_path / ".part.autosave.toml").write_text("[editor")
    with pytest.raises(InputError, match="cannot be read") as caught:
        edit(tmp_path)[1].read_left_over(np.zeros((1, 3)))
    assert caught.value.remedy == "discard it"


def test_a_selection_that_is_cleared_is_not_offered_later(tmp_path):
    session, autosave = edit(tmp_path)
    session.change(lambda s: replace(s, selection=fields.box(0.5)))
    autosave.save_if_changed()
    session.change(lambda s: replace(s, selection=None))
    autosave.save_if_changed()
    assert edit(tmp_path)[1].left_over is None


def test_an_edit_is_taken_up_under_the_map_it_was_begun_with_only(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    part, points = Path("part.py"), np.zeros((1, 3))
    maps = (None, Path("a.safetensors"), Path("b.safetensors"))
    for begun in maps:
        session = EditSession()
        crashed = Autosave(session, part, tmp_path, begun)
        session.change(lambda s: s.with_handle(HANDLES[0]))
        crashed.save_if_changed()
        for now in maps:
            autosave = Autosave(EditSession(), part, tmp_path, now)
            if now == begun:
                assert autosave.read_left_over(points).get("foot").held
                continue
            with pytest.raises(InputError, match="begun under") as caught:
                autosave.read_left_over(points)
            assert str(begun.resolve() if begun else "no map") in str(caught.value)
            assert "--warp" in caught.value.remedy
            assert autosave.left_over is not None, "it is still there"


def test_what_is_saved_is_a_handle_file_too(tmp_path):
    session, autosave = edit(tmp_path)
    session.change(lambda _: EditState(HANDLES, fields.box(0.5)))
    autosave.save_if_changed()
    handles, solve = load_handles(autosave.path)
    assert [h.name for h in handles] == ["foot", "head"]
    assert solve == {}


def test_an_edit_that_has_become_empty_is_not_offered_later(tmp_path):
    session, autosave = edit(tmp_path)
    session.change(lambda s: s.with_handle(HANDLES[0]))
    autosave.save_if_changed()
    session.undo()
    autosave.save_if_changed()
    assert edit(tmp_path)[1].left_over is None


def test_a_folder_that_is_gone_is_told_of_once_a_change(tmp_path):
    folder = tmp_path / "work"
    folder.mkdir()
    session, autosave = edit(folder)
    session.change(lambda s: s.with_handle(HANDLES[0]))
    folder.rmdir()
    with pytest.raises(InputError, match="folder"):
        autosave.save_if_changed()
    assert not autosave.save_if_changed()
    autosave.end()


# --- errors in the page ---


class Tab:
    """Hears what a tab would show."""

    def __init__(self) -> None:
        self.shown: list[tuple[str, str]] = []

    def add_notification(self, title: str, body: str, **_: object) -> None:
        self.shown.append((title, body))


def test_errors_are_shown_with_their_remedy_in_the_tab_that_caused_them():
    tab, other = Tab(), Tab()

    def callback(event: object) -> None:
        raise InputError("selection", 0, "nothing is picked", "click on the shape first")

    guarded(None, callback)(types.SimpleNamespace(client=tab))
    assert tab.shown == [("selection: nothing is picked", "click on the shape first")]
    assert not other.shown


def test_errors_of_the_solver_are_shown_in_all_tabs():
    tabs = {0: Tab(), 1: Tab()}
    tell(types.SimpleNamespace(get_clients=lambda: tabs), ValueError("odd"))
    assert all(tab.shown == [("Something went wrong", "ValueError: odd")] for tab in tabs.values())
    assert text_of(ValueError("odd")) == tabs[0].shown[0]


def test_events_that_the_program_made_itself_are_left_out():
    called = []
    act = guarded(None, called.append)
    act(types.SimpleNamespace(client=None))
    assert not called
    event = types.SimpleNamespace(client=Tab())
    act(event)
    assert called == [event]


def test_a_shape_is_edited_under_a_saved_map(tmp_path):
    script, path = tmp_path / "ball.py", tmp_path / "shift.safetensors"
    script.write_text("import fields as sdf\nshape = sdf.sphere(1)\n")
    iw.save(iw.Affine.from_matrix(np.eye(3, 4) + np.array([0, 0, 0, 2.0])), path)
    plain, shifted = ShapeSource(script), ShapeSource(script, path)
    np.testing.assert_allclose(
        shifted.preview.vertices.mean(axis=0), plain.preview.vertices.mean(axis=0) + 2.0, atol=0.02
    )
    with pytest.raises(InputError):
        ShapeSource(script, tmp_path / "missing.safetensors")
