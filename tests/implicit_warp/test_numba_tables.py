"""The fused sums of the optimisation step against the plain formulas they stand for."""

from __future__ import annotations

import pytest
import torch

from implicit_warp.energy import elastic_energy, layer_energy
from implicit_warp.evaluate import back_end
from implicit_warp.numba_tables import green_energy, mean_layer_energy, tabulate
from tests.implicit_warp.registered_maps import random_net

RESOLUTIONS = pytest.mark.parametrize("resolution", [2, 3, 11])


@RESOLUTIONS
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
def test_tables_equal_the_layer_stacks(resolution, dtype, seed):
    stack = random_net(seed, resolution=resolution).stack()
    fast = tabulate(stack.embeddings, stack.mesh, dtype)
    # The sums have three terms, each of the size of the resolution.
    tolerance = 20.0 * resolution * torch.finfo(dtype).eps
    assert fast.dtype == dtype
    assert (fast - stack.tables).abs().max() < tolerance


@RESOLUTIONS
def test_gradient_of_tables_is_the_transpose(resolution, seed):
    stack = random_net(seed, resolution=resolution).stack()
    direction = torch.randn(stack.tables.shape, dtype=torch.float64)
    results = [
        torch.autograd.grad((t * direction).sum(), stack.embeddings, retain_graph=True)[0]
        for t in (stack.tables, tabulate(stack.embeddings, stack.mesh, torch.float64))
    ]
    torch.testing.assert_close(*results, rtol=1e-11, atol=1e-11)


@RESOLUTIONS
def test_layer_energy_and_its_gradient(resolution, seed):
    results = []
    for name in ("torch", "numba"):
        net = random_net(seed, resolution=resolution)
        with back_end(name):
            energy = layer_energy(net.stack())
        gradients = torch.autograd.grad(energy, list(net.parameters()), allow_unused=True)
        results.append([energy.detach(), *gradients])
    for slow, fast in zip(*results, strict=True):
        torch.testing.assert_close(fast, slow, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("shape", [(50,), (2, 3), (0,), ()])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)
def test_elastic_energy_and_its_gradient_for_any_leading_shape(shape, dtype):
    results = []
    for name in ("torch", "numba"):
        generator = torch.Generator().manual_seed(0)
        j = torch.randn(*shape, 3, 3, generator=generator, dtype=dtype).requires_grad_()
        with back_end(name):
            energy = elastic_energy(j)
        assert energy.shape == shape
        results.append([energy.detach(), *torch.autograd.grad(energy.sum(), j)])
    for slow, fast in zip(*results, strict=True):
        torch.testing.assert_close(fast, slow, rtol=1e4 * torch.finfo(dtype).eps, atol=1e-5)


def test_derivatives_by_finite_differences(seed):
    net = random_net(seed, layers=2, resolution=3)
    u = net.embeddings().detach().requires_grad_()
    j = torch.randn(4, 3, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda u: mean_layer_energy(u, net.mesh), u)
    assert torch.autograd.gradcheck(lambda u: tabulate(u, net.mesh, torch.float64), u)
    assert torch.autograd.gradcheck(green_energy, j)
