"""Plots of results, and pictures of the deformed bodies with their errors in colour."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from experiments.study.fitters import NAMES
from experiments.study.jobs import Job, pair_of, stored, vertices_of
from experiments.study.paper import ABLATIONS, ACCURACY, TABLE_2
from experiments.study.tables import Records, by_name, quartiles
from implicit_warp.errors import InputError
from implicit_warp.files import atomic_write
from implicit_warp.render import Panel, render_row

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Distinguishable with every common kind of colour blindness, and by marker without colour.
STYLES = {
    "tuttenet": ("#0072b2", "o"),
    "realnvp": ("#d55e00", "s"),
    "realnvp_64": ("#e69f00", "v"),
    "i_resnet": ("#cc79a7", "D"),
    "neural_ode": ("#009e73", "^"),
    "cage": ("#56b4e9", "P"),
    "arap": ("#555555", "X"),
}

LARGEST_SHOWN = 0.02
"""Distance to the target, of the body's height, that has the last colour."""

_BODY = (0.80, 0.81, 0.83)


def convergence(records: Records, path: Path) -> None:
    """Median errors of each method against CPU seconds, with the paper's final ones."""
    figure = _figure((9.0, 3.9))
    for axes, column, title, goal in zip(
        figure.subplots(1, 2), (1, 2), ("vertex error", "gradient error"), ACCURACY, strict=True
    ):
        for name, group in by_name(records).items():
            colour, marker = STYLES[name]
            label = NAMES[name]
            if len(group[0]["trace"]) == 1:  # one solve
                points = [record["trace"][0] for record in group]
                x, y = (quartiles(p[i] for p in points)[1] for i in (0, column))
                axes.plot([x], [y], marker, color=colour, label=label, linestyle="none")
            else:
                seconds, middle = _median_curve([record["trace"] for record in group], column)
                axes.plot(seconds, middle, color=colour, label=label, linewidth=1.6)
        axes.axhline(goal, color="0.6", linewidth=0.9, linestyle=":")
        axes.set_yscale("log")
        axes.set_xscale("log")
        axes.set_xlabel("CPU seconds, one thread")
        axes.set_title(f"{title} x 1000, median of the pairs", fontsize=10)
        _plain(axes)
        axes.text(
            0.99, goal, "paper's TutteNet", fontsize=7, color="0.45", ha="right", va="bottom",
            transform=axes.get_yaxis_transform(),
        )  # fmt: skip
    figure.axes[0].legend(fontsize=8, frameon=False)
    _save(figure, path)


def ablations(records: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Errors against layers, resolution and steps, and every single loss of each idea."""
    studies = {record["study"] for record in records}
    curves = [s for s in ("layers", "resolution", "steps") if s in studies]
    dots = [s for s in ("orientation", "initialisation", "ideas") if s in studies]
    figure = _figure((3.4 * max(len(curves), 1) + 4.6 * bool(dots), 4.6))
    widths = [3.2] * len(curves) + [2.8] * bool(dots)
    panels = list(np.atleast_1d(figure.subplots(1, len(widths), width_ratios=widths)))
    for axes, study in zip(panels, curves, strict=False):
        _curve(axes, study, [r for r in records if r["study"] == study])
    if dots:
        _dots(panels[-1], [r for r in records if r["study"] in dots])
    if curves:
        lines = panels[0].get_legend_handles_labels()
        figure.legend(*lines, loc="outside lower left", ncols=4, fontsize=8, frameon=False)
    _save(figure, path)


def _curve(axes: Axes, study: str, records: Records) -> None:
    # Rows with a second change are not on the curve.
    groups = {name: group for name, group in by_name(records).items() if "," not in name}
    values = [int("".join(c for c in name if c.isdigit())) for name in groups]
    for key, column, colour, label in (
        ("gradient_error", 1, "#0072b2", "gradient"),
        ("vertex_error", 0, "#d55e00", "vertex"),
    ):
        low, middle, high = zip(
            *(quartiles(r[key] for r in group) for group in groups.values()), strict=True
        )
        axes.plot(values, middle, color=colour, marker="o", markersize=4, label=label)
        axes.fill_between(values, low, high, color=colour, alpha=0.15, linewidth=0)
        paper = [ABLATIONS.get(name, (np.nan, np.nan))[column] for name in groups]
        if not np.isnan(paper).all():
            axes.plot(
                values, paper, color=colour, linestyle=":", marker="x", markersize=4,
                label=f"{label}, paper",
            )  # fmt: skip
    axes.set_yscale("log")
    axes.set_xticks(values, [str(v) for v in values])
    axes.set_xlabel(study)
    axes.set_title("errors x 1000, median and quartiles", fontsize=9)
    _plain(axes)


def _dots(axes: Axes, records: Records) -> None:
    groups = by_name(records)
    for row, group in enumerate(groups.values()):
        losses = [r["vertex_error"] + 0.1 * r["gradient_error"] for r in group]
        axes.plot(losses, [row] * len(losses), "o", color="#0072b2", markersize=3.5, alpha=0.6)
        axes.plot([quartiles(losses)[1]], [row], "|", color="black", markersize=11)
    axes.set_yticks(range(len(groups)), list(groups), fontsize=7)
    axes.invert_yaxis()
    axes.set_xscale("log")
    axes.set_xlabel("loss x 1000, pairs and median")
    _plain(axes)


def timings(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Seconds of each operation, the methods side by side, one thread, with the paper's."""
    rows = [row for row in rows if row["threads"] == min(r["threads"] for r in rows)]
    operations = list(dict.fromkeys(row["operation"] for row in rows))
    figure = _figure((2.6 * len(operations), 3.2))
    for axes, operation in zip(
        np.atleast_1d(figure.subplots(1, len(operations))), operations, strict=True
    ):
        here = [row for row in rows if row["operation"] == operation]
        for place, row in enumerate(here):
            axes.bar(place, row["seconds"], color=STYLES[row["method"]][0])
            paper = _paper_seconds(row["method"], operation)
            if paper is not None:
                axes.plot([place - 0.4, place + 0.4], [paper, paper], color="black", linewidth=1.2)
        axes.set_yscale("log")
        axes.set_xticks(
            range(len(here)), [NAMES[row["method"]] for row in here], rotation=60, fontsize=7,
            ha="right",
        )  # fmt: skip
        axes.set_title(f"{operation}, seconds", fontsize=9)
        _plain(axes)
    _save(figure, path)


def _paper_seconds(method: str, operation: str) -> float | None:
    row = TABLE_2.get(method)
    if row is None:
        return None
    return {"forward": row.forward, "value and Jacobian": row.jacobian}.get(operation)


def comparison(jobs: Sequence[Job], folder: Path, path: Path, shown: Sequence[int] = ()) -> None:
    """Source | each method | target, errors in colour, one row a pair.

    Args:
        jobs: of the experiment.
        folder: of their records.
        path: the PNG file.
        shown: which pairs; by default those of median and of largest gradient error of the first
            method, among the pairs that all methods fitted.

    Raises:
        InputError: a pair that was not fitted.
    """
    records = [(job, record) for job in jobs if (record := stored(job, folder)) is not None]
    if not shown:
        fitted = Counter(job.index for job, _ in records)
        ranked = sorted(
            (record["gradient_error"], job.index)
            for job, record in records
            if job.method == jobs[0].method and fitted[job.index] == max(fitted.values())
        )
        shown = dict.fromkeys(ranked[i][1] for i in ((len(ranked) - 1) // 2, len(ranked) - 1))
    rows = []
    for index in shown:
        chosen = [(job, record) for job, record in records if job.index == index]
        if not chosen:
            raise InputError("shown", index, "no such pair was fitted", "choose among the pairs")
        rows.append(render_row(_panels(chosen, folder), size=(300, 400), supersampling=2))
    picture = _stacked(rows)
    figure = _figure((picture.shape[1] / 150, picture.shape[0] / 150 + 0.55))
    axes = figure.subplots()
    axes.imshow(picture)
    axes.set_axis_off()
    _colour_bar(figure, axes)
    _save(figure, path, dpi=160)


def _panels(chosen: Sequence[tuple[Job, Mapping[str, Any]]], folder: Path) -> list[Panel]:
    pair = pair_of(chosen[0][0])
    panels = [Panel(pair.source, _BODY, "source")]
    for job, record in chosen:
        vertices = vertices_of(job, folder)
        away = np.linalg.norm(vertices - pair.target.vertices, axis=1) / pair.height
        figures = f"{record['vertex_error']:.2g} / {record['gradient_error']:.2g}"
        mesh = trimesh.Trimesh(vertices, pair.source.faces, process=False)
        panels.append(Panel(mesh, error_colours(away), f"{NAMES[job.method]}  {figures}"))
    panels.append(Panel(pair.target, _BODY, "target"))
    centred = [p.mesh.copy() for p in panels]
    for mesh in centred:  # bodies stand beside each other, feet on one ground
        low, high = mesh.bounds
        mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    return [Panel(m, p.color, p.label) for m, p in zip(centred, panels, strict=True)]


def error_colours(distances: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) colours of distances (n,) as parts of the body's height."""
    return _map()(np.sqrt(np.clip(distances / LARGEST_SHOWN, 0.0, 1.0)))[:, :3]


def _map():
    from matplotlib.colors import LinearSegmentedColormap

    colours = (_BODY, "#f2d27a", "#e8853a", "#b4302b", "#4f0d2c")
    return LinearSegmentedColormap.from_list("errors", colours)


def _colour_bar(figure: Figure, axes: Axes) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import PowerNorm

    percent = 100 * LARGEST_SHOWN
    mappable = ScalarMappable(PowerNorm(0.5, 0.0, percent), _map())
    bar = figure.colorbar(
        mappable, ax=axes, orientation="horizontal", shrink=0.4, aspect=50, pad=0.01,
        extend="max", ticks=[0, 0.05, 0.2, 0.5, 1, 2],
    )  # fmt: skip
    bar.ax.set_xticklabels(["0", "0.05", "0.2", "0.5", "1", "2"])
    bar.set_label(
        "distance of a vertex to its target, % of the body's height; labels: vertex / gradient "
        "error x 1000", fontsize=8,
    )  # fmt: skip
    bar.ax.tick_params(labelsize=8)


def _stacked(rows: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Rows of pictures under each other, filled up with white on the right."""
    width = max(row.shape[1] for row in rows)
    filled = [
        np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0)), constant_values=255)
        for row in rows
    ]
    return np.concatenate(filled)


def _median_curve(
    traces: Sequence[Sequence[Sequence[float]]], column: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Seconds, and the median over the pairs of the best error so far."""
    end = float(np.median([trace[-1][0] for trace in traces]))
    start = max(1e-3, float(np.median([trace[1][0] for trace in traces])))
    seconds = np.geomspace(start, max(end, 1.01 * start), 60)
    curves = []
    for trace in traces:
        steps = np.array(trace)
        best = np.minimum.accumulate(steps[:, column])
        where = np.searchsorted(steps[:, 0], seconds, side="right") - 1
        curves.append(best[np.clip(where, 0, len(best) - 1)])
    return seconds, np.median(curves, axis=0)


def _figure(size: tuple[float, float], dpi: int = 110) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained", dpi=dpi)
    FigureCanvasAgg(figure)
    return figure


def _plain(axes: Axes) -> None:
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _save(figure: Figure, path: Path, dpi: int = 110) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, format="png", dpi=dpi, metadata={"Software": None})
