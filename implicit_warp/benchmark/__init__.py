"""The benchmark behind ``implicit-warp bench``: every speed goal, with the reference beside it.

Guarantee: both sides of every ratio were timed in one run, in turns, after both had compiled.
Non-guarantee: absolute figures from a busy machine; the report states its load.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numba

from implicit_warp.benchmark import field_rows, rows
from implicit_warp.benchmark.report import Machine, Report, Row, load_average
from implicit_warp.benchmark.settings import Settings
from implicit_warp.progress import Update
from implicit_warp.threads import set_threads

__all__ = ["Machine", "Report", "Row", "Settings", "run_benchmark"]


def run_benchmark(settings: Settings | None = None, progress: Update | None = None) -> Report:
    """Measure everything.

    Args:
        settings: the sizes; by default those of the goals, which take three to four minutes.
        progress: called with (parts done, parts in all, the next part's name).

    Raises:
        InputError: more threads than there are.
    """
    settings = settings or Settings()
    # The number of threads is stated, and restored, whatever was set before.
    before = numba.get_num_threads()
    settings = replace(settings, threads=settings.thread_count())
    parts = {
        # Fresh processes come first, while this one is still small.
        "processes": rows.processes,
        **{e.what: partial(rows.evaluations, e) for e in rows.EVALUATIONS},
        "fit step": rows.fit,
        "elastic step": rows.elastic,
        "embedding solves": rows.solves,
        "large map": rows.large_map,
    }
    if settings.device == "cpu":
        parts |= {"fields": field_rows.evaluation, "extraction": field_rows.extractions}
    load, found = load_average(), {}
    try:
        set_threads(settings.threads)
        for done, (name, part) in enumerate(parts.items()):
            if progress is not None:
                progress(done, len(parts), name)
            found[name] = list(part(settings))
    finally:
        set_threads(before)
    order = [name for name in parts if name != "processes"] + ["processes"]
    measured = [row for name in order for row in found[name]]
    return Report(Machine.here(settings, load), settings, measured)
