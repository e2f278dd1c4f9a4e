"""The solver's thread: it follows drags, ends when told, survives errors, and replays."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import torch

import fields
import implicit_warp as iw
from implicit_warp.certificate import certify
from implicit_warp.elastic_solve import ElasticOptions, draw_samples, elastic
from implicit_warp.errors import InputError
from implicit_warp.handles import load_handles
from implicit_warp.viewer.live_solver import ROUNDS, LiveSolver, Update
from implicit_warp.viewer.session import EditHandle, EditState, save_edit, solve_handles

BAR = fields.box((0.4, 0.4, 2.0))
VERTICES = np.random.default_rng(0).uniform((-0.2, -0.2, -1), (0.2, 0.2, 1), (500, 3))
SMALL = ElasticOptions(layers=6, resolution=5, steps=75, samples=256, handle_samples=64)
LONG = SMALL.with_changes({"steps": 100_000, "tolerance": 0.0})

FOOT = EditHandle("foot", fields.below(-0.7), (0.0, 0.0, -0.85), held=True)
HEAD = EditHandle("head", fields.above(0.7), (0.0, 0.0, 0.85), held=False)


def dragged(shift: float, turn: float = 0.0) -> list[iw.Handle]:
    head = replace(HEAD, shift=(shift, 0.0, 0.0), rotvec=(0.0, turn, 0.0))
    return solve_handles(EditState((FOOT, head)))


class Page:
    """Hears what the solver tells; `gate` holds it up, as a page that is slow to draw would."""

    def __init__(self, options: ElasticOptions = SMALL) -> None:
        self.updates: list[Update] = []
        self.errors: list[Exception] = []
        self.raises: Exception | None = None
        self.gate = threading.Event()
        self.gate.set()
        self._told = threading.Condition()
        self.solver = LiveSolver(BAR, VERTICES, self._update, self._error, options)

    def _update(self, update: Update) -> None:
        with self._told:
            self.updates.append(update)
            self._told.notify_all()
        assert self.gate.wait(60)
        if self.raises is not None:
            raise self.raises

    def _error(self, error: Exception) -> None:
        self.errors.append(error)
        if isinstance(error, ZeroDivisionError):
            raise RuntimeError("the page is gone")

    def hear(self, count: int = 1, timeout: float = 60.0) -> None:
        """Wait until so many updates have come."""
        with self._told:
            assert self._told.wait_for(lambda: len(self.updates) >= count, timeout), self.errors

    def finals(self) -> list[Update]:
        return [u for u in self.updates if u.final]


@pytest.fixture
def page():
    pages = []

    def made(options: ElasticOptions = SMALL) -> Page:
        pages.append(Page(options))
        return pages[-1]

    yield made
    for each in pages:
        each.gate.set()
        each.solver.close()
        assert not each.solver._thread.is_alive()


# --- following ---


def test_a_drag_is_followed_until_the_shape_is_there(page):
    heard = page()
    heard.solver.follow(dragged(0.5))
    assert heard.solver.wait()
    assert not heard.errors
    assert len(heard.updates) == ROUNDS
    first, last = heard.updates[0], heard.updates[-1]
    assert first.running
    assert not last.running
    assert not last.final
    assert last.handle_error < 0.03 < first.handle_error
    assert last.vertices.dtype == np.float32
    assert last.vertices.shape == VERTICES.shape
    np.testing.assert_array_equal(last.vertices, last.warp(VERTICES.astype(np.float32)))
    head = VERTICES[:, 2] > 0.7
    np.testing.assert_allclose(last.vertices[head], VERTICES[head] + (0.5, 0, 0), atol=0.1)


def test_every_map_that_is_shown_is_injective(page):
    heard = page()
    for turn in (0.0, 60.0, 120.0, 170.0):
        heard.solver.follow(dragged(1.5, turn))
        heard.hear(len(heard.updates) + 2)
    heard.solver.solve(dragged(1.5, 170.0))
    assert heard.solver.wait()
    assert not heard.errors
    assert len(heard.updates) > 8
    for update in heard.updates:
        certify(update.warp)  # raises NotInjective


def test_only_the_first_update_after_an_event_has_a_latency(page):
    heard = page()
    start = time.perf_counter()
    heard.solver.follow(dragged(0.3))
    assert heard.solver.wait()
    took = time.perf_counter() - start
    latencies = [u.latency for u in heard.updates]
    assert 0.0 < latencies[0] < took
    assert np.isnan(latencies[1:]).all()


def test_the_newest_target_counts_and_nothing_queues_up(page):
    heard = page()
    heard.solver.follow(dragged(0.01))
    heard.hear()
    heard.gate.clear()
    heard.solver.follow(dragged(0.02))
    while len(heard.updates) < 2:  # the one that was under way, and is now held up
        time.sleep(0.001)
    for i in range(100):
        heard.solver.follow(dragged(i / 100))
    before = len(heard.updates)
    heard.gate.set()
    assert heard.solver.wait()
    shifts = [u.handles[1].words["translate"][0] for u in heard.updates]
    assert shifts[before:] == [0.99] * ROUNDS


def test_asking_never_waits_for_the_work_nor_for_the_page(page):
    heard = page(LONG)
    heard.solver.solve(dragged(0.5))
    heard.gate.clear()
    heard.hear()  # the thread hangs in the page
    start = time.perf_counter()
    heard.solver.follow(dragged(0.1))
    heard.solver.prepare(dragged(0.1))
    heard.solver.solve(dragged(0.2))
    assert heard.solver.busy
    assert time.perf_counter() - start < 1.0


def test_preparing_shows_nothing_and_makes_no_difference(page):
    heard, other = page(), page()
    heard.solver.prepare(dragged(0.0))
    assert heard.solver.wait()
    assert not heard.updates
    assert not heard.errors
    for each in (heard, other):
        each.solver.follow(dragged(0.4))
        assert each.solver.wait()
    np.testing.assert_array_equal(heard.updates[-1].vertices, other.updates[-1].vertices)


# --- solving in full ---


def same_map(a, b) -> bool:
    x = torch.from_numpy(VERTICES)
    return torch.equal(a(x), b(x)) and torch.equal(a.inv(x), b.inv(x))


def test_replaying_the_saved_file_gives_the_same_map_bit_for_bit(page, tmp_path):
    heard = page()
    for step in range(5):  # whatever was dragged before
        heard.solver.follow(dragged(0.1 * step, 20.0 * step))
        heard.hear(len(heard.updates) + 1)
    head = replace(HEAD, shift=(0.123456789, 1 / 3, 0.0), rotvec=(10.0, 40.0, 1e-3), weight=2.0)
    state = EditState((FOOT, head))
    heard.solver.solve(solve_handles(state))
    assert heard.solver.wait()
    assert not heard.errors
    (final,) = heard.finals()
    assert not final.running
    assert final is heard.updates[-1]

    table = {"layers": 6, "resolution": 5, "steps": 75, "samples": 256, "handle_samples": 64}
    save_edit(state, tmp_path / "edit.toml", table)
    handles, solve = load_handles(tmp_path / "edit.toml")
    replayed = elastic(BAR, handles, options=ElasticOptions.from_mapping(solve), progress=False)
    assert same_map(final.warp, replayed)
    assert final.handle_error == replayed.report.handle_error
    assert final.handles == tuple(heard.updates[-1].handles)


def test_releasing_does_not_throw_the_shape_back_to_rest(page):
    heard = page()
    heard.solver.follow(dragged(0.6))
    assert heard.solver.wait()
    reached = heard.updates[-1]
    heard.solver.solve(dragged(0.6))
    assert heard.solver.wait()
    assert not heard.errors
    head = VERTICES[:, 2] > 0.7

    def gap(update: Update) -> float:
        away = update.vertices[head] - (VERTICES[head] + (0.6, 0, 0))
        return float(np.sqrt((away**2).sum(axis=1).mean()))

    after = heard.updates[ROUNDS:]
    np.testing.assert_array_equal(after[0].vertices, reached.vertices)
    assert max(gap(u) for u in after) < 0.1 < 0.6
    assert heard.finals() == [after[-1]]


def test_samples_are_drawn_once_for_all_motions_of_the_same_regions(page, monkeypatch):
    drawn = []

    def counted(*arguments):
        drawn.append(arguments)
        return draw_samples(*arguments)

    monkeypatch.setattr("implicit_warp.viewer.live_solver.draw_samples", counted)
    heard = page()
    for shift in (0.1, 0.2):
        heard.solver.follow(dragged(shift))
        heard.solver.wait()
        heard.solver.solve(dragged(shift))
        heard.solver.wait()
    assert len(drawn) == 1
    assert same_map(heard.finals()[1].warp, elastic(BAR, dragged(0.2), options=SMALL))
    heard.solver.solve(solve_handles(EditState((FOOT, replace(HEAD, region=fields.above(0.5))))))
    heard.solver.wait()
    heard.solver.set_shape(fields.box((0.4, 0.4, 2.2)), VERTICES)
    heard.solver.solve(dragged(0.2))
    heard.solver.wait()
    assert len(drawn) == 3
    assert not heard.errors


def test_a_contradiction_that_comes_with_the_motion_is_told(page):
    heard = page()
    both = replace(HEAD, region=fields.below(-0.6))
    heard.solver.prepare(solve_handles(EditState((FOOT, both))))  # nothing moves yet
    heard.solver.wait()
    assert not heard.errors
    heard.solver.solve(solve_handles(EditState((FOOT, replace(both, shift=(0.5, 0.0, 0.0))))))
    heard.solver.wait()
    assert "contradict" in str(heard.errors[0])


def test_a_drag_goes_on_from_what_a_full_solve_has_reached(page):
    heard = page()
    heard.solver.solve(dragged(0.6))
    assert heard.solver.wait()
    count, final = len(heard.updates), heard.updates[-1]
    heard.solver.follow(dragged(0.6))
    assert heard.solver.wait()
    assert not heard.errors
    assert np.abs(heard.updates[count].vertices - final.vertices).max() < 0.05


def test_at_rest_again_a_solve_is_shown_from_rest(page):
    heard = page()
    heard.solver.follow(dragged(0.6))
    assert heard.solver.wait()
    heard.solver.rest()
    count = len(heard.updates)
    heard.solver.solve(dragged(0.6))
    assert heard.solver.wait()
    other = page()
    other.solver.solve(dragged(0.6))
    assert other.solver.wait()
    for seen, expected in zip(heard.updates[count:], other.updates, strict=True):
        np.testing.assert_array_equal(seen.vertices, expected.vertices)


def test_a_drag_during_a_solve_takes_its_place(page):
    heard = page(LONG)
    heard.solver.solve(dragged(0.2))
    heard.hear(2)
    heard.solver.follow(dragged(0.4))
    assert heard.solver.wait()
    assert not heard.finals()
    assert not heard.errors
    assert [u.text for u in heard.updates[-ROUNDS:]] == ["following"] * ROUNDS


# --- ending ---


@pytest.mark.parametrize("how", ["stop", "rest", "close", "set_shape"])
@pytest.mark.parametrize("what", ["solve", "follow"])
def test_nothing_is_shown_after_the_work_was_ended(page, how, what):
    heard = page(LONG)
    getattr(heard.solver, what)(dragged(0.3))
    heard.hear(2)
    if how == "set_shape":
        heard.solver.set_shape(BAR, VERTICES[:100])
    else:
        getattr(heard.solver, how)()
    count, start = len(heard.updates), time.perf_counter()
    assert heard.solver.wait(10)
    assert not heard.solver.busy
    assert time.perf_counter() - start < 2.0, "a step at most was still to be taken"
    time.sleep(0.05)
    assert len(heard.updates) == count
    assert not heard.errors
    assert not heard.finals()


def test_after_stopping_the_next_drag_is_followed(page):
    heard = page(LONG)
    heard.solver.solve(dragged(0.3))
    heard.hear()
    heard.solver.stop()
    count = len(heard.updates)
    heard.solver.follow(dragged(0.4))
    assert heard.solver.wait()
    assert not heard.errors
    assert {u.text for u in heard.updates[count:]} == {"following"}


def test_after_closing_nothing_is_taken_on_and_closing_twice_is_fine(page):
    heard = page()
    heard.solver.close()
    heard.solver.close()
    heard.solver.follow(dragged(0.1))
    assert not heard.solver.busy
    assert heard.solver.wait(1)
    assert not heard.updates


def test_the_page_may_close_the_solver_from_an_update(page):
    heard = page(LONG)
    ended = threading.Event()

    def close(error: Exception) -> None:
        heard.solver.close()
        ended.set()

    heard.solver._on_error = close
    heard.raises = ValueError("drawn badly")
    heard.solver.follow(dragged(0.1))
    assert ended.wait(30)


# --- another shape ---


def test_another_shape_is_followed_with_its_own_vertices_and_field(page):
    heard = page()
    heard.solver.follow(dragged(0.3))
    assert heard.solver.wait()
    long = fields.box((0.4, 0.4, 4.0))
    other = np.random.default_rng(1).uniform((-0.2, -0.2, -2), (0.2, 0.2, 2), (123, 3))
    heard.solver.set_shape(long, other)
    count = len(heard.updates)
    heard.solver.solve(dragged(0.3))
    assert heard.solver.wait()
    assert not heard.errors
    assert {len(u.vertices) for u in heard.updates[count:]} == {123}
    assert same_map(heard.updates[-1].warp, elastic(long, dragged(0.3), options=SMALL))


def test_shapes_that_change_during_a_drag_never_mix(page):
    heard = page()
    for size in range(20, 60):
        heard.solver.follow(dragged(size / 100))
        time.sleep(0.003)
        heard.solver.set_shape(BAR, VERTICES[:size])
        count = len(heard.updates)
        heard.solver.follow(dragged(size / 100))
        heard.hear(count + 1)
        assert len(heard.updates[count].vertices) == size
    assert not heard.errors


# --- errors ---


def test_errors_of_handles_are_told_and_the_next_drag_is_followed(page):
    heard = page()
    nothing = replace(HEAD, region=fields.sphere(0.1, (9, 9, 9)), name="far away")
    heard.solver.follow(solve_handles(EditState((FOOT, nothing))))
    assert heard.solver.wait()
    torn = replace(HEAD, region=fields.below(-0.6), shift=(1.0, 0, 0))
    heard.solver.solve(solve_handles(EditState((FOOT, torn))))
    assert heard.solver.wait()
    twice = replace(HEAD, name="foot")
    heard.solver.solve(solve_handles(EditState((FOOT, twice))))
    assert heard.solver.wait()
    causes = [str(e) for e in heard.errors]
    assert all(isinstance(e, InputError) for e in heard.errors)
    assert len(causes) == 3
    assert "far away" in causes[0]
    assert "selects nothing" in causes[0]
    assert "contradict" in causes[1]
    assert "two handles have this name" in causes[2]
    assert not heard.updates
    heard.solver.follow(dragged(0.2))
    assert heard.solver.wait()
    assert len(heard.updates) == ROUNDS


@pytest.mark.parametrize("error", [ValueError("drawn badly"), ZeroDivisionError("told badly")])
def test_a_page_that_raises_does_not_end_the_thread(page, error):
    heard = page()
    heard.raises = error
    heard.solver.follow(dragged(0.2))
    assert heard.solver.wait()
    assert heard.errors == [error]
    heard.raises = None
    heard.solver.solve(dragged(0.2))
    assert heard.solver.wait()
    assert len(heard.finals()) == 1
    assert heard.errors == [error]
