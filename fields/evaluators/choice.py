"""Which evaluator computes the values of a field.

The compiled interpreter serves float32 and float64 points on the CPU where no graph for autograd
is wanted and the work is worth it; torch serves everything else, and is the reference. The choice
depends on the points' number, dtype and device, on the field, and on torch's gradient mode alone,
so the same call gives the same bits every time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.nn import Parameter

from fields.errors import InputError
from fields.tape import Tape

BACK_ENDS = ("auto", "torch", "numba")

WORTHWHILE = 1 << 20
"""Instructions times points from which on the compiled interpreter is chosen: torch needs about a
millisecond for so many, the interpreter a tenth of that."""

_forced: ContextVar[str] = ContextVar("fields_back_end", default="auto")


@contextlib.contextmanager
def back_end(name: str) -> Iterator[None]:
    """Force one evaluator within a `with` block, or choose automatically again ("auto").

    Args:
        name: "torch", "numba" or "auto".

    Raises:
        InputError: there is no such evaluator; on evaluation, "numba" cannot serve the points.
    """
    if name not in BACK_ENDS:
        raise InputError("name", name, "no such back end", f"use one of {', '.join(BACK_ENDS)}")
    token = _forced.set(name)
    try:
        yield
    finally:
        _forced.reset(token)


def runs_compiled(tape: Tape, points: Tensor, *, keep_graph: bool) -> bool:
    """Should the compiled interpreter compute this?

    Args:
        tape: of the field.
        points: `(..., 3)`.
        keep_graph: may the result have to be differentiable?

    Raises:
        InputError: the interpreter was forced, but does not serve these points.
    """
    forced = _forced.get()
    if forced == "torch":
        return False
    served = (
        points.device.type == "cpu"
        and points.dtype in (torch.float32, torch.float64)
        and not keep_graph
        and not torch.compiler.is_compiling()
        and not _is_transformed(points)
    )
    if forced == "numba" and not served:
        raise InputError(
            "points",
            f"{points.dtype} on {points.device}" + (", to be differentiated" if keep_graph else ""),
            "the compiled evaluator serves float32 and float64 on the CPU, without a graph",
            'use back end "auto" or "torch", or torch.no_grad()',
        )
    return served and (forced == "numba" or points.numel() // 3 * len(tape) >= WORTHWHILE)


def _is_transformed(points: Tensor) -> bool:
    """Does a tensor stand for others: in forward differentiation, transforms or tracing?"""
    if type(points) not in (Tensor, Parameter):
        return True
    if forward_ad.unpack_dual(points).tangent is not None:
        return True
    try:
        points.untyped_storage()
    except (NotImplementedError, RuntimeError):
        return True
    return False
