"""What a fit minimises, term by term; `fields.neural.options` has the formulas and weights."""

from __future__ import annotations

import torch
from torch import Tensor

from fields.neural.networks import Network
from fields.neural.options import NeuralOptions
from fields.neural.samples import Samples


def loss_terms(
    network: Network,
    samples: Samples,
    options: NeuralOptions,
    generator: torch.Generator,
    clamp: float | None = None,
) -> dict[str, Tensor]:
    """The terms of one step whose weights are not zero, unweighted, on freshly drawn batches.

    Args:
        network: with values in the cube's units.
        samples: what to draw from.
        options: batch sizes and weights.
        generator: of the draw, on the CPU.
        clamp: `options.clamp` in the cube's units.
    """
    near = round(options.batch * options.near_fraction)
    terms: dict[str, Tensor] = {}
    if options.distance_weight:
        i = _drawn(samples.near, near, generator)
        j = _drawn(samples.box, options.batch - near, generator)
        points = torch.cat([samples.near[i], samples.box[j]])
        distances = torch.cat([samples.near_distances[i], samples.box_distances[j]])
        terms["distance"] = distance_loss(network(points), distances, clamp)
    on_surface = options.surface_weight or options.normal_weight
    in_box = options.eikonal_weight or options.off_surface_weight
    i = _drawn(samples.surface, options.gradient_batch if on_surface else 0, generator)
    j = _drawn(samples.box, options.gradient_batch if in_box else 0, generator)
    if len(i) + len(j) == 0:
        return terms
    points = torch.cat([samples.surface[i], samples.box[j]])
    values, gradient = _values_and_gradient(
        network, points, bool(options.normal_weight or options.eikonal_weight)
    )
    if options.surface_weight:
        terms["surface"] = values[: len(i)].abs().mean()
    if options.normal_weight:
        difference = gradient[: len(i)] - samples.gradients[i]
        terms["normal"] = difference.square().sum(dim=-1).mean()
    if options.eikonal_weight:
        terms["eikonal"] = eikonal_loss(gradient[len(i) :])
    if options.off_surface_weight:
        terms["off_surface"] = torch.exp(-options.sharpness * values[len(i) :].abs()).mean()
    return terms


def distance_loss(values: Tensor, distances: Tensor, clamp: float | None) -> Tensor:
    """Mean absolute difference, clamped if there is a clamp (Park et al. 2019, eq. 4)."""
    if clamp is not None:
        values, distances = values.clamp(-clamp, clamp), distances.clamp(-clamp, clamp)
    return (values - distances).abs().mean()


def eikonal_loss(gradient: Tensor) -> Tensor:
    """Mean squared deviation of the gradient's length from 1 (Gropp et al. 2020)."""
    # The square root of a zero gradient has no derivative; 1e-12 changes no length that matters.
    return ((gradient.square().sum(dim=-1) + 1e-12).sqrt() - 1).square().mean()


def _values_and_gradient(
    network: Network, points: Tensor, with_gradient: bool
) -> tuple[Tensor, Tensor]:
    if not with_gradient:
        return network(points), points.new_empty(0, 3)
    points = points.requires_grad_()
    values = network(points)
    (gradient,) = torch.autograd.grad(values.sum(), points, create_graph=True)
    return values, gradient


def _drawn(points: Tensor, count: int, generator: torch.Generator) -> Tensor:
    return torch.randint(len(points), (count,), generator=generator).to(points.device)
