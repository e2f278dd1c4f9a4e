"""The package on a CUDA device: everything that lives on one side and is used on the other."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
import implicit_warp as iw
from implicit_warp import evaluate
from implicit_warp.warp import Warp
from tests.implicit_warp.registered_maps import random_net, random_warp

pytestmark = pytest.mark.gpu


def random_points(seed: int, n: int = 10_000) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 4.0 * torch.rand(n, 3, generator=generator, dtype=torch.float64) - 2.0


def test_triton_is_chosen_by_itself():
    pytest.importorskip("triton")
    assert evaluate._choose(torch.zeros(1, 3, device="cuda")).__name__.endswith("triton_backend")


@torch.no_grad()
def test_embeddings_equal_those_of_the_cpu(seed):
    net = random_net(seed)
    expected = net.embeddings()
    torch.testing.assert_close(net.to("cuda").embeddings().cpu(), expected, rtol=0, atol=1e-12)


def test_gradients_of_embeddings_equal_those_of_the_cpu(seed):
    found = []
    for device in ("cpu", "cuda"):
        net = random_net(seed).to(device)
        net.embeddings().square().sum().backward()
        found.append(net.theta_weights.grad.cpu())
    torch.testing.assert_close(*found, rtol=1e-10, atol=1e-12)


@torch.no_grad()
def test_a_million_points_agree_with_the_cpu(seed):
    warp, points = random_warp(seed, layers=24, resolution=11), random_points(seed, 1_000_000)
    there = warp.to("cuda")
    for here, beside in ((warp, there), (warp.inv, there.inv)):
        image, jacobian = here.call_and_jacobian(points)
        other, other_jacobian = beside.call_and_jacobian(points.cuda())
        # 24 random layers amplify a rounding by up to about 1e5.
        assert float((other.cpu() - image).abs().max()) < 1e-9
        # A point within rounding of a crease may take the Jacobian of either side.
        differs = (other_jacobian.cpu() - jacobian).abs().amax((1, 2)) > 1e-8
        assert int(differs.sum()) < 10


@torch.no_grad()
def test_a_map_is_evaluated_where_its_points_are(seed):
    warp, points = random_warp(seed), random_points(seed)
    expected = warp(points)
    for map_ in (warp, warp.to("cuda")):
        for given in (points, points.cuda()):
            image = map_(given)
            assert image.device == given.device
            torch.testing.assert_close(image.cpu(), expected, rtol=1e-10, atol=1e-10)
        assert isinstance(map_(points.numpy()), np.ndarray)
    chain = warp.inv @ warp.to("cuda")
    torch.testing.assert_close(chain(points.cuda()), points.cuda(), rtol=1e-9, atol=1e-9)


def test_gradients_cross_devices(seed):
    net, points = random_net(seed), random_points(seed, 100)
    found = []
    for given in (points, points.cuda()):
        net.zero_grad()
        net(given).square().sum().backward()
        found.append(net.theta_weights.grad.clone())
    assert found[1].device.type == "cpu"
    torch.testing.assert_close(*found, rtol=1e-9, atol=1e-11)


@torch.no_grad()
def test_a_net_on_the_device_is_frozen_saved_and_loaded(seed, tmp_path):
    net = random_net(seed, frames="free").to("cuda")
    warp = net.freeze()
    assert warp.embeddings.is_cuda
    iw.save(warp, tmp_path / "warp.safetensors")
    points = random_points(seed, 100)
    loaded = iw.load(tmp_path / "warp.safetensors")
    torch.testing.assert_close(loaded(points), warp(points), rtol=0, atol=0)
    assert warp.to("cpu").lipschitz == pytest.approx(warp.lipschitz, rel=1e-12)
    mixed = Warp(warp.embeddings, warp.frames.cpu(), before=torch.eye(3, 4))
    torch.testing.assert_close(mixed(points), warp(points), rtol=0, atol=0)
    assert iw.TutteNet(2, 3, net.frames()).n_layers == 2


def test_fields_are_deformed_by_maps_on_the_device(seed):
    warp = random_warp(seed)
    shape = sdf.sphere(1) & sdf.box(1.5)
    points = random_points(seed, 1000)
    expected = iw.deform(shape, warp)(points)
    there = iw.deform(shape, warp.to("cuda"))
    torch.testing.assert_close(there(points), expected, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(there(points.cuda()).cpu(), expected, rtol=1e-9, atol=1e-9)


def test_an_elastic_solve_on_the_device_reaches_the_loss_of_the_cpu():
    shape = sdf.capsule((0, 0, -1), (0, 0, 1), 0.3)
    handles = [iw.hold(sdf.below(-0.4)), iw.move(sdf.above(0.4), rotate=("z", 30))]
    losses = []
    for device in ("cpu", "cuda"):
        options = iw.ElasticOptions(steps=60, layers=6, resolution=5, samples=2000, device=device)
        warp = iw.elastic(shape, handles, options=options, progress=False)
        assert warp.embeddings.device.type == "cpu"
        losses.append(warp.report.loss["total"])
    # The same draws from the same start; rounding grows along the way.
    assert losses[1] == pytest.approx(losses[0], rel=0.05)
