"""Parts of a range on several threads: all of them, once, whoever asks."""

from __future__ import annotations

import multiprocessing
import threading

import numba
import numpy as np
import pytest

from fields.evaluators import threads
from fields.evaluators.threads import in_parts


@pytest.fixture
def two_threads(monkeypatch):
    monkeypatch.setattr(numba, "get_num_threads", lambda: 2)


def counted(count: int, size: int) -> np.ndarray:
    times = np.zeros(count, int)

    def task(start: int, stop: int) -> None:
        times[start:stop] += 1

    in_parts(task, count, size)
    return times


@pytest.mark.parametrize(("count", "size"), [(0, 3), (1, 3), (3, 3), (10, 3), (1000, 7)])
def test_every_part_is_done_once(two_threads, count, size):
    np.testing.assert_array_equal(counted(count, size), 1)


def test_two_threads_work_at_the_same_time(two_threads):
    meeting = threading.Barrier(2, timeout=30)
    in_parts(lambda start, stop: meeting.wait() and None, 2, 1)


def test_a_task_that_hands_out_parts_itself_does_not_wait_for_itself(two_threads):
    inner: list[np.ndarray] = []
    in_parts(lambda start, stop: inner.append(counted(50, 3)), 8, 1)
    assert len(inner) == 8
    np.testing.assert_array_equal(inner, 1)


def test_errors_arrive_and_later_runs_are_well(two_threads):
    def fail(start: int, stop: int) -> None:
        if start == 2:
            raise ValueError("part 2")

    with pytest.raises(ValueError, match="part 2"):
        in_parts(fail, 4, 1)
    np.testing.assert_array_equal(counted(40, 3), 1)


@pytest.mark.skipif(
    "fork" not in multiprocessing.get_all_start_methods(), reason="processes do not fork here"
)
def test_a_forked_process_makes_threads_of_its_own(two_threads):
    counted(40, 3)  # the pool is there before the fork
    assert threads._pool.cache_info().currsize
    context = multiprocessing.get_context("fork")
    child = context.Process(target=counted, args=(40, 3))
    child.start()
    child.join(30)
    assert child.exitcode == 0
