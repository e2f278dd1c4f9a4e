"""Frames of the prismatic layers: rotations whose third column is a layer's normal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from implicit_warp.errors import InputError
from implicit_warp.layers import determinant_3x3

NAMES = ("triplane", "cubic", "free")


def make_frames(frames: str | Sequence | np.ndarray | Tensor, layers: int) -> Tensor:
    """Rotations (K, 3, 3), float64, one a layer.

    * ``"triplane"``: normals z, x, y in turn (paper, sec. 4.2).
    * ``"cubic"``: the eight vertices of the cube in turn (paper, supplement).
    * ``"free"``: triplane as the start of frames that are learned.
    * an array (K, 3, 3) of rotations, or (k, 3, 3) to be repeated in turn.

    Raises:
        InputError: an unknown name, another shape, or matrices that are no rotations.
    """
    if isinstance(frames, str):
        if frames not in NAMES:
            raise InputError(
                "frames", frames, "no frames of that name", f"use one of {', '.join(NAMES)}"
            )
        cycle = _cubic() if frames == "cubic" else _triplane()
    else:
        given = frames.detach().cpu() if isinstance(frames, Tensor) else frames
        cycle = torch.as_tensor(np.asarray(given, dtype=np.float64)).clone()
        if cycle.ndim != 3 or cycle.shape[1:] != (3, 3) or not len(cycle):
            raise InputError(
                "frames", tuple(cycle.shape), "not a list of 3x3 matrices", "pass (K, 3, 3)"
            )
        refuse_non_rotations("frames", cycle)
    return cycle[torch.arange(layers) % len(cycle)]


def refuse_non_rotations(argument: str, matrices: Tensor, tolerance: float = 1e-9) -> None:
    """Raise `InputError` unless all of the matrices (k, 3, 3) are rotations, to the tolerance."""
    unit = torch.eye(3, dtype=matrices.dtype, device=matrices.device)
    error = (matrices @ matrices.transpose(-1, -2) - unit).abs().max()
    if not error < tolerance or not bool((determinant_3x3(matrices) > 0).all()):
        raise InputError(
            argument,
            f"orthogonality error {float(error):.3g}",
            f"not all of the matrices are rotations (det +1, to {tolerance:g})",
            "orthonormalise them, and mind the orientation",
        )


def turn(frames: Tensor, axis_angles: Tensor) -> Tensor:
    """Frames (K, 3, 3) turned by rotation vectors (K, 3), in their local axes; differentiable."""
    x, y, z = axis_angles.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return frames @ torch.matrix_exp(cross)


def _triplane() -> Tensor:
    # Cyclic shifts of the axes, so that the normals are z, x and y.
    eye = torch.eye(3, dtype=torch.float64)
    return torch.stack([eye[:, [0, 1, 2]], eye[:, [1, 2, 0]], eye[:, [2, 0, 1]]])


def _cubic() -> Tensor:
    signs = [(x, y, z) for z in (1.0, -1.0) for y in (1.0, -1.0) for x in (1.0, -1.0)]
    return torch.stack([_frame_of(torch.tensor(s, dtype=torch.float64)) for s in signs])


def _frame_of(normal: Tensor) -> Tensor:
    """A rotation whose third column is the given direction."""
    n = normal / normal.norm()
    helper = torch.eye(3, dtype=n.dtype)[int(n.abs().argmin())]
    u = torch.linalg.cross(helper, n)
    u = u / u.norm()
    return torch.stack([u, torch.linalg.cross(n, u), n], -1)
