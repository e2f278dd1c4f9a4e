"""The command ``implicit-warp bench``."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

from implicit_warp.commands.common import (
    GOOD,
    Common,
    say,
)

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, kw_only=True)
class Bench(Common):
    """Measure the speed goals, each beside the torch reference in the same run.

    Takes three to four minutes on two idle cores. Ratios count: absolute figures depend on the
    machine and its load, which is printed.

    Example: implicit-warp bench --json > bench.json
    """

    json: bool = False
    """Print JSON instead of a table."""
    device: str = "cpu"
    """cpu, or a CUDA device of torch."""
    quick: bool = False
    """Smaller calls and fewer rounds: under half a minute, and noisier."""
    memory_points: int = 10_000_000
    """Points of the call whose memory is measured; 10^8 need 2.4 GB for input and output."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.benchmark import Settings, run_benchmark
        from implicit_warp.progress import progress_bar

        make = Settings.quick if self.quick else Settings
        settings = make(device=self.device, memory_points=self.memory_points)
        with progress_bar("bench") as update:
            report = run_benchmark(settings, update)
        say(json.dumps(report.to_dict(), indent=2) if self.json else report.table())
        return GOOD
