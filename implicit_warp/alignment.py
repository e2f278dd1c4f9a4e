"""Affine maps that bring one set of points close to another."""

from __future__ import annotations

import torch
from torch import Tensor

from implicit_warp.layers import determinant_3x3

ALIGNMENTS = ("none", "rigid", "affine")


def apply_affine(matrix: Tensor, points: Tensor) -> Tensor:
    """The points (n, 3) under an affine map (3, 4)."""
    return points @ matrix[:, :3].T + matrix[:, 3]


def best_affine_map(
    source: Tensor, target: Tensor, kind: str, weights: Tensor | None = None
) -> Tensor:
    """The map (3, 4) of a kind that takes source to target best in the least-squares sense.

    Args:
        source, target: (n, 3) float64.
        kind: "none", the identity; "rigid", by Kabsch's algorithm: the rotation nearest to the
            covariance; "affine", which falls back to "rigid" where the points do not span space
            or the best affine map turns it inside out.
        weights: (n,) of the points; all alike if None.
    """
    if kind == "none":
        return torch.eye(3, 4, dtype=torch.float64)
    shares = torch.ones(len(source)).double() if weights is None else weights
    shares = (shares / shares.sum())[:, None]
    from_centre, to_centre = (shares * source).sum(0), (shares * target).sum(0)
    p, q = source - from_centre, target - to_centre
    covariance = q.T @ (shares * p)
    left, _, right = torch.linalg.svd(covariance)
    signs = torch.ones(3, dtype=source.dtype)
    signs[2] = torch.sign(torch.linalg.det(left @ right))
    linear = left @ torch.diag(signs) @ right
    spread = p.T @ (shares * p)
    values = torch.linalg.eigvalsh(spread)
    if kind == "affine" and values[0] > 1e-6 * values[2]:
        best = torch.linalg.solve(spread, covariance.T).T
        if determinant_3x3(best) > 0.05:
            linear = best
    return torch.cat([linear, (to_centre - linear @ from_centre)[:, None]], -1)
