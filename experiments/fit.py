"""The paper's fitting experiment: this project's TutteNet and the baselines on pairs of bodies.

    python -m experiments.fit -o out/fit                          everything: about 90 CPU minutes
    python -m experiments.fit -o out/fit --methods tuttenet       one method: 10 minutes
    python -m experiments.fit -o out/fit --keep                   also into experiments/results

Records of what is done stay in the folder, and a second run does only what is missing.  Written are
fit.json, fit.md (the tables), convergence.png and comparison.png.  With --keep, methods that met
fewer pairs here than in the repository's results keep the rows that they have there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import tyro

from experiments.study.fitters import NAMES
from experiments.study.jobs import Job, run_jobs
from experiments.study.results import (
    RESULTS,
    compact,
    machine_of,
    read_results,
    where_and_when,
    with_rows_of,
)
from experiments.study.settings import StudyOfPairs
from experiments.study.tables import accuracy_table, soundness_table

BY_STEPS = ("tuttenet",)
"""Methods that take a number of steps, and no budget of time."""


@dataclass(frozen=True, kw_only=True)
class FitExperiment(StudyOfPairs):
    """Fit pairs of bodies with every method, and compare."""

    methods: tuple[str, ...] = tuple(NAMES)
    """Which methods."""
    count: int = 20
    """How many pairs."""
    seconds: float = 60.0
    """CPU seconds a pair for a method that is trained until its time is over."""
    shown: tuple[int, ...] = ()
    """Pairs in comparison.png; by default those of median and largest error of the first method."""


def jobs_of(options: FitExperiment) -> list[Job]:
    """All jobs, pair by pair, so that a run cut short has compared something."""
    return [
        Job(
            name=method,
            method=method,
            index=index,
            bodies=options.bodies,
            pair_seed=options.pair_seed,
            seconds=None if method in BY_STEPS else options.seconds,
            seed=options.seed,
            options={"steps": options.steps} if method in BY_STEPS else {},
        )
        for index in range(options.count)
        for method in options.methods
    ]


def tables_of(found: dict[str, Any]) -> dict[str, str]:
    """The document's tables by name."""
    line = where_and_when(found)
    return {
        "fitting": f"{accuracy_table(found['records'])}\n\n{line}",
        "soundness": soundness_table(found["records"]),
    }


def run(options: FitExperiment, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Do what is missing, write all files, and return what fit.json holds."""
    jobs = jobs_of(options)
    records = run_jobs(jobs, options.records, options.processes, progress)
    in_order = sorted(records, key=lambda r: (options.methods.index(r["name"]), r["index"]))
    found = {
        "bodies": options.bodies,
        "pair_seed": options.pair_seed,
        "pairs": options.count,
        "seconds": options.seconds,
        "steps": options.steps,
        "machine": machine_of(records),
        "records": [compact(record) for record in in_order],
    }
    if options.keep and (kept := RESULTS / "fit.json").exists():
        found = with_rows_of(found, read_results(kept))
    options.write("fit", found, tables_of(found))
    if options.pictures:
        from experiments.study.pictures import comparison, convergence

        for folder in options.folders:
            convergence(found["records"], folder / "convergence.png")
            comparison(jobs, options.records, folder / "comparison.png", options.shown)
    return found


if __name__ == "__main__":
    run(tyro.cli(FitExperiment, prog="python -m experiments.fit"))
