"""Networks that learn a distance: an encoding of the point, then dense layers.

All of it lives in the cube [-1, 1]^3; `fields.neural.leaf` brings it to the user's units.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import final

import torch
from torch import Tensor, nn
from torch.nn import functional

from fields.neural.architecture import Architecture, HashGrid, Siren
from fields.neural.hash_grid import FEATURES, Grids, encode

_TABLE_SPREAD = 1e-4
"""Features start uniform in +- this, as in the paper: nearly nothing, and not symmetric."""


@final
class Network(nn.Module):
    """A scalar function on [-1, 1]^3.

    Attributes:
        architecture: its kind and sizes.
        weights, biases: of the dense layers, `(out, in)` and `(out,)`; the last has one row.
        table: the features of all grids, `(rows, 2)`; None for a `Siren`.
        grids: where they are; None for a `Siren`.
    """

    def __init__(self, architecture: Architecture, generator: torch.Generator | None = None):
        super().__init__()
        self.architecture = architecture
        is_hashed = isinstance(architecture, HashGrid)
        self.grids = Grids.of(architecture) if is_hashed else None
        inputs = 3 + (FEATURES * architecture.levels if is_hashed else 0)
        sizes = [inputs, *[architecture.width] * architecture.layers, 1]
        shapes = list(zip(sizes[1:], sizes[:-1], strict=True))
        self.weights = nn.ParameterList(torch.empty(shape) for shape in shapes)
        self.biases = nn.ParameterList(torch.zeros(rows) for rows, _ in shapes)
        self.table = nn.Parameter(torch.empty(self.grids.rows, FEATURES)) if self.grids else None
        with torch.no_grad():
            self._initialise(generator)

    def _initialise(self, generator: torch.Generator | None) -> None:
        """Sines: the scheme of the SIREN paper, section 3.2. ReLUs: He et al. 2015."""

        def uniform(tensor: Tensor, reach: float) -> None:
            tensor.uniform_(-reach, reach, generator=generator)

        for depth, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            fan_in = weight.shape[1]
            if isinstance(self.architecture, Siren):
                # Weighted sums then have a variance of 0.8 to 1 before every sine but the first,
                # whatever the width and depth; the first has its phases all over a turn.
                frequency = self.architecture.frequency
                uniform(weight, 1 / fan_in if depth == 0 else math.sqrt(6 / fan_in) / frequency)
                uniform(bias, math.pi / frequency if depth == 0 else 0.0)
            else:
                uniform(weight, math.sqrt(6 / fan_in))
        if self.table is not None:
            uniform(self.table, _TABLE_SPREAD)

    @property
    def parameter_count(self) -> int:
        """How many numbers it has learned."""
        return sum(parameter.numel() for parameter in self.parameters())

    @property
    def activation(self) -> Callable[[Tensor], Tensor]:
        """What follows each dense layer but the last."""
        if isinstance(self.architecture, Siren):
            frequency = self.architecture.frequency
            return lambda sums: torch.sin(frequency * sums)
        return functional.relu

    def forward(self, points: Tensor) -> Tensor:
        """Values `(n,)` at points `(n, 3)`, in the dtype and on the device of the weights."""
        return self.through_layers(self.encoded(points), self.biases)

    def encoded(self, points: Tensor) -> Tensor:
        """What the first dense layer sees: the points, and their features after them."""
        if self.grids is None:
            return points
        features = encode((points + 1) / 2, self.table, self.grids)
        return torch.cat([points, features], dim=-1)

    def through_layers(self, hidden: Tensor, biases: list[Tensor] | nn.ParameterList) -> Tensor:
        """The dense layers with the given biases, `(out,)` each or one row a point."""
        last = len(self.weights) - 1
        for depth, (weight, bias) in enumerate(zip(self.weights, biases, strict=True)):
            hidden = functional.linear(hidden, weight) + bias
            if depth < last:
                hidden = self.activation(hidden)
        return hidden.squeeze(-1)
