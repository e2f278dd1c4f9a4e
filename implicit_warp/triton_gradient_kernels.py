"""The kernels of the backward pass, in Triton; `triton_backend` launches them.

Three steps, so that nothing is added up in an order that chance decides:

1. `replay` sends a chunk of points forwards through the cells that the forward pass found, and
   keeps the state that enters each layer;
2. `differentiate` goes through the layers in reverse.  It writes each point's contribution to its
   cells' gradients, and each block's share of the transitions' gradients;
3. `sum_cells` adds up the contributions by cell, in the order of a stable sort.

Floating-point atomics would need no second and third step, but their sums change from run to run.
For layouts see `triton_kernels`.
"""

from __future__ import annotations

import triton
import triton.language as tl

from implicit_warp.triton_kernels import (
    apply,
    cell_map,
    load_three,
    mix,
    move,
    store_three,
    transition,
    turn,
)


@triton.jit
def _turn_back(t, g):
    """The transpose of the linear part, for gradients."""
    return (
        t[0] * g[0] + t[4] * g[1] + t[8] * g[2],
        t[1] * g[0] + t[5] * g[1] + t[9] * g[2],
        t[2] * g[0] + t[6] * g[1] + t[10] * g[2],
    )


@triton.jit
def _mix_back(a, g):
    """The transpose of `mix`, for gradients."""
    return a[0] * g[0] + a[2] * g[1], a[1] * g[0] + a[3] * g[1], g[2]


@triton.jit(do_not_specialize=["n", "n_layers", "first", "m"])
def replay(
    points, tables, transitions, found, history, n, n_layers, first, m,
    N_CELLS: tl.constexpr, JACOBIAN: tl.constexpr,
    SHARED: tl.constexpr, PADDED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Points first ... first + m through known cells; history: the state that enters each layer.

    The state is the point and, with JACOBIAN, the three columns of the Jacobian so far.
    """
    lane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    mask = lane < m
    index = first + lane.to(tl.int64)
    rows = 3
    if JACOBIAN:
        rows = 12
    p = load_three(points, index, 3, 1, mask)
    zero, one = p[0] * 0.0, p[0] * 0.0 + 1.0
    ju, jv, jw = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for k in range(n_layers):
        t = transition(transitions, k)
        cell = tl.load(found + tl.cast(k, tl.int64) * n + index, mask=mask, other=0)
        a = cell_map(tables + k * (6 * N_CELLS), cell, N_CELLS, SHARED, PADDED)
        state = history + tl.cast(k, tl.int64) * (rows * m)
        p = move(t, p)
        store_three(state, lane, 1, m, p, mask)
        p = apply(a, p)
        if JACOBIAN:
            ju, jv, jw = turn(t, ju), turn(t, jv), turn(t, jw)
            store_three(state + 3 * m, lane, 1, m, ju, mask)
            store_three(state + 6 * m, lane, 1, m, jv, mask)
            store_three(state + 9 * m, lane, 1, m, jw, mask)
            ju, jv, jw = mix(a, ju), mix(a, jv), mix(a, jw)


@triton.jit
def _collect_transition(into, p, g, columns, grads, JACOBIAN: tl.constexpr):
    """A block's share of d L / d (linear part, offset) of a transition entered by p and columns."""
    for r in tl.static_range(3):
        for c in tl.static_range(3):
            share = g[r] * p[c]
            if JACOBIAN:
                for d in tl.static_range(3):
                    share += grads[d][r] * columns[d][c]
            tl.store(into + (4 * r + c), tl.sum(share, 0))
        tl.store(into + (4 * r + 3), tl.sum(g[r], 0))


@triton.jit(do_not_specialize=["n", "n_layers", "first", "m"])
def differentiate(
    points, tables, transitions, found, history, grad_image, grad_jacobians,
    grad_points, contributions, shares, n, n_layers, first, m,
    N_CELLS: tl.constexpr, JACOBIAN: tl.constexpr, CELLS: tl.constexpr, TRANSITIONS: tl.constexpr,
    SHARED: tl.constexpr, PADDED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """The layers in reverse, after `replay`: gradients for the points first ... first + m.

    With CELLS, contributions (K, 6, m) get each point's d L / d (its cell's six numbers).  With
    TRANSITIONS, shares (programs, K + 1, 12) get each block's sums of d L / d transitions.
    """
    lane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    mask = lane < m
    index = first + lane.to(tl.int64)
    rows = 3
    if JACOBIAN:
        rows = 12
    # Lanes beyond the end have zero gradients, and so add nothing to any sum.
    g = load_three(grad_image, index, 3, 1, mask)
    gu, gv, gw = g, g, g
    if JACOBIAN:
        gu = load_three(grad_jacobians, index, 9, 3, mask)
        gv = load_three(grad_jacobians + 1, index, 9, 3, mask)
        gw = load_three(grad_jacobians + 2, index, 9, 3, mask)
    shares += tl.program_id(0) * (n_layers + 1) * 12
    for back in range(n_layers):
        k = n_layers - 1 - back
        cell = tl.load(found + tl.cast(k, tl.int64) * n + index, mask=mask, other=0)
        a = cell_map(tables + k * (6 * N_CELLS), cell, N_CELLS, SHARED, PADDED)
        t = transition(transitions, k + 1)
        # The gradients of points alone need no history, and then there is none.
        p, ju, jv, jw = g, g, g, g
        state = history + tl.cast(k, tl.int64) * (rows * m)
        if CELLS or TRANSITIONS:
            p = load_three(state, lane, 1, m, mask)
        if (CELLS or TRANSITIONS) and JACOBIAN:
            ju = load_three(state + 3 * m, lane, 1, m, mask)
            jv = load_three(state + 6 * m, lane, 1, m, mask)
            jw = load_three(state + 9 * m, lane, 1, m, mask)
        if TRANSITIONS:
            # What enters the transition is not kept: one application of the cell restores it.
            _collect_transition(
                shares + (k + 1) * 12, apply(a, p), g,
                (mix(a, ju), mix(a, jv), mix(a, jw)), (gu, gv, gw), JACOBIAN,
            )  # fmt: skip
        g = _turn_back(t, g)
        if JACOBIAN:
            gu, gv, gw = _turn_back(t, gu), _turn_back(t, gv), _turn_back(t, gw)
        if CELLS:
            g00, g01, g10, g11 = g[0] * p[0], g[0] * p[1], g[1] * p[0], g[1] * p[1]
            if JACOBIAN:
                g00 += gu[0] * ju[0] + gv[0] * jv[0] + gw[0] * jw[0]
                g01 += gu[0] * ju[1] + gv[0] * jv[1] + gw[0] * jw[1]
                g10 += gu[1] * ju[0] + gv[1] * jv[0] + gw[1] * jw[0]
                g11 += gu[1] * ju[1] + gv[1] * jv[1] + gw[1] * jw[1]
            into = contributions + tl.cast(k, tl.int64) * (6 * m)
            store_three(into, lane, 1, m, (g00, g01, g10), mask)
            store_three(into + 3 * m, lane, 1, m, (g11, g[0], g[1]), mask)
        g = _mix_back(a, g)
        if JACOBIAN:
            gu, gv, gw = _mix_back(a, gu), _mix_back(a, gv), _mix_back(a, gw)
    if TRANSITIONS:
        p = load_three(points, index, 3, 1, mask)
        zero, one = p[0] * 0.0, p[0] * 0.0 + 1.0
        columns = ((one, zero, zero), (zero, one, zero), (zero, zero, one))
        _collect_transition(shares, p, g, columns, (gu, gv, gw), JACOBIAN)
    store_three(grad_points, index, 3, 1, _turn_back(transition(transitions, 0), g), mask)


@triton.jit(do_not_specialize=["m"])
def sum_cells(
    contributions, order, starts, grad_tables, m, N_CELLS: tl.constexpr, BLOCK: tl.constexpr
):
    """Add up the contributions (K, 6, m) by cell; one program a cell and layer, in a fixed order.

    order (K, m) lists the points by cell, starts (K, C + 1) where each cell's points begin.
    """
    cell, k = tl.program_id(0), tl.program_id(1)
    begin = tl.load(starts + k * (N_CELLS + 1) + cell)
    end = tl.load(starts + k * (N_CELLS + 1) + cell + 1)
    row = tl.arange(0, 8)
    lane = tl.arange(0, BLOCK)
    numbers = contributions + (k * 6 + row[:, None]).to(tl.int64) * m
    total = tl.zeros([8, BLOCK], grad_tables.dtype.element_ty)
    for start in range(begin, end, BLOCK):
        rest = start + lane < end
        point = tl.load(order + tl.cast(k, tl.int64) * m + start + lane, mask=rest, other=0)
        mask = (row < 6)[:, None] & rest[None, :]
        total += tl.load(numbers + point[None, :], mask=mask, other=0.0)
    into = grad_tables + (k * 6 + row) * N_CELLS + cell
    tl.store(into, tl.load(into, mask=row < 6, other=0.0) + tl.sum(total, 1), mask=row < 6)
