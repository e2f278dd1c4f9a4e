"""Networks and the hash encoding: starts, values against a plain oracle, derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from fields import HashGrid, InputError, Siren
from fields.neural.hash_grid import Grids, encode, encode_in_torch
from fields.neural.networks import Network

SMALL = HashGrid(levels=3, coarsest=2, finest=9, log2_table=7, width=8, layers=1)
"""Its grids have 27 and 125 vertices, each with a row of its own, and 1000, hashed to 128 rows."""


def _generator(seed: int = 3) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def _slow_features(point, table, architecture):
    """The encoding of one point, vertex by vertex, from the paper's formulas."""
    features, start = [], 0
    for n in architecture.resolutions.tolist():
        rows = min((n + 1) ** 3, 2**architecture.log2_table)
        cell = [min(math.floor(c * n), n - 1) for c in point]
        total = np.zeros(2)
        for corner in np.ndindex(2, 2, 2):
            vertex = [i + step for i, step in zip(cell, corner, strict=True)]
            if rows == (n + 1) ** 3:
                row = vertex[0] + (n + 1) * vertex[1] + (n + 1) ** 2 * vertex[2]
            else:
                x, y, z = (np.uint32(v) for v in vertex)
                with np.errstate(over="ignore"):
                    row = int((x ^ y * np.uint32(2654435761) ^ z * np.uint32(805459861)) % rows)
            weight = math.prod(1 - abs(c * n - v) for c, v in zip(point, vertex, strict=True))
            total += weight * table[start + row]
        features += total.tolist()
        start += rows
    return features


@pytest.mark.parametrize("encoder", [encode, encode_in_torch])
@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float64, 1e-13), (torch.float32, 1e-5)])
def test_features_are_those_of_a_loop_over_vertices(encoder, dtype, tolerance, rng):
    grids = Grids.of(SMALL)
    assert grids.masks.tolist() == [-1, -1, 127]
    table = torch.from_numpy(rng.normal(size=(grids.rows, 2))).to(dtype)
    points = torch.from_numpy(rng.uniform(0, 1, (50, 3))).to(dtype)
    points[:2] = torch.tensor([[0.0, 0.5, 1.0], [1.0, 1.0, 1.0]])  # on walls and vertices
    expected = [_slow_features(p, table.double().numpy(), SMALL) for p in points.tolist()]
    # Positions are counted in up to 9 cells, and table entries are below 4.
    np.testing.assert_allclose(encoder(points, table, grids), expected, atol=tolerance)


@pytest.mark.parametrize("encoder", [encode, encode_in_torch])
def test_first_and_second_derivatives_of_the_encoding(encoder, rng):
    grids = Grids.of(HashGrid(levels=2, coarsest=2, finest=5, log2_table=6))
    table = torch.from_numpy(rng.normal(size=(grids.rows, 2))).requires_grad_()
    # In the middle of cells of both grids: differences must not step over a border.
    cells = torch.from_numpy(rng.integers(0, 5, (3, 3)))
    points = ((cells + torch.tensor([0.3, 0.6, 0.2], dtype=torch.float64)) / 5).requires_grad_()

    def features(points, table):
        return encoder(points, table, grids)

    assert torch.autograd.gradcheck(features, (points, table), fast_mode=True)
    assert torch.autograd.gradgradcheck(features, (points, table), fast_mode=True)


def test_the_kernels_repeat_bit_for_bit(rng):
    grids = Grids.of(SMALL)
    table = torch.from_numpy(rng.normal(size=(grids.rows, 2))).float().requires_grad_()
    points = torch.from_numpy(rng.uniform(0, 1, (5000, 3))).float()
    gradients = []
    for _ in range(2):
        (gradient,) = torch.autograd.grad(encode(points, table, grids).sin().sum(), table)
        gradients.append(gradient)
    assert torch.equal(*gradients)


@pytest.mark.parametrize("architecture", [Siren(6, 2, 4.0), SMALL], ids=["siren", "hash"])
def test_gradients_of_an_eikonal_loss_by_all_parameters(architecture, rng):
    """What training needs: the derivative, by the weights, of the gradient by the points."""
    network = Network(architecture, _generator()).double()
    if network.table is not None:
        network.table.data *= 1e4
    points = torch.from_numpy(rng.uniform(-0.9, 0.9, (5, 3))).requires_grad_()
    names = [name for name, _ in network.named_parameters()]

    def loss(*parameters):
        values = torch.func.functional_call(
            network, dict(zip(names, parameters, strict=True)), (points,)
        )
        (gradient,) = torch.autograd.grad(values.sum(), points, create_graph=True)
        return (gradient.square().sum(dim=-1).sqrt() - 1).square().mean()

    parameters = tuple(parameter.detach().requires_grad_() for parameter in network.parameters())
    assert torch.autograd.gradcheck(loss, parameters, fast_mode=True)


@torch.no_grad()
def test_a_siren_starts_with_the_same_spread_at_every_depth():
    """Section 3.2 of the paper, a little sharper. Weights are uniform in +- sqrt(6 / n) / w, so at
    the frequency w sums have twice the variance of their inputs. Sines of many turns have 1/2,
    those of normal sums of variance v have (1 - exp(-2 v)) / 2: v goes from 1 to near 0.8."""
    architecture = Siren(width=256, layers=6, frequency=30.0)
    network = Network(architecture, _generator())
    hidden, variance = 2 * torch.rand(4000, 3, generator=_generator()) - 1, 1.0
    layers = list(zip(network.weights, network.biases, strict=True))
    hidden = torch.sin(30 * (hidden @ layers[0][0].T + layers[0][1]))
    assert hidden.var() == pytest.approx(0.5, abs=0.02)
    for weight, bias in layers[1:-1]:
        sums = architecture.frequency * (hidden @ weight.T + bias)
        # Weights are random: the mean of 256 variances scatters by some 1 / sqrt(256) of itself.
        assert sums.var(dim=0).mean() == pytest.approx(variance, rel=0.08)
        assert bias.abs().max() == 0
        hidden, variance = torch.sin(sums), 1 - math.exp(-2 * variance)
    assert network.weights[0].abs().max() <= 1 / 3
    assert network.weights[0].abs().max() > 0.3


def test_seeds_decide_the_start():
    first, same, other = (Network(SMALL, _generator(seed)) for seed in (1, 1, 2))
    assert torch.equal(first.table, same.table)
    assert not torch.equal(first.table, other.table)
    assert first.table.abs().max() <= 1e-4
    assert first.parameter_count == 280 * 2 + (9 * 8 + 8) + (8 + 1)


@pytest.mark.parametrize(
    ("make", "argument"),
    [
        (lambda: Siren(width=0), "width"),
        (lambda: Siren(layers=1.5), "layers"),
        (lambda: Siren(frequency=-1), "frequency"),
        (lambda: HashGrid(coarsest=9, finest=8), "finest"),
        (lambda: HashGrid(log2_table=40), "log2_table"),
        (lambda: HashGrid(levels=True), "levels"),
    ],
)
def test_impossible_sizes_are_refused(make, argument):
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.argument == argument


def test_whole_floats_are_whole_numbers():
    assert Network(Siren(width=4.0, layers=2.0), _generator()).parameter_count == 16 + 20 + 5
    assert isinstance(HashGrid(levels=3.0).levels, int)


def test_one_level_is_the_coarsest():
    assert HashGrid(levels=1, coarsest=7, finest=90).resolutions.tolist() == [7]
