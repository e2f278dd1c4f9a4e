"""Numba back end with gradients: the same traversals as `torch.autograd.Function`.

Forward stores only the cell of every point in every layer.  Backward walks the layers twice per
block of points: forwards again, from the stored cells, keeping the block's history in cache, and
then in reverse, collecting

    d L / d cells        for each of a cell's six numbers, over the points in that cell,
    d L / d transitions  for each of a transition's twelve numbers, over all points,
    d L / d points,

through the value and, if it was asked for, through the Jacobian.  Points are dealt to a fixed
number of parts, each with its own accumulators that are added up in order at the end, so that the
result does not depend on the number of threads.

One kernel serves both directions: the inverse is the same traversal with the inverse's tables.
"""

from __future__ import annotations

import numpy as np
import torch
from numba import prange
from torch import Tensor

from implicit_warp import numba_backend
from implicit_warp.jit import inlined, point_kernel
from implicit_warp.layers import LayerStack

_PARTS = 4
_BLOCK = 128
"""Points a block: the history of 64 layers with Jacobians, in float64, stays within a megabyte."""


def forward(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3), and the Jacobians (n, 3, 3) if asked for; differentiable."""
    return _run(stack, points, jacobian, stack.tables, stack.transitions, inverse=False)


def inverse(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f^-1(points) and the Jacobians of f^-1 if asked for; differentiable."""
    tables = stack.inverse_tables.flip(0)
    return _run(stack, points, jacobian, tables, stack.inverse_transitions, inverse=True)


def _run(stack, points, jacobian, tables, transitions, *, inverse):
    if not (torch.is_grad_enabled() and (points.requires_grad or stack.requires_grad)):
        run = numba_backend.traverse_inverse if inverse else numba_backend.traverse
        return run(stack, points, jacobian)
    image, jacobians = _Traverse.apply(
        points, tables.to(points.dtype), transitions.to(points.dtype), stack, jacobian, inverse
    )
    return image, jacobians if jacobian else None


class _Traverse(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, tables, transitions, stack, jacobian, inverse):
        found = np.empty((len(tables), len(points)), dtype=np.int32)
        run = numba_backend.traverse_inverse if inverse else numba_backend.traverse
        image, jacobians = run(stack, points, jacobian, found)
        ctx.found, ctx.with_jacobian = found, jacobian
        ctx.save_for_backward(points, tables, transitions)
        if jacobians is None:
            jacobians = image.new_empty(0)
            ctx.mark_non_differentiable(jacobians)
        return image, jacobians

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, grad_image, grad_jacobians):
        points, tables, transitions = ctx.saved_tensors

        def array(tensor: Tensor) -> np.ndarray:
            return np.ascontiguousarray(tensor.detach().numpy())

        x = array(points)
        grad_points = np.empty_like(x)
        kind = x.dtype
        grad_cells = np.zeros((_PARTS, *tables.flatten(1).shape), kind)
        grad_transitions = np.zeros((_PARTS, len(transitions), 12), kind)
        jacobian_part = (
            array(grad_jacobians).reshape(-1, 9) if ctx.with_jacobian else np.empty((0, 9), kind)
        )
        _backward(
            x, ctx.found, array(tables.flatten(1)), array(transitions.flatten(1)),
            array(grad_image), jacobian_part, ctx.needs_input_grad[2],
            grad_points, grad_cells, grad_transitions,
        )  # fmt: skip
        return (
            torch.from_numpy(grad_points),
            torch.from_numpy(grad_cells.sum(0)).view_as(tables),
            torch.from_numpy(grad_transitions.sum(0)).view_as(transitions),
            None,
            None,
            None,
        )


@point_kernel
def _backward(
    points, found, cells, transitions, grad_image, grad_jacobians, with_transitions,
    grad_points, grad_cells, grad_transitions,
):  # fmt: skip
    kind = points.dtype.type
    zero, one = kind(0.0), kind(1.0)
    n_layers, n = found.shape
    # The state of a point: three coordinates, and nine Jacobian entries if they are asked for.
    wide = len(grad_jacobians) > 0
    rows = 12 if wide else 3
    blocks = (n + _BLOCK - 1) // _BLOCK
    for part in prange(_PARTS):
        history = np.empty((n_layers, rows, _BLOCK), points.dtype)
        state = np.empty((rows, _BLOCK), points.dtype)
        grad = np.empty((rows, _BLOCK), points.dtype)
        into_cells, into_transitions = grad_cells[part], grad_transitions[part]
        for b in range(part * blocks // _PARTS, (part + 1) * blocks // _PARTS):
            start = b * _BLOCK
            m = min(_BLOCK, n - start)
            for i in range(m):
                for c in range(3):
                    state[c, i] = points[start + i, c]
            if wide:
                for c in range(9):
                    value = one if c % 4 == 0 else zero
                    for i in range(m):
                        state[3 + c, i] = value
            for k in range(n_layers):
                _transit(transitions[k], state, history[k], m, wide)
                _apply(cells[k], found[k, start : start + m], history[k], state, m, wide)

            for i in range(m):
                for c in range(3):
                    grad[c, i] = grad_image[start + i, c]
            if wide:
                for i in range(m):
                    for c in range(9):
                        grad[3 + c, i] = grad_jacobians[start + i, c]
            for back in range(n_layers):
                k = n_layers - 1 - back
                if with_transitions:
                    # The state after layer k is not kept: one cheap application restores it.
                    at = found[k, start : start + m]
                    _apply(cells[k], at, history[k], state, m, wide)
                    _collect_transition(state, grad, into_transitions[k + 1], m, wide)
                _transit_back(transitions[k + 1], grad, m, wide)
                at = found[k, start : start + m]
                _collect_cells(history[k], grad, at, into_cells[k], m, wide)
                _apply_back(cells[k], at, grad, m, wide)
            if with_transitions:
                for i in range(m):
                    for c in range(3):
                        state[c, i] = points[start + i, c]
                if wide:
                    for c in range(9):
                        value = one if c % 4 == 0 else zero
                        for i in range(m):
                            state[3 + c, i] = value
                _collect_transition(state, grad, into_transitions[0], m, wide)
            _transit_back(transitions[0], grad, m, wide)
            for i in range(m):
                for c in range(3):
                    grad_points[start + i, c] = grad[c, i]


@inlined
def _transit(t, state, out, m, wide):
    """out = T state: rows 0 to 2 are the point, rows 3 to 11 the Jacobian, row by row."""
    for i in range(m):
        p, q, r = state[0, i], state[1, i], state[2, i]
        out[0, i] = t[0] * p + t[1] * q + t[2] * r + t[3]
        out[1, i] = t[4] * p + t[5] * q + t[6] * r + t[7]
        out[2, i] = t[8] * p + t[9] * q + t[10] * r + t[11]
    if wide:
        for c in range(3, 6):
            for i in range(m):
                p, q, r = state[c, i], state[c + 3, i], state[c + 6, i]
                out[c, i] = t[0] * p + t[1] * q + t[2] * r
                out[c + 3, i] = t[4] * p + t[5] * q + t[6] * r
                out[c + 6, i] = t[8] * p + t[9] * q + t[10] * r


@inlined
def _transit_back(t, grad, m, wide):
    for i in range(m):
        p, q, r = grad[0, i], grad[1, i], grad[2, i]
        grad[0, i] = t[0] * p + t[4] * q + t[8] * r
        grad[1, i] = t[1] * p + t[5] * q + t[9] * r
        grad[2, i] = t[2] * p + t[6] * q + t[10] * r
    if wide:
        for c in range(3, 6):
            for i in range(m):
                p, q, r = grad[c, i], grad[c + 3, i], grad[c + 6, i]
                grad[c, i] = t[0] * p + t[4] * q + t[8] * r
                grad[c + 3, i] = t[1] * p + t[5] * q + t[9] * r
                grad[c + 6, i] = t[2] * p + t[6] * q + t[10] * r


@inlined
def _apply(table, at, state, out, m, wide):
    """out = the state after the layer; at holds each point's cell."""
    for i in range(m):
        a = at[i] * np.int32(6)
        p, q = state[0, i], state[1, i]
        out[0, i] = table[a] * p + table[a + 1] * q + table[a + 4]
        out[1, i] = table[a + 2] * p + table[a + 3] * q + table[a + 5]
        out[2, i] = state[2, i]
    if wide:
        for i in range(m):
            a = at[i] * np.int32(6)
            a00, a01, a10, a11 = table[a], table[a + 1], table[a + 2], table[a + 3]
            for c in range(3, 6):
                p, q = state[c, i], state[c + 3, i]
                out[c, i] = a00 * p + a01 * q
                out[c + 3, i] = a10 * p + a11 * q
                out[c + 6, i] = state[c + 6, i]


@inlined
def _apply_back(table, at, grad, m, wide):
    for i in range(m):
        a = at[i] * np.int32(6)
        a00, a01, a10, a11 = table[a], table[a + 1], table[a + 2], table[a + 3]
        p, q = grad[0, i], grad[1, i]
        grad[0, i] = a00 * p + a10 * q
        grad[1, i] = a01 * p + a11 * q
        if wide:
            for c in range(3, 6):
                p, q = grad[c, i], grad[c + 3, i]
                grad[c, i] = a00 * p + a10 * q
                grad[c + 3, i] = a01 * p + a11 * q


@inlined
def _collect_cells(state, grad, at, into, m, wide):
    """Scatter d L / d (a00, a01, a10, a11, d0, d1) of each point's cell."""
    for i in range(m):
        x, y, p, q = state[0, i], state[1, i], grad[0, i], grad[1, i]
        g00, g01, g10, g11 = p * x, p * y, q * x, q * y
        if wide:
            for c in range(3, 6):
                u, v, r, s = state[c, i], state[c + 3, i], grad[c, i], grad[c + 3, i]
                g00 += r * u
                g01 += r * v
                g10 += s * u
                g11 += s * v
        a = at[i] * np.int32(6)
        into[a] += g00
        into[a + 1] += g01
        into[a + 2] += g10
        into[a + 3] += g11
        into[a + 4] += p
        into[a + 5] += q


@inlined
def _collect_transition(state, grad, into, m, wide):
    """Add d L / d (linear part, offset) of a transition whose input is the state."""
    for r in range(3):
        for c in range(3):
            total = into.dtype.type(0.0)
            for i in range(m):
                total += grad[r, i] * state[c, i]
            if wide:
                for d in range(3):
                    for i in range(m):
                        total += grad[3 + 3 * r + d, i] * state[3 + 3 * c + d, i]
            into[4 * r + c] += total
        total = into.dtype.type(0.0)
        for i in range(m):
            total += grad[r, i]
        into[4 * r + 3] += total
