"""The edit's state: undo, redo, listeners, threads, poses and handle files."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import fields
from implicit_warp.errors import InputError
from implicit_warp.handles import load_handles, move, save_handles
from implicit_warp.viewer.session import (
    MOST_UNDO,
    EditHandle,
    EditSession,
    EditState,
    load_edit,
    same_task,
    save_edit,
    solve_handles,
)

POINTS = np.random.default_rng(3).uniform(-1, 1, (300, 3))


def handle(name: str, held: bool = False, **words) -> EditHandle:
    words.setdefault("region", fields.above(0.6))
    words.setdefault("pivot", (0.0, 0.0, 0.8))
    return EditHandle(name, held=held, **words)


def adding(name: str):
    return lambda state: state.with_handle(handle(name))


# --- undo and redo ---


def test_undo_after_a_change_is_the_identity_and_redo_brings_it_back():
    session = EditSession()
    before = session.state
    after = session.change(adding("a"))
    assert session.undo() is before
    assert session.state is before
    assert session.redo() is after
    assert session.state is after


@given(st.lists(st.sampled_from(["add", "shift", "end", "undo", "redo", "reset"]), max_size=40))
def test_any_sequence_agrees_with_a_plain_list_of_states(actions):
    session, model, at, merging, revision = EditSession(), [EditState()], 0, False, 0
    for number, action in enumerate(actions):
        if action in ("undo", "redo"):
            step = min(max(at + (1 if action == "redo" else -1), 0), len(model) - 1)
            revision += step != at
            at, merging = step, False
            assert getattr(session, action)() is session.state
        elif action == "end":
            session.end_merging()
            merging = False
        else:
            now = model[at]
            if action == "add":
                new = now.with_handle(handle(f"h{number}"))
            elif not now.handles:
                continue
            elif action == "shift":
                new = now.with_handle(replace(now.handles[0], shift=(0.0, 0.0, number + 1.0)))
            else:
                still = [replace(h, shift=(0.0, 0.0, 0.0)) for h in now.handles]
                new = replace(now, handles=tuple(still))
                if [h.shift for h in still] == [h.shift for h in now.handles]:
                    assert session.reset() is session.state
                    merging = False if merging is None else merging
                    continue
            keep = at if action == "shift" and merging else at + 1
            model, at, merging = [*model[:keep], new], keep, action == "shift"
            revision += 1
            if action == "reset":
                session.reset()
            else:
                session.change(lambda _, new=new: new, merge="drag" if merging else None)
        shown, expected = session.state, model[at]
        assert [(h.name, h.shift) for h in shown.handles] == [
            (h.name, h.shift) for h in expected.handles
        ]
        assert session.revision == revision


def test_a_drag_is_undone_as_one_and_the_next_drag_is_another():
    session = EditSession()
    session.change(adding("a"))
    for drag in range(2):
        for step in range(5):
            moved = handle("a", shift=(0.0, float(drag), step + 1.0))
            session.change(lambda s, moved=moved: s.with_handle(moved), merge="drag a")
        session.end_merging()
    assert session.undo().get("a").shift == (0.0, 0.0, 5.0)
    assert session.undo().get("a").shift == (0.0, 0.0, 0.0)


def test_a_change_after_undo_drops_what_was_undone():
    session = EditSession()
    session.change(adding("a"))
    session.undo()
    session.change(adding("b"))
    assert [h.name for h in session.redo().handles] == ["b"]
    assert session.undo().handles == ()


def test_old_states_are_dropped_and_the_newest_kept():
    session = EditSession()
    for i in range(MOST_UNDO + 20):
        session.change(adding(f"h{i}"))
    for _ in range(MOST_UNDO + 20):
        session.undo()
    assert len(session.state.handles) == 21  # the oldest of the last MOST_UNDO states


def test_what_a_change_raises_leaves_everything_as_it_was():
    session, told = EditSession(), []
    session.change(adding("a"))
    session.listen(told.append)
    state, revision = session.state, session.revision
    with pytest.raises(InputError, match="no handle has this name"):
        session.change(lambda s: s.without("b"))
    assert session.state is state
    assert session.revision == revision
    assert not told


def test_reset_puts_all_back_keeps_the_regions_and_can_be_undone():
    session = EditSession()
    session.change(lambda s: s.with_handle(handle("a", shift=(1.0, 0, 0), rotvec=(0, 0, 30.0))))
    session.change(lambda s: s.with_handle(handle("b", held=True)))
    moved = session.state
    state = session.reset()
    assert [h.name for h in state.handles] == ["a", "b"]
    assert state.get("b").held
    assert state.get("a").shift == state.get("a").rotvec == (0.0, 0.0, 0.0)
    assert state.get("a").region is moved.get("a").region
    assert session.reset() is state, "at rest there is nothing to reset"
    assert session.undo() is moved


# --- listeners and threads ---


def test_listeners_hear_every_change_in_order_also_if_one_raises():
    session, heard = EditSession(), []

    def broken(state):
        raise RuntimeError("no page")

    session.listen(broken)
    session.listen(heard.append)
    with pytest.raises(RuntimeError, match="no page"):
        session.change(adding("a"))
    with pytest.raises(RuntimeError, match="no page"):
        session.undo()
    assert [len(s.handles) for s in heard] == [1, 0]


def test_a_listener_that_changes_the_edit_leaves_the_newest_state_told_last():
    session, heard = EditSession(), []
    session.listen(lambda s: session.change(adding("second")) if len(s.handles) == 1 else None)
    session.listen(heard.append)
    session.change(adding("first"))
    assert [h.name for h in session.state.handles] == ["first", "second"]
    assert heard[-1] is session.state
    assert session.revision == 2


def test_tabs_that_change_at_once_lose_nothing_and_hear_states_in_order():
    session, heard, failed = EditSession(), [], []
    session.listen(lambda s: heard.append((session.revision, len(s.handles))))

    def work(tab: int) -> None:
        try:
            for i in range(25):
                session.change(adding(f"{tab}-{i}"))
                session.undo()
                session.redo()
        except Exception as error:  # noqa: BLE001 - asserted below
            failed.append(error)

    threads = [threading.Thread(target=work, args=(tab,)) for tab in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=60)
    assert not failed
    assert not any(thread.is_alive() for thread in threads)
    numbers = [revision for revision, _ in heard]
    assert numbers == list(range(1, session.revision + 1))
    counts = [count for _, count in heard]
    assert np.abs(np.diff([0, *counts])).max() == 1, "no state was skipped or half seen"
    names = [h.name for h in session.state.handles]
    assert len(set(names)) == len(names)


# --- handles of a state ---


def test_handles_are_named_renamed_replaced_and_removed_in_their_places():
    state = EditState().with_handle(handle("a")).with_handle(handle("b")).with_handle(handle("c"))
    assert state.active == "c"
    assert state.moves
    state = state.with_handle(replace(state.get("b"), name="B"), "b")
    assert [h.name for h in state.handles] == ["a", "B", "c"]
    assert state.active == "c"
    state = state.with_handle(replace(state.get("c"), name="C"), "c")
    assert state.active == "C"
    with pytest.raises(InputError, match="another handle has this name"):
        state.with_handle(replace(state.get("C"), name="a"), "C")
    assert state.without("C").active == ""
    assert state.without("a").active == "C"
    with pytest.raises(InputError, match="there are: a, B, C"):
        state.get("b")
    assert not EditState((handle("x", held=True),)).moves
    assert not state.displaced
    assert state.with_handle(handle("d", shift=(0.0, 0.1, 0.0))).displaced
    assert not state.with_handle(handle("d", held=True, shift=(0.0, 0.1, 0.0))).displaced


def test_free_names_are_free():
    state = EditState()
    for _ in range(4):
        state = state.with_handle(handle(state.free_name("held")))
    assert [h.name for h in state.handles] == ["held 1", "held 2", "held 3", "held 4"]
    assert state.without("held 2").free_name("held") == "held 2"


def test_an_edit_without_handles_cannot_be_solved():
    with pytest.raises(InputError, match="select a region"):
        solve_handles(EditState())


# --- poses ---


def test_pose_is_the_inverse_of_posed(rng):
    for turn in Rotation.random(20, rng=rng):
        position, wxyz = rng.normal(size=3), turn.as_quat(scalar_first=True)
        moved = handle("a", held=True).posed(position, wxyz)
        again, quaternion = moved.pose()
        assert not moved.held
        np.testing.assert_allclose(again, position, atol=1e-8)
        np.testing.assert_allclose(np.abs(quaternion @ wxyz), 1.0, atol=1e-12)


def test_a_posed_handle_moves_its_points_as_the_gizmo_does(rng):
    for turn in Rotation.random(20, rng=rng):
        position, first = rng.normal(size=3), handle("a", pivot=tuple(rng.normal(size=3)))
        motion = first.posed(position, turn.as_quat(scalar_first=True)).handle().motion
        expected = turn.apply(POINTS - first.pivot) + position
        np.testing.assert_allclose(motion(POINTS), expected, atol=1e-7)


def test_another_pivot_leaves_the_motion_as_it_is(rng):
    for turn in Rotation.random(10, rng=rng):
        first = handle("a", pivot=tuple(rng.normal(size=3)))
        moved = first.posed(rng.normal(size=3), turn.as_quat(scalar_first=True))
        pivot = rng.normal(size=3)
        about = moved.about(pivot)
        np.testing.assert_allclose(about.pivot, pivot, atol=1e-8)
        np.testing.assert_allclose(about.pose()[0], moved.handle().motion(pivot), atol=1e-7)
        np.testing.assert_allclose(
            about.handle().motion(POINTS), moved.handle().motion(POINTS), atol=1e-7
        )


def test_amounts_lead_from_rest_to_the_whole_motion_and_add_up():
    turned = handle("a", rotvec=(30.0, -100.0, 60.0), shift=(0.3, 0.0, -2.0))
    np.testing.assert_allclose(turned.handle(0.0).motion(POINTS), POINTS, atol=1e-12)
    still = replace(turned, shift=(0.0, 0.0, 0.0))
    third = still.handle(1 / 3).motion
    np.testing.assert_allclose(
        third(third(third(POINTS))), still.handle().motion(POINTS), atol=1e-7
    )
    held = replace(turned, held=True).handle()
    assert held.is_held
    np.testing.assert_array_equal(held.motion(POINTS), POINTS)


def test_a_handle_that_has_not_been_dragged_yet_is_moved_by_nothing():
    idle = handle("a").handle()
    assert not idle.is_held
    np.testing.assert_array_equal(idle.motion(POINTS), POINTS)


def test_tasks_are_the_same_if_a_solve_would_be():
    state = EditState((handle("a", shift=(0.0, 0.0, 1.0)), handle("b", held=True)))
    task = solve_handles(state)
    assert same_task(task, solve_handles(state))
    seen = replace(state.handles[0], visible=False, name="other")
    assert same_task(task, solve_handles(replace(state, handles=(seen, state.handles[1]))))
    for change in ({"weight": 2.0}, {"shift": (0.0, 0.0, 1.5)}, {"rotvec": (0.0, 0.0, 1.0)},
                   {"region": fields.above(0.5)}, {"held": True}):  # fmt: skip
        other = replace(state.handles[0], **change)
        assert not same_task(task, solve_handles(replace(state, handles=(other, state.handles[1]))))
    assert not same_task(task, task[:1])


# --- files ---


def state_of(rng: np.random.Generator) -> EditState:
    turn = Rotation.random(rng=rng)
    moved = handle('tip of the "arm"\n', region=fields.sphere(0.4, (0.1, 1 / 3, 0.7)), weight=2.5)
    return EditState((
        handle("foot", held=True, region=fields.below(-0.6) & fields.box(3)),
        moved.posed(rng.normal(size=3), turn.as_quat(scalar_first=True)),
        handle("only shifted", shift=(1e-7, -3.0, 12345.678), region=fields.right(0.5)),
        handle("not yet moved", region=fields.left(-0.5)),
    ))  # fmt: skip


def test_the_file_asks_for_exactly_what_the_page_solves(tmp_path, rng):
    state = state_of(rng)
    save_edit(state, tmp_path / "edit.toml", {"steps": 30, "seed": 4})
    read, solve = load_handles(tmp_path / "edit.toml")
    assert solve == {"steps": 30, "seed": 4}
    for mine, its in zip(solve_handles(state), read, strict=True):
        assert (mine.name, mine.weight, mine.is_held) == (its.name, its.weight, its.is_held)
        np.testing.assert_array_equal(mine.motion.matrix.numpy(), its.motion.matrix.numpy())
        np.testing.assert_array_equal(mine.region(POINTS), its.region(POINTS))


def test_an_edit_comes_back_from_its_file(tmp_path, rng):
    state = state_of(rng)
    save_edit(state, tmp_path / "edit.toml", {"seed": 4})
    again, solve = load_edit(tmp_path / "edit.toml", POINTS)
    assert solve == {"seed": 4}
    assert again.active == "not yet moved"
    for before, after in zip(state.handles, again.handles, strict=True):
        assert (before.name, before.held, before.weight) == (after.name, after.held, after.weight)
        picked = POINTS[before.region(POINTS) <= 0]
        np.testing.assert_allclose(after.pivot, picked.mean(axis=0), atol=1e-8)
        scale = 1.0 + np.abs(before.shift).max()
        np.testing.assert_allclose(
            after.handle().motion(POINTS), before.handle().motion(POINTS), atol=1e-7 * scale
        )


def test_a_handle_given_by_a_matrix_can_be_edited(tmp_path):
    matrix = np.eye(3, 4)
    matrix[:, :3] = Rotation.from_euler("xyz", (2.0, 0.5, -1.0)).as_matrix()
    matrix[:, 3] = (0.1, 0.2, 0.3)
    given = move(fields.above(0), matrix=matrix, name="m")
    save_handles(tmp_path / "m.toml", [given])
    state, _ = load_edit(tmp_path / "m.toml", POINTS)
    np.testing.assert_allclose(
        state.get("m").handle().motion(POINTS), given.motion(POINTS), atol=1e-7
    )


@given(st.text(min_size=1, max_size=12))
def test_any_name_that_can_be_typed_can_be_saved(tmp_path_factory, name):
    path = tmp_path_factory.getbasetemp() / "named.toml"
    try:
        name.encode()
    except UnicodeEncodeError:
        return  # half a character: no keyboard gives that, and no file can hold it
    save_edit(EditState((handle(name, held=True),)), path)
    assert load_handles(path)[0][0].name == name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no \\[\\[handle\\]\\] table"),
        ("[[handle]", "not a TOML file"),
        ('[[handle]]\nregion = "above(0)"\n', "neither that it is held nor how it moves"),
        ('[[handle]]\nregion = "import os"\nhold = true\n', "not an expression"),
        ('[[handle]]\nregion = "above(0)"\nhold = true\nname = "a"\n' * 2, "two handles"),
    ],
)
def test_a_wrong_handle_file_is_refused_with_its_reason(tmp_path, text, message):
    (tmp_path / "edit.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        load_edit(tmp_path / "edit.toml", POINTS)
