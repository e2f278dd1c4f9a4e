"""Energies of maps: elastic distortion, its exact integral over a layer, handle terms."""

from __future__ import annotations

import torch
from torch import Tensor

from implicit_warp import evaluate
from implicit_warp.layers import LayerStack


def elastic_energy(jacobians: Tensor) -> Tensor:
    """|| J^T J - I ||_F^2 of (..., d, d) Jacobians, shape (...): zero exactly for rotations.

    The deviation of the Cauchy-Green strain tensor from the identity (paper, Eq. 7).
    """
    if _is_fast(jacobians) and jacobians.shape[1:] == (3, 3):
        from implicit_warp.numba_tables import green_energy

        return green_energy(jacobians)
    gram = jacobians.transpose(-1, -2) @ jacobians
    strain = gram - torch.eye(gram.shape[-1], dtype=gram.dtype, device=gram.device)
    return strain.square().sum((-1, -2))


def layer_energy(stack: LayerStack) -> Tensor:
    """Mean over the layers of the exact integral of each layer's elastic energy.

    Layer by layer, the sum over all triangles of (rest area x energy), divided by the square's
    area of 4 (paper, sec. 3.2: exact, because the layer's Jacobians can be enumerated).
    """
    if _is_fast(stack.embeddings):
        from implicit_warp.numba_tables import mean_layer_energy

        return mean_layer_energy(stack.embeddings, stack.mesh)
    n = stack.mesh.n_triangles
    linear = stack.tables[:, :n, :4].unflatten(-1, (2, 2))
    # All rest triangles have the same area, so the area-weighted sum is a mean.
    return elastic_energy(linear).mean()


def _is_fast(tensor: Tensor) -> bool:
    """Is there a Numba kernel for such a tensor, and is it allowed?"""
    return evaluate.forced_back_end() != "torch" and (
        tensor.device.type == "cpu" and tensor.dtype in (torch.float32, torch.float64)
    )
