"""One training loop for all networks: the loss of `fit`, on parts of the mesh, within CPU time.

A step over all 13,000 vertices of a body takes a network of this size a second or more, so steps
are taken over parts: strips of neighbouring faces, so that their vertices are shared, many of
them from all over the body.  The errors in the trace are of the whole mesh.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from experiments.baselines.method import Body, Fitted, Trace
from experiments.baselines.module_map import ModuleMap
from fields.z_order import sorted_in_space
from implicit_warp.affine import Affine
from implicit_warp.alignment import apply_affine
from implicit_warp.fitting.options import FitOptions
from implicit_warp.fitting.problem import PAPER_HEIGHT, FitProblem, correspondence
from implicit_warp.layers import invert_affine
from implicit_warp.mesh_gradient import MeshGradient

STRIP = 64
"""Faces of a strip."""

REVIEWS = 12
"""How often the whole mesh is looked at."""

GRADIENT_WEIGHT = 0.1


def problem_for(source, target, faces, height: float) -> FitProblem:
    """Source, target and loss as `fit` has them, the rigid motion between them taken out."""
    given = correspondence(Body(source, faces), Body(target, faces), None, None)
    return FitProblem(given, FitOptions(height=height, gradient_weight=GRADIENT_WEIGHT))


def errors_of(problem: FitProblem, vertices: NDArray[np.float64]) -> tuple[float, float]:
    """(vertex, gradient) errors times 1000 of deformed vertices (V, 3) in the user's space."""
    image = apply_affine(invert_affine(problem.after), torch.from_numpy(vertices))
    errors, _ = problem.errors(image.to(problem.target))
    return errors["vertex"], errors["gradient"]


class _Part:
    """The loss on some faces and their vertices, as `FitProblem` has it on all."""

    def __init__(self, problem: FitProblem, source, target, faces, scale: float) -> None:
        self.vertices, local = np.unique(faces, return_inverse=True)
        corners = source[self.vertices] * scale
        self._gradient = MeshGradient(corners, local.reshape(-1, 3), weighting="uniform")
        self.source = problem.source[torch.from_numpy(self.vertices)]
        self._target = problem.target[torch.from_numpy(self.vertices)]
        self._metric = problem._metric

    def slope(self, image: Tensor) -> Tensor:
        """The derivative of the loss by the images (n, 3)."""
        d = (image - self._target) @ self._metric.T
        q = d / d.numel() + GRADIENT_WEIGHT * self._gradient.laplacian(d) / 9.0
        return 2000.0 * q @ self._metric


def _parts(problem, source, target, faces, scale, count: int, seed: int) -> list[_Part]:
    """So many parts, with all faces between them."""
    near = sorted_in_space(source[faces].mean(axis=1))
    strips = np.array_split(near, max(count, len(faces) // STRIP))
    order = np.random.default_rng(seed).permutation(len(strips))
    return [
        _Part(problem, source, target, faces[np.concatenate([strips[i] for i in chosen])], scale)
        for chosen in np.array_split(order, count)
    ]


def train(
    module: nn.Module,
    make_map: Callable[[nn.Module], ModuleMap],
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    faces: NDArray[np.int64],
    *,
    height: float,
    seconds: float,
    seed: int,
    learning_rate: float,
    parts: int,
    steps: int = 100_000,
) -> Fitted:
    """Fit a network by Adam, its rate on a half cosine over the time it has; the best state counts.

    Args:
        module: takes points (n, 3) in the unit domain of `fit` to points.  Its errors are those in
            evaluation.
        make_map: of the fitted network.
        source, target, faces, height, seconds, seed: see `Method`.
        learning_rate: at the start.
        parts: that the mesh is divided into, one a step.
        steps: at most so many.
    """
    problem = problem_for(source, target, faces, height)
    pieces = _parts(problem, source, target, faces, PAPER_HEIGHT / height, parts, seed)
    optimiser = torch.optim.Adam(module.parameters(), lr=learning_rate, betas=(0.9, 0.99))
    order = np.random.default_rng(seed + 1)
    start, trace = time.process_time(), []
    best: tuple[float, dict[str, Tensor]] = (math.inf, {})
    step, reviewed, queue = 0, -math.inf, []
    while True:
        done = min(max((time.process_time() - start) / seconds, step / steps), 1.0)
        if done - reviewed >= 1.0 / REVIEWS or done == 1.0:
            best, reviewed = _reviewed(module, problem, best, trace, start), done
        if done == 1.0:
            break
        queue = queue or list(order.permutation(len(pieces)))
        part = pieces[queue.pop()]
        for group in optimiser.param_groups:
            group["lr"] = learning_rate * max(0.5 * (1.0 + math.cos(math.pi * done)), 1e-3)
        image = module(part.source)
        optimiser.zero_grad(set_to_none=True)
        image.backward(part.slope(image.detach()))
        nn.utils.clip_grad_norm_(module.parameters(), 100.0)
        optimiser.step()
        step += 1
    module.load_state_dict(best[1])
    parameters = sum(p.numel() for p in module.parameters())
    whole = affine(problem.after) @ make_map(module) @ affine(problem.before)
    return Fitted(whole(source), whole, parameters, step, trace)


def affine(matrix: Tensor) -> Affine:
    """The affine map of a (3, 4) matrix."""
    return Affine(matrix[:, :3].numpy(), matrix[:, 3].numpy())


@torch.no_grad()
def _reviewed(module, problem: FitProblem, best, trace: Trace, start: float):
    """Enter the errors of the whole mesh into the trace; the better of the two states."""
    module.eval()
    image = module(problem.source)
    module.train()
    errors, _ = problem.errors(image)
    trace.append((time.process_time() - start, errors["vertex"], errors["gradient"]))
    if errors["total"] < best[0]:
        state = {name: value.clone() for name, value in module.state_dict().items()}
        return errors["total"], state
    return best
