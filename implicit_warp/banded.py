"""Banded solver of the Tutte system and its adjoint (CPU, float64).

The row-normalised system is u = P u with P_ij = w_ij / sum_j w_ij.  Cell centres are averages of
their four corners, so substituting them leaves one equation per inner grid vertex g,

    (1 - s_gg) u_g - sum_h s_gh u_h = boundary terms,     h among the eight surrounding vertices,

an M-matrix with half-bandwidth N - 1 in the row-major order: LU without pivoting is stable, and
costs O(N^4) where the dense one costs O(N^6).  Each layer is factored by one thread.

A row of the band is [width numbers left of the diagonal | the diagonal | width right of it | one
that is never read], where width is the half-bandwidth rounded up to whole vectors: inner loops have
no remainder, and what reaches beyond the band or the matrix meets zeros.  What belongs to boundary
vertices is dropped into the last number, so that assembling asks nothing.

Backward: with (I - P)^T mu = dL/du, solved through the same factors,
dL/dw_ij = mu_i . (u_j - u_i) / sum_j w_ij and dL/db = dL/du_b + (P^T mu)_b.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from numba import prange
from torch import Tensor

from fields.jit import inlined, parallel_kernel
from implicit_warp.numba_rows import subtract_four
from implicit_warp.square_mesh import SquareMesh


def solve_banded(weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
    """The embedding and, on backward, its adjoint. Shapes as in `embedding.embed`."""
    return _BandedSolve.apply(weights, boundary, mesh)


class _BandedSolve(torch.autograd.Function):
    @staticmethod
    def forward(ctx, weights: Tensor, boundary: Tensor, mesh: SquareMesh) -> Tensor:
        w = np.ascontiguousarray(weights.detach().numpy())
        u = np.empty((len(w), len(mesh.vertices), 2))
        u[:, mesh.boundary] = boundary.detach().numpy()
        ctx.mesh, ctx.saved = mesh, (*_solve(w, u, *_system(mesh)), u)
        return torch.from_numpy(u)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad: Tensor):
        mu = np.array(grad.numpy(), order="C", copy=True)
        grad_w = _adjoint(*ctx.saved, mu, *_system(ctx.mesh))
        return torch.from_numpy(grad_w), torch.from_numpy(mu[:, ctx.mesh.boundary]), None


class _System(NamedTuple):
    """What the reduced equations owe to the mesh; weights are numbered as its edges are."""

    corners: np.ndarray  # (centres, 4) grid vertices
    inner: np.ndarray  # (G,) the grid vertex of each equation
    neighbours: np.ndarray  # (G, 8) its neighbours: four on the grid, then four centres
    columns: np.ndarray  # (G, 20) place in the row of each of the four, and of the centres' corners
    direct: np.ndarray  # (D, 3) equation, weight, boundary vertex next to it
    through: np.ndarray  # (R, 4) equation, weight, weight of a centre, boundary vertex behind that
    half: int  # half-bandwidth


@lru_cache(maxsize=64)
def _system(mesh: SquareMesh) -> _System:
    corners, inner, neighbours = mesh.centre_corners, mesh.inner, mesh.inner_neighbours
    half, n_grid = mesh.resolution - 1, mesh.resolution**2
    width, _ = _row(half)
    equation = np.full(n_grid, -1)
    equation[inner] = np.arange(len(inner))
    centres = neighbours[:, 4:] - n_grid
    # Of every row: the grid vertices that it sees, and the weights by which it does.
    seen = np.concatenate([neighbours[:, :4], corners[centres].reshape(-1, 16)], 1)
    weights = 4 * len(corners) + 8 * np.arange(len(inner))[:, None] + np.arange(8)
    first = np.concatenate([weights[:, :4], np.repeat(weights[:, 4:], 4, axis=1)], 1)
    second = (4 * centres[..., None] + np.arange(4)).reshape(-1, 16)
    columns = width + equation[seen] - np.arange(len(inner))[:, None]
    outside = equation[seen] < 0
    columns[outside] = 2 * width + 1
    g, at = np.nonzero(outside[:, :4])
    direct = np.stack([g, first[g, at], seen[g, at]], -1)
    g, at = np.nonzero(outside[:, 4:])
    through = np.stack([g, first[g, 4 + at], second[g, at], seen[g, 4 + at]], -1)
    return _System(corners, inner, neighbours, columns, direct, through, half)


@inlined
def _row(half):
    """(numbers on each side of the diagonal, all numbers) of a row of the band."""
    width = (half + 3) // 4 * 4
    return width, 2 * width + 2


@parallel_kernel
def _solve(w, u, corners, inner, neighbours, columns, direct, through, half):
    """Fill u's inner vertices and centres; its boundary vertices are given.

    Returned are the normalised weights, what they were divided by, and the factors: the multipliers
    of L replace the entries they eliminate, and the diagonal holds its reciprocal.
    """
    layers, n_centres, n_inner = len(w), len(corners), len(inner)
    width, stride = _row(half)
    first, n_grid = 4 * n_centres, (half + 1) ** 2
    normalised = np.empty_like(w)
    totals = np.empty((layers, n_centres + n_inner))
    factors = np.zeros((layers, n_inner * stride))
    for k in prange(layers):
        p, m, x = normalised[k], factors[k], u[k]
        for c in range(n_centres):
            total = 0.0
            for a in range(4):
                total += w[k, 4 * c + a]
            totals[k, c] = total
            for a in range(4):
                p[4 * c + a] = w[k, 4 * c + a] / total
        for g in range(n_inner):
            e, row = first + 8 * g, g * stride
            total = 0.0
            for a in range(8):
                total += w[k, e + a]
            totals[k, n_centres + g] = total
            for a in range(8):
                p[e + a] = w[k, e + a] / total
            m[row + width] = 1.0
            for a in range(4):
                m[row + columns[g, a]] -= p[e + a]
                of_centre = 4 * (neighbours[g, 4 + a] - n_grid)
                for b in range(4):
                    m[row + columns[g, 4 + 4 * a + b]] -= p[e + 4 + a] * p[of_centre + b]
        # The unknowns, with zeros around them for what a row reaches beyond.
        r, s = np.zeros(n_inner + 2 * width), np.zeros(n_inner + 2 * width)
        for t in range(len(direct)):
            g, e, q = direct[t]
            r[width + g] += p[e] * x[q, 0]
            s[width + g] += p[e] * x[q, 1]
        for t in range(len(through)):
            g, e, of_centre, q = through[t]
            r[width + g] += p[e] * p[of_centre] * x[q, 0]
            s[width + g] += p[e] * p[of_centre] * x[q, 1]
        for g in range(n_inner):
            diagonal, at = g * stride + width, g + width
            pivot = 1.0 / m[diagonal]
            m[diagonal] = pivot
            for below in range(1, min(half, n_inner - 1 - g) + 1):
                entry = diagonal + below * (stride - 1)
                factor = m[entry] * pivot
                m[entry] = factor
                r[at + below] -= factor * r[at]
                s[at + below] -= factor * s[at]
                for d in range(1, width + 1, 4):
                    subtract_four(m, entry + d, factor, m, diagonal + d)
        for g in range(n_inner - 1, -1, -1):
            diagonal, at = g * stride + width, g + width
            r[at] = (r[at] - _dot(m, diagonal + 1, r, at + 1, width)) * m[diagonal]
            s[at] = (s[at] - _dot(m, diagonal + 1, s, at + 1, width)) * m[diagonal]
            x[inner[g], 0] = r[at]
            x[inner[g], 1] = s[at]
        for c in range(n_centres):
            sx, sy = 0.0, 0.0
            for b in range(4):
                sx += p[4 * c + b] * x[corners[c, b], 0]
                sy += p[4 * c + b] * x[corners[c, b], 1]
            x[n_grid + c, 0] = sx
            x[n_grid + c, 1] = sy
    return normalised, totals, factors


@inlined
def _dot(m, a, r, b, width):
    """The dot product of two runs of numbers; in four sums, which need not wait for each other."""
    one, two, three, four = 0.0, 0.0, 0.0, 0.0
    for t in range(0, width, 4):
        one += m[a + t] * r[b + t]
        two += m[a + t + 1] * r[b + t + 1]
        three += m[a + t + 2] * r[b + t + 2]
        four += m[a + t + 3] * r[b + t + 3]
    return (one + two) + (three + four)


@parallel_kernel
def _adjoint(
    normalised, totals, factors, u, mu, corners, inner, neighbours, columns, direct, through, half
):
    """Turn mu from dL/du into the multipliers, in place; return dL/dw.

    On return the boundary rows of mu hold dL/db.
    """
    n_centres, n_inner, n_grid = len(corners), len(inner), (half + 1) ** 2
    width, stride = _row(half)
    first = 4 * n_centres
    grad = np.empty_like(normalised)
    for k in prange(len(u)):
        p, m, x, y = normalised[k], factors[k], u[k], mu[k]
        # Transposed elimination: a centre's own gradient passes to its corners ...
        for c in range(n_centres):
            for b in range(4):
                q = corners[c, b]
                y[q, 0] += p[4 * c + b] * y[n_grid + c, 0]
                y[q, 1] += p[4 * c + b] * y[n_grid + c, 1]
        # ... then (L U)^T z = y on the inner grid vertices: U^T forwards, L^T backwards ...
        r, s = np.zeros(n_inner + 2 * width), np.zeros(n_inner + 2 * width)
        for g in range(n_inner):
            r[width + g] = y[inner[g], 0]
            s[width + g] = y[inner[g], 1]
        for g in range(n_inner):
            diagonal, at = g * stride + width, g + width
            r[at] *= m[diagonal]
            s[at] *= m[diagonal]
            for d in range(1, width + 1, 4):
                subtract_four(r, at + d, r[at], m, diagonal + d)
                subtract_four(s, at + d, s[at], m, diagonal + d)
        for g in range(n_inner - 1, -1, -1):
            at = g + width
            for d in range(0, width, 4):
                subtract_four(r, g + d, r[at], m, g * stride + d)
                subtract_four(s, g + d, s[at], m, g * stride + d)
            y[inner[g], 0] = r[at]
            y[inner[g], 1] = s[at]
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
        for t in range(len(direct)):
            g, e, q = direct[t]
            y[q, 0] += p[e] * y[inner[g], 0]
            y[q, 1] += p[e] * y[inner[g], 1]
        for t in range(len(through)):
            g, e, of_centre, q = through[t]
            y[q, 0] += p[e] * p[of_centre] * y[inner[g], 0]
            y[q, 1] += p[e] * p[of_centre] * y[inner[g], 1]
        for c in range(n_centres):
            v = n_grid + c
            inverse = 1.0 / totals[k, c]
            for b in range(4):
                q = corners[c, b]
                grad[k, 4 * c + b] = inverse * (
                    y[v, 0] * (x[q, 0] - x[v, 0]) + y[v, 1] * (x[q, 1] - x[v, 1])
                )
    return grad
