"""Take the figures of docs/benchmarks.md anew.

    python -m experiments.record_benchmarks                 the CPU's table, and the scaling plot
    python -m experiments.record_benchmarks --device cuda   the GPU's table
    python -m experiments.record_benchmarks --report b.json a table from an earlier run

The benchmark runs as ``implicit-warp bench --json`` in a process of its own, as users run it.
Only the text between a table's two marks is replaced.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro

from experiments.scaling import Scaling
from experiments.scaling import run as run_scaling
from implicit_warp.benchmark import Report
from implicit_warp.errors import InputError
from implicit_warp.files import atomic_write

DOCS = Path(__file__).resolve().parents[1] / "docs"


@dataclass(frozen=True, kw_only=True)
class Record:
    """Rewrite a table of docs/benchmarks.md, and the scaling plot with the CPU's."""

    device: str = "cpu"
    """cpu, or a CUDA device of torch."""
    report: Path | None = None
    """Take the table from this output of `implicit-warp bench --json` and measure nothing."""
    docs: Path = DOCS
    """The folder that holds benchmarks.md and pictures/."""


def replace_table(text: str, name: str, table: str) -> str:
    """The text with the block between the marks of that name replaced.

    Raises:
        InputError: the text has no such pair of marks.
    """
    begin, end = f"<!-- table {name} -->\n", f"<!-- end of table {name} -->"
    before, found_begin, rest = text.partition(begin)
    _, found_end, after = rest.partition(end)
    if not (found_begin and found_end):
        raise InputError(
            "name", name, "the document has no marks for this table", f"add {begin.strip()} {end}"
        )
    return f"{before}{begin}\n{table}\n\n{end}{after}"


def run(options: Record) -> None:
    """Measure or read, and rewrite the document."""
    if options.report is None:
        command = [sys.executable, "-m", "implicit_warp.cli", "bench", "--json"]
        output = subprocess.run(
            [*command, "--device", options.device], stdout=subprocess.PIPE, text=True, check=True
        ).stdout
    else:
        output = options.report.read_text(encoding="utf-8")
    report = Report.from_dict(json.loads(output))
    device = report.settings.device.partition(":")[0]
    document = options.docs / "benchmarks.md"
    text = replace_table(document.read_text(encoding="utf-8"), device, report.markdown())
    with atomic_write(document) as temporary:
        temporary.write_text(text, encoding="utf-8")
    if options.report is None and device == "cpu":
        with TemporaryDirectory() as folder:
            run_scaling(Scaling(out=Path(folder)))
            picture = (Path(folder) / "scaling.png").read_bytes()
        with atomic_write(options.docs / "pictures" / "scaling.png") as temporary:
            temporary.write_bytes(picture)


if __name__ == "__main__":
    run(tyro.cli(Record, prog="python -m experiments.record_benchmarks"))
