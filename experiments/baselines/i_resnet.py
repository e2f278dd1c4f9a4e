"""i-ResNet (Behrmann et al., 2019): x + g(x), with g of Lipschitz constant below 1.

The positional encoding is part of g.  With each frequency's sine and cosine divided by the
frequency, every pair has a Jacobian of norm 1; all of them and the point itself, over the root of
their number, make an encoding of Lipschitz constant 1 that still holds all frequencies.  Weights
are divided by their exact 2-norm where it is above 1, and the activations (ELU) have slopes of at
most 1.

The exact norms of all weights take longer than the rest of a small step.  So training steps follow
the largest singular vectors by power iteration; whatever is measured or returned (a module in
evaluation) is bounded by the exact norms.
"""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn

from experiments.baselines.method import Fitted
from experiments.baselines.module_map import ModuleMap
from experiments.baselines.training import train

LAYERS, FREQUENCIES, WIDTH = 6, 5, 256

CONTRACTION = 0.97
"""Bound of g's Lipschitz constant."""


class Contraction(nn.Module):
    """g: encoding, two hidden layers, three outputs; Lipschitz constant at most `CONTRACTION`."""

    def __init__(self, width: int) -> None:
        super().__init__()
        sizes = [3 * (1 + 2 * FREQUENCIES), width, width, 3]
        self.linear = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        with torch.no_grad():
            self.linear[-1].weight *= 0.01
            self.linear[-1].bias.zero_()
        self.register_buffer("frequencies", math.pi * 2.0 ** torch.arange(FREQUENCIES))
        self._vectors: list[Tensor | None] = [None] * len(self.linear)

    def encoded(self, points: Tensor) -> Tensor:
        """(n, 33) of Lipschitz constant 1."""
        waves = points[:, :, None] * self.frequencies
        both = torch.cat([waves.sin(), waves.cos()], -1) / torch.cat([self.frequencies] * 2)
        whole = torch.cat([points, both.flatten(1)], 1)
        return whole / math.sqrt(1 + FREQUENCIES)

    def forward(self, points: Tensor) -> Tensor:
        """(n, 3)."""
        x = self.encoded(points)
        for index, layer in enumerate(self.linear):
            x = nn.functional.elu(x) if index else x
            x = nn.functional.linear(x, self._bounded(index), layer.bias)
        return CONTRACTION * x

    def _bounded(self, index: int) -> Tensor:
        """The weight, bounded exactly, or nearly so in training."""
        weight = self.linear[index].weight
        left = self._vectors[index]
        if not self.training:
            return bounded(weight)
        with torch.no_grad():
            left = leading(weight) if left is None else followed(weight, left)
        self._vectors[index] = left
        return bounded(weight, left)


def leading(weight: Tensor) -> Tensor:
    """The singular vector of the largest singular value, on the shorter side, in float64."""
    small = _wide(weight).double()
    return torch.linalg.eigh(small @ small.T)[1][:, -1]


def followed(weight: Tensor, left: Tensor, times: int = 3) -> Tensor:
    """An estimate of `leading` from that of a weight close by."""
    small = _wide(weight)
    left = left.to(weight.dtype)
    for _ in range(times):
        left = small @ (small.T @ left)
        left = left / left.norm().clamp(min=torch.finfo(weight.dtype).tiny)
    return left


def _wide(weight: Tensor) -> Tensor:
    return weight if weight.shape[0] <= weight.shape[1] else weight.T


def bounded(weight: Tensor, left: Tensor | None = None) -> Tensor:
    """A matrix, divided by its 2-norm if that is above 1.

    Args:
        weight: the matrix.
        left: a unit vector that stands for `leading(weight)`; exact if left out.
    """
    small = _wide(weight)
    with torch.no_grad():
        left = leading(weight) if left is None else left
        right = small.to(left.dtype).T @ left
        right = (right / right.norm()).to(weight.dtype)
        left = left.to(weight.dtype)
    norm = left @ small @ right  # its derivative by the weight is that of the norm
    # What rounding may have taken from the norm is added.
    return weight / torch.clamp(norm * (1.0 + 8 * torch.finfo(weight.dtype).eps), min=1.0)


class IResNet(nn.Module):
    """Residual layers."""

    def __init__(self, width: int, seed: int) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.layers = nn.ModuleList(Contraction(width) for _ in range(LAYERS))

    def forward(self, points: Tensor) -> Tensor:
        """(n, 3) images."""
        for layer in self.layers:
            points = points + layer(points)
        return points


class IResNetMap(ModuleMap):
    """A fitted i-ResNet; its inverse iterates until a layer's error is below 1e-7."""

    tolerance = 1e-4
    _ERROR, _MOST = 1e-7, 2000

    def _solve(self, points: Tensor) -> Tensor:
        for layer in reversed(self.module.layers):
            points = self._undone(layer, points)
        return points

    def _undone(self, layer: Contraction, points: Tensor) -> Tensor:
        x = points
        if not len(points):
            return x
        for _ in range(self._MOST):
            following = points - layer(x)
            moved = float((following - x).norm(dim=-1).max())
            x = following
            # Banach: the error left is at most c / (1 - c) times the last step.
            if moved * CONTRACTION / (1.0 - CONTRACTION) <= self._ERROR:
                break
        return x


def fit_i_resnet(source, target, faces, *, height, seconds, seed=0, width: int = WIDTH) -> Fitted:
    """The supplement's size."""
    return train(
        IResNet(width, seed), IResNetMap, source, target, faces,
        height=height, seconds=seconds, seed=seed, learning_rate=5e-3, parts=32,
    )  # fmt: skip
