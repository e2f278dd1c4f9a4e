"""i-ResNet (Behrmann et al., 2019): x + g(x), with g of Lipschitz constant below 1.

The positional encoding is part of g.  With each frequency's sine and cosine divided by the
frequency, every pair has a Jacobian of norm 1; all of them and the point itself, over the root of
their number, make an encoding of Lipschitz constant 1 that still holds all frequencies.  Weights
are divided by their exact 2-norm where it is above 1, and the activations (ELU) have slopes of at
most 1.
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

    def encoded(self, points: Tensor) -> Tensor:
        """(n, 33) of Lipschitz constant 1."""
        waves = points[:, :, None] * self.frequencies
        both = torch.cat([waves.sin(), waves.cos()], -1) / torch.cat([self.frequencies] * 2)
        whole = torch.cat([points, both.flatten(1)], 1)
        return whole / math.sqrt(1 + FREQUENCIES)

    def forward(self, points: Tensor) -> Tensor:
        """(n, 3)."""
        x = self.encoded(points)
        for layer in self.linear[:-1]:
            x = nn.functional.linear(x, bounded(layer.weight), layer.bias)
            x = nn.functional.elu(x)
        last = self.linear[-1]
        return CONTRACTION * nn.functional.linear(x, bounded(last.weight), last.bias)


def bounded(weight: Tensor) -> Tensor:
    """A matrix, divided by its exact 2-norm if that is above 1."""
    small = weight if weight.shape[0] <= weight.shape[1] else weight.T
    with torch.no_grad():
        gram = small.double() @ small.double().T
        left = torch.linalg.eigh(gram)[1][:, -1]
        right = small.double().T @ left
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
        height=height, seconds=seconds, seed=seed, learning_rate=2e-3, parts=8,
    )  # fmt: skip
