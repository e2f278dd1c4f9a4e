"""Small sums over cells and points, with gradients, for the optimisation step (CPU).

Each stands beside a plain torch formula that means the same and serves other devices; these exist
because a step makes them from a dozen operations on small arrays, which cost more than the
traversal itself.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import prange
from torch import Tensor

from fields.jit import kernel, parallel_kernel
from implicit_warp.square_mesh import SquareMesh, rest_forms


def tabulate(embeddings: Tensor, mesh: SquareMesh, dtype: torch.dtype) -> Tensor:
    """(K, C, 6) affine maps of every cell, rest to image; `LayerStack.tables` in one pass.

    The map of a cell is the sum over its corners of (image corner) x (rest coordinate), so the
    table is a constant linear function of the embedding, and its gradient the transpose.

    Args:
        embeddings: (K, V, 2) float64 on the CPU.
        mesh: the rest mesh.
        dtype: of the result.
    """
    return _Tabulate.apply(embeddings, mesh, dtype)


class _Tabulate(torch.autograd.Function):
    @staticmethod
    def forward(ctx, embeddings: Tensor, mesh: SquareMesh, dtype: torch.dtype) -> Tensor:
        ctx.mesh, ctx.count = mesh, len(embeddings)
        u = np.ascontiguousarray(embeddings.detach().numpy())
        tables = torch.empty(len(u), mesh.n_cells, 6, dtype=dtype)
        _tabulate(u, mesh.cells, rest_forms(mesh), tables.numpy())
        return tables

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):
        mesh = ctx.mesh
        into = np.zeros((ctx.count, len(mesh.vertices), 2))
        g = np.ascontiguousarray(grad.numpy())
        _tabulate_adjoint(g, mesh.cells, rest_forms(mesh), into)
        return torch.from_numpy(into), None, None


@kernel
def _tabulate(u, cells, forms, tables):
    last = u.shape[1]  # the virtual vertex at the origin, where every cone begins
    for k in range(len(u)):
        for c in range(len(cells)):
            a00 = a01 = a10 = a11 = d0 = d1 = 0.0
            for j in range(3):
                v = cells[c, j]
                if v < last:
                    x, y = u[k, v, 0], u[k, v, 1]
                    a00 += x * forms[c, j, 0]
                    a01 += x * forms[c, j, 1]
                    a10 += y * forms[c, j, 0]
                    a11 += y * forms[c, j, 1]
                    d0 += x * forms[c, j, 2]
                    d1 += y * forms[c, j, 2]
            tables[k, c, 0] = a00
            tables[k, c, 1] = a01
            tables[k, c, 2] = a10
            tables[k, c, 3] = a11
            tables[k, c, 4] = d0
            tables[k, c, 5] = d1


@kernel
def _tabulate_adjoint(grad, cells, forms, into):
    last = into.shape[1]
    for k in range(len(grad)):
        for c in range(len(cells)):
            g = grad[k, c]
            for j in range(3):
                v = cells[c, j]
                if v < last:
                    f0, f1, f2 = forms[c, j, 0], forms[c, j, 1], forms[c, j, 2]
                    into[k, v, 0] += g[0] * f0 + g[1] * f1 + g[4] * f2
                    into[k, v, 1] += g[2] * f0 + g[3] * f1 + g[5] * f2


def green_energy(jacobians: Tensor) -> Tensor:
    """|| J^T J - I ||^2 of (n, 3, 3) Jacobians, shape (n,); `energy.elastic_energy` in one pass."""
    return _GreenEnergy.apply(jacobians)


class _GreenEnergy(torch.autograd.Function):
    @staticmethod
    def forward(ctx, jacobians: Tensor) -> Tensor:
        j = np.ascontiguousarray(jacobians.detach().numpy())
        energy, slope = np.empty(len(j), j.dtype), np.empty_like(j)
        _green_energy(j, energy, slope)
        ctx.slope = torch.from_numpy(slope)
        return torch.from_numpy(energy)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):
        return ctx.slope * grad[:, None, None]


@parallel_kernel
def _green_energy(jacobians, energy, slope):
    """The energy and its gradient 4 J (J^T J - I), point by point."""
    for i in prange(len(jacobians)):
        a = jacobians[i]
        s00 = a[0, 0] * a[0, 0] + a[1, 0] * a[1, 0] + a[2, 0] * a[2, 0] - 1
        s11 = a[0, 1] * a[0, 1] + a[1, 1] * a[1, 1] + a[2, 1] * a[2, 1] - 1
        s22 = a[0, 2] * a[0, 2] + a[1, 2] * a[1, 2] + a[2, 2] * a[2, 2] - 1
        s01 = a[0, 0] * a[0, 1] + a[1, 0] * a[1, 1] + a[2, 0] * a[2, 1]
        s02 = a[0, 0] * a[0, 2] + a[1, 0] * a[1, 2] + a[2, 0] * a[2, 2]
        s12 = a[0, 1] * a[0, 2] + a[1, 1] * a[1, 2] + a[2, 1] * a[2, 2]
        diagonal = s00 * s00 + s11 * s11 + s22 * s22
        energy[i] = diagonal + 2 * (s01 * s01 + s02 * s02 + s12 * s12)
        for r in range(3):
            p, q, t = a[r, 0], a[r, 1], a[r, 2]
            slope[i, r, 0] = 4 * (p * s00 + q * s01 + t * s02)
            slope[i, r, 1] = 4 * (p * s01 + q * s11 + t * s12)
            slope[i, r, 2] = 4 * (p * s02 + q * s12 + t * s22)


def mean_layer_energy(embeddings: Tensor, mesh: SquareMesh) -> Tensor:
    """`energy.layer_energy` in one pass, straight from the embeddings (K, V, 2)."""
    return _LayerEnergy.apply(embeddings, mesh)


class _LayerEnergy(torch.autograd.Function):
    @staticmethod
    def forward(ctx, embeddings: Tensor, mesh: SquareMesh) -> Tensor:
        u = np.ascontiguousarray(embeddings.detach().numpy())
        slope = np.zeros_like(u)
        total = _layer_energy(u, mesh.triangles, rest_forms(mesh), slope)
        ctx.slope = torch.from_numpy(slope)
        return torch.tensor(total, dtype=embeddings.dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):
        return ctx.slope * grad, None


@kernel
def _layer_energy(u, triangles, forms, slope):
    """Mean over layers and triangles of || A^T A - I ||^2; its gradient goes into slope."""
    share = 1.0 / (len(u) * len(triangles))
    total = 0.0
    for k in range(len(u)):
        for c in range(len(triangles)):
            a00 = a01 = a10 = a11 = 0.0
            for j in range(3):
                x, y = u[k, triangles[c, j], 0], u[k, triangles[c, j], 1]
                a00 += x * forms[c, j, 0]
                a01 += x * forms[c, j, 1]
                a10 += y * forms[c, j, 0]
                a11 += y * forms[c, j, 1]
            s00, s11 = a00 * a00 + a10 * a10 - 1.0, a01 * a01 + a11 * a11 - 1.0
            s01 = a00 * a01 + a10 * a11
            total += share * (s00 * s00 + s11 * s11 + 2.0 * s01 * s01)
            g00, g01 = a00 * s00 + a01 * s01, a00 * s01 + a01 * s11
            g10, g11 = a10 * s00 + a11 * s01, a10 * s01 + a11 * s11
            for j in range(3):
                f0, f1 = 4.0 * share * forms[c, j, 0], 4.0 * share * forms[c, j, 1]
                slope[k, triangles[c, j], 0] += g00 * f0 + g01 * f1
                slope[k, triangles[c, j], 1] += g10 * f0 + g11 * f1
    return total
