"""Tutte embeddings of the square mesh: parameters -> positive weights and a convex boundary
-> vertex positions, differentiably.

For every interior vertex i, with w_ij > 0 one weight per *directed* edge,

    sum_j w_ij (u_j - u_i) = 0,        u_b = given, on a convex polygon, for boundary vertices b.

With a convex boundary the solution is an embedding (Tutte 1963; Floater 2003), and with directed
weights every piecewise-linear embedding of the mesh into that polygon is reached.  No interior
edge of the square mesh joins two boundary vertices of one side, so corners may well lie on a
common line.

Three solvers, one meaning:

* `solve_dense`: plain torch, any device, differentiable to any order.  The reference.
* `solve_banded`: eliminates the cell centres (each sees only its four corners), which leaves
  (N-2)^2 unknowns with a nine-point stencil, and factors that M-matrix in banded form; the
  backward pass is one transposed solve with the same factors.  CPU, float64, first order.
* `solve_schur`: the same elimination in torch, and a batched dense solve of what is left; for
  accelerators, and wherever the torch back end is asked for.

Guarantee: with exact arithmetic the result is injective for any parameters.  Non-guarantee:
float64 rounding can spoil areas near 1e-16; `Warp` re-checks what it stores.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from implicit_warp.evaluate import forced_back_end
from implicit_warp.square_mesh import SquareMesh, mesh_tensor

WEIGHT_FLOOR = 0.2
"""Smallest directed weight; the largest is 1 - WEIGHT_FLOOR (paper, sec. 3.2)."""

BOUNDARY_FLOOR = 0.1
"""Smallest factor on a boundary angle increment, before normalisation (paper, sec. 3.2)."""


def edge_weights(theta: Tensor, floor: float = WEIGHT_FLOOR) -> Tensor:
    """Unconstrained parameters -> weights in (floor, 1 - floor), 1/2 at theta = 0."""
    return floor + (1.0 - 2.0 * floor) * torch.sigmoid(theta)


def boundary_positions(theta: Tensor, mesh: SquareMesh, floor: float = BOUNDARY_FLOOR) -> Tensor:
    """Unconstrained parameters (..., M) -> boundary vertices (..., M, 2) on the square's outline.

    The angle increments are the rest increments times factors in (floor, 1 - floor), normalised
    to sum to 2 pi; the direction at each accumulated angle is projected onto the square.  Hence
    theta = 0 is the rest boundary, and the first vertex never moves.

    Every increment stays below pi, so that consecutive vertices span a cone around the origin.
    For N >= 5 the paper's floor already ensures it; on coarser meshes the floor is raised to
    1.05 times the largest rest increment over 2 pi, which is what the bound needs.
    """
    rest = mesh_tensor(mesh, "boundary_increments", theta.dtype, theta.device)
    floor = max(floor, 1.05 * float(mesh.boundary_increments.max()) / (2.0 * math.pi))
    raw = rest * (floor + (1.0 - 2.0 * floor) * torch.sigmoid(theta))
    increments = raw * (2.0 * math.pi / raw.sum(-1, keepdim=True))
    turned = torch.nn.functional.pad(increments.cumsum(-1)[..., :-1], (1, 0))
    angles = turned + float(mesh.boundary_angles[0])
    directions = torch.stack([angles.cos(), angles.sin()], -1)
    return directions / directions.abs().amax(-1, keepdim=True)


def embed(weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
    """Solve for all vertices with the fastest solver that fits the arguments.

    Args:
        weights: (K, E) positive directed weights in the order of `mesh.edges`.
        boundary: (K, M, 2) boundary vertices, convex and counter-clockwise.
        mesh: the square mesh.

    Returns:
        (K, V, 2) vertex positions.
    """
    on_cpu = weights.device.type == "cpu" and weights.dtype == torch.float64
    if on_cpu and forced_back_end() != "torch":
        from implicit_warp.banded import solve_banded

        return solve_banded(weights, boundary, mesh)
    return solve_schur(weights, boundary, mesh)


def solve_dense(weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
    """The embedding by one dense linear solve a layer. Shapes as in `embed`."""
    count, vertices = weights.shape[0], len(mesh.vertices)
    device = weights.device
    source, target = mesh_tensor(mesh, "edges", torch.int64, device).T
    laplacian = weights.new_zeros(count, vertices, vertices)
    laplacian[:, source, target] = -weights
    laplacian = laplacian - torch.diag_embed(laplacian.sum(-1))
    border = mesh_tensor(mesh, "boundary", torch.int64, device)
    is_interior = torch.ones(vertices, dtype=torch.bool, device=device)
    is_interior[border] = False
    interior = is_interior.nonzero().squeeze(-1)
    matrix = laplacian[:, interior[:, None], interior]
    right = -laplacian[:, interior[:, None], border] @ boundary
    inner = _solve_each(matrix, right)
    order = torch.argsort(torch.cat([interior, border]))
    return torch.cat([inner, boundary], 1)[:, order]


def solve_schur(weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
    """The embedding with the centres eliminated first; differentiable. Shapes as in `embed`.

    Half the unknowns of `solve_dense`, hence a quarter of its memory and an eighth of its work.
    """
    device, n = weights.device, mesh.resolution
    inner, border, corners, neighbours = (
        mesh_tensor(mesh, name, torch.int64, device)
        for name in ("inner", "boundary", "centre_corners", "inner_neighbours")
    )
    layers, unknowns = len(weights), len(inner)
    of_centres, of_inner = weights.split([4 * len(corners), 8 * unknowns], 1)
    of_centres = of_centres.unflatten(1, (-1, 4))
    of_centres = of_centres / of_centres.sum(-1, keepdim=True)
    of_inner = of_inner.unflatten(1, (-1, 8))
    of_inner = of_inner / of_inner.sum(-1, keepdim=True)

    # Row g: the share of every grid vertex in g, directly and through g's four centres.
    centres = neighbours[:, 4:] - n * n
    through = of_inner[..., 4:, None] * of_centres[:, centres]
    columns = torch.cat([neighbours[:, :4], corners[centres].flatten(1)], 1)
    flat = (columns + n * n * torch.arange(unknowns, device=device)[:, None]).flatten()
    values = torch.cat([of_inner[..., :4], through.flatten(2)], 2).flatten(1)
    shares = weights.new_zeros(layers, unknowns * n * n).index_add(1, flat, values)
    shares = shares.unflatten(1, (unknowns, n * n))
    matrix = torch.eye(unknowns, dtype=weights.dtype, device=device) - shares[..., inner]
    on_grid = weights.new_zeros(layers, n * n, 2).index_copy(1, border, boundary)
    if unknowns:
        found = _solve_each(matrix, shares[..., border] @ boundary)
        on_grid = on_grid.index_copy(1, inner, found)
    at_centres = (of_centres[..., None] * on_grid[:, corners]).sum(-2)
    return torch.cat([on_grid, at_centres], 1)


def _solve_each(matrix: Tensor, right: Tensor) -> Tensor:
    # On the CPU one by one: batched dense LU with several threads was seen to hang there.
    if matrix.device.type == "cpu":
        pairs = zip(matrix, right, strict=True)
        return torch.stack([torch.linalg.solve(m, r) for m, r in pairs])
    return torch.linalg.solve(matrix, right)
