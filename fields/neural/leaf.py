"""A network as a field: in the user's units, and guarded by the box it was trained in.

A network says nothing true outside the box whose points it has seen, and often claims surfaces
there. So the field of a network n, trained in a box B with the signed distance b to it, is

    f(p) = max( n(c(p)) + |p - c(p)|,  b(p) outside, steepness b(p) inside )

with c(p) the point of B nearest to p: continuous, at least the distance to B outside, and inside
the network itself, as long as that is not below -steepness times the depth in B. A distance to a
shape in B never is, with a steepness of 1. Hence:

bounds
    B: outside, f >= b > 0.
growth
    1: {f <= t} lies within t of B.
lipschitz
    sqrt(L^2 + 1), or the steepness if that is more, for a bound L on the gradient in B: outside,
    n(c(p)) changes only along the sides of B that p is nearest to, and |p - c(p)| only across them.

The distances are part of the expression, so that every evaluator knows them; the network with c is
the leaf.
"""

from __future__ import annotations

import copy
import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fields.expression import Expression, X, Y, Z, call, length, maximum, where_negative
from fields.field import Field, make_field
from fields.neural.architecture import Siren
from fields.neural.enclosure import ROUNDING, enclose
from fields.neural.networks import Network
from fields.notation import History, Opaque
from fields.operations import Body
from fields.oracle import Boxes
from fields.tags import Tags

_BLOCK = 1 << 16
"""Points at a time without gradients: bounds the memory of the hidden layers to some 50 MB."""


class NeuralOracle:
    """A frozen network on a box, as a leaf of the expression graph.

    Args:
        network: on [-1, 1]^3; a copy is kept.
        box: `(2, 3)`, where it was trained; its longest side is stretched to [-1, 1].
        lipschitz: a bound on the norm of its gradient, or None.
        steepness: at least 1; see the module's text.

    Values are in the box's units. Points outside are replaced by the nearest ones of the box.
    Derivatives by the points: of every order for a `Siren`, two for a `HashGrid` on the CPU.
    """

    name = "neural"
    outputs = 1

    def __init__(
        self,
        network: Network,
        box: NDArray[np.float64],
        lipschitz: float | None = None,
        steepness: float = 1.0,
    ) -> None:
        self.network = copy.deepcopy(network).cpu().float().requires_grad_(False)
        self.box = np.array(box, dtype=np.float64)
        self.lipschitz, self.steepness = lipschitz, steepness
        self._centre = self.box.mean(axis=0)
        self._half = float(np.ptp(self.box, axis=0).max()) / 2
        self._copies: dict[tuple[torch.dtype, torch.device], Network] = {}

    def __call__(self, points: Tensor) -> Tensor:
        """Values `(..., 1)` at points `(..., 3)`; half precision is computed in float32."""
        single = points.dtype in (torch.float32, torch.float64)
        dtype = points.dtype if single else torch.float32
        network = self._network(dtype, points.device)
        flat = points.reshape(-1, 3).to(dtype)
        if torch.is_grad_enabled() and points.requires_grad:
            values = self._evaluated(network, flat)
        else:
            values = torch.cat([self._evaluated(network, part) for part in flat.split(_BLOCK)])
        return values.to(points.dtype).reshape(*points.shape[:-1], 1)

    def enclose(self, boxes: Boxes) -> NDArray[np.float64]:
        """By affine and interval arithmetic through the layers, see `fields.neural.enclosure`."""
        inside = (np.clip(boxes, self.box[0], self.box[1]) - self._centre) / self._half
        # Far from the origin, float32 knows neither the box nor its centre to the last digit.
        inside += 3 * ROUNDING * np.abs(self.box).max() / self._half * np.array([[-1.0], [1.0]])
        bounds = enclose(self.network, *torch.from_numpy(inside).unbind(dim=1))
        return np.stack(bounds, axis=-1)[:, None] * self._half

    def _network(self, dtype: torch.dtype, device: torch.device) -> Network:
        if (dtype, device) not in self._copies:
            self._copies[dtype, device] = copy.deepcopy(self.network).to(device, dtype)
        return self._copies[dtype, device]

    def _evaluated(self, network: Network, points: Tensor) -> Tensor:
        low, high, centre = (points.new_tensor(row) for row in (*self.box, self._centre))
        return self._half * network((points.clamp(low, high) - centre) / self._half)


def neural_field(oracle: NeuralOracle, history: History | None = None) -> Field:
    """The field of a network in its box; `repr` shows the history, or what kind it is."""
    known = oracle.lipschitz is not None
    tags = Tags(
        exact=False,
        lipschitz=max(math.hypot(oracle.lipschitz, 1.0), oracle.steepness) if known else None,
        extent=oracle.box,
        growth=1.0,
    )
    return make_field(Body(_guarded(oracle), tags), history or Opaque(summary(oracle.network)))


def neural_leaf(field: Field) -> NeuralOracle | None:
    """The network of a field that `neural_field` made; None for all others."""
    for instruction in field.tape.instructions:
        oracle = instruction.payload
        if isinstance(oracle, NeuralOracle) and _guarded(oracle) is field.expression:
            return oracle
    return None


def _guarded(oracle: NeuralOracle) -> Expression:
    """The formula at the head of this module."""
    (value,) = call(oracle, (X, Y, Z))
    centre, half = oracle.box.mean(axis=0), np.ptp(oracle.box, axis=0) / 2
    offsets = [
        abs(axis - float(c)) - float(h) for axis, c, h in zip((X, Y, Z), centre, half, strict=True)
    ]
    outside, faces = length(*(maximum(offset, 0.0) for offset in offsets)), maximum(*offsets)
    guard = where_negative(-faces, outside, oracle.steepness * faces)
    return maximum(value + outside, guard)


def summary(network: Network) -> str:
    """What kind of network it is, and how large."""
    kind = "SIREN" if isinstance(network.architecture, Siren) else "hash grid"
    return f"neural {kind} of {network.parameter_count} numbers"
