"""Parallel runs of compiled kernels."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

_HERE = threading.local()


def in_parts(task: Callable[[int, int], None], count: int, size: int) -> None:
    """Call `task(start, stop)` for the parts of range(count), on as many threads as numba uses.

    Python's threads, because the kernels release the lock: parts are then given out as threads
    become free, and kernels without `prange` take a third of the time to compile. The threads stay
    for the next run, asleep. A task that comes here itself goes on alone.

    Args:
        task: something that is safe to call from several threads, and mostly without the lock.
        count: how much there is to do.
        size: of a part; some 100 microseconds of work, to pay for handing it out.
    """
    import numba

    parts = [(start, min(start + size, count)) for start in range(0, count, size)]
    threads = min(len(parts), numba.get_num_threads())
    if threads <= 1 or getattr(_HERE, "working", False):
        for part in parts:
            task(*part)
        return
    for future in [_pool(threads).submit(task, *part) for part in parts]:
        future.result()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, "fields", lambda: setattr(_HERE, "working", True))


# A forked process has the pools, and none of their threads.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pool.cache_clear)
