"""Choice of the back end: one entry a quantity, whatever computes it.

The Numba kernels serve CPU tensors in float32 and float64, with first-order gradients; the torch
reference serves everything else.  Both give the same answers, to rounding.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
from torch import Tensor

from implicit_warp import torch_backend
from implicit_warp.errors import InputError
from implicit_warp.layers import LayerStack

BACK_ENDS = ("auto", "torch", "numba")

_forced = "auto"


@contextlib.contextmanager
def back_end(name: str) -> Iterator[None]:
    """Force one back end within a ``with`` block: "torch", "numba", or "auto" again."""
    global _forced
    if name not in BACK_ENDS:
        raise InputError("name", name, "no such back end", f"use one of {', '.join(BACK_ENDS)}")
    previous, _forced = _forced, name
    try:
        yield
    finally:
        _forced = previous


def forward(stack: LayerStack, points: Tensor) -> Tensor:
    """f(points), (n, 3)."""
    return _choose(stack, points).forward(stack, points, jacobian=False)[0]


def forward_and_jacobian(stack: LayerStack, points: Tensor) -> tuple[Tensor, Tensor]:
    """f(points) and its Jacobians (n, 3, 3)."""
    return _choose(stack, points).forward(stack, points, jacobian=True)


def inverse(stack: LayerStack, points: Tensor) -> Tensor:
    """f^-1(points), (n, 3)."""
    return _choose(stack, points).inverse(stack, points, jacobian=False)[0]


def inverse_and_jacobian(stack: LayerStack, points: Tensor) -> tuple[Tensor, Tensor]:
    """f^-1(points) and the Jacobians of f^-1 (n, 3, 3)."""
    return _choose(stack, points).inverse(stack, points, jacobian=True)


def _choose(stack: LayerStack, points: Tensor):
    fits = (
        points.device.type == "cpu"
        and stack.embeddings.device.type == "cpu"
        and points.dtype in (torch.float32, torch.float64)
    )
    if _forced == "numba" and not fits:
        raise InputError(
            "points",
            f"{points.dtype} on {points.device}",
            "the numba back end serves float32 and float64 on the CPU",
            'use back end "auto" or "torch"',
        )
    if fits and _forced != "torch":
        from implicit_warp import numba_gradients

        return numba_gradients
    return torch_backend
