"""One method on one pair: done once, kept in a file, and never done again.

Guarantee: a record on disk is whole (written under a temporary name and renamed), belongs to the
job that it is returned for (the job is stored in it and compared), and was measured with one thread
after everything had been compiled.  Costs are CPU seconds of the process, which a busy machine
changes little, with wall-clock seconds beside them.

Non-guarantee: a record does not know the version of the code that made it.  After a method is
changed, remove its folder.
"""

from __future__ import annotations

import datetime
import json
import multiprocessing
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from experiments.bodies import AnnyBody, BodyModel, FigureBody, Pair, pairs
from experiments.study.fitters import fit
from experiments.study.paper import ACCURACY
from experiments.study.quality import errors, quality
from implicit_warp.benchmark.report import cpu_name, load_average
from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.files import atomic_write
from implicit_warp.threads import set_threads

Record = dict[str, Any]
"""What a job's file holds, besides the deformed vertices in the ``.npz`` file next to it."""

BODIES: Mapping[str, Callable[[], BodyModel]] = {
    "anny": AnnyBody,
    "figure": FigureBody,
    "small-figure": lambda: FigureBody(28),
}


@dataclass(frozen=True)
class Job:
    """One method on one pair.

    Attributes:
        name: of the row in tables, and of the folder.
        method: a key of `fitters.FITTERS`.
        index: of the pair.
        bodies, pair_seed: whose pairs; a key of `BODIES`.
        seconds: of CPU time, for methods that are stopped by time; None where steps count.
        seed: of everything random in the method, and of the measurements' points.
        options: of the method.
        measured: all of `quality`, or only the errors.
    """

    name: str
    method: str
    index: int
    bodies: str = "anny"
    pair_seed: int = 2026
    seconds: float | None = None
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)
    measured: bool = True

    def path(self, folder: Path) -> Path:
        """The record's file."""
        return folder / self.name.replace(" ", "-").replace("/", "-") / f"{self.index}.json"


def run_jobs(
    jobs: Sequence[Job], folder: Path, workers: int = 1, progress: Callable[[str], None] = print
) -> list[Record]:
    """The records of all jobs, in order; those on disk are read, the others made.

    Args:
        jobs: what to do.
        folder: of the records; created.
        workers: processes, one thread each.  With one, everything happens in this process; with
            none, what is missing is left out.
        progress: called with a line for each job done.

    Raises:
        InputError: a negative number of workers, an unknown method or body, a record of another
            job of that name, or no record at all.
        FileFormatError: a record that cannot be read.
    """
    if workers < 0:
        raise InputError("workers", workers, "a negative number of processes", "pass 1 or more")
    missing = [job for job in jobs if stored(job, folder) is None]
    progress(f"{len(jobs) - len(missing)} of {len(jobs)} done before")
    for count, record in enumerate(_performed(missing, folder, workers) if workers else (), 1):
        progress(
            f"{count} / {len(missing)}: {record['name']}, pair {record['index']}: "
            f"vertex {record['vertex_error']:.4g}, gradient {record['gradient_error']:.4g}, "
            f"{record['cpu_seconds']:.1f} s of CPU, {record['wall_seconds']:.1f} s"
        )
    records = [found for job in jobs if (found := stored(job, folder)) is not None]
    if not records:
        raise InputError("folder", str(folder), "no record is there", "fit something first")
    return records


def stored(job: Job, folder: Path) -> Record | None:
    """The record of a job on disk, or None.

    Raises:
        InputError: it is the record of another job.
        FileFormatError: it cannot be read.
    """
    path = job.path(folder)
    if not path.exists():
        return None
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        written = record["job"]
    except (ValueError, KeyError) as error:
        raise FileFormatError(f"{path}: not a record of a job ({error}). Remove it") from error
    if written != json.loads(json.dumps(asdict(job))):
        raise InputError(
            "folder",
            str(path),
            "it holds the record of a job with other options, seeds or budgets",
            "choose another folder, or remove the old records",
        )
    return record


def vertices_of(job: Job, folder: Path) -> np.ndarray:
    """(V, 3) the deformed vertices that a job left."""
    with np.load(job.path(folder).with_suffix(".npz")) as file:
        return file["vertices"].astype(np.float64)


def pair_of(job: Job) -> Pair:
    """The pair of a job."""
    return _pair_of(job.bodies, job.pair_seed, job.index)


@lru_cache(maxsize=4)
def _pair_of(bodies: str, seed: int, index: int) -> Pair:
    if bodies not in BODIES:
        raise InputError("bodies", bodies, "no such bodies", f"use one of {', '.join(BODIES)}")
    *_, wanted = pairs(index + 1, seed, _model(bodies))
    return wanted


@lru_cache(maxsize=1)
def _model(bodies: str) -> BodyModel:
    return BODIES[bodies]()


def _performed(jobs: Sequence[Job], folder: Path, workers: int) -> Iterator[Record]:
    if workers == 1 or len(jobs) < 2:
        for job in jobs:
            yield _perform(job, folder)
        return
    # Forked processes would share the state of thread pools that do not survive it.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=context) as pool:
        for done in as_completed([pool.submit(_perform, job, folder) for job in jobs]):
            yield done.result()


def _perform(job: Job, folder: Path) -> Record:
    """Do one job and write its files."""
    pair = pair_of(job)
    with _one_thread():
        _warm_up(job.method, json.dumps(dict(job.options)))
        before = load_average()
        cpu, wall = time.process_time(), time.perf_counter()
        fitted = fit(job.method, pair, job.seconds, job.seed, job.options)
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        found = errors(pair, fitted.vertices) if not job.measured else quality(pair, fitted, job)
    record = {
        "job": asdict(job),
        "name": job.name,
        "index": job.index,
        "pair": pair.name,
        "cpu_seconds": cpu,
        "wall_seconds": wall,
        "to_accuracy": time_to_accuracy(fitted.trace),
        "steps": fitted.steps,
        "parameters": fitted.parameters,
        **found,
        "load": [before, load_average()],
        "cpu": cpu_name(),
        "torch": torch.__version__,
        "date": datetime.date.today().isoformat(),
        "trace": fitted.trace,
    }
    path = job.path(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path.with_suffix(".npz")) as temporary, temporary.open("wb") as file:
        np.savez(file, vertices=fitted.vertices.astype(np.float32))
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(record), encoding="utf-8")
    return record


def time_to_accuracy(
    trace: Sequence[Sequence[float]], goals: tuple[float, float] = ACCURACY
) -> float | None:
    """CPU seconds after which both errors were at most the goals for the first time, or None."""
    for seconds, vertex, gradient in trace:
        if vertex <= goals[0] and gradient <= goals[1]:
            return seconds
    return None


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads(), numba.get_num_threads()
    set_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads[0])
        numba.set_num_threads(threads[1])


@lru_cache(maxsize=256)
def _warm_up(method: str, options: str) -> None:
    """Compile what a method uses, on a pair that costs nothing, so that no job pays for it."""
    values = json.loads(options)
    if "steps" in values or method == "tuttenet":
        values["steps"] = 2
    fit(method, _pair_of("small-figure", 0, 0), 0.5, 0, values)
