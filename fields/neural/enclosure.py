"""Rigorous bounds of a network's values on boxes.

Every hidden number is enclosed twice as the layers are passed: in an interval, and in an affine
form

    mid + slope . (x - c)  +- rad       for x in the box with centre c,

which remembers how the number depends on the point, so that what two terms have in common cancels
in their difference. The interval taken is what both allow. (Affine arithmetic for neural shapes:
Sharp and Jacobson, "Spelunking the Deep", ACM ToG 2022.) A sine or ReLU is replaced on its interval
by the line through its ends, with the exact largest deviations from it. Features of the hash grids
are multilinear in each cell, so that their deviations from a line are largest at the box's corners
and where it meets grid planes: all of these are visited.

Guarantee: the bounds hold for exact arithmetic and for evaluation in float64 or float32; rounding
is allowed for, layer by layer (Higham, "Accuracy and Stability of Numerical Algorithms", ch. 3).

Non-guarantee: they are not tight. The overestimate shrinks with the square of the box's size once
the network is nearly linear on it, and on large boxes bounds may say nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from fields.neural.architecture import Siren
from fields.neural.networks import Network

ROUNDING = 2.0**-24
"""Of float32, the coarsest arithmetic that networks are evaluated in."""

BLOCK = 1 << 12
"""Boxes at a time: seven numbers for each of them and each hidden number are kept in float64."""


class Interval(NamedTuple):
    """Lower and upper bounds, of one shape."""

    low: Tensor
    high: Tensor


@dataclass(frozen=True, slots=True)
class Affine:
    """Numbers `(n, m)` on n boxes, as affine forms in the offset from the box's centre.

    Attributes:
        mid: `(n, m)` at the centre.
        slope: `(n, 3, m)`.
        rad: `(n, m)` the deviation allowed, at least 0.
    """

    mid: Tensor
    slope: Tensor
    rad: Tensor

    def interval(self, half: Tensor) -> Interval:
        """The range over boxes of half edges `(n, 3)`."""
        reach = self.rad + (self.slope.abs() * half.unsqueeze(-1)).sum(dim=1)
        return Interval(self.mid - reach, self.mid + reach)


class Line(NamedTuple):
    """activation(z) = slope z + offset +- error, on an interval each."""

    slope: Tensor
    offset: Tensor
    error: Tensor


def enclose(network: Network, low: Tensor, high: Tensor) -> Interval:
    """Bounds `(n,)` of the network's values on boxes with float64 corners `(n, 3)` in [-1, 1]^3."""
    with torch.no_grad():
        parts = [
            list(sums(network, *corners))[-1]
            for corners in zip(low.split(BLOCK), high.split(BLOCK), strict=True)
        ]
    return Interval(*(torch.cat(side).squeeze(1) for side in zip(*parts, strict=True)))


def sums(network: Network, low: Tensor, high: Tensor) -> Iterator[Interval]:
    """The weighted sums of each dense layer, before its activation: bounds `(n, m)`, in turn."""
    low, high = widened(low, high)
    half = (high - low) / 2
    form = _encoded(network, low, high)
    interval = form.interval(half)
    last = len(network.weights) - 1
    for depth, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        form, interval = _linear(form, interval, half, weight.double(), bias.double())
        yield interval
        if depth < last:
            form, interval = _activated(network, form, interval, half)


def widened(low: Tensor, high: Tensor) -> tuple[Tensor, Tensor]:
    """Room for the rounding of points, when they are brought into the cube and counted in cells."""
    return low - 4 * ROUNDING, high + 4 * ROUNDING


def _encoded(network: Network, low: Tensor, high: Tensor) -> Affine:
    """The inputs of the first layer: the point itself, exactly, and the features."""
    centre = (low + high) / 2
    form = Affine(centre, torch.eye(3).double().expand(len(low), 3, 3), torch.zeros_like(centre))
    if network.grids is None:
        return form
    from fields.neural.enclosure_kernels import fit_features

    table = network.table.detach().double().numpy()
    shape = (len(low), 2 * len(network.grids.resolutions))
    mid, rad, slope = np.empty(shape), np.empty(shape), np.empty((shape[0], 3, shape[1]))
    # The grids count from 0 to 1, where a slope is twice that in the cube from -1 to 1.
    corners = ((low + 1) / 2).numpy(), ((high + 1) / 2).numpy()
    fit_features(*corners, table, *network.grids.arrays, mid, slope, rad)
    rad += 16 * ROUNDING * np.abs(table).max()  # fifteen roundings an interpolated feature
    return Affine(
        torch.cat([form.mid, torch.from_numpy(mid)], dim=1),
        torch.cat([form.slope, torch.from_numpy(slope / 2)], dim=2),
        torch.cat([form.rad, torch.from_numpy(rad)], dim=1),
    )


def _linear(
    form: Affine, interval: Interval, half: Tensor, weight: Tensor, bias: Tensor
) -> tuple[Affine, Interval]:
    """W z + b, with (m + 3) roundings of the sum of absolute values, for m terms."""
    size = torch.maximum(interval.low.abs(), interval.high.abs())
    absolute = weight.abs()
    rounding = (weight.shape[1] + 3) * ROUNDING * (size @ absolute.T + bias.abs())
    result = Affine(
        form.mid @ weight.T + bias,
        form.slope @ weight.T,
        form.rad @ absolute.T + rounding,
    )
    middle = ((interval.low + interval.high) / 2) @ weight.T + bias
    reach = ((interval.high - interval.low) / 2) @ absolute.T + rounding
    return result, _both(result.interval(half), Interval(middle - reach, middle + reach))


def _both(first: Interval, second: Interval) -> Interval:
    low = torch.maximum(first.low, second.low)
    return Interval(low, torch.maximum(low, torch.minimum(first.high, second.high)))


def _activated(
    network: Network, form: Affine, interval: Interval, half: Tensor
) -> tuple[Affine, Interval]:
    if isinstance(network.architecture, Siren):
        frequency = network.architecture.frequency
        line, image = sine(Interval(frequency * interval.low, frequency * interval.high))
        line = Line(line.slope * frequency, line.offset, line.error)
    else:
        line, image = _relu(interval)
    result = Affine(
        line.slope * form.mid + line.offset,
        line.slope.unsqueeze(1) * form.slope,
        line.slope.abs() * form.rad + line.error,
    )
    return result, _both(result.interval(half), image)


def _relu(interval: Interval) -> tuple[Line, Interval]:
    """Between the chord over the interval and its parallel through 0."""
    low, high = interval
    crosses = (low < 0) & (high > 0)
    slope = torch.where(crosses, high / (high - low).clamp_min(1e-300), (low >= 0).double())
    gap = torch.where(crosses, -slope * low / 2, 0.0)
    return Line(slope, gap, gap), Interval(low.clamp_min(0), high.clamp_min(0))


def sine(interval: Interval) -> tuple[Line, Interval]:
    """The chord of the sine, shifted to the middle of its deviations; flat beyond half a turn.

    sin t - slope t is extreme at the ends or where cos t = slope, which intervals of at most half a
    turn hold at most once for either sign of t.
    """
    # A float32 argument is rounded twice, by this much.
    slack = 2 * ROUNDING * torch.maximum(interval.low.abs(), interval.high.abs()) + ROUNDING
    low, high = interval.low - slack, interval.high + slack
    ends = torch.sin(low), torch.sin(high)
    image = Interval(
        torch.where(_meets(low, high, -math.pi / 2), -1.0, torch.minimum(*ends)),
        torch.where(_meets(low, high, math.pi / 2), 1.0, torch.maximum(*ends)),
    )
    narrow = high - low <= math.pi
    slope = torch.where(narrow, ((ends[1] - ends[0]) / (high - low)).clamp(-1, 1), 0.0)
    turning = torch.acos(slope)
    deviations = [ends[0] - slope * low, ends[1] - slope * high]
    for root in (turning, -turning):
        at = root + 2 * math.pi * torch.ceil((low - root) / (2 * math.pi))
        deviations.append(torch.where(at <= high, torch.sin(at) - slope * at, deviations[0]))
    least, most = torch.stack(deviations).aminmax(dim=0)
    least = torch.where(narrow, least, image.low)
    most = torch.where(narrow, most, image.high)
    error = (most - least) / 2 + slope.abs() * slack + 4 * ROUNDING
    return Line(slope, (most + least) / 2, error), Interval(
        image.low - 2 * ROUNDING, image.high + 2 * ROUNDING
    )


def _meets(low: Tensor, high: Tensor, phase: float) -> Tensor:
    """Does [low, high] hold phase + 2 pi k for some whole k?"""
    turn = 2 * math.pi
    return phase + turn * torch.ceil((low - phase) / turn) <= high
