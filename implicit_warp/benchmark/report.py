"""Results of the benchmark: rows, the machine they were taken on, and their printed forms."""

from __future__ import annotations

import datetime
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import torch

import implicit_warp
from implicit_warp.benchmark.settings import Settings


@dataclass(frozen=True)
class Row:
    """One measured quantity.

    Attributes:
        key: short name that stays the same between versions.
        what: for people.
        unit: of value, best, goal and reference.
        value: the median.
        best: the best round.
        more_is_better: True for rates, False for times and sizes.
        goal: None where there is none on this device.
        reference: the same quantity of the torch reference, or as the note says; None if left out.
        note: how value or reference came about, if it needs saying.
    """

    key: str
    what: str
    unit: str
    value: float
    best: float
    more_is_better: bool
    goal: float | None = None
    reference: float | None = None
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Does the median reach the goal? None without a goal."""
        if self.goal is None:
            return None
        return self.value >= self.goal if self.more_is_better else self.value <= self.goal

    @property
    def ratio(self) -> float | None:
        """How many times better than the reference; None if there is none, or it is zero."""
        if not self.reference or not self.value:
            return None
        better, worse = (self.value, self.reference)[:: 1 if self.more_is_better else -1]
        return better / worse


@dataclass(frozen=True)
class Machine:
    """Where and when the figures were taken.

    Attributes:
        date: ISO day.
        cpu, gpu: names; gpu is empty on the CPU.
        cores: that this process may use.
        threads: of the kernels.
        wait_policy: OMP_WAIT_POLICY. Unless it is PASSIVE, waiting threads spin, and on a busy
            machine they keep the working ones off the cores.
        load_before, load_after: one-minute load averages; NaN where the system has none.
        versions: of python and of the libraries that matter.
        seed: of the random map and points.
    """

    date: str
    cpu: str
    gpu: str
    cores: int
    threads: int
    wait_policy: str
    load_before: float
    load_after: float
    versions: Mapping[str, str]
    seed: int

    @classmethod
    def here(cls, settings: Settings, load_before: float) -> Machine:
        """This machine, now."""
        cuda = settings.device != "cpu"
        return cls(
            date=datetime.date.today().isoformat(),
            cpu=cpu_name(),
            gpu=torch.cuda.get_device_name(settings.device) if cuda else "",
            cores=usable_cores(),
            threads=settings.thread_count(),
            wait_policy=os.environ.get("OMP_WAIT_POLICY", "not set"),
            load_before=load_before,
            load_after=load_average(),
            versions={
                "python": platform.python_version(),
                "torch": torch.__version__,
                "numba": version("numba"),
                "implicit_warp": implicit_warp.__version__,
            },
            seed=settings.seed,
        )

    def __str__(self) -> str:
        on = f"{self.gpu}, {self.cpu}" if self.gpu else self.cpu
        versions = ", ".join(f"{name} {text}" for name, text in self.versions.items())
        return (
            f"{on}, {self.cores} cores, {self.threads} threads (OMP_WAIT_POLICY "
            f"{self.wait_policy}), load average {self.load_before:.1f} before and "
            f"{self.load_after:.1f} after; {versions}; seed {self.seed}; {self.date}"
        )


@dataclass(frozen=True)
class Report:
    """All rows of one run."""

    machine: Machine
    settings: Settings
    rows: Sequence[Row]

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: the data, and each row's ratio and whether it met its goal."""
        rows = [{**asdict(row), "ratio": row.ratio, "met": row.met} for row in self.rows]
        return {"machine": asdict(self.machine), "settings": asdict(self.settings), "rows": rows}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Report:
        """The inverse of `to_dict`."""
        derived = ("ratio", "met")
        rows = [Row(**{k: v for k, v in row.items() if k not in derived}) for row in values["rows"]]
        settings = dict(values["settings"])
        settings["solve_resolutions"] = tuple(settings["solve_resolutions"])
        return cls(Machine(**values["machine"]), Settings(**settings), rows)

    def table(self) -> str:
        """For a terminal."""
        cells = [HEADINGS, *(_cells(row) for row in self.rows)]
        widths = [max(len(row[i]) for row in cells) for i in range(len(HEADINGS))]
        lines = [
            "  ".join(
                cell.ljust(w) if i in (0, len(HEADINGS) - 1) else cell.rjust(w)
                for i, (cell, w) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in cells
        ]
        rule = "-" * max(map(len, lines))
        return "\n".join([str(self.machine), "", lines[0], rule, *lines[1:], "", LEGEND])

    def markdown(self) -> str:
        """For docs/benchmarks.md."""
        lines = [
            "| " + " | ".join(HEADINGS) + " |",
            "|---|" + "---:|" * (len(HEADINGS) - 2) + "---|",
        ]
        lines += ["| " + " | ".join(_cells(row)) + " |" for row in self.rows]
        return "\n".join([f"{self.machine}.", "", *lines, "", LEGEND])


HEADINGS = ("what", "median", "best", "goal", "reference", "ratio", "note")

LEGEND = (
    "Goals marked * were missed by the median. The reference is the torch back end in the same "
    "run, unless the note says otherwise; the ratio says how many times better the median is."
)


def _cells(row: Row) -> tuple[str, ...]:
    sign = ">=" if row.more_is_better else "<="
    goal = "" if row.goal is None else f"{sign} {number(row.goal)}{'' if row.met else ' *'}"
    return (
        f"{row.what}, {row.unit}",
        number(row.value),
        number(row.best),
        goal,
        "" if row.reference is None else number(row.reference),
        "" if row.ratio is None else f"x {number(row.ratio)}",
        row.note,
    )


def number(value: float) -> str:
    """Three significant digits, without exponents."""
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:,.{min(digits, 6)}f}"


def cpu_name() -> str:
    """The processor's name as the system tells it."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.partition(":")[2].strip() for line in lines if "model name" in line]
    except OSError:
        names = []
    return names[0] if names else platform.processor() or platform.machine()


def usable_cores() -> int:
    """The cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_average() -> float:
    """Runnable processes over the last minute, NaN where the system does not say."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return math.nan
