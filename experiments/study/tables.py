"""Medians, quartiles and Markdown tables of records; every number in a table comes from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from experiments.study.fitters import NAMES
from experiments.study.paper import ABLATIONS, TABLE_2, PaperRow

Records = Sequence[Mapping[str, Any]]

_ERRORS = ("vertex_error", "gradient_error")


def number(value: float | None, digits: int = 3) -> str:
    """Some significant digits; whole numbers in full; a dash for None."""
    if value is None:
        return "-"
    if float(value).is_integer() and abs(value) < 1e6:
        return f"{value:,.0f}"
    if not math.isfinite(value):
        return f"{value:g}"
    size = math.floor(math.log10(abs(value)))
    if -4 <= size < 6:
        return f"{value:,.{max(0, digits - 1 - size)}f}"
    return f"{value:.{digits - 1}g}"


def quartiles(values: Iterable[float]) -> tuple[float, float, float]:
    """Lower quartile, median and upper quartile."""
    low, middle, high = np.percentile(list(values), [25, 50, 75])
    return float(low), float(middle), float(high)


def spread(records: Records, key: str) -> str:
    """Median and quartiles of a measurement, "0.15 (0.12 to 0.2)"."""
    values = [record[key] for record in records if record[key] is not None]
    if not values:
        return "-"
    low, middle, high = quartiles(values)
    return f"{number(middle)} ({number(low)} to {number(high)})"


def mean(records: Records, key: str) -> float:
    """The mean of a measurement, which is what the paper's table states."""
    return float(np.mean([record[key] for record in records]))


def extreme(records: Records, key: str, of: Callable[[list[float]], float]) -> str:
    """The largest or smallest of a measurement over all records."""
    values = [record[key] for record in records if record[key] is not None]
    return number(of(values), 2) if values else "-"


def by_name(records: Records) -> dict[str, list[Mapping[str, Any]]]:
    """Records of each row, in the order of first appearance."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for record in records:
        groups.setdefault(record["name"], []).append(record)
    return groups


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; the first column to the left, the others to the right."""
    lines = ["| " + " | ".join(headings) + " |", "|---|" + "---:|" * (len(headings) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def accuracy_table(records: Records) -> str:
    """Table 2's columns of fitting: errors times 1000, beside the paper's, and costs."""
    rows = []
    for name, group in by_name(records).items():
        paper = TABLE_2.get(name)
        reached = [record["to_accuracy"] for record in group if record["to_accuracy"] is not None]
        seconds = number(quartiles(reached)[1]) if reached else "never"
        if reached and len(reached) < len(group):
            seconds += f", {len(reached)} of {len(group)}"
        rows.append(
            (
                NAMES.get(name, name),
                str(len(group)),
                number(group[0]["parameters"]),
                _paper_errors(paper),
                spread(group, "vertex_error"),
                spread(group, "gradient_error"),
                " / ".join(number(mean(group, key)) for key in _ERRORS),
                " / ".join(number(max(r[key] for r in group)) for key in _ERRORS),
                "{} ({})".format(
                    *(
                        number(quartiles(r[key] for r in group)[1])
                        for key in ("cpu_seconds", "wall_seconds")
                    )
                ),
                seconds,
                number(quartiles(r["steps"] for r in group)[1]),
            )
        )
    headings = (
        "method", "pairs", "parameters", "paper: vertex / gradient", "vertex", "gradient", "means",
        "worst", "CPU s (wall)", "CPU s to 0.15 / 4.4", "steps",
    )  # fmt: skip
    return markdown(headings, rows)


def soundness_table(records: Records) -> str:
    """Round trips, smallest determinants and self-intersections of all pairs together."""
    rows = []
    for name, group in by_name(records).items():
        contacts = [record["contacts"] for record in group]
        rows.append(
            (
                NAMES.get(name, name),
                extreme(group, "round_trip", max),
                extreme(group, "det_vertices", min),
                extreme(group, "det_box", min),
                f"{sum(c == 0 for c in contacts)} of {len(group)}",
                number(quartiles(contacts)[1]),
                number(max(contacts)),
                extreme(group, "exact_contacts", max),
            )
        )
    headings = (
        "method", "worst round trip / height", "smallest det J, vertices", "in the box",
        "meshes without self-intersection", "pairs of faces: median", "most", "exact image: most",
    )  # fmt: skip
    return markdown(headings, rows)


def ablation_table(records: Records, base: str) -> str:
    """Each variation beside the base: errors, costs, and on how many pairs it is better.

    Args:
        records: of one study; the base's among them.
        base: name of the row that the others differ from in one thing.
    """
    groups = by_name(records)
    losses = {record["index"]: _loss(record) for record in groups[base]}
    rows = []
    for name, group in groups.items():
        beside = [record for record in group if record["index"] in losses]
        better = sum(_loss(record) < losses[record["index"]] for record in beside)
        rows.append(
            (
                name + (" (base)" if name == base else ""),
                "-" if name not in ABLATIONS else "{:g} / {:g}".format(*ABLATIONS[name]),
                spread(group, "vertex_error"),
                spread(group, "gradient_error"),
                number(max(_loss(record) for record in group)),
                "" if name == base else f"{better} of {len(beside)}",
                number(quartiles(r["cpu_seconds"] for r in group)[1]),
                number(quartiles(1e3 * r["cpu_seconds"] / r["steps"] for r in group)[1]),
            )
        )
    headings = (
        "variation", "paper: vertex / gradient", "vertex", "gradient", "worst loss",
        "better than the base", "CPU s", "ms a step",
    )  # fmt: skip
    return markdown(headings, rows)


def _paper_errors(paper: PaperRow | None) -> str:
    return "-" if paper is None else f"{paper.vertex:g} / {paper.gradient:g}"


def _loss(record: Mapping[str, Any]) -> float:
    return record["vertex_error"] + 0.1 * record["gradient_error"]
