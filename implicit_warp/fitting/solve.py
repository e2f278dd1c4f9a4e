"""Fitting one deformation: the injective map that takes one mesh closest to another.

Minimised over the parameters of a TutteNet f (paper, sec. 4.2), for a source mesh with vertices p
and a target with vertices q of the same connectivity,

    mean over vertices and coordinates of (f(p) - q)^2
  + 0.1  mean over faces and the nine entries of (D(f(p)) - D(q))^2,

where D is the mesh's deformation gradient, taken with the source mesh's operator (`MeshGradient`);
it is not the Jacobian of f, so nothing is asked of f off the surface.  Landmarks are further points
with targets; points without faces have the first term only.

Guarantee: the result is injective whatever the optimiser does.  Non-guarantee: the minimum found is
a local one; a target that intersects itself, or passes through what no homeomorphism could, is met
as well as an injective map can; and flat faces between exactly mapped vertices may still intersect
(`deform_mesh` has the exact ways).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from implicit_warp import evaluate
from implicit_warp.fitting.checkpoint import Checkpoint
from implicit_warp.fitting.options import FitOptions
from implicit_warp.fitting.problem import FitProblem, correspondence
from implicit_warp.fitting.report import FitReport
from implicit_warp.progress import progress_bar
from implicit_warp.threads import threads_for_steps
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

_REVIEW = 25
"""Steps between reviews, which keep the best state, write the checkpoint and decide on stopping."""

_WARM_UP = 20
"""Steps in which the learning rate rises, at the start and after a relapse."""

_LOWER = 0.7
"""Factor on the learning rate after a relapse."""

_NOISE = 0.01
"""Spread of the first parameters: at the identity all layers of one frame have the same gradient,
and would move as one."""


def fit(
    source: Any = None,
    target: Any = None,
    *,
    options: FitOptions | None = None,
    landmarks: Any = None,
    vertex_weights: Any = None,
    progress: bool | None = None,
    checkpoint: str | Path | None = None,
    callback: Callable[[int, Warp], None] | None = None,
    **changes: Any,
) -> Warp:
    """Find the injective map that takes the source to the target as closely as it can.

    Args:
        source: a triangle mesh, or points (n, 3); None if there are only landmarks.
        target: a mesh of the same connectivity, or the points (n, 3) that the source's vertices
            should go to.
        options: all options at once; single ones may be given by keyword instead or on top.
        landmarks: (points, their targets), two arrays (m, 3), alone or in addition; they need not
            be vertices.
        vertex_weights: (n,) how much each vertex counts in the vertex term; scaled to mean 1.
        progress: True or False to show a bar or not; None shows it on a terminal.
        checkpoint: a `.safetensors` file, written at every review. If it exists, the fit goes on
            from it, and ends bit for bit where it would have ended without the interruption.
        callback: called with (step, current map) at every review.
        **changes: options by name, see `FitOptions`.

    Returns:
        A `Warp` in the user's own units; ``warp.report`` is the `FitReport`. On Ctrl-C, the best
        map so far, with the report's status "interrupted".

    Raises:
        InputError: options out of range; meshes or points that do not belong together, are empty,
            not finite, or of sizes that speak of different units; faces without area; a checkpoint
            of another fit.
        FileFormatError: a checkpoint that cannot be read.
    """
    options = (options or FitOptions()).with_changes(changes)
    given = correspondence(source, target, landmarks, vertex_weights)
    with (
        # Whatever mode the caller is in, a fit needs gradients.
        torch.inference_mode(False),
        torch.enable_grad(),
        progress_bar("fit", progress) as update,
        threads_for_steps(len(given.source)),
    ):
        saved = None if checkpoint is None else Checkpoint(checkpoint, given, options)
        return _Fit(FitProblem(given, options), saved).run(update, callback)


class _Fit:
    """One fit: the net, its optimiser, and the loop."""

    def __init__(self, problem: FitProblem, saved: Checkpoint | None) -> None:
        self.problem, self.options, self.saved = problem, problem.options, saved
        options = self.options
        net = TutteNet(
            options.layers, options.resolution, options.frames, options.boundary,
            init=options.init, seed=options.seed,
        )  # fmt: skip
        generator = torch.Generator().manual_seed(options.seed)
        with torch.no_grad():
            for parameter in net.parameters():
                noise = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
                parameter += _NOISE * noise
        self.net = net.to(options.device)
        self.optimiser = self._new_optimiser()
        self.step, self.seconds = 0, 0.0
        self.relapses: list[int] = []
        self.history: list[tuple[int, float, float, float | None, float | None]] = []
        self.best: tuple[float, dict[str, Tensor]] | None = None
        if saved is not None:
            saved.restore(self)

    def _new_optimiser(self) -> torch.optim.Adam:
        slow = {"theta_boundary": self.options.boundary_rate}
        groups = [
            {"params": [parameter], "rate": slow.get(name, 1.0)}
            for name, parameter in self.net.named_parameters()
        ]
        return torch.optim.Adam(groups, betas=(0.9, self.options.memory), fused=True)

    def run(self, update, callback) -> Warp:
        """The loop; returns the best state found."""
        start = time.perf_counter() - self.seconds
        status = ""
        try:
            while not status:
                self.seconds = time.perf_counter() - start
                if self.step % _REVIEW == 0 or self.step == self.options.steps:
                    if not self.history or self.history[-1][0] != self.step:  # else just restored
                        self._review()
                        if self.saved is not None:
                            self.saved.write(self)
                    update(self.step, self.options.steps, f"loss {self.history[-1][2]:.4g}")
                    if callback is not None:
                        callback(self.step, self._warp())
                    status = self._reason_to_stop()
                if not status:
                    self._advance()
        except KeyboardInterrupt:
            status = "interrupted"
        self.seconds = time.perf_counter() - start
        if self.best is not None:
            self.net.load_state_dict(self.best[1])
        return self._warp(self._report(status))

    def _advance(self) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = self._rate() * group["rate"]
        image = evaluate.forward(self.net.stack(), self.problem.source)
        errors, slope = self.problem.errors(image.detach())
        most = math.inf if self.options.relapse is None else self.options.relapse * self.best[0]
        if errors["total"] <= most:
            self.optimiser.zero_grad(set_to_none=True)
            image.backward(slope)
            self.optimiser.step()
        else:  # also NaN
            self.net.load_state_dict(self.best[1])
            self.optimiser = self._new_optimiser()
            self.relapses.append(self.step)
        self.step += 1

    def _rate(self) -> float:
        """The learning rate of the next step: a short rise, then down a half cosine, if any."""
        options = self.options
        done = self.step / options.steps
        if options.seconds is not None:
            done = max(done, min(self.seconds / options.seconds, 1.0))
        fall = max(0.5 * (1.0 + math.cos(math.pi * done)), 1e-3)
        if options.schedule == "constant":
            fall = 1.0
        since = self.step - (self.relapses[-1] if self.relapses else 0)
        rise = min(1.0, (since + 1) / _WARM_UP)
        return options.learning_rate * _LOWER ** len(self.relapses) * rise * fall

    @torch.no_grad()
    def _measure(self) -> dict[str, float]:
        return self.problem.errors(evaluate.forward(self.net.stack(), self.problem.source))[0]

    def _review(self) -> None:
        errors = self._measure()
        row = (errors["total"], errors.get("vertex"), errors.get("gradient"))
        self.history.append((self.step, self.seconds, *row))
        if self.best is None or errors["total"] < self.best[0]:
            state = {name: value.clone() for name, value in self.net.state_dict().items()}
            self.best = (errors["total"], state)

    def _reason_to_stop(self) -> str:
        """The status to stop with now, or an empty text to go on."""
        options = self.options
        _, seconds, _, vertex, gradient = self.history[-1]
        goals = [
            (error, goal)
            for error, goal in ((vertex, options.vertex_goal), (gradient, options.gradient_goal))
            if goal is not None and error is not None
        ]
        if goals and all(error <= goal for error, goal in goals):
            return "reached the goals"
        if self._has_converged():
            return "converged"
        if options.seconds is not None and seconds >= options.seconds:
            return "stopped at the time limit"
        return "stopped at the step limit" if self.step >= options.steps else ""

    def _has_converged(self) -> bool:
        window = max(1, self.options.steps // (10 * _REVIEW))
        if self.options.tolerance == 0.0 or len(self.history) <= window:
            return False
        losses = [row[2] for row in self.history]
        return min(losses[-window:]) > (1.0 - self.options.tolerance) * min(losses[:-window])

    def _warp(self, report: FitReport | None = None) -> Warp:
        with torch.no_grad():
            parts = (self.net.embeddings(), self.net.frames())
            affine = (self.problem.before, self.problem.after)
            return Warp(*(part.cpu() for part in parts), *affine, report=report)

    def _report(self, status: str) -> FitReport:
        errors = self._measure()
        return FitReport(
            status=status,
            steps=self.step,
            seconds=self.seconds,
            vertex_error=errors.get("vertex"),
            gradient_error=errors.get("gradient"),
            landmark_error=errors.get("landmark"),
            loss=errors["total"],
            height=self.problem.height,
            history=self.history,
            relapses=self.relapses,
            seed=self.options.seed,
            options=asdict(self.options),
        )
