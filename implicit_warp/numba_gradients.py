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

from fields.jit import inlined, point_kernel
from implicit_warp import numba_backend
from implicit_warp.layers import LayerStack
from implicit_warp.numba_rows import add_to_row, apply_cells
from implicit_warp.numba_tables import tabulate

_PARTS = 4
_BLOCK = 128
"""Points a block: the history of 64 layers with Jacobians, in float64, stays within a megabyte."""


def forward(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3), and the Jacobians (n, 3, 3) if asked for; differentiable."""
    if not _needs_gradients(stack, points):
        return numba_backend.traverse(stack, points, jacobian)
    tables = tabulate(stack.embeddings, stack.mesh, points.dtype)
    return _run(stack, points, jacobian, tables, stack.transitions, inverse=False)


def inverse(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f^-1(points) and the Jacobians of f^-1 if asked for; differentiable."""
    if not _needs_gradients(stack, points):
        return numba_backend.traverse_inverse(stack, points, jacobian)
    tables = stack.inverse_tables.flip(0).to(points.dtype)
    return _run(stack, points, jacobian, tables, stack.inverse_transitions, inverse=True)


def _needs_gradients(stack: LayerStack, points: Tensor) -> bool:
    return torch.is_grad_enabled() and (points.requires_grad or stack.requires_grad)


def _run(stack, points, jacobian, tables, transitions, *, inverse):
    image, jacobians = _Traverse.apply(
        points, tables, transitions.to(points.dtype), stack, jacobian, inverse
    )
    return image, jacobians if jacobian else None


class _Traverse(torch.autograd.Function):
    @staticmethod
    def forward(ctx, points, tables, transitions, stack, jacobian, inverse):
        found = np.empty((len(tables), len(points)), dtype=np.int32)
        location = numba_backend.compiled_location(stack, points.dtype) if inverse else None
        arrays = numba_backend.as_tables(tables, transitions)
        image, jacobians = numba_backend.run(points, arrays, location, stack.mesh, jacobian, found)
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

        arrays = numba_backend.as_tables(tables, transitions)
        x = array(points)
        grad_points = np.empty_like(x)
        kind = x.dtype
        grad_cells = np.zeros((_PARTS, *tables.flatten(1).shape), kind)
        grad_transitions = np.zeros((_PARTS, len(transitions), 12), kind)
        jacobian_part = (
            array(grad_jacobians).reshape(-1, 9) if ctx.with_jacobian else np.empty((0, 9), kind)
        )
        _backward(
            x, ctx.found, *arrays,
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
    n_layers, n = found.shape
    # The state of a point: three coordinates, and nine Jacobian entries if they are asked for.
    wide = len(grad_jacobians) > 0
    rows = 12 if wide else 3
    blocks = (n + _BLOCK - 1) // _BLOCK
    for part in prange(_PARTS):
        history = np.empty((n_layers, rows, _BLOCK), kind)
        linear = np.empty((n_layers, 4 * _BLOCK), kind)
        uv, share = np.empty(2 * _BLOCK, kind), np.empty(4 * _BLOCK, kind)
        state, grad = np.empty((rows, _BLOCK), kind), np.empty((rows, _BLOCK), kind)
        into_cells, into_transitions = grad_cells[part], grad_transitions[part]
        for b in range(part * blocks // _PARTS, (part + 1) * blocks // _PARTS):
            start = b * _BLOCK
            m = min(_BLOCK, n - start)
            _begin(points, start, state, m, wide)
            for k in range(n_layers):
                _transit(transitions[k], state, history[k], m, wide)
                at = found[k, start : start + m]
                _apply(cells[k], at, history[k], linear[k], uv, state, m, wide)

            for i in range(m):
                for c in range(3):
                    grad[c, i] = grad_image[start + i, c]
            if wide:
                for i in range(m):
                    for c in range(9):
                        grad[3 + c, i] = grad_jacobians[start + i, c]
            for back in range(n_layers):
                k = n_layers - 1 - back
                at = found[k, start : start + m]
                if with_transitions:
                    # The state after layer k is not kept: one cheap application restores it.
                    _apply(cells[k], at, history[k], linear[k], uv, state, m, wide)
                    _collect_transition(state, grad, into_transitions[k + 1], m, wide)
                _transit_back(transitions[k + 1], grad, m, wide)
                _collect_cells(history[k], grad, at, share, into_cells[k], m, wide)
                _apply_back(linear[k], grad, m, wide)
            if with_transitions:
                _begin(points, start, state, m, wide)
                _collect_transition(state, grad, into_transitions[0], m, wide)
            _transit_back(transitions[0], grad, m, wide)
            for i in range(m):
                for c in range(3):
                    grad_points[start + i, c] = grad[c, i]


@inlined
def _begin(points, start, state, m, wide):
    """The state before all layers: the point, and the identity as its Jacobian."""
    kind = points.dtype.type
    for i in range(m):
        for c in range(3):
            state[c, i] = points[start + i, c]
    if wide:
        for c in range(9):
            value = kind(1.0) if c % 4 == 0 else kind(0.0)
            for i in range(m):
                state[3 + c, i] = value


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
    """Pull the gradient back through a transition, in place."""
    for c in range(0, 6 if wide else 1):
        if c == 1 or c == 2:
            continue
        # The point's rows are consecutive, those of a Jacobian column three apart.
        step = 1 if c == 0 else 3
        for i in range(m):
            p, q, r = grad[c, i], grad[c + step, i], grad[c + 2 * step, i]
            grad[c, i] = t[0] * p + t[4] * q + t[8] * r
            grad[c + step, i] = t[1] * p + t[5] * q + t[9] * r
            grad[c + 2 * step, i] = t[2] * p + t[6] * q + t[10] * r


@inlined
def _apply(table, at, state, linear, uv, out, m, wide):
    """out = the state after the layer; at holds each point's cell, whose 2x2 part is kept."""
    apply_cells(table, at, state[0], state[1], uv, linear, m, True)
    for i in range(m):
        out[0, i], out[1, i], out[2, i] = uv[2 * i], uv[2 * i + 1], state[2, i]
    if wide:
        for i in range(m):
            a00, a01 = linear[4 * i], linear[4 * i + 1]
            a10, a11 = linear[4 * i + 2], linear[4 * i + 3]
            for c in range(3, 6):
                p, q = state[c, i], state[c + 3, i]
                out[c, i] = a00 * p + a01 * q
                out[c + 3, i] = a10 * p + a11 * q
                out[c + 6, i] = state[c + 6, i]


@inlined
def _apply_back(linear, grad, m, wide):
    """Pull the gradient back through each point's plane map, in place."""
    for i in range(m):
        a00, a01 = linear[4 * i], linear[4 * i + 1]
        a10, a11 = linear[4 * i + 2], linear[4 * i + 3]
        p, q = grad[0, i], grad[1, i]
        grad[0, i] = a00 * p + a10 * q
        grad[1, i] = a01 * p + a11 * q
        if wide:
            for c in range(3, 6):
                p, q = grad[c, i], grad[c + 3, i]
                grad[c, i] = a00 * p + a10 * q
                grad[c + 3, i] = a01 * p + a11 * q


@inlined
def _collect_cells(state, grad, at, share, into, m, wide):
    """Add each point's d L / d (a00, a01, a10, a11, d0, d1) to its cell."""
    for i in range(m):
        x, y, p, q = state[0, i], state[1, i], grad[0, i], grad[1, i]
        g00, g01, g10, g11 = p * x, p * y, q * x, q * y
        if wide:
            for c in range(3, 6):
                x, y, p, q = state[c, i], state[c + 3, i], grad[c, i], grad[c + 3, i]
                g00 += p * x
                g01 += p * y
                g10 += q * x
                g11 += q * y
        share[4 * i], share[4 * i + 1] = g00, g01
        share[4 * i + 2], share[4 * i + 3] = g10, g11
    for i in range(m):
        add_to_row(into, np.intp(at[i]) * 6, share, 4 * i, grad[0, i], grad[1, i])


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
