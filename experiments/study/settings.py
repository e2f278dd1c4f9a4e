"""Options that the experiments share, and where what they found is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from experiments.study.results import DOCUMENT, RESULTS, write_results, write_tables
from implicit_warp.files import atomic_write


@dataclass(frozen=True, kw_only=True)
class Study:
    """Options of every experiment."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    """Folder for records, results, tables and pictures."""
    bodies: str = "anny"
    """anny, figure or small-figure."""
    pair_seed: int = 2026
    """Of the pairs. The options of `fit` were chosen on pairs of seed 1."""
    seed: int = 0
    """Of the methods."""
    measuring: bool = True
    """Fit or time what is missing; without it, what is on disk is reported."""
    pictures: bool = True
    """Draw pictures as well."""
    keep: bool = False
    """Also write experiments/results and the tables of experiments/README.md."""

    @property
    def records(self) -> Path:
        """The folder of the records."""
        return self.out / "records"

    @property
    def folders(self) -> Sequence[Path]:
        """Where results and pictures go."""
        return [self.out, RESULTS] if self.keep else [self.out]

    def write(self, name: str, found: Mapping[str, Any], tables: Mapping[str, str]) -> None:
        """Results as JSON, their tables as Markdown, and both into the repository if asked for."""
        for folder in self.folders:
            write_results(folder / f"{name}.json", found)
        with atomic_write(self.out / f"{name}.md") as temporary:
            temporary.write_text("\n\n".join(tables.values()) + "\n", encoding="utf-8")
        if self.keep:
            write_tables(DOCUMENT, tables)


@dataclass(frozen=True, kw_only=True)
class StudyOfPairs(Study):
    """Options of the experiments that fit pairs one by one."""

    steps: int = 1000
    """Of a TutteNet's fit, where nothing else is said."""
    workers: int = 1
    """Processes, one thread each."""

    @property
    def processes(self) -> int:
        """How many processes fit what is missing; none if it is to be left out."""
        return self.workers if self.measuring else 0
