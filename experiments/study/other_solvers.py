"""Ways of solving a fit that `implicit_warp.fit` does not offer, tried for the table of ideas."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from experiments.baselines import Fitted
from experiments.baselines.training import affine, problem_for
from implicit_warp import FitOptions, TutteNet, Warp, evaluate
from implicit_warp.fitting.problem import FitProblem

NOISE = 0.01
"""Spread of the first parameters, as in `fit`."""

_WARM_UP, _BACK = 20, 0.7
"""Steps in which the rate rises, and factor on it after a relapse; as in `fit`."""


class _Descent:
    """Evaluations of the loss, its gradient in the net's parameters, and the best state so far."""

    def __init__(self, problem: FitProblem, start: float) -> None:
        self.problem, self.start = problem, start
        self.trace: list[tuple[float, float, float]] = []
        self.best: tuple[float, dict[str, Tensor]] = (math.inf, {})

    def loss(self, net: TutteNet) -> tuple[float, Callable[[], None]]:
        """The loss, and what puts its gradient into the parameters."""
        image = evaluate.forward(net.stack(), self.problem.source)
        found, slope = self.problem.errors(image.detach())
        if found["total"] < self.best[0]:
            self.best = (found["total"], {n: t.clone() for n, t in net.state_dict().items()})
        clock = time.process_time() - self.start
        self.trace.append((clock, found["vertex"], found["gradient"]))
        return found["total"], lambda: image.backward(slope)

    def result(self, net: TutteNet, source: NDArray[np.float64]) -> Fitted:
        """The best state, as a map in the user's units."""
        net.load_state_dict(self.best[1])
        whole = affine(self.problem.after) @ net.freeze() @ affine(self.problem.before)
        parameters = sum(p.numel() for p in net.parameters())
        return Fitted(whole(source), whole, parameters, len(self.trace), self.trace)


def fit_by_lbfgs(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    faces: NDArray[np.int64],
    *,
    height: float,
    seconds: float | None,
    seed: int = 0,
    steps: int = 1000,
    memory: int = 20,
) -> Fitted:
    """Quasi-Newton steps over all parameters, with a strong Wolfe search, from the same start.

    Args:
        source, target, faces, height, seed: see `Method`.
        seconds: not used.
        steps: evaluations of the loss and its gradient, each as dear as a step of Adam.
        memory: pairs of differences kept.
    """
    descent = _Descent(problem_for(source, target, faces, height), time.process_time())
    net = _beside_identity(FitOptions().resolution, seed)
    optimiser = torch.optim.LBFGS(
        net.parameters(),
        lr=1.0,
        max_iter=steps,
        max_eval=steps,
        history_size=memory,
        tolerance_grad=0.0,
        tolerance_change=0.0,
        line_search_fn="strong_wolfe",
    )

    def evaluation() -> float:
        optimiser.zero_grad(set_to_none=True)
        loss, differentiate = descent.loss(net)
        differentiate()
        return loss

    optimiser.step(evaluation)
    return descent.result(net, source)


def fit_coarse_to_fine(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    faces: NDArray[np.int64],
    *,
    height: float,
    seconds: float | None,
    seed: int = 0,
    steps: int = 1000,
    coarse: int = 6,
) -> Fitted:
    """Three tenths of the steps on a coarse mesh, then on the fine one, which contains it.

    The refined embedding is met as well as the fine net's weights can: they are bounded, and their
    boundary vertices lie on the square's outline, where the middle of a coarse edge need not.

    Args:
        source, target, faces, height, seed, steps: see `Method`.
        seconds: not used.
        coarse: resolution of the first mesh.
    """
    descent = _Descent(problem_for(source, target, faces, height), time.process_time())
    net = _beside_identity(coarse, seed)
    first = max(1, round(0.3 * steps))
    _adam(net, descent, first, final=0.3)
    net.load_state_dict(descent.best[1])
    fine = refined(net, FitOptions().resolution)
    descent.best = (math.inf, {})
    _adam(fine, descent, max(1, steps - first), final=0.0)
    return descent.result(fine, source)


def refined(net: TutteNet, resolution: int, steps: int = 300) -> TutteNet:
    """A net of higher resolution whose embeddings are close to those of another one."""
    fine = TutteNet(net.n_layers, resolution, "cubic")
    rest = torch.from_numpy(np.array(fine.mesh.vertices))
    flat = torch.cat([rest, torch.zeros(len(rest), 1).double()], -1)
    with torch.no_grad():
        plane = torch.eye(3).double()[None]
        goals = torch.stack([Warp(u[None], plane)(flat)[:, :2] for u in net.embeddings()])
    optimiser = torch.optim.Adam(fine.parameters(), lr=0.1)
    for step in range(steps):
        for group in optimiser.param_groups:
            group["lr"] = 0.1 * 0.5 * (1.0 + math.cos(math.pi * step / steps))
        optimiser.zero_grad(set_to_none=True)
        (fine.embeddings() - goals).square().sum().backward()
        optimiser.step()
    return fine


def _beside_identity(resolution: int, seed: int) -> TutteNet:
    net = TutteNet(FitOptions().layers, resolution, FitOptions().frames)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in net.parameters():
            noise = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
            parameter += NOISE * noise
    return net


def _adam(net: TutteNet, descent: _Descent, steps: int, final: float) -> None:
    """Steps as `fit` takes them; the rate ends at a part of its highest."""
    usual = FitOptions()

    def new_optimiser() -> torch.optim.Adam:
        groups = [{"params": [net.theta_weights], "rate": 1.0}]
        groups.append({"params": [net.theta_boundary], "rate": usual.boundary_rate})
        return torch.optim.Adam(groups, betas=(0.9, usual.memory), fused=True)

    optimiser, relapses, since = new_optimiser(), 0, 0
    for step in range(steps):
        wave = 0.5 * (1.0 + math.cos(math.pi * step / steps))
        fall = max(final + (1.0 - final) * wave, 1e-3)
        rise = min(1.0, (step - since + 1) / _WARM_UP)
        for group in optimiser.param_groups:
            group["lr"] = usual.learning_rate * _BACK**relapses * rise * fall * group["rate"]
        loss, differentiate = descent.loss(net)
        if loss <= usual.relapse * descent.best[0]:
            optimiser.zero_grad(set_to_none=True)
            differentiate()
            optimiser.step()
        else:
            net.load_state_dict(descent.best[1])
            optimiser, relapses, since = new_optimiser(), relapses + 1, step


SOLVERS = {"lbfgs": fit_by_lbfgs, "coarse_to_fine": fit_coarse_to_fine}
"""By the names that variations use."""
