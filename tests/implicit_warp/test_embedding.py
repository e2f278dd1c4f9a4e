"""The Tutte embedding: against a dense solve, and its own laws."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from implicit_warp.banded import solve_banded
from implicit_warp.embedding import (
    boundary_positions,
    edge_weights,
    solve_dense,
    solve_schur,
)
from implicit_warp.errors import InputError
from implicit_warp.layers import LayerStack, fuse_frames
from implicit_warp.orientation import cell_signs
from implicit_warp.square_mesh import square_mesh

RESOLUTIONS = pytest.mark.parametrize("resolution", [2, 3, 4, 5, 11, 17])


def random_parameters(mesh, seed, spread, layers=3):
    generator = torch.Generator().manual_seed(seed)
    sizes = (mesh.n_edges, mesh.n_cones)
    return [
        spread * torch.randn(layers, n, generator=generator, dtype=torch.float64) for n in sizes
    ]


def stack_of(mesh, u):
    return LayerStack(mesh, u, fuse_frames(torch.eye(3, dtype=torch.float64).expand(len(u), 3, 3)))


@RESOLUTIONS
def test_topology_of_the_mesh(resolution):
    mesh, n = square_mesh(resolution), resolution
    assert len(mesh.vertices) == n**2 + (n - 1) ** 2
    assert mesh.n_triangles == 4 * (n - 1) ** 2
    assert mesh.n_cones == 4 * (n - 1)
    # Euler's formula of a disc, with every undirected edge counted once.
    sides = np.concatenate(
        [mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]
    )
    undirected = np.unique(np.sort(sides, 1), axis=0)
    assert len(mesh.vertices) - len(undirected) + mesh.n_triangles == 1
    # The weights' edges are exactly the directed edges that start at an interior vertex.
    both = np.concatenate([undirected, undirected[:, ::-1]])
    expected = both[~np.isin(both[:, 0], mesh.boundary)]
    assert {*map(tuple, mesh.edges)} == {*map(tuple, expected)}
    assert len(mesh.edges) == len(expected)
    # Rest triangles are congruent, so the layer energy is a plain mean.
    p = mesh.vertices[mesh.triangles]
    (a, b), (c, d) = (p[:, 1] - p[:, 0]).T, (p[:, 2] - p[:, 0]).T
    area = a * d - b * c
    np.testing.assert_allclose(area, 2.0 / (n - 1) ** 2, rtol=1e-12)


@RESOLUTIONS
def test_neighbours_share_the_edge_they_are_listed_across(resolution):
    mesh = square_mesh(resolution)
    for cell, corners in enumerate(mesh.cells):
        for k in range(3):
            shared = {corners[(k + 1) % 3], corners[(k + 2) % 3]}
            other = mesh.neighbours[cell, k]
            assert shared <= {*mesh.cells[other]}
            assert cell in mesh.neighbours[other]
            assert other != cell


@RESOLUTIONS
@pytest.mark.parametrize("spread", [0.0, 1.0, 10.0])
def test_all_solvers_agree(resolution, spread, seed):
    mesh = square_mesh(resolution)
    theta_w, theta_b = random_parameters(mesh, seed, spread)
    weights, boundary = edge_weights(theta_w), boundary_positions(theta_b, mesh)
    solvers = (solve_banded, solve_dense, solve_schur)
    banded, dense, schur = (solve(weights, boundary, mesh) for solve in solvers)
    # The matrix is diagonally dominant with condition number O(N^2); positions are below 1.5.
    tolerance = 50.0 * resolution**2 * torch.finfo(torch.float64).eps
    assert (banded - dense).abs().max() < tolerance
    assert (schur - dense).abs().max() < tolerance
    # And both solve the equations they are meant to.
    source, target = torch.tensor(mesh.edges.T)
    pull = weights[..., None] * (banded[:, target] - banded[:, source])
    residual = torch.zeros_like(banded).index_add_(1, source, pull)
    assert residual.abs().max() < tolerance


@RESOLUTIONS
@torch.no_grad()
def test_zero_parameters_are_the_identity(resolution):
    mesh = square_mesh(resolution)
    theta_w, theta_b = random_parameters(mesh, 0, 0.0)
    u = solve_banded(edge_weights(theta_w), boundary_positions(theta_b, mesh), mesh)
    assert (u - torch.tensor(mesh.vertices)).abs().max() < 1e-14


@RESOLUTIONS
@pytest.mark.parametrize("spread", [1.0, 3.0, 1e3])
@torch.no_grad()
def test_all_oriented_areas_are_positive_even_at_the_limits_of_the_weights(
    resolution, spread, seed
):
    mesh = square_mesh(resolution)
    theta_w, theta_b = random_parameters(mesh, seed, spread, layers=20)
    boundary = boundary_positions(theta_b, mesh)
    u = solve_banded(edge_weights(theta_w), boundary, mesh)
    assert (cell_signs(u.numpy(), mesh)[0] > 0).all()
    assert (boundary.abs().amax(-1) - 1.0).abs().max() < 1e-15


@RESOLUTIONS
@torch.no_grad()
def test_every_boundary_increment_stays_below_half_a_turn(resolution):
    mesh = square_mesh(resolution)
    # The worst case: one increment as large as it gets, all others as small as they get.
    theta = torch.full((mesh.n_cones, mesh.n_cones), -1e9, dtype=torch.float64)
    theta.fill_diagonal_(1e9)
    b = boundary_positions(theta, mesh)
    ahead = b.roll(-1, 1)
    assert (b[..., 0] * ahead[..., 1] - b[..., 1] * ahead[..., 0] > 0).all()


@pytest.mark.parametrize("resolution", [3, 5])
@pytest.mark.parametrize("solve", [solve_banded, solve_dense, solve_schur])
def test_gradients_of_weights_and_boundary(resolution, solve, seed):
    mesh = square_mesh(resolution)
    theta = random_parameters(mesh, seed, 1.0, layers=2)
    theta = [t.requires_grad_() for t in theta]
    assert torch.autograd.gradcheck(
        lambda w, b: solve(edge_weights(w), boundary_positions(b, mesh), mesh), theta
    )


@pytest.mark.parametrize("resolution", [4, 11])
def test_adjoint_equals_autograd_through_the_dense_solve(resolution, seed):
    mesh = square_mesh(resolution)
    generator = torch.Generator().manual_seed(seed)
    shape = (3, len(mesh.vertices), 2)
    direction = torch.randn(shape, generator=generator, dtype=torch.float64)
    gradients = []
    for solve in (solve_banded, solve_dense):
        theta = [t.requires_grad_() for t in random_parameters(mesh, seed, 1.0)]
        u = solve(edge_weights(theta[0]), boundary_positions(theta[1], mesh), mesh)
        gradients.append(torch.autograd.grad((u * direction).sum(), theta))
    for banded, dense in zip(*gradients, strict=True):
        torch.testing.assert_close(banded, dense, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("resolution", [1, 0, -3, 2.5, "11"])
def test_bad_resolution_is_named(resolution):
    with pytest.raises(InputError, match=r"resolution = .*at least 2"):
        square_mesh(resolution)
