"""What a call costs: each method's map, Jacobian, inverse and training step, side by side.

    python -m experiments.timing -o out/timing             about 6 CPU minutes
    python -m experiments.timing -o out/timing --keep      also into experiments/results

Networks are fitted to one pair for a while first, because what a NeuralODE or the inverse of an
i-ResNet costs depends on what was learned.  All of them then take turns on the same points, and
medians count.  With one thread the clock is the process's CPU time, which a busy machine changes
little; with more it is the wall's.  Written are timing.json, timing.md and timing.png.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import torch
import tyro
from torch import Tensor, nn

from experiments.baselines.module_map import ModuleMap
from experiments.bodies import Pair
from experiments.study.fitters import NAMES, fit
from experiments.study.jobs import Job, pair_of
from experiments.study.paper import TABLE_2
from experiments.study.results import read_results
from experiments.study.settings import Study
from experiments.study.tables import markdown, number
from implicit_warp import TutteNet, Warp
from implicit_warp.benchmark.report import cpu_name, load_average
from implicit_warp.benchmark.timing import Contender, race, wall
from implicit_warp.benchmark.workloads import sphere_mesh
from implicit_warp.errors import InputError
from implicit_warp.maps import Composition, Map
from implicit_warp.mesh_gradient import MeshGradient
from implicit_warp.threads import set_threads

OPERATIONS = ("forward", "value and Jacobian", "inverse", "training step")
_LONG = 10.0
"""Seconds from which a call is measured twice only."""

_THREADS = ("{} thread (CPU time)", "{} threads (wall-clock time)")
WITH_MAPS = ("tuttenet", "realnvp", "realnvp_64", "i_resnet", "neural_ode")


@dataclass(frozen=True, kw_only=True)
class TimingExperiment(Study):
    """Time every method that has a map."""

    methods: tuple[str, ...] = WITH_MAPS
    """Which methods."""
    points: int = 6890
    """Points a call, and vertices of the mesh of the training step; SMPL's by default."""
    threads: tuple[int, ...] = (1, 2)
    """Numbers of threads; those that the machine does not allow are left out."""
    rounds: int = 5
    """Measurements of each operation, of which the median counts."""
    seconds: float = 20.0
    """CPU seconds of the fit before, for networks."""
    steps: int = 300
    """Steps of that fit, for the TutteNet."""


def operations_of(
    method: str, map_: Map, points: Tensor, options: TimingExperiment
) -> dict[str, Callable[[], object]]:
    """What is timed of a fitted method, by the names of `OPERATIONS`.

    In float32, but for the inverse: the networks' inverses iterate to tolerances below float32's.
    """
    images = map_(points.double())
    if isinstance(map_, Warp):
        module: nn.Module = TutteNet(map_.n_layers, map_.resolution, "cubic")
        called: Callable[[Tensor], Tensor] = map_
        jacobian = map_.call_and_jacobian
    else:
        # Trained in float32 and kept in float64 for accuracy; speed is that of float32.
        inner, around = _inside(map_)
        module = copy.deepcopy(inner.module).float()
        in_float32 = _Float32(module, around)
        called, jacobian = in_float32.call, in_float32.jacobian
    return {
        "forward": torch.no_grad()(lambda: called(points)),
        "value and Jacobian": lambda: jacobian(points),
        "inverse": torch.no_grad()(lambda: map_.inv(images)),
        "training step": _training_step(
            copy.deepcopy(module).requires_grad_(True).train(), options
        ),
    }


class _Float32:
    """A fitted network between its affine maps, all in float32."""

    def __init__(self, module: nn.Module, around: tuple[Map, Map]) -> None:
        self._module = module.eval().requires_grad_(False)
        self._before, self._after = around

    def call(self, points: Tensor) -> Tensor:
        return self._after(self._module(self._before(points)))

    def jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        x = points.detach().requires_grad_()
        y = self.call(x)
        rows = [torch.autograd.grad(y[:, i].sum(), x, retain_graph=i < 2)[0] for i in range(3)]
        return y.detach(), torch.stack(rows, dim=1)


def _inside(map_: Map) -> tuple[ModuleMap, tuple[Map, Map]]:
    """The network in a fitted map, and the affine maps before and after it."""
    parts = map_.maps if isinstance(map_, Composition) else (map_,)
    if len(parts) == 3 and isinstance(parts[1], ModuleMap):
        return parts[1], (parts[0], parts[2])
    raise InputError("map_", map_, "no network between two affine maps", "see baselines.training")


def _training_step(module: nn.Module, options: TimingExperiment) -> Callable[[], float]:
    """Forward, backward and Adam over a whole mesh of so many vertices; returns the loss."""
    positions, faces = sphere_mesh(options.points)
    source = torch.tensor(0.7 * positions, dtype=torch.float32)
    target = source * torch.tensor([1.1, 0.9, 1.0])
    gradient = MeshGradient(source, faces, weighting="uniform")
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-5, fused=True)

    def step() -> float:
        image = module(source)
        vertex = (image - target).square().mean()
        loss = vertex + 0.1 * gradient.squared_distance(image, target) / 9.0
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        return float(loss.detach())

    return step


def measure(options: TimingExperiment, progress: Callable[[str], None]) -> list[dict[str, Any]]:
    """Median seconds, one row a method, operation and number of threads."""
    pair = pair_of(Job("timing", "tuttenet", 0, options.bodies, options.pair_seed))
    points = _points_of(pair, options.points)
    work: dict[tuple[str, str], Callable[[], object]] = {}
    for method in options.methods:
        progress(f"fitting {method}")
        given = {"steps": options.steps} if method == "tuttenet" else {}
        limit = None if method == "tuttenet" else options.seconds
        fitted = fit(method, pair, limit, options.seed, given)
        if fitted.map is None:
            raise InputError("methods", method, "it has no map", f"use some of {WITH_MAPS}")
        for operation, call in operations_of(method, fitted.map, points, options).items():
            work[method, operation] = call
    rows = []
    for threads in options.threads:
        if threads > numba.config.NUMBA_NUM_THREADS:
            progress(f"{threads} threads are not to be had here")
            continue
        set_threads(threads)
        for call in work.values():
            call()
        before = load_average()
        found = race(
            {
                " ".join(key): Contender(wall(call, "cpu"), options.rounds)
                for key, call in work.items()
            }
        )
        rows += [
            {
                "method": method,
                "operation": operation,
                "threads": threads,
                "seconds": float(f"{found[f'{method} {operation}'].median:.4g}"),
                "best": float(f"{found[f'{method} {operation}'].best:.4g}"),
                "load": [round(before, 1), round(load_average(), 1)],
            }
            for method, operation in work
        ]
        progress(f"timed with {threads} threads")
    return rows


def _clock(call: Callable[[], object], threads: int) -> Callable[[], float]:
    """Does the work once and returns the seconds it took."""
    if threads > 1:
        return wall(call, "cpu")

    def measure() -> float:
        start = time.process_time()
        call()
        return time.process_time() - start

    return measure


def _points_of(pair: Pair, count: int) -> Tensor:
    """(count, 3) vertices of the source, float32, in their order; repeated if there are too few."""
    vertices = np.array(pair.source.vertices, np.float32)
    chosen = np.sort(np.resize(np.random.default_rng(0).permutation(len(vertices)), count))
    return torch.from_numpy(vertices[chosen])


def table_of(found: Mapping[str, Any]) -> str:
    """Milliseconds of every operation, and the paper's."""
    rows = found["records"]
    seconds = {(r["method"], r["operation"], r["threads"]): (r["seconds"], r["best"]) for r in rows}
    threads = sorted({row["threads"] for row in rows})
    lines = []
    for method in dict.fromkeys(row["method"] for row in rows):
        cells = []
        for operation in OPERATIONS:
            values = [seconds[method, operation, count] for count in threads]
            cells.append(
                " / ".join("{} ({})".format(*(number(1e3 * v) for v in p)) for p in values)
            )
        paper = TABLE_2.get(method)
        for value in (None, None) if paper is None else (paper.forward, paper.jacobian):
            cells.append("-" if value is None else number(1e3 * value))
        lines.append((NAMES[method], *cells))
    headings = ("method", *OPERATIONS, "paper: forward", "paper: Jacobian")
    load = [value for row in rows for value in row["load"]]
    clocks = " / ".join(_THREADS[count > 1].format(count) for count in threads)
    note = (
        f"Milliseconds, {found['points']:,} points, float32 (inverse: float64), medians of "
        f"{found['rounds']} turns (the best of them), {clocks}; {found['machine']['cpu']}, load "
        f"average {min(load)} to {max(load)}, torch {found['machine']['torch']}."
    )
    return f"{markdown(headings, lines)}\n\n{note}"


def _measured(options: TimingExperiment, progress: Callable[[str], None]) -> dict[str, Any]:
    before = torch.get_num_threads(), numba.get_num_threads()
    try:
        set_threads(1)
        rows = measure(options, progress)
    finally:
        torch.set_num_threads(before[0])
        numba.set_num_threads(before[1])
    return {
        "points": options.points,
        "rounds": options.rounds,
        "machine": {"cpu": cpu_name(), "torch": torch.__version__},
        "records": rows,
    }


def run(options: TimingExperiment, progress: Callable[[str], None] = print) -> dict[str, Any]:
    """Measure, write all files, and return what timing.json holds."""
    if options.measuring:
        found = _measured(options, progress)
    else:
        found = read_results(options.out / "timing.json")
    options.write("timing", found, {"timing": table_of(found)})
    if options.pictures:
        from experiments.study.pictures import timings

        for folder in options.folders:
            timings(found["records"], folder / "timing.png")
    return found


if __name__ == "__main__":
    run(tyro.cli(TimingExperiment, prog="python -m experiments.timing"))
