"""How many threads the numeric libraries use, in one place."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import numba
import torch

from implicit_warp.errors import InputError


def set_threads(count: int) -> None:
    """Use so many threads in torch and in the Numba kernels from now on.

    Raises:
        InputError: less than one, or more than the machine's cores allow.
    """
    most = numba.config.NUMBA_NUM_THREADS
    if not isinstance(count, int) or not 1 <= count <= most:
        raise InputError(
            "threads", count, "not a possible number of threads", f"pass 1 to {most} here"
        )
    torch.set_num_threads(count)
    numba.set_num_threads(count)


POINTS_WORTH_A_THREAD = 8192
"""Points a step from which a loop of small operations gains by a second thread."""


@contextlib.contextmanager
def threads_for_steps(points: int) -> Iterator[None]:
    """Within the block, as many threads as steps over so many points can use.

    Most operations of an optimisation step are small: handing each to a second thread costs more
    than it saves, and on a busy machine the waiting threads were seen to slow such a loop tenfold.
    Torch gets one thread; the kernels get more when there are points enough.
    """
    before = torch.get_num_threads(), numba.get_num_threads()
    torch.set_num_threads(1)
    numba.set_num_threads(max(1, min(before[1], points // POINTS_WORTH_A_THREAD)))
    try:
        yield
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])
