"""The paper's ablations, and what each idea of `implicit_warp.fit` is worth.

    python -m experiments.ablate -o out/ablate                       all: about 30 CPU minutes
    python -m experiments.ablate -o out/ablate --studies layers      one table
    python -m experiments.ablate -o out/ablate --keep                also into experiments/results

Every variation changes one thing of the defaults of `fit`, on the first pairs of
`experiments.fit`.  Records of what is done stay in the folder.  Written are ablate.json, ablate.md
and ablate.png.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from experiments.study.jobs import Job, run_jobs
from experiments.study.results import compact, machine_of, where_and_when
from experiments.study.settings import StudyOfPairs
from experiments.study.tables import ablation_table
from experiments.study.variations import STUDIES, Variation, base_of
from implicit_warp.errors import InputError

_BASE_FOLDER = "defaults"


@dataclass(frozen=True, kw_only=True)
class Ablation(StudyOfPairs):
    """Vary one thing at a time, on a few pairs."""

    studies: tuple[str, ...] = tuple(STUDIES)
    """Which tables."""
    count: int = 5
    """How many pairs."""


def job_of(variation: Variation, index: int, options: Ablation) -> Job:
    """The job of one row on one pair; rows that equal the defaults share theirs."""
    is_base = not variation.options and variation.method == "tuttenet"
    return Job(
        name=_BASE_FOLDER if is_base else variation.name,
        method=variation.method,
        index=index,
        bodies=options.bodies,
        pair_seed=options.pair_seed,
        seed=options.seed,
        options={"steps": options.steps, **variation.options},
        measured=False,
    )


def tables_of(found: dict[str, Any]) -> dict[str, str]:
    """The document's tables by name, one a study."""
    tables = {}
    for study in dict.fromkeys(record["study"] for record in found["records"]):
        records = [record for record in found["records"] if record["study"] == study]
        tables[study] = ablation_table(records, base_of(study).name)
    tables["ablation machine"] = where_and_when(found)
    return tables


def run(options: Ablation, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Do what is missing, write all files, and return what ablate.json holds.

    Raises:
        InputError: no such study, or what `run_jobs` raises.
    """
    for study in options.studies:
        if study not in STUDIES:
            raise InputError("studies", study, "no such study", f"use some of {', '.join(STUDIES)}")
    rows = [
        (study, variation, job_of(variation, index, options))
        for study in options.studies
        for variation in STUDIES[study]
        for index in range(options.count)
    ]
    # In the order of their first need, each once.
    jobs = list({job.path(Path()): job for _, _, job in rows}.values())
    records = run_jobs(jobs, options.records, options.processes, progress)
    by_job = {(record["name"], record["index"]): record for record in records}
    found = {
        "bodies": options.bodies,
        "pair_seed": options.pair_seed,
        "pairs": options.count,
        "steps": options.steps,
        "machine": machine_of(records),
        "records": [
            {"study": study, **compact(by_job[job.name, job.index]), "name": variation.name}
            for study, variation, job in rows
            if (job.name, job.index) in by_job
        ],
    }
    for record in found["records"]:
        del record["trace"], record["wall_seconds"], record["load"], record["date"]
    options.write("ablate", found, tables_of(found))
    if options.pictures:
        from experiments.study.pictures import ablations

        for folder in options.folders:
            ablations(found["records"], folder / "ablate.png")
    return found


if __name__ == "__main__":
    run(tyro.cli(Ablation, prog="python -m experiments.ablate"))
