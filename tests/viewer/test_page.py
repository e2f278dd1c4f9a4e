"""The editor, from opening it to a checked mesh, with real mouse events."""

from __future__ import annotations

import shlex
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from implicit_warp.axial import Twist
from implicit_warp.checking import check
from implicit_warp.cli import main
from implicit_warp.files import load, save
from implicit_warp.viewer import regions
from implicit_warp.viewer.page import Editor
from tests.viewer.bar import BAR, BAR_HANDLES
from tests.viewer.conftest import EXAMPLES
from tests.viewer.driver import PATIENCE, Tab, seen_vertex, until

LEFT, RIGHT = (-1.5, -0.55), (1.5, -0.5)


def make_handles(tab: Tab, held: tuple[float, float], moved: tuple[float, float]) -> None:
    """Hold what is seen at one place, and move what is seen at another."""
    session = tab.editor.session
    for place, press in ((held, "Hold what is picked"), (moved, "Move what is picked")):
        tab.click_shape(seen_vertex(tab.editor, *place))
        until(lambda: session.state.selection is not None, "the brush picks")
        tab.press(press)
        until(lambda: session.state.selection is None, "it is a handle")
    tab.editor.solver.wait()
    tab.settle()


def test_from_the_command_to_an_exported_bent_part_in_six_actions(browser, editor, tmp_path):
    tab = Tab(browser, editor)
    before = tab.picture()
    # 1 and 2: click one end and hold it.
    tab.click_shape(seen_vertex(editor, *LEFT))
    until(lambda: editor.session.state.selection is not None, "the brush picks")
    tab.press("Hold what is picked")
    until(lambda: len(editor.session.state.handles) == 1, "it is held")
    # 3 and 4: click the other end and move it.
    tab.click_shape(seen_vertex(editor, *RIGHT))
    until(lambda: editor.session.state.selection is not None, "the brush picks again")
    tab.press("Move what is picked")
    until(lambda: editor.session.state.active == "moved 1", "it gets a gizmo")
    assert editor.solver.wait(3 * PATIENCE)  # the first solve on a machine compiles its kernels
    tab.settle()
    # 5: drag the gizmo's upward arrow.
    tab.drag_arrow((0, -80))
    until(lambda: len(editor.drags) > 3, "the shape follows")
    moved = np.abs(editor.shown.vertices - editor.source.preview.vertices).max()
    assert moved > 0.02 * editor.size
    assert tab.picture() != before
    tab.drop_and_solve()
    shift = editor.session.state.get("moved 1").shift
    assert shift[2] > 0.05 * editor.size
    assert np.allclose(shift[:2], 0, atol=1e-6)  # along the arrow
    assert editor.final.handle_error < 0.02 * editor.size
    # 6: export.
    editor.export.resolution.value = 48
    tab.press("Export the mesh")
    path = tmp_path / "part-deformed.stl"
    until(path.exists, "the file is written")
    tab.notice("watertight")
    report = check(path)
    report.raise_if_bad(0)
    assert list(report.topology.genus) == [3]

    # The handle file gives the same map on the command line, and the same mesh.
    tab.open("Other files")
    tab.press("Handles")
    toml = tmp_path / "part-deformed.toml"
    until(toml.exists, "the handle file is written")
    again = tmp_path / "again.stl"
    part = str(EXAMPLES / "demo" / "part.py")
    words = ["--handles", str(toml), "-o", str(again), "--resolution", "48"]
    assert main(["deform", part, *words]) == 0
    replayed = load(again.with_suffix(".safetensors"))
    points = np.asarray(editor.source.preview.vertices)
    np.testing.assert_allclose(replayed(points), editor.final.warp(points), atol=1e-9)
    assert again.read_bytes() == path.read_bytes()
    latency = 1e3 * np.median(editor.drags)  # shown by pytest -s
    print(  # noqa: T201 - a figure for whoever asks
        f"median of {len(editor.drags)} from a drag's event to its mesh: {latency:.0f} ms"
    )
    assert np.isfinite(latency)


@pytest.fixture
def twisted_bar(tmp_path, monkeypatch):
    """In the working folder: a bar, its handles, and a map to edit it under."""
    monkeypatch.chdir(tmp_path)
    Path("a bar.py").write_text(BAR)
    Path("bar.toml").write_text(BAR_HANDLES)
    save(Twist(40.0), "twist.safetensors")


@contextmanager
def opened(browser, handles=None, warp=None):
    """A tab with an editor of the bar, which ends by a crash."""
    pytest.importorskip("viser")
    editor = Editor("a bar.py", handles, warp=warp, port=8340)
    try:
        tab = Tab(browser, editor)
        yield tab
        tab.page.close()
    finally:
        editor.close(crashed=True)


@pytest.mark.usefixtures("twisted_bar")
def test_the_command_the_page_shows_makes_the_same_mesh_of_an_edit_under_a_saved_map(browser):
    with opened(browser, "bar.toml", "twist.safetensors") as tab:
        until(lambda: tab.editor.final is not None, "the handle file's solve ends")
        tab.editor.export.resolution.value = 40
        tab.press("Export the mesh")
        tab.notice("watertight")
        tab.open("Other files")
        tab.press("Handles")
        command = tab.page.locator("code")
        command.wait_for()
        words = shlex.split(command.inner_text())
        tab.press("Warp")
        tab.notice("Wrote a bar-deformed.safetensors")
    assert words[0] == "implicit-warp"
    assert main(words[1:]) == 0
    again = Path(words[words.index("-o") + 1])
    assert again.read_bytes() == Path("a bar-deformed.stl").read_bytes()
    points = np.random.default_rng(0).normal(size=(100, 3))
    replayed, saved = load(again.with_suffix(".safetensors")), load("a bar-deformed.safetensors")
    np.testing.assert_array_equal(replayed(points), saved(points))


@pytest.mark.usefixtures("twisted_bar")
def test_what_a_crash_left_is_taken_up_in_the_page_under_its_map_only(browser):
    with opened(browser, "bar.toml", "twist.safetensors") as tab:
        tab.press("Invert")
        until(lambda: tab.editor.session.state.selection is not None, "all is picked")
        before = tab.editor.session.state
        assert tab.editor.autosave.save_if_changed()
    with opened(browser) as tab:
        tab.press("Go on with it")
        tab.notice("it was begun under the map")
        assert not tab.editor.session.state.handles
    with opened(browser, warp="twist.safetensors") as tab:
        tab.press("Go on with it")
        until(lambda: tab.editor.final is not None, "it is taken up and solved")
        state, rest = tab.editor.session.state, tab.editor.rest
        assert [h.held for h in state.handles] == [True, False]
        np.testing.assert_array_equal(state.selection(rest), before.selection(rest))
        tab.page.get_by_text("Go on with it").wait_for(state="hidden")


def test_a_rectangle_picks_what_is_seen_and_can_be_undone(browser, editor):
    tab = Tab(browser, editor)
    corners = tab.on_screen((-1.8, -0.9, 0.0)), tab.on_screen((-1.2, 0.8, 0.9))
    low, high = np.minimum(*corners), np.maximum(*corners)
    tab.page.keyboard.down("Shift")
    tab.drag(low, high - low)
    tab.drop()
    tab.page.keyboard.up("Shift")
    until(lambda: editor.session.state.selection is not None, "the rectangle picks")
    tab.notice("of the surface is picked")
    tab.press("Undo")
    until(lambda: editor.session.state.selection is None, "it is undone")
    tab.press("Redo")
    until(lambda: editor.session.state.selection is not None, "it is redone")
    tab.press("Clear")
    until(lambda: editor.session.state.selection is None, "it is cleared")


def test_a_box_shows_its_controls_and_picks_what_is_inside(browser, editor):
    tab = Tab(browser, editor)
    pick = tab.page.get_by_role("button", name="Pick what is inside", exact=True)
    size = tab.page.get_by_text("Box size", exact=True)
    assert not pick.is_visible()
    assert not size.is_visible()
    tab.choose("Tool", "Ball")
    pick.wait_for()
    assert not size.is_visible()
    tab.choose("Tool", "Box")
    size.wait_for()
    pick.click()
    until(lambda: editor.session.state.selection is not None, "the box picks")
    low, high = np.asarray(editor.source.field.bounds)
    half = 0.5 * np.array(editor.select.box_size.value)
    inside = (np.abs(editor.rest - (low + high) / 2) <= half).all(axis=1)
    picked = regions.selected(editor.session.state.selection, editor.rest)
    assert picked.any()
    np.testing.assert_array_equal(picked, inside)
    tab.choose("Tool", "Brush")
    pick.wait_for(state="hidden")
    assert not size.is_visible()


def test_mistakes_are_told_in_the_page(browser, editor, tmp_path):
    tab = Tab(browser, editor)
    tab.press("Hold what is picked")
    tab.notice("nothing is picked")
    assert not editor.session.state.handles
    for name, cause in (
        ("../out.stl", "outside of the working folder"),
        ("part.xyz", "cannot write"),
    ):
        editor.export.file.value = name
        tab.press("Export the mesh")
        tab.notice(cause)
    assert not (tmp_path.parent / "out.stl").exists()
    tab.dismiss()
    # Two handles that want the same points elsewhere.
    make_handles(tab, LEFT, LEFT)
    tab.drag_arrow((0, -60))
    tab.drop()
    tab.notice("contradict each other")


def test_two_tabs_share_one_edit_and_closing_one_in_a_solve_harms_nothing(browser, editor):
    one, two = Tab(browser, editor), Tab(browser, editor, (960, 620))
    one.click_shape(seen_vertex(editor, *LEFT))
    until(lambda: editor.session.state.selection is not None, "the first tab picks")
    two.notice("of the surface is picked")
    two.press("Hold what is picked")
    until(lambda: editor.session.state.handles, "the second tab holds it")
    two.click_shape(seen_vertex(editor, *RIGHT))
    until(lambda: editor.session.state.selection is not None, "the second tab picks")
    one.press("Move what is picked")
    until(lambda: editor.session.state.active == "moved 1", "the first tab moves it")
    editor.solver.wait()
    one.settle()
    one.drag_arrow((0, -50))
    one.page.close()  # in the middle of the drag
    until(lambda: len(editor.server.get_clients()) == 1, "the first tab is gone")
    two.press("Undo")
    until(lambda: editor.session.state.get("moved 1").shift == (0.0, 0.0, 0.0), "it is undone")
    two.press("Redo")
    until(lambda: editor.session.state.get("moved 1").shift[2] > 0, "and redone")
    until(lambda: editor.final is not None, "the solve ends")


def test_a_drag_during_a_solve_takes_its_place(browser, editor):
    tab = Tab(browser, editor)
    make_handles(tab, LEFT, RIGHT)
    tab.drag_arrow((0, -50))
    tab.drop()
    first = editor.session.state.get("moved 1").shift[2]
    tab.drag_arrow((0, -40))  # the solve for the first one is running
    tab.drop_and_solve()
    assert editor.session.state.get("moved 1").shift[2] > first
    target = editor.session.state.get("moved 1").handle().motion
    region = editor.session.state.get("moved 1").region
    points = np.asarray(editor.source.preview.vertices)
    points = points[region(points) <= 0]
    error = np.sqrt(((editor.final.warp(points) - target(points)) ** 2).sum(axis=1).mean())
    assert error < 0.02 * editor.size


def test_distortion_is_shown_in_colours_with_their_legend(browser, editor):
    tab = Tab(browser, editor)
    make_handles(tab, LEFT, RIGHT)
    tab.drag_arrow((0, -60))
    tab.drop_and_solve()
    tab.dismiss()
    tab.settle()
    before = tab.drawn()
    tab.open("4 See")
    tab.choose("Colours", "Stretch")
    tab.notice("largest stretch")
    until(lambda: tab.drawn() != before, "the shape is coloured")


def test_a_script_that_changes_is_shown_and_a_broken_one_is_told_of(browser, tmp_path):
    script = tmp_path / "ball.py"
    script.write_text("import fields as sdf\nshape = sdf.sphere(1)\n")
    editor = Editor(script, port=8320, folder=tmp_path)
    try:
        tab = Tab(browser, editor)
        script.write_text("import fields as sdf\nshape = sdf.box((1, 2, 3))\n")
        until(lambda: abs(np.ptp(editor.shown.vertices[:, 2]) - 3) < 0.1, "the box is shown")
        script.write_text("shape = 1 / 0\n")
        tab.notice("the script failed")
        assert abs(np.ptp(editor.shown.vertices[:, 2]) - 3) < 0.1
    finally:
        editor.close()


def test_a_wrong_file_is_refused_before_anything_is_served(tmp_path, capsys):
    assert main(["view", str(tmp_path / "nothing.py")]) == 2
    assert "there is no such file" in capsys.readouterr().err
    (tmp_path / "handles.toml").write_text("[[handle]]\nregion = 3\n")
    part = str(EXAMPLES / "demo" / "part.py")
    assert main(["view", part, "--handles", str(tmp_path / "handles.toml")]) == 2
