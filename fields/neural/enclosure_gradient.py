"""Rigorous bounds of a network's gradient on boxes, and from them a Lipschitz bound.

Forward differentiation in interval arithmetic, on the intervals that `fields.neural.enclosure`
finds for the sums of each layer. Guarantees as there; partial derivatives are bounded wherever they
exist, which for hash grids and ReLUs is almost everywhere. Over a region, the largest norm of the
gradient is then a Lipschitz bound.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from fields.neural.architecture import Siren
from fields.neural.enclosure import BLOCK, ROUNDING, Interval, sine, sums, widened
from fields.neural.networks import Network

_AT_ONCE = 512
"""Boxes that are cut at a time."""


def enclose_gradient(network: Network, low: Tensor, high: Tensor) -> Interval:
    """Bounds `(n, 3)` of the partial derivatives on boxes with float64 corners `(n, 3)`."""
    with torch.no_grad():
        parts = [
            _block(network, *corners)
            for corners in zip(low.split(BLOCK), high.split(BLOCK), strict=True)
        ]
    return Interval(*(torch.cat(side) for side in zip(*parts, strict=True)))


def _block(network: Network, low: Tensor, high: Tensor) -> Interval:
    gradient = _encoded(network, *widened(low, high))
    last = len(network.weights) - 1
    layers = zip(network.weights, sums(network, low, high), strict=True)
    for depth, (weight, interval) in enumerate(layers):
        gradient = _linear(gradient, weight.double())
        if depth < last:
            gradient = _times(gradient, _derivative(network, interval))
    return Interval(gradient.low.squeeze(2), gradient.high.squeeze(2))


def _encoded(network: Network, low: Tensor, high: Tensor) -> Interval:
    """Of the inputs of the first layer, `(n, 3, m)`: row k by coordinate k of the point."""
    own = torch.eye(3, dtype=torch.float64).expand(len(low), 3, 3)
    if network.grids is None:
        return Interval(own, own)
    from fields.neural.enclosure_kernels import feature_derivatives

    table, resolutions = network.table.detach().double().numpy(), network.grids.resolutions
    least, most = (np.empty((len(low), 3, 2 * len(resolutions))) for _ in range(2))
    corners = ((low + 1) / 2).numpy(), ((high + 1) / 2).numpy()
    feature_derivatives(*corners, table, *network.grids.arrays, least, most)
    # A difference of features of this size loses their digits. Halves, as the cube's edge is 2.
    lost = 16 * ROUNDING * np.abs(table).max() * np.repeat(resolutions, 2)
    return Interval(
        torch.cat([own, torch.from_numpy((least - lost) / 2)], dim=2),
        torch.cat([own, torch.from_numpy((most + lost) / 2)], dim=2),
    )


def _linear(gradient: Interval, weight: Tensor) -> Interval:
    size = torch.maximum(gradient.low.abs(), gradient.high.abs())
    reach = (gradient.high - gradient.low) / 2 + (weight.shape[1] + 4) * ROUNDING * size
    middle, spread = ((gradient.low + gradient.high) / 2) @ weight.T, reach @ weight.abs().T
    return Interval(middle - spread, middle + spread)


def _times(gradient: Interval, factor: Interval) -> Interval:
    products = [side * end.unsqueeze(1) for side in gradient for end in factor]
    return Interval(*torch.stack(products).aminmax(dim=0))


def _derivative(network: Network, interval: Interval) -> Interval:
    """Of the activation, over intervals of the sums that go into it."""
    if not isinstance(network.architecture, Siren):
        return Interval((interval.low > 0).double(), (interval.high >= 0).double())
    frequency, quarter = network.architecture.frequency, math.pi / 2  # cos t = sin(t + quarter)
    ahead = Interval(frequency * interval.low + quarter, frequency * interval.high + quarter)
    image = sine(ahead)[1]
    return Interval(frequency * image.low, frequency * image.high)


def lipschitz_bound(network: Network, boxes: int) -> float:
    """A rigorous bound on the norm of the network's gradient over [-1, 1]^3.

    The cube is cut into boxes, those with the largest bounds again and again, until so many boxes
    have been looked at.
    """
    edge = torch.linspace(-1, 1, 9, dtype=torch.float64)
    low = torch.cartesian_prod(edge[:-1], edge[:-1], edge[:-1])
    high = low + 0.25
    norm = _norms(network, low, high)
    eighths = torch.cartesian_prod(*[torch.tensor([0.0, 0.5], dtype=torch.float64)] * 3)
    for _ in range(0, boxes, 8 * _AT_ONCE):
        worst = norm.topk(min(len(norm), _AT_ONCE)).indices
        edges = (high - low)[worst]
        new_low = (low[worst][:, None] + eighths * edges[:, None]).reshape(-1, 3)
        new_high = new_low + (edges / 2).repeat_interleave(8, dim=0)
        new_norm = _norms(network, new_low, new_high)
        new_norm = torch.minimum(new_norm, norm[worst].repeat_interleave(8))
        others = torch.ones(len(norm), dtype=torch.bool)
        others[worst] = False
        low, high = torch.cat([low[others], new_low]), torch.cat([high[others], new_high])
        norm = torch.cat([norm[others], new_norm])
    return float(norm.max())


def _norms(network: Network, low: Tensor, high: Tensor) -> Tensor:
    bounds = enclose_gradient(network, low, high)
    return torch.maximum(bounds.low.abs(), bounds.high.abs()).norm(dim=-1)
