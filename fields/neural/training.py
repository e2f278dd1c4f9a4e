"""The loop that fits a network: steps, schedule, reviews, and a state that can be put on disk."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from fields.errors import InputError
from fields.neural.options import NeuralOptions

REVIEW = 50
"""Steps between reviews, which look for NaN, keep the best parameters and show progress."""

CHECKPOINT_SECONDS = 10.0
"""Between two checkpoints on disk."""

_ETA = 1e-15
"""Adam's epsilon: table entries that are seldom met have tiny gradients (Mueller et al. 2022)."""

Progress = Callable[[int, int, str], None]
"""Called with (steps done, steps in all, a short text)."""

Terms = dict[str, tuple[Tensor, float]]
"""The terms of a loss by name: value and weight."""

Group = tuple[list[nn.Parameter], float]
"""Parameters, and their learning rate as a fraction of `options.learning_rate`."""


@dataclass
class Record:
    """How far a run has come.

    Attributes:
        step: steps taken.
        seconds: of training so far.
        best_error: the least error at a review.
        history: (step, seconds, error) at each review.
        loss: the terms of the last reviewed step, unweighted.
    """

    step: int = 0
    seconds: float = 0.0
    best_error: float = math.inf
    history: list[tuple[int, float, float]] = field(default_factory=list)
    loss: dict[str, float] = field(default_factory=dict)


class Training:
    """Adam on a sum of terms, with a learning rate that falls exponentially.

    Args:
        groups: what is trained.
        options: steps, seconds, rates and the seed.
        terms: the loss of one step, drawn with the given generator.
        error: what reviews compare, the lower the better.

    Guarantee: without a time limit, the same samples, options and number of threads give the same
    numbers, bit for bit, also if the run was cut in two by `tensors` and `restore`.
    """

    def __init__(
        self,
        groups: list[Group],
        options: NeuralOptions,
        terms: Callable[[torch.Generator], Terms],
        error: Callable[[], float],
    ) -> None:
        self.parameters = [parameter for group, _ in groups for parameter in group]
        self.best = [parameter.detach().clone() for parameter in self.parameters]
        self.record = Record()
        self._options, self._terms, self._error = options, terms, error
        self._generator = torch.Generator().manual_seed(options.seed)
        self._optimizer = torch.optim.Adam(
            [{"params": group, "factor": factor} for group, factor in groups],
            betas=(0.9, 0.99),
            eps=_ETA,
            fused=True,
        )

    def run(self, progress: Progress, checkpoint: Callable[[], None]) -> str:
        """Train to the end and take the best parameters seen; returns the status.

        That is "finished", "out of time", or "interrupted" after Ctrl-C, when the last checkpoint
        stays what it was: the state may be that of half a step.

        Raises:
            InputError: the loss is NaN or infinite.
        """
        try:
            status = self._run(progress, checkpoint)
        except KeyboardInterrupt:
            status = "interrupted"
        self._take(self.best)
        return status

    def _run(self, progress: Progress, checkpoint: Callable[[], None]) -> str:
        record, options = self.record, self._options
        start = time.perf_counter() - record.seconds
        saved, status, loss = record.seconds, "finished", None
        while record.step < options.steps:
            if options.seconds is not None and record.seconds >= options.seconds:
                status = "out of time"
                break
            loss = self._step()
            record.seconds = time.perf_counter() - start
            if record.step % REVIEW == 0:
                self._review(loss, progress)
                if record.seconds - saved > CHECKPOINT_SECONDS:
                    checkpoint()
                    saved = record.seconds
        if loss is not None and record.step % REVIEW:
            self._review(loss, progress)
        checkpoint()
        return status

    def _step(self) -> dict[str, Tensor]:
        for group in self._optimizer.param_groups:
            group["lr"] = self._rate() * group["factor"]
        terms = self._terms(self._generator)
        total = torch.stack([weight * term for term, weight in terms.values()]).sum()
        self._optimizer.zero_grad()
        # Only by what is trained: points need no gradients, though some were given some.
        total.backward(inputs=self.parameters)
        self._optimizer.step()
        self.record.step += 1
        return {name: term.detach() for name, (term, _) in terms.items()}

    def _rate(self) -> float:
        """The learning rate: by steps or by time, whichever is nearer to its end."""
        options, record = self._options, self.record
        done = record.step / options.steps
        if options.seconds is not None:
            done = max(done, record.seconds / options.seconds)
        return options.learning_rate * options.decay ** min(done, 1.0)

    def _review(self, loss: dict[str, Tensor], progress: Progress) -> None:
        record = self.record
        record.loss = {name: float(value) for name, value in loss.items()}
        error = self._error()
        if not math.isfinite(error) or not all(map(math.isfinite, record.loss.values())):
            raise InputError(
                "learning_rate",
                self._options.learning_rate,
                f"the loss became NaN or infinite by step {record.step}",
                "lower it, such as by ten; a checkpoint, if any, holds the last good state",
            )
        if error < record.best_error:
            self.best = [parameter.detach().clone() for parameter in self.parameters]
            record.best_error = error
        record.history.append((record.step, record.seconds, error))
        progress(record.step, self._options.steps, f"error {100 * error:.3f} %")

    def _take(self, values: list[Tensor]) -> None:
        with torch.no_grad():
            for parameter, value in zip(self.parameters, values, strict=True):
                parameter.copy_(value)

    # --- on disk ----------------------------------------------------------------------

    def tensors(self) -> dict[str, Tensor]:
        """The state beside `facts`, by name."""
        result = {"generator": self._generator.get_state()}
        for index, parameter in enumerate(self.parameters):
            moments = self._optimizer.state[parameter]
            result[f"now.{index}"], result[f"best.{index}"] = parameter.detach(), self.best[index]
            for name in ("step", "exp_avg", "exp_avg_sq"):
                result[f"{name}.{index}"] = moments[name]
        return result

    def facts(self) -> dict[str, Any]:
        """The rest of the state, in plain values."""
        return asdict(self.record)

    def restore(self, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
        """Go on from a state; KeyError, TypeError or RuntimeError if it is of another run."""
        indices = range(len(self.parameters))
        self._take([tensors[f"now.{index}"] for index in indices])
        self.best = [
            tensors[f"best.{i}"].to(p).reshape(p.shape) for i, p in enumerate(self.parameters)
        ]
        for index, parameter in enumerate(self.parameters):
            self._optimizer.state[parameter] = {
                name: tensors[f"{name}.{index}"].to(parameter.device)
                for name in ("step", "exp_avg", "exp_avg_sq")
            }
        self._generator.set_state(tensors["generator"])
        facts["history"] = [tuple(row) for row in facts["history"]]
        self.record = Record(**facts)
