"""Gradients of the Numba back end against the torch reference."""

from __future__ import annotations

import numba
import pytest
import torch

from implicit_warp import numba_gradients, torch_backend
from tests.implicit_warp.registered_maps import random_net

DIRECTIONS = pytest.mark.parametrize("direction", ["forward", "inverse"])
JACOBIAN = pytest.mark.parametrize("jacobian", [False, True], ids=["value", "value and Jacobian"])


def gradients(back_end, direction, dtype, jacobian, seed, *, frames="free", **options):
    """Gradients of a random functional for points and every parameter of a random net."""
    net = random_net(seed, frames=frames, **options)
    generator = torch.Generator().manual_seed(seed)

    def random(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)

    n = 777  # several blocks, the last one not full
    points, pull, pull_jacobian = random(n, 3), random(n, 3), random(n, 3, 3)
    points.requires_grad_()
    image, jac = getattr(back_end, direction)(net.stack(), points, jacobian)
    functional = (image * pull).sum()
    if jacobian:
        functional = functional + (jac * pull_jacobian).sum()
    parameters = dict(net.named_parameters())
    found = torch.autograd.grad(functional, [points, *parameters.values()])
    return dict(zip(["points", *parameters], found, strict=True))


@DIRECTIONS
@JACOBIAN
@pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.float64, 1e-10), (torch.float32, 1e-5)], ids=str
)
def test_gradients_equal_the_reference(direction, jacobian, dtype, tolerance, seed):
    arguments = (direction, dtype, jacobian, seed)
    fast, slow = (gradients(b, *arguments) for b in (numba_gradients, torch_backend))
    assert fast.keys() == {"points", "theta_weights", "theta_boundary", "theta_frames"}
    for name, expected in slow.items():
        error = (fast[name] - expected).norm() / expected.norm()
        assert error < tolerance, f"{name}: relative error {float(error):.3g}"


@DIRECTIONS
def test_gradients_repeat_bit_for_bit_for_any_number_of_threads(direction, seed):
    runs = []
    for threads in {1, numba.config.NUMBA_NUM_THREADS}:
        numba.set_num_threads(threads)
        runs += [gradients(numba_gradients, direction, torch.float32, True, seed) for _ in range(2)]
    for run in runs[1:]:
        assert all(torch.equal(run[name], value) for name, value in runs[0].items())


@DIRECTIONS
@pytest.mark.parametrize("n", [0, 1, 128, 129])
def test_any_number_of_points(direction, n, seed):
    net = random_net(seed, layers=2, resolution=3)
    points = torch.rand(n, 3, dtype=torch.float64)
    results = []
    for back_end in (numba_gradients, torch_backend):
        image, jac = getattr(back_end, direction)(net.stack(), points, True)
        functional = image.sum() + jac.square().sum()
        results.append(torch.autograd.grad(functional, net.theta_weights)[0])
    torch.testing.assert_close(*results, rtol=1e-10, atol=1e-12)


def test_gradients_of_points_alone_leave_the_map_untouched(seed):
    net = random_net(seed).freeze()
    points = torch.rand(10, 3, dtype=torch.float64, requires_grad=True)
    net(points).sum().backward()
    expected = net.jacobian(points.detach()).sum(1)
    torch.testing.assert_close(points.grad, expected, rtol=1e-12, atol=1e-12)


def test_second_derivatives_are_refused_and_left_to_the_reference(seed):
    net = random_net(seed)
    points = torch.rand(5, 3, dtype=torch.float64, requires_grad=True)
    image, _ = numba_gradients.forward(net.stack(), points, False)
    (gradient,) = torch.autograd.grad(image.square().sum(), points, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()
