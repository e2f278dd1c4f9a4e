"""Banded solver of the Tutte system and its adjoint (CPU, float64).

The row-normalised system is u = P u with P_ij = w_ij / sum_j w_ij.  Cell centres are averages of
their four corners, so substituting them leaves one equation per inner grid vertex g,

    (1 - s_gg) u_g - sum_h s_gh u_h = boundary terms,     h among the eight surrounding vertices,

an M-matrix with half-bandwidth N - 1 in the row-major order: LU without pivoting is stable, and
costs O(N^4) where the dense one costs O(N^6).  Each layer is factored by one thread.

Backward: with (I - P)^T mu = dL/du, solved through the same factors,
dL/dw_ij = mu_i . (u_j - u_i) / sum_j w_ij and dL/db = dL/du_b + (P^T mu)_b.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from numba import prange
from torch import Tensor

from fields.jit import parallel_kernel
from implicit_warp.square_mesh import SquareMesh


def solve_banded(weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
    """The embedding and, on backward, its adjoint. Shapes as in `embedding.embed`."""
    return _BandedSolve.apply(weights, boundary, mesh)


class _BandedSolve(torch.autograd.Function):
    @staticmethod
    def forward(ctx, weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
        w = np.ascontiguousarray(weights.detach().numpy())
        n = mesh.resolution
        position = _band_position(mesh)
        u = np.empty((len(w), len(mesh.vertices), 2))
        u[:, mesh.boundary] = boundary.detach().numpy()
        normalised, totals, factors = _factor(
            w, mesh.centre_corners, mesh.inner_neighbours, mesh.inner, position, n
        )
        _substitute(
            normalised, factors, mesh.centre_corners, mesh.inner_neighbours, mesh.inner, position,
            n, u,
        )  # fmt: skip
        ctx.mesh, ctx.saved = mesh, (normalised, totals, factors, u)
        return torch.from_numpy(u)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):
        mesh = ctx.mesh
        normalised, totals, factors, u = ctx.saved
        mu = np.array(grad.numpy(), order="C", copy=True)
        grad_w = _adjoint(
            normalised, totals, factors, mesh.centre_corners, mesh.inner_neighbours, mesh.inner,
            _band_position(mesh), mesh.resolution, u, mu,
        )  # fmt: skip
        return torch.from_numpy(grad_w), torch.from_numpy(mu[:, mesh.boundary]), None


@lru_cache(maxsize=64)
def _band_position(mesh: SquareMesh) -> np.ndarray:
    """(V,) index of each inner grid vertex among the unknowns, -1 for all others."""
    position = np.full(len(mesh.vertices), -1, dtype=np.int64)
    position[mesh.inner] = np.arange(len(mesh.inner))
    return position


@parallel_kernel
def _factor(w, corners, neighbours, inner, position, n):
    """Normalise the weights, eliminate the centres and factor, layer by layer.

    The factors are stored by rows: column j of row i at [i, j - i + half]; the multipliers of L
    replace the entries they eliminate, and the diagonal holds its reciprocal.
    """
    layers, n_centres, n_inner = w.shape[0], corners.shape[0], inner.shape[0]
    half = n - 1
    normalised = np.empty_like(w)
    totals = np.empty((layers, n_centres + n_inner))
    factors = np.zeros((layers, n_inner, 2 * half + 1))
    first = 4 * n_centres
    for k in prange(layers):
        p = normalised[k]
        for c in range(n_centres):
            total = 0.0
            for a in range(4):
                total += w[k, 4 * c + a]
            totals[k, c] = total
            for a in range(4):
                p[4 * c + a] = w[k, 4 * c + a] / total
        m = factors[k]
        for g in range(n_inner):
            total = 0.0
            for a in range(8):
                total += w[k, first + 8 * g + a]
            totals[k, n_centres + g] = total
            m[g, half] += 1.0
            for a in range(8):
                weight = w[k, first + 8 * g + a] / total
                p[first + 8 * g + a] = weight
                v = neighbours[g, a]
                if a < 4:
                    h = position[v]
                    if h >= 0:
                        m[g, h - g + half] -= weight
                else:
                    c = v - n * n
                    for b in range(4):
                        h = position[corners[c, b]]
                        if h >= 0:
                            m[g, h - g + half] -= weight * p[4 * c + b]
        for i in range(n_inner):
            pivot = 1.0 / m[i, half]
            m[i, half] = pivot
            # Slices, so that the inner loop runs from zero over contiguous numbers: with computed
            # indices it was measured not to vectorise.
            row = m[i, half + 1 :]
            for below in range(1, min(half + 1, n_inner - i)):
                factor = m[i + below, half - below] * pivot
                m[i + below, half - below] = factor
                target = m[i + below, half + 1 - below : 2 * half + 1 - below]
                for d in range(half):
                    target[d] -= factor * row[d]
    return normalised, totals, factors


@parallel_kernel
def _substitute(normalised, factors, corners, neighbours, inner, position, n, u):
    """Fill u's inner vertices and centres; its boundary vertices are given."""
    n_centres, n_inner = corners.shape[0], inner.shape[0]
    half, first = n - 1, 4 * n_centres
    for k in prange(u.shape[0]):
        p, m, x = normalised[k], factors[k], u[k]
        for g in range(n_inner):
            sx, sy = 0.0, 0.0
            for a in range(8):
                weight = p[first + 8 * g + a]
                v = neighbours[g, a]
                if a < 4:
                    if position[v] < 0:
                        sx += weight * x[v, 0]
                        sy += weight * x[v, 1]
                else:
                    c = v - n * n
                    for b in range(4):
                        q = corners[c, b]
                        if position[q] < 0:
                            sx += weight * p[4 * c + b] * x[q, 0]
                            sy += weight * p[4 * c + b] * x[q, 1]
            for j in range(max(0, g - half), g):
                factor = m[g, j - g + half]
                sx -= factor * x[inner[j], 0]
                sy -= factor * x[inner[j], 1]
            x[inner[g], 0] = sx
            x[inner[g], 1] = sy
        for i in range(n_inner):
            g = n_inner - 1 - i
            sx, sy = x[inner[g], 0], x[inner[g], 1]
            for j in range(g + 1, min(g + half + 1, n_inner)):
                entry = m[g, j - g + half]
                sx -= entry * x[inner[j], 0]
                sy -= entry * x[inner[j], 1]
            x[inner[g], 0] = sx * m[g, half]
            x[inner[g], 1] = sy * m[g, half]
        for c in range(n_centres):
            sx, sy = 0.0, 0.0
            for b in range(4):
                sx += p[4 * c + b] * x[corners[c, b], 0]
                sy += p[4 * c + b] * x[corners[c, b], 1]
            x[n * n + c, 0] = sx
            x[n * n + c, 1] = sy


@parallel_kernel
def _adjoint(normalised, totals, factors, corners, neighbours, inner, position, n, u, mu):
    """Turn mu from dL/du into the multipliers, in place; return dL/dw.

    On return the boundary rows of mu hold dL/db.
    """
    layers, n_centres, n_inner = u.shape[0], corners.shape[0], inner.shape[0]
    half, first = n - 1, 4 * n_centres
    grad = np.empty_like(normalised)
    for k in prange(layers):
        p, m, x, y = normalised[k], factors[k], u[k], mu[k]
        # Transposed elimination: a centre's own gradient passes to its corners ...
        for c in range(n_centres):
            for b in range(4):
                q = corners[c, b]
                y[q, 0] += p[4 * c + b] * y[n * n + c, 0]
                y[q, 1] += p[4 * c + b] * y[n * n + c, 1]
        # ... then (L U)^T z = y on the inner grid vertices: U^T forwards, L^T backwards ...
        for g in range(n_inner):
            sx, sy = y[inner[g], 0], y[inner[g], 1]
            for j in range(max(0, g - half), g):
                entry = m[j, g - j + half]
                sx -= entry * y[inner[j], 0]
                sy -= entry * y[inner[j], 1]
            y[inner[g], 0] = sx * m[g, half]
            y[inner[g], 1] = sy * m[g, half]
        for i in range(n_inner):
            g = n_inner - 1 - i
            sx, sy = y[inner[g], 0], y[inner[g], 1]
            for j in range(g + 1, min(g + half + 1, n_inner)):
                factor = m[j, g - j + half]
                sx -= factor * y[inner[j], 0]
                sy -= factor * y[inner[j], 1]
            y[inner[g], 0] = sx
            y[inner[g], 1] = sy
        # ... and the multipliers of the centres and of the boundary follow.
        for g in range(n_inner):
            v = inner[g]
            inverse = 1.0 / totals[k, n_centres + g]
            for a in range(8):
                e, q = first + 8 * g + a, neighbours[g, a]
                grad[k, e] = inverse * (
                    y[v, 0] * (x[q, 0] - x[v, 0]) + y[v, 1] * (x[q, 1] - x[v, 1])
                )
                if a >= 4:
                    y[q, 0] += p[e] * y[v, 0]
                    y[q, 1] += p[e] * y[v, 1]
                    c = q - n * n
                    for b in range(4):
                        r = corners[c, b]
                        if position[r] < 0:
                            y[r, 0] += p[e] * p[4 * c + b] * y[v, 0]
                            y[r, 1] += p[e] * p[4 * c + b] * y[v, 1]
                elif position[q] < 0:
                    y[q, 0] += p[e] * y[v, 0]
                    y[q, 1] += p[e] * y[v, 1]
        for c in range(n_centres):
            v = n * n + c
            inverse = 1.0 / totals[k, c]
            for b in range(4):
                q = corners[c, b]
                grad[k, 4 * c + b] = inverse * (
                    y[v, 0] * (x[q, 0] - x[v, 0]) + y[v, 1] * (x[q, 1] - x[v, 1])
                )
    return grad
