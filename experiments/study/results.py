"""Compact results that are kept in the repository, and the document's tables made of them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from experiments.record_benchmarks import replace_table
from experiments.study.tables import by_name
from implicit_warp.errors import InputError
from implicit_warp.files import atomic_write

HERE = Path(__file__).resolve().parents[1]
RESULTS, DOCUMENT = HERE / "results", HERE / "README.md"

_KEPT = (
    "name", "index", "pair", "parameters", "steps", "vertex_error", "gradient_error", "cpu_seconds",
    "wall_seconds", "to_accuracy", "round_trip", "det_vertices", "det_box", "contacts",
    "exact_contacts", "exact_faces", "load", "date",
)  # fmt: skip

POINTS_OF_TRACE = 12


def compact(record: Mapping[str, Any], digits: int = 4) -> dict[str, Any]:
    """What is kept of a record: figures to some digits, and a few points of its trace."""
    kept = {key: record[key] for key in _KEPT if key in record}
    trace = record["trace"]
    chosen = np.unique(np.linspace(0, len(trace) - 1, POINTS_OF_TRACE).round().astype(int))
    kept["trace"] = [trace[i] for i in chosen]
    return _rounded(kept, digits)


def machine_of(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Where and when records were taken: processor, torch, days, and the range of the load."""
    loads = [load for record in records for load in record["load"]]
    return {
        "cpu": sorted({record["cpu"] for record in records}),
        "torch": sorted({record["torch"] for record in records}),
        "dates": sorted({record["date"] for record in records}),
        "load": [round(min(loads), 1), round(max(loads), 1)],
        "threads": 1,
    }


def with_rows_of(found: Mapping[str, Any], earlier: Mapping[str, Any]) -> dict[str, Any]:
    """Results with the rows of earlier ones for methods that met more pairs there.

    Raises:
        InputError: the earlier results are of other pairs or budgets.
    """
    settings = found.keys() - {"machine", "records"}
    differing = sorted(key for key in settings if found[key] != earlier.get(key))
    if differing:
        raise InputError(
            "keep",
            {key: found[key] for key in differing},
            f"the results in the repository have {[earlier.get(key) for key in differing]}",
            "use their options, or remove the old results",
        )
    new, old = by_name(found["records"]), by_name(earlier["records"])
    taken = {name for name in old if len(old[name]) > len(new.get(name, []))}
    if not taken:
        return dict(found)
    machine, other = found["machine"], earlier["machine"]
    loads = (*machine["load"], *other["load"])
    lists = {key: sorted({*machine[key], *other[key]}) for key in ("cpu", "torch", "dates")}
    names = dict.fromkeys((*old, *new))
    records = [r for name in names for r in (old if name in taken else new)[name]]
    machine = {**machine, **lists, "load": [min(loads), max(loads)]}
    return {**found, "machine": machine, "records": records}


def write_results(path: Path, found: Mapping[str, Any]) -> None:
    """A JSON file with one record a line, so that changes can be read."""
    records = ",\n".join(json.dumps(record) for record in found["records"])
    head = json.dumps({k: v for k, v in found.items() if k != "records"}, indent=1)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        temporary.write_text(f'{head[:-2]},\n "records": [\n{records}\n]\n}}\n', encoding="utf-8")


def read_results(path: Path) -> dict[str, Any]:
    """What `write_results` wrote."""
    return json.loads(path.read_text(encoding="utf-8"))


def write_tables(document: Path, tables: Mapping[str, str]) -> None:
    """Replace the tables between their marks in a document."""
    text = document.read_text(encoding="utf-8")
    for name, table in tables.items():
        text = replace_table(text, name, table)
    with atomic_write(document) as temporary:
        temporary.write_text(text, encoding="utf-8")


def where_and_when(found: Mapping[str, Any]) -> str:
    """A line that says what the figures were taken on."""
    machine = found["machine"]
    low, high = machine["load"]
    return (
        f"{', '.join(machine['cpu'])}, {machine['threads']} thread, torch "
        f"{', '.join(machine['torch'])}, load average {low} to {high}, "
        f"{' to '.join(dict.fromkeys((machine['dates'][0], machine['dates'][-1])))}; "
        f"pairs {found['pairs']} of {found['bodies']}, seed {found['pair_seed']}."
    )


def _rounded(value: Any, digits: int) -> Any:
    if isinstance(value, float):
        return float(f"{value:.{digits}g}")
    if isinstance(value, list | tuple):
        return [_rounded(part, digits) for part in value]
    if isinstance(value, dict):
        return {key: _rounded(part, digits) for key, part in value.items()}
    return value
