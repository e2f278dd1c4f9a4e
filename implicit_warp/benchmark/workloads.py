"""The work that is measured: a random map, a mesh to fit, solves."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

import fields
from implicit_warp import embedding
from implicit_warp.benchmark.timing import synchronise
from implicit_warp.elastic_solve import elastic
from implicit_warp.handles import hold, move
from implicit_warp.mesh_gradient import MeshGradient
from implicit_warp.square_mesh import square_mesh
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

SPREAD = 0.5
"""Standard deviation of the random parameters: distinct, but no thin triangles."""

GRADIENT_WEIGHT = 0.1
"""Weight of the mesh gradient in the fitting loss."""


def random_net(layers: int, resolution: int, seed: int) -> TutteNet:
    """A net with cubic frames and normally distributed parameters of moderate size."""
    net = TutteNet(layers, resolution, "cubic", init="paper", seed=seed)
    with torch.no_grad():
        for parameter in net.parameters():
            parameter *= SPREAD
    return net


def random_warp(layers: int, resolution: int, seed: int, device: str) -> Warp:
    """The compiled form of `random_net`."""
    return random_net(layers, resolution, seed).freeze().to(device)


def cube_points(count: int, seed: int, dtype: torch.dtype, device: str) -> Tensor:
    """(n, 3) uniform points of [-1, 1]^3.

    Its corners stick out of the layers' squares, so cones are met as well as triangles.
    """
    generator = torch.Generator(device).manual_seed(seed)
    points = torch.rand(count, 3, generator=generator, dtype=dtype, device=device)
    return points.mul_(2.0).sub_(1.0)


def sphere_mesh(vertices: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed mesh of genus 0 with any number of vertices V: (V, 3) and faces (2 V - 4, 3).

    Points of a golden spiral on a sphere, which are nearly evenly spread, and their convex hull,
    whose faces are oriented outward.  Deterministic.
    """
    from scipy.spatial import ConvexHull

    index = np.arange(vertices) + 0.5
    height = 1.0 - 2.0 * index / vertices
    angle = math.pi * (1.0 + math.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - height**2)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], -1)
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = (points[faces[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * a).sum(-1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points, faces


def fit_step(
    vertices: int, layers: int, resolution: int, seed: int, device: str
) -> Callable[[], float]:
    """One step of fitting a net to a deformed mesh; returns the loss before it.

    Mean squared vertex distance plus a tenth of the mesh gradients', forward, backward and Adam,
    written as a user would write it.  The target is the image under another net.
    """
    positions, faces = sphere_mesh(vertices)
    source = torch.tensor(0.7 * positions, dtype=torch.float32, device=device)
    with torch.no_grad():
        target = random_warp(layers, resolution, seed + 1, device)(source)
    gradient = MeshGradient(source, faces)
    net = TutteNet(layers, resolution, "cubic").to(device)
    optimiser = torch.optim.Adam(net.parameters(), lr=0.01, fused=True)

    def step() -> float:
        image = net(source)
        distance = (image - target).square().sum(-1).mean()
        loss = distance + GRADIENT_WEIGHT * gradient.squared_distance(image, target)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        return float(loss.detach())

    return step


def elastic_step_seconds(
    samples: int, steps: int, layers: int, resolution: int, seed: int, device: str
) -> float:
    """Seconds that `elastic` takes for one step, with the review after so many of them.

    A bar bent by 60 degrees.  The clock runs from the first review to the last one, so that
    sampling the shape and reporting are left out.
    """
    reached = {}

    def record(step: int, _: Warp) -> None:
        synchronise(device)
        reached[step] = time.perf_counter()

    elastic(
        fields.box((1.0, 1.0, 3.0)),
        [
            hold(fields.below(-1.1)),
            move(fields.above(1.1), rotate=("y", 60)),
        ],
        layers=layers,
        resolution=resolution,
        samples=samples,
        steps=steps,
        seed=seed,
        device=device,
        tolerance=0.0,
        progress=False,
        callback=record,
    )
    return (reached[steps] - reached[0]) / steps


def embedding_solve(
    layers: int, resolution: int, seed: int, device: str, *, dense: bool
) -> Callable[[], None]:
    """All layers' embeddings and their adjoint for a random functional of the vertices.

    Args:
        layers, resolution, seed, device: as elsewhere.
        dense: use the reference, one dense LU a layer.
    """
    mesh = square_mesh(resolution)
    generator = torch.Generator().manual_seed(seed)

    def random(*shape: int) -> Tensor:
        values = torch.randn(layers, *shape, generator=generator, dtype=torch.float64)
        return values.to(device)

    weights = embedding.edge_weights(SPREAD * random(mesh.n_edges)).requires_grad_()
    boundary = embedding.boundary_positions(SPREAD * random(mesh.n_cones), mesh).requires_grad_()
    pull = random(len(mesh.vertices), 2)
    solve = embedding.solve_dense if dense else embedding.embed

    def run() -> None:
        torch.autograd.grad(solve(weights, boundary, mesh), [weights, boundary], pull)

    return run
