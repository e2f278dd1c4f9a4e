"""Choice of the back end: one entry a quantity, whatever computes it.

The Numba kernels serve CPU tensors and the Triton kernels CUDA tensors, both in float32 and
float64 and with first-order gradients; the torch reference serves everything else, and CUDA
tensors where Triton is not installed.  All give the same answers, to rounding.

A map is evaluated where its points are: if its layers lie on another device, their tables are
copied, once for layers that are not being trained.
"""

from __future__ import annotations

import contextlib
import functools
import weakref
from collections.abc import Iterator
from contextvars import ContextVar
from types import ModuleType

import torch
from torch import Tensor

from implicit_warp import torch_backend
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.layers import LayerStack

BACK_ENDS = ("auto", "torch", "numba", "triton")

_forced: ContextVar[str] = ContextVar("back_end", default="auto")


@contextlib.contextmanager
def back_end(name: str) -> Iterator[None]:
    """Force one back end within a ``with`` block, or choose automatically again ("auto").

    Args:
        name: one of `BACK_ENDS`.

    Raises:
        InputError: no such back end; on evaluation, one that does not serve the points' device
            or dtype.
        MissingDependency: "triton", where Triton cannot be imported.
    """
    if name not in BACK_ENDS:
        raise InputError("name", name, "no such back end", f"use one of {', '.join(BACK_ENDS)}")
    if name == "triton" and _triton_backend() is None:
        raise MissingDependency(
            "triton", 'back end "triton"', "It comes with the CUDA builds of torch"
        )
    token = _forced.set(name)
    try:
        yield
    finally:
        _forced.reset(token)


def forced_back_end() -> str:
    """The back end that an enclosing `back_end` block asks for; "auto" outside of any."""
    return _forced.get()


def forward(stack: LayerStack, points: Tensor) -> Tensor:
    """f(points), (n, 3)."""
    return _choose(points).forward(_beside(stack, points), points, jacobian=False)[0]


def forward_and_jacobian(stack: LayerStack, points: Tensor) -> tuple[Tensor, Tensor]:
    """f(points) and its Jacobians (n, 3, 3)."""
    return _choose(points).forward(_beside(stack, points), points, jacobian=True)


def inverse(stack: LayerStack, points: Tensor) -> Tensor:
    """f^-1(points), (n, 3)."""
    return _choose(points).inverse(_beside(stack, points), points, jacobian=False)[0]


def inverse_and_jacobian(stack: LayerStack, points: Tensor) -> tuple[Tensor, Tensor]:
    """f^-1(points) and the Jacobians of f^-1 (n, 3, 3)."""
    return _choose(points).inverse(_beside(stack, points), points, jacobian=True)


def _choose(points: Tensor) -> ModuleType:
    known = points.dtype in (torch.float32, torch.float64)
    forced = _forced.get()
    if forced == "torch":
        return torch_backend
    if forced == "triton" or (forced == "auto" and points.is_cuda and known):
        triton_backend = _triton_backend()
        if triton_backend is not None and triton_backend.fits(points):
            return triton_backend
        if forced == "triton":
            raise _refusal(points, "triton", "on a CUDA device")
    elif points.device.type == "cpu" and known:
        from implicit_warp import numba_gradients

        return numba_gradients
    elif forced == "numba":
        raise _refusal(points, "numba", "on the CPU")
    return torch_backend


def _refusal(points: Tensor, name: str, where: str) -> InputError:
    return InputError(
        "points",
        f"{points.dtype} on {points.device}",
        f"the {name} back end serves float32 and float64 {where}",
        'use back end "auto" or "torch"',
    )


@functools.cache
def _triton_backend() -> ModuleType | None:
    try:
        import triton  # noqa: F401 (asked for first, so that no other failure is mistaken for it)
    except ImportError:
        return None
    from implicit_warp import triton_backend

    return triton_backend


_copies: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()


def _beside(stack: LayerStack, points: Tensor) -> LayerStack:
    """The stack, or its copy on the points' device."""
    if stack.embeddings.device == points.device:
        return stack
    if stack.requires_grad:
        return stack.to(points.device)
    copies = _copies.setdefault(stack, {})
    if points.device not in copies:
        copies[points.device] = stack.to(points.device)
    return copies[points.device]
