"""The paper's fitting experiment: this project's TutteNet and the baselines on pairs of bodies.

    python -m experiments.fit -o out/fit                          everything: about 90 CPU minutes
    python -m experiments.fit -o out/fit --methods tuttenet       one method: 10 minutes
    python -m experiments.fit -o out/fit --keep                   also into experiments/results

Records of what is done stay in the folder, and a second run does only what is missing.  Written are
fit.json, fit.md (the tables), convergence.png and comparison.png.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from experiments.study.fitters import NAMES
from experiments.study.jobs import Job, run_jobs
from experiments.study.results import (
    DOCUMENT,
    RESULTS,
    compact,
    machine_of,
    where_and_when,
    write_results,
    write_tables,
)
from experiments.study.tables import accuracy_table, soundness_table
from implicit_warp.files import atomic_write

BY_STEPS = ("tuttenet",)
"""Methods that take a number of steps, and no budget of time."""


@dataclass(frozen=True, kw_only=True)
class FitExperiment:
    """Fit pairs of bodies with every method, and compare."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for records, results, tables and pictures."""
    methods: tuple[str, ...] = tuple(NAMES)
    """Which methods."""
    count: int = 20
    """How many pairs."""
    bodies: str = "anny"
    """anny, figure or small-figure."""
    pair_seed: int = 2026
    """Of the pairs. The options of `fit` were chosen on pairs of seed 1."""
    seed: int = 0
    """Of the methods."""
    seconds: float = 60.0
    """CPU seconds a pair for a method that is trained until its time is over."""
    steps: int = 1000
    """Steps of the TutteNet."""
    workers: int = 1
    """Processes, one thread each."""
    fitting: bool = True
    """Fit what is missing; without it, what is on disk is reported."""
    pictures: bool = True
    """Draw convergence.png and comparison.png."""
    shown: tuple[int, ...] = ()
    """Pairs in comparison.png; by default those of median and largest error of the first method."""
    keep: bool = False
    """Also write experiments/results and the tables of experiments/README.md."""


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
    workers = options.workers if options.fitting else 0
    records = run_jobs(jobs, options.out / "records", workers, progress)
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
    folders = [options.out, RESULTS] if options.keep else [options.out]
    tables = tables_of(found)
    for folder in folders:
        write_results(folder / "fit.json", found)
    with atomic_write(options.out / "fit.md") as temporary:
        temporary.write_text("\n\n".join(tables.values()) + "\n", encoding="utf-8")
    if options.keep:
        write_tables(DOCUMENT, tables)
    if options.pictures:
        from experiments.study.pictures import comparison, convergence

        for folder in folders:
            convergence(found["records"], folder / "convergence.png")
            comparison(jobs, options.out / "records", folder / "comparison.png", options.shown)
    return found


if __name__ == "__main__":
    run(tyro.cli(FitExperiment, prog="python -m experiments.fit"))
