"""The Triton back end against the torch reference.

The same checks run on a CUDA device (`-m gpu`) and, with TRITON_INTERPRET=1, on the CPU under
Triton's interpreter; `test_triton_on_the_cpu` starts the latter in a process of its own, because
Triton reads the variable when it is first imported.
"""

from __future__ import annotations

import itertools
import os

import pytest
import torch

from implicit_warp import torch_backend
from implicit_warp.errors import InputError
from implicit_warp.evaluate import back_end
from tests.implicit_warp.registered_maps import random_net, random_warp
from tests.implicit_warp.test_layers import special_points

pytest.importorskip("triton", reason="no Triton on this platform")

INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
DEVICE = "cpu" if INTERPRETED else "cuda"
N = 300 if INTERPRETED else 100_000

pytestmark = [] if INTERPRETED else [pytest.mark.gpu]

DIRECTIONS = pytest.mark.parametrize("direction", ["forward", "inverse"])
RESOLUTIONS = pytest.mark.parametrize("resolution", [2, 3, 11])
DTYPES = pytest.mark.parametrize("dtype", [torch.float64, torch.float32], ids=str)


@pytest.fixture
def triton_backend(monkeypatch):
    from implicit_warp import triton_backend

    if INTERPRETED:
        monkeypatch.setattr(triton_backend, "GUESS_GRID", 16)  # 128 takes a second a layer
    return triton_backend


def random_points(seed: int, n: int = N, dtype=torch.float64) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    points = 4.0 * torch.rand(n, 3, generator=generator, dtype=torch.float64) - 2.0
    return points.to(DEVICE, dtype)


def random_stack(seed: int, **options):
    return random_net(seed, **{"layers": 3, **options}).to(DEVICE).stack()


def condition(stack) -> float:
    """Bound on how much all layers together, both ways, amplify an error."""
    product = 1.0
    for tables in (stack.tables, stack.inverse_tables):
        linear = tables[..., :4].unflatten(-1, (2, 2))
        layers = torch.linalg.matrix_norm(linear, 2).amax(1).clamp(min=1.0)
        product *= float(layers.prod())
    return product


def one_layer_specials(seed: int, resolution: int):
    """A single layer, and points on and within one unit in the last place of all its creases."""
    stack = random_stack(seed, layers=1, resolution=resolution, frames="triplane")
    rest = torch.tensor(special_points(random_net(seed, resolution=resolution).mesh))
    rest = torch.cat([rest, torch.full((len(rest), 1), 0.3, dtype=rest.dtype)], 1).to(DEVICE)
    return stack, rest


@torch.no_grad()
@DIRECTIONS
@RESOLUTIONS
def test_points_on_edges_vertices_rays_and_far_outside(triton_backend, direction, resolution, seed):
    stack, points = one_layer_specials(seed, resolution)
    if direction == "inverse":
        points = torch_backend.forward(stack, points, False)[0]
    points = torch.cat([torch.nextafter(points, points + s) for s in (-1.0, 0.0, 1.0)])
    fast, _ = getattr(triton_backend, direction)(stack, points, False)
    slow, _ = getattr(torch_backend, direction)(stack, points, False)
    # Either cell at a crease will do.  Each location is right to a few roundings of the pulled
    # back point, and what a wrong neighbour does to that is amplified once there and once back.
    size = 1.0 + points.norm(dim=1)
    tolerance = 64 * torch.finfo(torch.float64).eps * size * condition(stack)
    assert ((fast - slow).norm(dim=1) <= tolerance).all()


@torch.no_grad()
@DIRECTIONS
@RESOLUTIONS
def test_float64_equals_the_reference(triton_backend, direction, resolution, seed):
    stack, points = random_stack(seed, resolution=resolution), random_points(seed)
    fast = getattr(triton_backend, direction)(stack, points, True)
    slow = getattr(torch_backend, direction)(stack, points, True)
    eps = torch.finfo(torch.float64).eps
    for a, b in zip(fast, slow, strict=True):
        assert float((a - b).abs().max()) <= 64 * eps * condition(stack) * 4.0
    assert torch.equal(fast[0], getattr(triton_backend, direction)(stack, points, False)[0])


@torch.no_grad()
@DIRECTIONS
@RESOLUTIONS
def test_float32_is_as_accurate_as_the_reference(triton_backend, direction, resolution, seed):
    """Neither is exact: both are held against float64."""
    stack, points = random_stack(seed, resolution=resolution), random_points(seed)
    points = points.float().double()
    exact = getattr(torch_backend, direction)(stack, points, False)[0]
    fast, slow = (
        getattr(back, direction)(stack, points.float(), False)[0]
        for back in (triton_backend, torch_backend)
    )
    assert fast.dtype == torch.float32
    errors = [float((result - exact).abs().max()) for result in (fast, slow)]
    # Different orders of the same few operations: alike, but not equal.
    assert errors[0] <= 2.0 * errors[1] + 8 * torch.finfo(torch.float32).eps


@torch.no_grad()
@DIRECTIONS
@pytest.mark.parametrize("n", [0, 1, 7, 255, 256, 257])
def test_any_number_of_points_and_any_strides(triton_backend, direction, n, seed):
    stack, points = random_stack(seed, layers=2, resolution=3), random_points(seed, 300)
    everything = getattr(triton_backend, direction)(stack, points, True)
    scattered = torch.empty(3, n, dtype=points.dtype, device=DEVICE).T
    scattered.copy_(points[:n])
    some = getattr(triton_backend, direction)(stack, scattered, True)
    for a, b in zip(some, everything, strict=True):
        assert torch.equal(a, b[:n])


@torch.no_grad()
@DTYPES
@pytest.mark.parametrize("steps", [0, 3, None], ids=["no walk", "short walk", "walk"])
def test_location_ends_in_the_right_cell_from_any_guess(
    triton_backend, monkeypatch, dtype, steps, seed
):
    """With guesses at random everything walks, and with no steps every cell is tried."""
    stack, points = random_stack(seed, resolution=4, spread=2.0), random_points(seed, dtype=dtype)
    expected = triton_backend.inverse(stack, points, False)[0]
    guesses = triton_backend._location(stack, dtype).guesses
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randint(stack.mesh.n_cells, guesses.shape, generator=generator)
    guesses.copy_(noise.to(guesses))
    if steps is not None:
        monkeypatch.setattr(triton_backend, "_steps", lambda mesh: steps)
    found = triton_backend.inverse(stack, points, False)[0]
    tolerance = 64 * torch.finfo(dtype).eps * condition(stack)
    assert float((found - expected).abs().max()) <= tolerance
    slow = torch_backend.inverse(stack, points, False)[0]
    assert float((found - slow).abs().max()) <= tolerance


@torch.no_grad()
@DIRECTIONS
@DTYPES
def test_both_ways_to_gather_give_the_same_bits(
    triton_backend, monkeypatch, direction, dtype, seed
):
    stack, points = random_stack(seed, resolution=11), random_points(seed, dtype=dtype)
    cached = getattr(triton_backend, direction)(stack, points, True)
    monkeypatch.setattr(triton_backend, "_LARGEST_SHARED", 512)
    shared = getattr(triton_backend, direction)(stack, points, True)
    assert all(torch.equal(a, b) for a, b in zip(cached, shared, strict=True))


def gradients(back_end, direction, dtype, jacobian, seed, **options):
    """Gradients of a random functional for points and every parameter of a random net."""
    net = random_net(seed, **{"layers": 2, "resolution": 3, "frames": "free", **options}).to(DEVICE)
    points = random_points(seed, dtype=dtype).requires_grad_()
    pull = random_points(seed + 1, dtype=dtype)
    image, jac = getattr(back_end, direction)(net.stack(), points, jacobian)
    functional = (image * pull).sum()
    if jacobian:
        functional = functional + (jac * pull[:, None] * points.detach()[:, :, None]).sum()
    names, parameters = zip(*net.named_parameters(), strict=True)
    found = torch.autograd.grad(functional, [points, *parameters])
    return dict(zip(["points", *names], found, strict=True))


@DIRECTIONS
@pytest.mark.parametrize("jacobian", [False, True], ids=["value", "value and Jacobian"])
@pytest.mark.parametrize(
    ("dtype", "tolerance"), [(torch.float64, 1e-10), (torch.float32, 1e-5)], ids=str
)
def test_gradients_equal_the_reference(
    triton_backend, monkeypatch, direction, jacobian, dtype, tolerance, seed
):
    if INTERPRETED:
        monkeypatch.setattr(triton_backend, "_CHUNK", 256)  # two chunks, the last not full
    arguments = (direction, dtype, jacobian, seed)
    fast, slow = (gradients(b, *arguments) for b in (triton_backend, torch_backend))
    assert fast.keys() == {"points", "theta_weights", "theta_boundary", "theta_frames"}
    for name, expected in slow.items():
        error = float((fast[name] - expected).norm() / expected.norm())
        assert error < tolerance, f"{name}: relative error {error:.3g}"


def test_gradients_at_the_usual_resolution(triton_backend, seed):
    options = {"layers": 1, "resolution": 11}
    arguments = ("inverse", torch.float64, True, seed)
    fast, slow = (gradients(b, *arguments, **options) for b in (triton_backend, torch_backend))
    for name, expected in slow.items():
        assert float((fast[name] - expected).norm() / expected.norm()) < 1e-10, name


@DIRECTIONS
def test_gradients_repeat_bit_for_bit(triton_backend, direction, seed):
    first, *others = (
        gradients(triton_backend, direction, torch.float32, True, seed) for _ in range(2)
    )
    for run, name in itertools.product(others, first):
        assert torch.equal(run[name], first[name]), name


def test_gradients_of_no_points_are_zero(triton_backend, seed):
    net = random_net(seed, layers=2, resolution=3).to(DEVICE)
    image, jacobian = triton_backend.forward(net.stack(), random_points(seed, 0), True)
    (image.sum() + jacobian.sum()).backward()
    assert float(net.theta_weights.grad.abs().max()) == 0.0


def test_gradients_of_points_alone_leave_the_map_untouched(triton_backend, seed):
    stack = random_warp(seed, layers=2, resolution=3).to(DEVICE).stack
    points = random_points(seed).requires_grad_()
    image, jacobian = triton_backend.forward(stack, points, True)
    (image.sum() + jacobian.sum()).backward()
    torch.testing.assert_close(points.grad, jacobian.detach().sum(1), rtol=1e-12, atol=1e-12)


def test_second_derivatives_are_refused(triton_backend, seed):
    stack = random_stack(seed, layers=1, resolution=2)
    points = random_points(seed, 5).requires_grad_()
    image, _ = triton_backend.forward(stack, points, False)
    (gradient,) = torch.autograd.grad(image.square().sum(), points, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        gradient.sum().backward()


@torch.no_grad()
def test_maps_use_it_when_told_to(triton_backend, seed):
    warp, points = random_warp(seed, layers=2, resolution=3).to(DEVICE), random_points(seed)
    with back_end("triton"):
        image = warp(points)
        assert float((warp.inv(image) - points).abs().max()) < 1e-10
        with pytest.raises(InputError, match="the triton back end serves"):
            warp(points.half())
    with back_end("torch"):
        torch.testing.assert_close(warp(points), image, rtol=1e-12, atol=1e-12)
