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
from typing import Annotated, Any

import tyro

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
from experiments.study.tables import ablation_table
from experiments.study.variations import STUDIES, Variation, base_of
from implicit_warp.errors import InputError
from implicit_warp.files import atomic_write

_BASE_FOLDER = "defaults"


@dataclass(frozen=True, kw_only=True)
class Ablation:
    """Vary one thing at a time, on a few pairs."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for records, results, tables and the picture."""
    studies: tuple[str, ...] = tuple(STUDIES)
    """Which tables."""
    count: int = 5
    """How many pairs."""
    bodies: str = "anny"
    """anny, figure or small-figure."""
    pair_seed: int = 2026
    """Of the pairs."""
    seed: int = 0
    """Of the fits."""
    steps: int = 1000
    """Of every fit whose row does not say otherwise."""
    workers: int = 1
    """Processes, one thread each."""
    fitting: bool = True
    """Fit what is missing; without it, what is on disk is reported."""
    pictures: bool = True
    """Draw ablate.png."""
    keep: bool = False
    """Also write experiments/results and the tables of experiments/README.md."""


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
    workers = options.workers if options.fitting else 0
    records = run_jobs(jobs, options.out / "records", workers, progress)
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
    tables = tables_of(found)
    folders = [options.out, RESULTS] if options.keep else [options.out]
    for folder in folders:
        write_results(folder / "ablate.json", found)
    with atomic_write(options.out / "ablate.md") as temporary:
        temporary.write_text("\n\n".join(tables.values()) + "\n", encoding="utf-8")
    if options.keep:
        write_tables(DOCUMENT, tables)
    if options.pictures:
        from experiments.study.pictures import ablations

        for folder in folders:
            ablations(found["records"], folder / "ablate.png")
    return found


if __name__ == "__main__":
    run(tyro.cli(Ablation, prog="python -m experiments.ablate"))
