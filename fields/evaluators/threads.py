"""Parallel runs of compiled kernels."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def in_parts(task: Callable[[int, int], None], count: int, size: int) -> None:
    """Call `task(start, stop)` for the parts of range(count), on as many threads as numba uses.

    Python's threads, because the kernels release the lock: parts are then given out as threads
    become free, and kernels without `prange` take a third of the time to compile.

    Args:
        task: something that is safe to call from several threads, and mostly without the lock.
        count: how much there is to do.
        size: of a part; some 100 microseconds of work, to pay for handing it out.
    """
    import numba

    parts = [(start, min(start + size, count)) for start in range(0, count, size)]
    threads = min(len(parts), numba.get_num_threads())
    if threads <= 1:
        for part in parts:
            task(*part)
        return
    with ThreadPoolExecutor(threads) as pool:
        for future in [pool.submit(task, *part) for part in parts]:
            future.result()
