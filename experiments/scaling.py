"""How the cost of a warp grows with the number of points, layers and vertices of its layers.

    python -m experiments.scaling -o out/

writes scaling.json (seconds, and the exponent that fits each curve's upper half) and scaling.png
(one panel per axis).  On one CPU thread it takes about a minute.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numba
import numpy as np
import torch
import tyro

from implicit_warp.benchmark import workloads
from implicit_warp.benchmark.report import cpu_name, load_average
from implicit_warp.benchmark.settings import Settings
from implicit_warp.benchmark.timing import Contender, race, wall
from implicit_warp.files import atomic_write
from implicit_warp.threads import set_threads
from implicit_warp.warp import Warp

EVALUATIONS: dict[str, Callable[[Warp, torch.Tensor], object]] = {
    "map": lambda warp, x: warp(x),
    "inverse": lambda warp, x: warp.inv(x),
    "value and Jacobian": lambda warp, x: warp.call_and_jacobian(x),
}
SOLVE = "solve and adjoint"

AXES = {"points": "points n", "layers": "layers K", "resolution": "resolution N"}

# Distinguishable with every common kind of colour blindness, and by marker without colour.
STYLES = {
    "map": ("#0072b2", "o"),
    "inverse": ("#d55e00", "s"),
    "value and Jacobian": ("#009e73", "^"),
    SOLVE: ("#cc79a7", "D"),
}


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """How the cost grows with points, layers and resolution.

    While one of the three varies, the others stay as in the speed goals: 24 layers of resolution
    11, and a fixed number of points.
    """

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for scaling.json and scaling.png."""
    device: str = "cpu"
    """cpu, or a CUDA device of torch."""
    points: tuple[int, ...] = (100, 1_000, 10_000, 100_000, 1_000_000)
    """Numbers of points."""
    layers: tuple[int, ...] = (1, 2, 4, 8, 16, 32, 64)
    """Numbers of layers."""
    resolution: tuple[int, ...] = (3, 5, 9, 17, 33, 65)
    """Resolutions."""
    fixed_points: int = 100_000
    """Points while layers or resolution vary."""
    threads: int = 1
    """Threads; with one, the curves show the work and not how well it is shared."""
    rounds: int = 5
    """Measurements of each value, of which the best counts: it is the least disturbed one."""
    seed: int = 0
    """Of the maps and points."""


@dataclass(frozen=True)
class Curve:
    """The cost of one operation along one axis.

    Attributes:
        operation: what is done.
        axis: what varies, a key of `AXES`.
        values: along the axis, increasing.
        seconds: the best of the rounds, one a value.
        exponent: of the power law through the upper half of the curve; None below two values.
    """

    operation: str
    axis: str
    values: Sequence[int]
    seconds: Sequence[float]
    exponent: float | None = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "exponent", power_law(self.values, self.seconds))


def power_law(values: Sequence[float], seconds: Sequence[float]) -> float | None:
    """The exponent p of c x^p through the upper half of a curve, by least squares of logarithms."""
    start = len(values) // 2 if len(values) > 3 else 0
    x, y = np.log(values[start:]), np.log(seconds[start:])
    return float(np.polyfit(x, y, 1)[0]) if len(x) > 1 else None


def measure(options: Scaling) -> list[Curve]:
    """All curves."""
    settings = Settings(device=options.device, seed=options.seed)
    usual = {
        "points": options.fixed_points,
        "layers": settings.layers,
        "resolution": settings.resolution,
    }
    curves = []
    for axis in AXES:
        values = sorted(getattr(options, axis))
        seconds: dict[str, list[float]] = {}
        for value in values:
            for operation, best in cost(**{**usual, axis: value}, options=options).items():
                seconds.setdefault(operation, []).append(best)
        for operation, costs in seconds.items():
            if not (axis == "points" and operation == SOLVE):
                curves.append(Curve(operation, axis, values, costs))
    return curves


def cost(*, points: int, layers: int, resolution: int, options: Scaling) -> dict[str, float]:
    """Seconds of every operation at one size."""
    device, seed = options.device, options.seed
    warp = workloads.random_warp(layers, resolution, seed, device)
    cube = workloads.cube_points(points, seed, torch.float32, device)
    work: dict[str, Callable[[], object]] = {
        name: lambda call=call: call(warp, cube) for name, call in EVALUATIONS.items()
    }
    work[SOLVE] = workloads.embedding_solve(layers, resolution, seed, device, dense=False)
    for run in work.values():
        run()
    contenders = {
        name: Contender(_repeated(run, device), options.rounds) for name, run in work.items()
    }
    return {name: timing.best for name, timing in race(contenders).items()}


def _repeated(run: Callable[[], object], device: str) -> Callable[[], float]:
    """Repeat what is too short for the clock, so that a measurement takes a millisecond or more."""
    once = wall(run, device)
    repeats = max(1, math.ceil(1e-3 / max(min(once(), once()), 1e-6)))

    def many() -> None:
        for _ in range(repeats):
            run()

    together = wall(many, device)
    return lambda: together() / repeats


def plot(curves: Sequence[Curve], path: Path) -> None:
    """One panel per axis, logarithmic both ways, exponents in the legends."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (axis, label) in zip(figure.subplots(1, len(AXES)), AXES.items(), strict=True):
        for curve in (c for c in curves if c.axis == axis):
            colour, marker = STYLES[curve.operation]
            growth = "" if curve.exponent is None else f" ~ ${label[-1]}^{{{curve.exponent:.1f}}}$"
            milliseconds = [1e3 * s for s in curve.seconds]
            axes.plot(
                curve.values, milliseconds, color=colour, marker=marker, markersize=4,
                linewidth=1.4, label=curve.operation + growth,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.set_yscale("log")
        if axis != "points":
            ticks = sorted({v for c in curves if c.axis == axis for v in c.values})
            axes.set_xticks(ticks, [str(v) for v in ticks])
            axes.minorticks_off()
        axes.set_xlabel(label)
        axes.set_ylabel("milliseconds")
        axes.grid(True, color="0.9", linewidth=0.6)
        axes.legend(fontsize=8, frameon=False)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})


def run(options: Scaling) -> dict[str, Any]:
    """Measure, write both files, and return what the JSON file holds."""
    options.out.mkdir(parents=True, exist_ok=True)
    threads, before = numba.get_num_threads(), load_average()
    try:
        set_threads(options.threads)
        curves = measure(options)
    finally:
        set_threads(threads)
    found = {
        "device": options.device,
        "cpu": cpu_name(),
        "threads": options.threads,
        "load_before": before,
        "load_after": load_average(),
        "fixed_points": options.fixed_points,
        "curves": [asdict(curve) for curve in curves],
    }
    with atomic_write(options.out / "scaling.json") as temporary:
        temporary.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    plot(curves, options.out / "scaling.png")
    return found


if __name__ == "__main__":
    run(tyro.cli(Scaling, prog="python -m experiments.scaling"))
