"""Numba back end: map, inverse and Jacobians on the CPU.

Points go through all layers block by block, so that memory beyond the result stays constant.  A
block lies in arrays of the size of the first-level cache, one a coordinate; each layer is a few
loops over the block: one moves into the layer's frame, one locates the cell of each point (both
vectorise), and one looks up that cell's six numbers and applies them.

In a block, x and y are arrays of their own where every point is treated alike, which vectorises
over points, and pairs (u, v) where each has its own cell, which vectorises within a point
(`numba_rows`).

For developers: Numba's cache of a compiled function does not notice changes in functions of other
modules.  After editing `numba_location`, `numba_rows` or `jit`, delete this folder's
`__pycache__`.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import prange
from torch import Tensor

from fields.jit import inlined, point_kernel
from implicit_warp.layers import LayerStack
from implicit_warp.numba_location import (
    Location,
    correct,
    locate,
    location_of,
    look_up,
    no_location,
)
from implicit_warp.numba_rows import apply_cells
from implicit_warp.square_mesh import SquareMesh

BLOCK_BYTES = 2048
"""Of one number a point of a block; some twenty of these are in use at a time."""


class Tables(NamedTuple):
    """A stack as the kernels read it: contiguous, of one dtype."""

    cells: np.ndarray  # (K, C * 6) affine maps
    transitions: np.ndarray  # (K + 1, 12)


def traverse(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3) and, if asked for, the Jacobians (n, 3, 3); no gradients."""
    tables = compiled_tables(stack, points.dtype, inverse=False)
    return run(points, tables, None, stack.mesh, jacobian)


def traverse_inverse(
    stack: LayerStack, points: Tensor, jacobian: bool
) -> tuple[Tensor, Tensor | None]:
    """f^-1(points) and, if asked for, the Jacobians of f^-1; no gradients."""
    tables = compiled_tables(stack, points.dtype, inverse=True)
    location = compiled_location(stack, points.dtype)
    return run(points, tables, location, stack.mesh, jacobian)


def run(
    points: Tensor,
    tables: Tables,
    location: Location | None,
    mesh: SquareMesh,
    jacobian: bool,
    found: np.ndarray | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Take points through all layers of the tables.

    Args:
        points: (n, 3), float32 or float64 on the CPU.
        tables: of the same dtype, in the order in which layers are met.
        location: of the inverse; None for the map itself, which locates at rest.
        mesh: the rest mesh.
        jacobian: are the Jacobians wanted?
        found: (K, n) int32, filled with each point's cell in each layer, if given.
    """
    x = np.ascontiguousarray(points.detach().numpy())
    y = np.empty_like(x)
    jac = np.empty((len(x) if jacobian else 0, 9), x.dtype)
    found = np.empty((0, 0), np.int32) if found is None else found
    compiled = _KERNELS[location is not None, jacobian]
    compiled(x, *tables, *(location or no_location(x.dtype)), mesh.resolution, y, jac, found)
    return torch.from_numpy(y), torch.from_numpy(jac).view(-1, 3, 3) if jacobian else None


_cache: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()


def compiled_tables(stack: LayerStack, dtype: torch.dtype, *, inverse: bool) -> Tables:
    """A stack's tables in one dtype; made once, and dropped together with the stack."""

    def make() -> Tables:
        with torch.no_grad():
            if inverse:
                return as_tables(
                    stack.inverse_tables.flip(0).to(dtype), stack.inverse_transitions.to(dtype)
                )
            from implicit_warp.numba_tables import tabulate

            return as_tables(
                tabulate(stack.embeddings, stack.mesh, dtype), stack.transitions.to(dtype)
            )

    return _once(stack, (dtype, "inverse" if inverse else "forward"), make)


def compiled_location(stack: LayerStack, dtype: torch.dtype) -> Location:
    """What the inverse of a stack needs to find cells; made once."""

    def make() -> Location:
        return location_of(stack, compiled_tables(stack, dtype, inverse=True).cells)

    return _once(stack, (dtype, "location"), make)


def as_tables(cells: Tensor, transitions: Tensor) -> Tables:
    """The kernels' view of tensors (K, C, 6) and (K + 1, 3, 4)."""
    flat = (np.ascontiguousarray(t.detach().flatten(1).numpy()) for t in (cells, transitions))
    return Tables(*flat)


def _once(stack: LayerStack, key: tuple, make: Callable[[], Any]) -> Any:
    parts = _cache.setdefault(stack, {})
    if key not in parts:
        parts[key] = make()
    return parts[key]


@inlined
def _move(t, uv, x, y, z, m):
    """(x, y, z) = a transition of (u, v, z)."""
    t00, t01, t02, t03 = t[0], t[1], t[2], t[3]
    t10, t11, t12, t13 = t[4], t[5], t[6], t[7]
    t20, t21, t22, t23 = t[8], t[9], t[10], t[11]
    for i in range(m):
        p, q, r = uv[2 * i], uv[2 * i + 1], z[i]
        x[i] = t00 * p + t01 * q + t02 * r + t03
        y[i] = t10 * p + t11 * q + t12 * r + t13
        z[i] = t20 * p + t21 * q + t22 * r + t23


@inlined
def _turn(t, jac, m):
    """Multiply the Jacobians (9, m) of a block by a transition, from the left."""
    t00, t01, t02 = t[0], t[1], t[2]
    t10, t11, t12 = t[4], t[5], t[6]
    t20, t21, t22 = t[8], t[9], t[10]
    for c in range(3):
        for i in range(m):
            p, q, r = jac[c, i], jac[c + 3, i], jac[c + 6, i]
            jac[c, i] = t00 * p + t01 * q + t02 * r
            jac[c + 3, i] = t10 * p + t11 * q + t12 * r
            jac[c + 6, i] = t20 * p + t21 * q + t22 * r


@inlined
def _turn_and_mix(t, linear, jac, m):
    """The same, and then by each point's plane map: plane rows mix, the normal row stays."""
    t00, t01, t02 = t[0], t[1], t[2]
    t10, t11, t12 = t[4], t[5], t[6]
    t20, t21, t22 = t[8], t[9], t[10]
    for i in range(m):
        a00, a01 = linear[4 * i], linear[4 * i + 1]
        a10, a11 = linear[4 * i + 2], linear[4 * i + 3]
        for c in range(3):
            p, q, r = jac[c, i], jac[c + 3, i], jac[c + 6, i]
            u = t00 * p + t01 * q + t02 * r
            v = t10 * p + t11 * q + t12 * r
            jac[c + 6, i] = t20 * p + t21 * q + t22 * r
            jac[c, i] = a00 * u + a01 * v
            jac[c + 3, i] = a10 * u + a11 * v


def _compile(inverse: bool, jacobian: bool):
    """The kernel of one operation: what it does not need is not there when it is compiled."""

    @point_kernel
    def traverse_points(
        points, cells, transitions, guesses, lines, sides, extent, forms, neighbours, resolution,
        out, jacobians, found,
    ):  # fmt: skip
        kind = points.dtype.type
        n_layers, n = len(cells), len(points)
        size = BLOCK_BYTES // points.itemsize
        for b in prange((n + size - 1) // size):
            x, y, z = np.empty(size, kind), np.empty(size, kind), np.empty(size, kind)
            uv, linear = np.empty(2 * size, kind), np.empty(4 * size, kind)
            at, jac = np.empty(size, np.int32), np.empty((9, size), kind)
            if inverse:
                p, q = np.empty(size, kind), np.empty(size, kind)
                other, which = np.empty(size, np.int32), np.empty(size, np.int32)
            start = b * size
            m = min(size, n - start)
            for i in range(m):
                uv[2 * i] = points[start + i, 0]
                uv[2 * i + 1] = points[start + i, 1]
                z[i] = points[start + i, 2]
            if jacobian:
                for c in range(9):
                    jac[c, :m] = kind(1.0) if c % 4 == 0 else kind(0.0)
            for k in range(n_layers):
                _move(transitions[k], uv, x, y, z, m)
                if inverse:
                    unsure = look_up(guesses[k], lines[k], sides, extent, x, y, at, which, m)
                    apply_cells(cells[k], at, x, y, uv, linear, m, jacobian)
                    correct(
                        unsure, cells[k], forms, neighbours, x, y, uv, at, which, p, q, other,
                        linear, jacobian, resolution,
                    )  # fmt: skip
                else:
                    locate(x, y, at, m, resolution)
                    apply_cells(cells[k], at, x, y, uv, linear, m, jacobian)
                if jacobian:
                    _turn_and_mix(transitions[k], linear, jac, m)
                if len(found):
                    found[k, start : start + m] = at[:m]
            _move(transitions[n_layers], uv, x, y, z, m)
            for i in range(m):
                out[start + i, 0] = x[i]
                out[start + i, 1] = y[i]
                out[start + i, 2] = z[i]
            if jacobian:
                _turn(transitions[n_layers], jac, m)
                for i in range(m):
                    for c in range(9):
                        jacobians[start + i, c] = jac[c, i]

    return traverse_points


_KERNELS = {
    (inverse, jacobian): _compile(inverse, jacobian)
    for inverse in (False, True)
    for jacobian in (False, True)
}
