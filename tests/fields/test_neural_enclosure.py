"""Bounds of networks on boxes: they hold, and they are not idle."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
from fields import HashGrid, Siren
from fields.neural.enclosure import Interval, enclose, sine
from fields.neural.enclosure_gradient import enclose_gradient, lipschitz_bound
from fields.neural.leaf import NeuralOracle, neural_field
from tests.fields.catalogue.neural import tiny_network

NETWORKS = {
    "siren": tiny_network(Siren(16, 2, 10.0)),
    "siren, steep": tiny_network(Siren(24, 3, 40.0)),
    "hash": tiny_network(HashGrid(3, 2, 9, 7, 16, 2)),
    "hash, fine": tiny_network(HashGrid(2, 16, 40, 10, 16, 1)),
}
SIZES = (1.0, 0.1, 0.01, 0.0)
BOXES, POINTS = 150, 100


@pytest.fixture(params=NETWORKS.values(), ids=NETWORKS.keys())
def network(request):
    return request.param


def _boxes(rng, size):
    """Boxes of half edges up to `size`, cut off at the cube; some of them flat."""
    centre = rng.uniform(-1, 1, (BOXES, 3))
    half = rng.uniform(0, size, (BOXES, 3)) * rng.choice([0, 1], (BOXES, 3), p=[0.1, 0.9])
    low, high = (np.clip(centre + sign * half, -1, 1) for sign in (-1, 1))
    return torch.from_numpy(low), torch.from_numpy(high)


def _points_in(low, high, rng):
    """Random points of each box, and its corners."""
    t = torch.from_numpy(rng.uniform(0, 1, (len(low), POINTS, 3)))
    t[:, :8] = torch.cartesian_prod(*[torch.tensor([0.0, 1.0], dtype=torch.float64)] * 3)
    points = low[:, None] + t * (high - low)[:, None]
    return torch.minimum(torch.maximum(points, low[:, None]), high[:, None])


def _values_and_gradients(network, points, dtype):
    network = NeuralOracle(network, [[-1] * 3, [1] * 3])._network(dtype, points.device)
    flat = points.reshape(-1, 3).to(dtype).requires_grad_()
    values = network(flat)
    (gradient,) = torch.autograd.grad(values.sum(), flat)
    shape = points.shape[:2]
    return values.detach().double().reshape(shape), gradient.double().reshape(*shape, 3)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("size", SIZES)
def test_values_and_gradients_lie_within_their_bounds(network, size, dtype, rng):
    low, high = _boxes(rng, size)
    bounds, slopes = enclose(network, low, high), enclose_gradient(network, low, high)
    points = _points_in(low, high, rng)
    values, gradients = _values_and_gradients(network, points, dtype)
    assert (bounds.low[:, None] <= values).all()
    assert (values <= bounds.high[:, None]).all()
    # Next to a grid plane, float32 may take the neighbouring cell: boxes are widened for that.
    assert (slopes.low[:, None] <= gradients).all()
    assert (gradients <= slopes.high[:, None]).all()


def test_bounds_become_sharp_on_small_boxes(network, rng):
    """First order is exact, so that the ratio of widths goes to 1 (and the rest is rounding)."""
    low, high = _boxes(rng, 1e-3)
    values, _ = _values_and_gradients(network, _points_in(low, high, rng), torch.float64)
    bounds = enclose(network, low, high)
    true = values.amax(1) - values.amin(1)
    ratio = ((bounds.high - bounds.low) / true)[true > 1e-4]
    assert ratio.median() < 1.6


@pytest.mark.parametrize("shift", [0.0, 0.7, -200.0, 1e5])
def test_the_line_through_a_sine_and_its_range(shift, rng):
    """Intervals of all widths, around the turning points too, against dense samples."""
    width = np.concatenate([10 ** rng.uniform(-6, 1, 400), np.full(20, np.pi)])
    low = rng.uniform(-4, 4, len(width)) + shift
    interval = Interval(torch.from_numpy(low), torch.from_numpy(low + width))
    line, image = sine(interval)
    t = torch.linspace(0, 1, 400, dtype=torch.float64)
    points = (low + width * t[:, None].numpy()).astype(np.float64)
    values = torch.from_numpy(np.sin(points))
    assert (values >= image.low).all()
    assert (values <= image.high).all()
    deviation = values - line.slope * torch.from_numpy(points) - line.offset
    assert (deviation.abs() <= line.error).all()
    if shift == 0.0:  # within what 400 samples miss, nothing is given away
        narrow = torch.from_numpy(width < 2)
        assert (line.error <= 1.01 * deviation.abs().amax(0) + 1e-5)[narrow].all()


def test_the_lipschitz_bound_is_a_bound_and_falls_with_work(rng):
    network = NETWORKS["siren"]
    points = torch.from_numpy(rng.uniform(-1, 1, (1, 20_000, 3)))
    _, gradients = _values_and_gradients(network, points, torch.float64)
    steepest = float(gradients.norm(dim=-1).max())
    rough, fine = (lipschitz_bound(network, boxes) for boxes in (512, 16_000))
    assert steepest <= fine <= rough
    assert fine < 0.9 * rough
    assert fine < 3 * steepest


def test_an_oracle_encloses_in_its_own_units_wherever_the_box_lies(rng):
    for centre in (0.0, 3_000.0):
        box = np.array([[-2.0, -1.0, -1.0], [2.0, 2.0, 1.0]]) + centre
        oracle = NeuralOracle(NETWORKS["hash"], box)
        corners = rng.uniform(-3, 3, (BOXES, 2, 3)) + centre  # some beyond the box
        boxes = np.sort(corners, axis=1)
        boxes[:50, 1] = boxes[:50, 0] + 1e-3
        bounds = oracle.enclose(boxes)
        assert bounds.shape == (BOXES, 1, 2)
        points = boxes[:, :1] + rng.uniform(0, 1, (BOXES, POINTS, 3)) * np.diff(boxes, axis=1)
        for dtype in (torch.float64, torch.float32):
            given = torch.from_numpy(points).to(dtype)
            inside = ((given >= torch.from_numpy(boxes[:, :1]))
                      & (given <= torch.from_numpy(boxes[:, 1:]))).all(-1).numpy()  # fmt: skip
            values = oracle(given).double().numpy()[..., 0]
            assert ((values >= bounds[:, :1, 0]) & (values <= bounds[:, :1, 1]))[inside].all()


def test_most_boxes_off_a_learned_surface_are_told_apart():
    """What the bounds are for: of boxes an eighth of the shape wide, few are left undecided."""
    learned, _ = sdf.fit_neural(
        sdf.sphere(1), Siren(32, 2, 10.0), steps=250, batch=1024, gradient_batch=128,
        near_samples=5_000, box_samples=5_000,
    )  # fmt: skip
    (oracle,) = {i.payload for i in learned.tape.instructions if i.kind == "call"}
    edges = np.linspace(-1, 1, 17)
    low = np.stack(np.meshgrid(*[edges[:-1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    boxes = np.stack([low, low + 0.125], axis=1)
    bounds = oracle.enclose(boxes)[:, 0]
    undecided = (bounds[:, 0] <= 0) & (bounds[:, 1] >= 0)
    centres, half = low + 0.0625, 0.0625 * np.sqrt(3)
    truly = np.abs(np.linalg.norm(centres, axis=1) - 1) <= half
    assert undecided[truly].mean() > 0.6
    assert undecided.mean() < 2 * truly.mean()


def test_a_field_guards_its_box():
    """A network that is negative all over: the field is still positive outside, and closed."""
    network = tiny_network(Siren(8, 1, 3.0))
    with torch.no_grad():
        network.biases[-1] -= 100.0
    box = np.array([[-1.0, -0.5, -0.25], [1.0, 0.5, 0.25]])
    field = neural_field(NeuralOracle(network, box))
    around = np.random.default_rng(0).uniform(-3, 3, (20_000, 3))
    distance = sdf.box((2, 1, 0.5))(around)
    np.testing.assert_allclose(field(around)[distance > 0], distance[distance > 0], atol=1e-12)
    np.testing.assert_allclose(field(around)[distance <= 0], distance[distance <= 0], atol=1e-12)
    assert field.bounds.tolist() == box.tolist()
    assert not field.exact
    assert field.lipschitz is None
