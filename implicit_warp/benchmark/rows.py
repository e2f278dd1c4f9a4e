"""The measurements, each a function from settings to the rows it fills."""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from implicit_warp.benchmark import workloads
from implicit_warp.benchmark.fresh_process import FIRST_CALL, IMPORT, PEAK_MEMORY, run_fresh
from implicit_warp.benchmark.report import Row, number
from implicit_warp.benchmark.settings import Settings
from implicit_warp.benchmark.timing import Contender, Measure, Timing, race, wall
from implicit_warp.evaluate import back_end
from implicit_warp.files import save
from implicit_warp.threads import set_threads
from implicit_warp.warp import Warp

MILLION = 1e6
_SHARED_MEMORY_LIMIT = 50_000.0
"""Million points a second at which an H200's shared memory delivers 24 layers' gathers."""


@dataclass(frozen=True)
class Evaluation:
    """One way to evaluate a map at points; the goal is in million points a second."""

    key: str
    what: str
    goal: float
    searches: bool
    call: Callable[[Warp, Tensor], object]


EVALUATIONS = (
    Evaluation("map", "map", 30.0, False, lambda warp, x: warp(x)),
    Evaluation("inverse", "inverse", 10.0, True, lambda warp, x: warp.inv(x)),
    Evaluation(
        "jacobian", "value and Jacobian", 15.0, False, lambda warp, x: warp.call_and_jacobian(x)
    ),
    Evaluation(
        "inverse_jacobian",
        "value and Jacobian of the inverse",
        15.0,
        True,
        lambda warp, x: warp.inv.call_and_jacobian(x),
    ),
)

SOLVE_GOALS = {11: 0.6, 25: 12.0, 65: 300.0}
"""Milliseconds of 24 embedding solves with their adjoints, by resolution."""


def evaluations(evaluation: Evaluation, settings: Settings) -> Iterable[Row]:
    """Points a second in float32 and float64, each beside the reference."""
    device = settings.device
    warp = workloads.random_warp(settings.layers, settings.resolution, settings.seed, device)
    slow_count = settings.searched_points if evaluation.searches else settings.reference_points
    contenders = {}
    for dtype in (torch.float32, torch.float64):
        points = workloads.cube_points(settings.points, settings.seed, dtype, device)
        if evaluation.searches:
            points = warp(points)
        few = points[:slow_count]

        def fast(points: Tensor = points) -> None:
            evaluation.call(warp, points)

        def slow(few: Tensor = few) -> None:
            with back_end("torch"):
                evaluation.call(warp, few)

        fast()
        slow()
        contenders[f"{dtype} fast"] = Contender(wall(fast, device), settings.rounds)
        contenders[f"{dtype} slow"] = Contender(wall(slow, device), settings.few_rounds)
    timings = race(contenders)
    single = None
    for dtype in (torch.float32, torch.float64):
        name = str(dtype).removeprefix("torch.")
        timing, reference = timings[f"{dtype} fast"], timings[f"{dtype} slow"]
        rate = settings.points / timing.median / MILLION
        on_cpu = device == "cpu"
        if single is None:
            goal = evaluation.goal if on_cpu else None
            visits = settings.points * settings.layers
            cost = 1e9 * timing.median * settings.thread_count() / visits
            note = f"{number(cost)} ns of a core a point and layer" if on_cpu else ""
        else:
            goal, note = 0.5 * single, "goal: half of float32's rate in this run"
        single = rate if single is None else single
        yield Row(
            key=f"{evaluation.key}_{name}",
            what=f"{evaluation.what}, {name}",
            unit="million points/s",
            value=rate,
            best=settings.points / timing.best / MILLION,
            more_is_better=True,
            goal=goal,
            reference=len(few) / reference.median / MILLION,
            note=note,
        )


def fit(settings: Settings) -> Iterable[Row]:
    """One step of fitting a mesh."""
    step = workloads.fit_step(
        settings.vertices, settings.layers, settings.resolution, settings.seed, settings.device
    )

    def slow_step() -> None:
        with back_end("torch"):
            step()

    step()
    slow_step()
    timings = race(
        _with_threads("step", step, 3 * settings.rounds, settings)
        | _with_threads("reference", slow_step, settings.few_rounds, settings)
    )
    timing, name = _faster(timings, "step")
    reference, reference_name = _faster(timings, "reference")
    yield _milliseconds(
        "fit_step",
        f"one fit step, {settings.vertices} vertices, vertex and gradient loss",
        timing,
        5.0 if settings.device == "cpu" else None,
        reference.median,
        f"{name}, {reference_name}",
    )


def elastic(settings: Settings) -> Iterable[Row]:
    """One step of the elastic solve, as `elastic` runs it."""

    def measure(steps: int, name: str) -> Measure:
        def run() -> float:
            with back_end(name):
                return workloads.elastic_step_seconds(
                    settings.samples, steps, settings.layers, settings.resolution, settings.seed,
                    settings.device,
                )  # fmt: skip

        return run

    measure(1, "auto")()
    timings = race(
        {
            "fast": Contender(measure(settings.elastic_steps, "auto"), settings.few_rounds),
            "slow": Contender(measure(settings.reference_elastic_steps, "torch"), 1),
        }
    )
    note = f"a review in {settings.elastic_steps} steps included"
    if settings.reference_elastic_steps != settings.elastic_steps:
        note += f"; reference: in {settings.reference_elastic_steps}"
    yield _milliseconds(
        "elastic_step",
        f"one elastic step, {settings.samples} sample points",
        timings["fast"],
        12.0 if settings.device == "cpu" else None,
        timings["slow"].median,
        note,
    )


def solves(settings: Settings) -> Iterable[Row]:
    """Embedding solves with their adjoints."""
    for resolution in settings.solve_resolutions:
        arguments = (resolution, settings.seed, settings.device)
        run = workloads.embedding_solve(settings.layers, *arguments, dense=False)
        run()
        contenders = _with_threads("solve", run, settings.rounds, settings)
        layers = _reference_layers(resolution, settings)
        if layers:
            dense = workloads.embedding_solve(layers, *arguments, dense=True)
            contenders["reference"] = Contender(wall(dense, settings.device), 1)
        timings = race(contenders)
        timing, note = _faster(timings, "solve")
        if layers == settings.layers:
            note += "; reference: dense LU"
        elif layers:
            note += f"; reference: dense LU of {layers} of the layers, scaled"
        yield _milliseconds(
            f"solve_{resolution}",
            f"embedding solve and adjoint, {settings.layers} layers, N = {resolution}",
            timing,
            SOLVE_GOALS.get(resolution) if settings.device == "cpu" else None,
            timings["reference"].median * settings.layers / layers if layers else None,
            note,
        )


def _reference_layers(resolution: int, settings: Settings) -> int:
    """How many layers the dense reference solves: all are alike, and large ones take seconds."""
    if resolution > settings.largest_reference_solve:
        return 0
    return min(settings.layers, 24 if resolution <= 16 else 3 if resolution <= 32 else 1)


def processes(settings: Settings) -> Iterable[Row]:
    """Memory of one large call, the first call, and the import, each in fresh processes."""
    threads, on_cpu = settings.thread_count(), settings.device == "cpu"
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "warp.safetensors"
        save(
            workloads.random_warp(settings.layers, settings.resolution, settings.seed, "cpu"), path
        )
        job = {"device": settings.device, "warp": str(path)}

        def memory(name: str, points: int) -> float:
            job_here = {**job, "back_end": name, "points": points}
            return run_fresh(PEAK_MEMORY, job_here, threads) / MILLION

        def first_call(name: str) -> float:
            return run_fresh(FIRST_CALL, {**job, "back_end": name}, threads)

        count, few = settings.memory_points, settings.reference_memory_points
        used = [memory("auto", count) for _ in range(settings.few_rounds)]
        yield Row(
            key="memory",
            what=f"memory beyond input and output, map of {count:.0e} points".replace("e+0", "e"),
            unit="MB",
            value=statistics.median(used),
            best=min(used),
            more_is_better=False,
            goal=50.0 if on_cpu else None,
            reference=memory("torch", few) * count / few,
            note=f"reference: {number(few / MILLION)} million points, scaled",
        )
        first_call("auto")  # the first one of all may have to compile
        seconds = [first_call("auto") for _ in range(settings.few_rounds)]
        yield Row(
            key="first_call",
            what="first call in a fresh process, kernels cached",
            unit="s",
            value=statistics.median(seconds),
            best=min(seconds),
            more_is_better=False,
            goal=1.0 if on_cpu else None,
            reference=first_call("torch"),
            note="load a warp and map 1,000 points, after the imports",
        )
    imports = [run_fresh(IMPORT, {}, threads) for _ in range(settings.few_rounds)]
    own, torchs = zip(*imports, strict=True)
    yield Row(
        key="import",
        what="import implicit_warp, beyond torch's own import",
        unit="s",
        value=statistics.median(own),
        best=min(own),
        more_is_better=False,
        goal=0.3,
        reference=statistics.median(torchs),
        note="reference: torch's own import",
    )


@torch.no_grad()
def large_map(settings: Settings) -> Iterable[Row]:
    """On a GPU: one map of very many points, and the fraction of the hardware's limit."""
    if settings.device == "cpu":
        return
    warp = workloads.random_warp(
        settings.layers, settings.resolution, settings.seed, settings.device
    )
    points = workloads.cube_points(
        settings.large_points, settings.seed, torch.float32, settings.device
    )
    few = points[: settings.points]

    def slow() -> None:
        with back_end("torch"):
            warp(few)

    warp(points)
    slow()
    timings = race(
        {
            "fast": Contender(wall(lambda: warp(points), settings.device), settings.rounds),
            "slow": Contender(wall(slow, settings.device), settings.few_rounds),
        }
    )
    rate = len(points) / timings["fast"].median / MILLION
    is_h200 = "H200" in torch.cuda.get_device_name(settings.device)
    yield Row(
        key="large_map",
        what=f"map of {len(points):.0e} points, float32".replace("e+0", "e"),
        unit="million points/s",
        value=rate,
        best=len(points) / timings["fast"].best / MILLION,
        more_is_better=True,
        goal=10_000.0 if is_h200 else None,
        reference=len(few) / timings["slow"].median / MILLION,
        note=f"{rate / _SHARED_MEMORY_LIMIT:.0%} of the shared-memory limit" if is_h200 else "",
    )


def _milliseconds(
    key: str, what: str, timing: Timing, goal: float | None, reference: float | None, note: str
) -> Row:
    return Row(
        key=key,
        what=what,
        unit="ms",
        value=1e3 * timing.median,
        best=1e3 * timing.best,
        more_is_better=False,
        goal=goal,
        reference=None if reference is None else 1e3 * reference,
        note=note,
    )


def _with_threads(
    label: str, work: Callable[[], object], rounds: int, settings: Settings
) -> dict[str, Contender]:
    """The same work on one thread and on all: small steps can lose by sharing, large ones gain."""
    contenders = {}
    for threads in sorted({1, settings.thread_count()}):

        def measure(threads: int = threads) -> float:
            set_threads(threads)
            try:
                return wall(work, settings.device)()
            finally:
                set_threads(settings.thread_count())

        number_of = "1 thread" if threads == 1 else f"{threads} threads"
        contenders[f"{label} on {number_of}"] = Contender(measure, rounds)
    return contenders


def _faster(timings: dict[str, Timing], label: str) -> tuple[Timing, str]:
    """The better of what `_with_threads` compares, and its name."""
    names = [name for name in timings if name.startswith(f"{label} on ")]
    best = min(names, key=lambda name: timings[name].median)
    return timings[best], best
