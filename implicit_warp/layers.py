"""A stack of prismatic layers: the one data structure every back end evaluates.

Layer k acts as R_k lift(psi_k) R_k^T, where psi_k is the piecewise-linear plane map that takes the
rest square mesh (and the cones around it) to the embedding U_k, and lift leaves the normal
coordinate alone (paper, Eq. 5, 6).  Consecutive frames, and whatever affine maps come before and
after, are fused into one 3x4 *transition* per layer:

    q_0 = T_0 (x),   q_k = T_k (lift(psi_{k-1}) (q_{k-1})),   y = T_K (lift(psi_{K-1}) (q_{K-1})).

A plane map is tabulated as one affine map a cell, six numbers (a00, a01, a10, a11, d0, d1), and
likewise its inverse.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from implicit_warp.square_mesh import SquareMesh, mesh_tensor


@dataclass(frozen=True, eq=False)
class LayerStack:
    """Embeddings and transitions of K layers; tables are derived once, on first use.

    Attributes:
        mesh: the rest mesh shared by all layers.
        embeddings: (K, V, 2) float64 vertex positions of each layer's image.
        transitions: (K + 1, 3, 4) float64 affine maps before, between and after the layers.
    """

    mesh: SquareMesh
    embeddings: Tensor
    transitions: Tensor

    @property
    def n_layers(self) -> int:
        """K, the number of layers."""
        return self.embeddings.shape[0]

    @property
    def requires_grad(self) -> bool:
        """Does any gradient flow to the layers?"""
        return self.embeddings.requires_grad or self.transitions.requires_grad

    def to(self, device: torch.device) -> LayerStack:
        """The same layers on another device; gradients flow back."""
        return LayerStack(self.mesh, self.embeddings.to(device), self.transitions.to(device))

    @cached_property
    def tables(self) -> Tensor:
        """(K, C, 6) rest -> image, one affine map a cell."""
        return self._cell_maps(inverse=False)

    @cached_property
    def inverse_tables(self) -> Tensor:
        """(K, C, 6) image -> rest."""
        return self._cell_maps(inverse=True)

    @cached_property
    def inverse_transitions(self) -> Tensor:
        """(K + 1, 3, 4) the inverses of the transitions, in the order in which they are met."""
        with torch.inference_mode(False), torch.set_grad_enabled(self.transitions.requires_grad):
            return invert_affine(self.transitions).flip(0)

    def _cell_maps(self, inverse: bool) -> Tensor:
        # What is cached must carry its gradients, also if it is first asked for without them.
        with torch.inference_mode(False), torch.set_grad_enabled(self.embeddings.requires_grad):
            rest, image = self._corners
            return _cell_maps(image, rest) if inverse else _cell_maps(rest, image)

    @property
    def _corners(self) -> tuple[Tensor, Tensor]:
        u = self.embeddings
        cells = mesh_tensor(self.mesh, "cells", torch.int64, u.device)
        rest = mesh_tensor(self.mesh, "vertices", u.dtype, u.device)
        image = torch.cat([u, u.new_zeros(len(u), 1, 2)], 1)
        return torch.cat([rest, rest.new_zeros(1, 2)])[cells][None], image[:, cells]


def fuse_frames(
    frames: Tensor, before: Tensor | None = None, after: Tensor | None = None
) -> Tensor:
    """Transitions (K + 1, 3, 4) of layers with the given frames (K, 3, 3).

    Args:
        frames: rotations whose columns are each layer's plane axes and normal.
        before, after: optional affine maps (3, 4) applied before and after all layers.
    """
    to_local = frames.transpose(-1, -2)
    linear = torch.cat([to_local[:1], to_local[1:] @ frames[:-1], frames[-1:]])
    transitions = torch.cat([linear, linear.new_zeros(len(linear), 3, 1)], -1)
    first, last = transitions[0], transitions[-1]
    if before is not None:
        first = compose_affine(first, before)
    if after is not None:
        last = compose_affine(after, last)
    return torch.cat([first[None], transitions[1:-1], last[None]])


def compose_affine(outer: Tensor, inner: Tensor) -> Tensor:
    """The 3x4 matrix of outer after inner."""
    linear = outer[..., :3] @ inner[..., :3]
    offset = outer[..., :3] @ inner[..., 3:] + outer[..., 3:]
    return torch.cat([linear, offset], -1)


def invert_affine(matrix: Tensor) -> Tensor:
    """The inverse of (a batch of) 3x4 affine maps."""
    linear = inverse_3x3(matrix[..., :3])
    return torch.cat([linear, -linear @ matrix[..., 3:]], -1)


def inverse_3x3(matrix: Tensor) -> Tensor:
    """The inverse of (a batch of) 3x3 matrices, by their cofactors; differentiable.

    Not `torch.linalg.inv`: batched LU was seen to hang on the CPU, and is slow for small matrices.
    """
    rows = matrix.unbind(-2)
    cofactors = torch.stack(
        [torch.linalg.cross(rows[(i + 1) % 3], rows[(i + 2) % 3]) for i in range(3)], -1
    )
    return cofactors / (rows[0] * cofactors[..., 0]).sum(-1)[..., None, None]


def determinant_3x3(matrix: Tensor) -> Tensor:
    """The determinants (...) of 3x3 matrices (..., 3, 3); differentiable."""
    first, second, third = matrix.unbind(-2)
    return (first * torch.linalg.cross(second, third)).sum(-1)


def _cell_maps(source: Tensor, target: Tensor) -> Tensor:
    """Affine maps taking source corners (..., C, 3, 2) to target corners, as (..., C, 6)."""
    s0, t0 = source[..., 0, :], target[..., 0, :]
    s1, s2 = source[..., 1, :] - s0, source[..., 2, :] - s0
    t1, t2 = target[..., 1, :] - t0, target[..., 2, :] - t0
    inverse_area = 1.0 / (s1[..., 0] * s2[..., 1] - s1[..., 1] * s2[..., 0])
    # Rows of the inverse of [s1 s2]: barycentric coordinates 1 and 2 as linear forms.
    b1 = torch.stack([s2[..., 1], -s2[..., 0]], -1) * inverse_area[..., None]
    b2 = torch.stack([-s1[..., 1], s1[..., 0]], -1) * inverse_area[..., None]
    linear = t1[..., :, None] * b1[..., None, :] + t2[..., :, None] * b2[..., None, :]
    offset = t0 - (linear @ s0[..., None]).squeeze(-1)
    return torch.cat([linear.flatten(-2), offset], -1)
