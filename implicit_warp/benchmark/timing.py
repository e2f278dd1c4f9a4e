"""Timing on noisy machines: every contender once a round, and medians over the rounds.

Whatever else the machine does then hits all contenders alike, so that their ratios mean something
where the times themselves do not.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch

Measure = Callable[[], float]
"""Does the work once and returns the seconds it took."""


@dataclass(frozen=True)
class Contender:
    """One way to do a piece of work.

    Attributes:
        measure: does it once and returns the seconds.
        rounds: take part in so many rounds.
    """

    measure: Measure
    rounds: int


@dataclass(frozen=True)
class Timing:
    """Seconds of one contender: the median over its rounds, and the best round."""

    median: float
    best: float


def wall(work: Callable[[], object], device: str) -> Measure:
    """A measure of wall-clock time that waits for the device before and after."""

    def measure() -> float:
        synchronise(device)
        start = time.perf_counter()
        work()
        synchronise(device)
        return time.perf_counter() - start

    return measure


def synchronise(device: str) -> None:
    """Wait until a CUDA device has done what it was asked to; nothing to do on the CPU."""
    if device.startswith("cuda"):
        torch.cuda.synchronize(device)


def race(contenders: Mapping[str, Contender]) -> dict[str, Timing]:
    """Time all contenders in turns; each must have run once before, so that it is compiled."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for turn in range(max(contender.rounds for contender in contenders.values())):
        for name, contender in contenders.items():
            if turn < contender.rounds:
                seconds[name].append(contender.measure())
    return {name: Timing(statistics.median(s), min(s)) for name, s in seconds.items()}
