"""Numba back end: map, inverse and Jacobians on the CPU.

Points go through all layers block by block, so that memory beyond the result stays constant.  A
block lies in registers-and-cache-sized arrays, one a coordinate; each layer is two loops: the
first moves into the layer's frame and stores the cell of each point, the second gathers that
cell's six numbers and applies them.  Split like this, LLVM vectorises both.

The inverse guesses a cell from a uniform grid over the image square, pulls the point back with it,
and locates the result at rest: the same cell means the guess was right.  The few that miss walk
over neighbouring cells.  A walk that does not end within its bound falls back to testing every
cell, so location always ends, in the right cell up to rounding.
"""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
import torch
from numba import prange
from torch import Tensor

from implicit_warp.jit import inlined, kernel, parallel_kernel, point_kernel
from implicit_warp.layers import LayerStack
from implicit_warp.square_mesh import SquareMesh

BLOCK = 512
"""Points a block: twelve float32 arrays of this length fit the first-level cache."""

GUESS_GRID = 128
"""Samples a side of the grid of guessed cells."""

_NUMPY = {torch.float32: np.float32, torch.float64: np.float64}


class _Tables(NamedTuple):
    """A stack as the kernels read it: contiguous, of one dtype."""

    cells: np.ndarray  # (K, C * 6) affine maps
    transitions: np.ndarray  # (K + 1, 12)


class _Location(NamedTuple):
    """What the inverse needs to find cells."""

    guesses: np.ndarray  # (K, G * G) int32
    forms: np.ndarray  # (C, 9) coordinates of a rest cell as affine forms
    neighbours: np.ndarray  # (C, 3) int32


def traverse(
    stack: LayerStack, points: Tensor, jacobian: bool, found: np.ndarray | None = None
) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3), and the Jacobians (n, 3, 3) if asked for.

    Args:
        stack: the layers.
        points: float32 or float64 on the CPU.
        jacobian: are the Jacobians wanted?
        found: (K, n) int32, filled with each point's cell in each layer, if given.
    """
    tables = _compiled(stack, points.dtype, "forward")
    x, y, jac = _arrays(points, jacobian)
    arguments = (x, *tables, stack.mesh.resolution, y)
    if jacobian:
        _map_with_jacobian(*arguments, jac, _NOWHERE if found is None else found)
        return torch.from_numpy(y), torch.from_numpy(jac)
    _map(*arguments, _NOWHERE if found is None else found)
    return torch.from_numpy(y), None


def traverse_inverse(
    stack: LayerStack, points: Tensor, jacobian: bool, found: np.ndarray | None = None
) -> tuple[Tensor, Tensor | None]:
    """f^-1(points) and the Jacobians of f^-1; arguments as for `traverse`.

    The layers, and so the rows of found, are met in reverse order.
    """
    tables = _compiled(stack, points.dtype, "inverse")
    location = _compiled(stack, points.dtype, "location")
    x, y, jac = _arrays(points, jacobian)
    found = _NOWHERE if found is None else found
    _invert(x, *tables, *location, stack.mesh.resolution, jacobian, y, jac, found)
    return torch.from_numpy(y), torch.from_numpy(jac) if jacobian else None


_NOWHERE = np.empty((0, 0), dtype=np.int32)


def _arrays(points: Tensor, jacobian: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    x = np.ascontiguousarray(points.detach().numpy())
    return x, np.empty_like(x), np.empty((len(x) if jacobian else 0, 3, 3), x.dtype)


_cache: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()


def _compiled(stack: LayerStack, dtype: torch.dtype, part: str):
    """Tables of a stack in one dtype; made once, and dropped together with the stack."""
    parts = _cache.setdefault(stack, {})
    key = (dtype, part)
    if key not in parts:
        if part == "location":
            parts[key] = _location(stack, dtype)
        elif part == "forward":
            parts[key] = _tables(stack.tables, stack.transitions, dtype)
        else:
            cells = stack.inverse_tables.flip(0)
            parts[key] = _tables(cells, stack.inverse_transitions, dtype)
    return parts[key]


def _tables(cells: Tensor, transitions: Tensor, dtype: torch.dtype) -> _Tables:
    def prepare(tensor: Tensor) -> np.ndarray:
        return np.ascontiguousarray(tensor.detach().to(dtype).flatten(1).numpy())

    return _Tables(prepare(cells), prepare(transitions))


def _location(stack: LayerStack, dtype: torch.dtype) -> _Location:
    mesh = stack.mesh
    tables = _compiled(stack, dtype, "inverse")
    forms = rest_forms(mesh).astype(_NUMPY[dtype]).reshape(-1, 9)
    neighbours = mesh.neighbours.astype(np.int32)
    guesses = np.empty((stack.n_layers, GUESS_GRID**2), dtype=np.int32)
    _guess(tables.cells, forms, neighbours, mesh.n_triangles, GUESS_GRID, guesses)
    return _Location(guesses, forms, neighbours)


def rest_forms(mesh: SquareMesh) -> np.ndarray:
    """(C, 3, 3) barycentric coordinates of each rest cell as affine forms (x, y, 1).

    A cone's coordinate at the origin changes sign, so that being inside any cell means that all
    three are non-negative.
    """
    corners = np.concatenate([mesh.vertices, np.zeros((1, 2))])[mesh.cells]
    homogeneous = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], -1)
    forms = np.linalg.inv(homogeneous).transpose(0, 2, 1)
    forms[mesh.n_triangles :, 0] *= -1.0
    return np.ascontiguousarray(forms)


@inlined
def _cell_at_rest(x, y, scale, last, one, half, zero, n_side):
    """The cell of the rest mesh that holds (x, y); straight-line code, so that it vectorises."""
    u = (x + one) * scale
    v = (y + one) * scale
    iu = np.int32(min(max(u, zero), last))
    iv = np.int32(min(max(v, zero), last))
    du = u - iu - half
    dv = v - iv - half
    # Which side of the two diagonals: +x 0, +y 1, -x 2, -y 3.
    e = np.int32(du + dv >= zero)
    f = np.int32(du - dv >= zero)
    side = np.int32(3) * (np.int32(1) - e) + (np.int32(1) - f) * (np.int32(2) * e - np.int32(1))
    triangle = (iu * n_side + iv) * np.int32(4) + side
    # Outside: the boundary edge that the ray from the origin leaves through.
    reach = max(abs(x), abs(y))
    vertical = abs(x) >= abs(y)
    along = y if vertical else x
    across = x if vertical else -y
    along = along if across > zero else -along
    step = np.int32(min(max((along / max(reach, one) + one) * scale, zero), last))
    turn = np.int32(1) if vertical else np.int32(0)
    turn += np.int32(0) if across > zero else np.int32(2)
    cone = np.int32(4) * n_side * n_side + turn * n_side + step
    return triangle if reach <= one else cone


@point_kernel
def _map(points, cells, transitions, resolution, out, found):
    kind = points.dtype.type
    zero, half, one = kind(0.0), kind(0.5), kind(1.0)
    n_side = np.int32(resolution - 1)
    scale, last = kind(0.5 * n_side), kind(n_side - 0.5)
    n_layers, n = len(cells), len(points)
    for b in prange((n + BLOCK - 1) // BLOCK):
        x = np.empty(BLOCK, points.dtype)
        y = np.empty(BLOCK, points.dtype)
        z = np.empty(BLOCK, points.dtype)
        at = np.empty(BLOCK, np.int32)
        start = b * BLOCK
        m = min(BLOCK, n - start)
        for i in range(m):
            x[i] = points[start + i, 0]
            y[i] = points[start + i, 1]
            z[i] = points[start + i, 2]
        for k in range(n_layers):
            _move(transitions[k], x, y, z, m)
            for i in range(m):
                at[i] = _cell_at_rest(x[i], y[i], scale, last, one, half, zero, n_side) * np.int32(
                    6
                )
            _apply_cells(cells[k], at, x, y, m)
            if len(found):
                for i in range(m):
                    found[k, start + i] = at[i] // np.int32(6)
        _move(transitions[n_layers], x, y, z, m)
        for i in range(m):
            out[start + i, 0] = x[i]
            out[start + i, 1] = y[i]
            out[start + i, 2] = z[i]


@inlined
def _move(t, x, y, z, m):
    """Apply a transition to a block in place."""
    t00, t01, t02, t03 = t[0], t[1], t[2], t[3]
    t10, t11, t12, t13 = t[4], t[5], t[6], t[7]
    t20, t21, t22, t23 = t[8], t[9], t[10], t[11]
    for i in range(m):
        p, q, r = x[i], y[i], z[i]
        x[i] = t00 * p + t01 * q + t02 * r + t03
        y[i] = t10 * p + t11 * q + t12 * r + t13
        z[i] = t20 * p + t21 * q + t22 * r + t23


@inlined
def _turn_columns(t, jac, m):
    """Multiply the Jacobians (9, m) of a block by a transition's linear part, from the left."""
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
def _apply_cells(table, at, x, y, m):
    """Apply each point's own cell; at holds six times the cell's index."""
    for i in range(m):
        a = at[i]
        p, q = x[i], y[i]
        x[i] = table[a] * p + table[a + 1] * q + table[a + 4]
        y[i] = table[a + 2] * p + table[a + 3] * q + table[a + 5]


@inlined
def _mix_columns(table, at, jac, m):
    """The same for Jacobians: the plane rows mix, the normal row stays."""
    for i in range(m):
        a = at[i]
        a00, a01, a10, a11 = table[a], table[a + 1], table[a + 2], table[a + 3]
        for c in range(3):
            p, q = jac[c, i], jac[c + 3, i]
            jac[c, i] = a00 * p + a01 * q
            jac[c + 3, i] = a10 * p + a11 * q


@point_kernel
def _map_with_jacobian(points, cells, transitions, resolution, out, jacobians, found):
    kind = points.dtype.type
    zero, half, one = kind(0.0), kind(0.5), kind(1.0)
    n_side = np.int32(resolution - 1)
    scale, last = kind(0.5 * n_side), kind(n_side - 0.5)
    n_layers, n = len(cells), len(points)
    for b in prange((n + BLOCK - 1) // BLOCK):
        x = np.empty(BLOCK, points.dtype)
        y = np.empty(BLOCK, points.dtype)
        z = np.empty(BLOCK, points.dtype)
        jac = np.zeros((9, BLOCK), points.dtype)
        at = np.empty(BLOCK, np.int32)
        start = b * BLOCK
        m = min(BLOCK, n - start)
        for i in range(m):
            x[i] = points[start + i, 0]
            y[i] = points[start + i, 1]
            z[i] = points[start + i, 2]
        jac[0, :m] = one
        jac[4, :m] = one
        jac[8, :m] = one
        for k in range(n_layers):
            _move(transitions[k], x, y, z, m)
            _turn_columns(transitions[k], jac, m)
            for i in range(m):
                at[i] = _cell_at_rest(x[i], y[i], scale, last, one, half, zero, n_side) * np.int32(
                    6
                )
            _mix_columns(cells[k], at, jac, m)
            _apply_cells(cells[k], at, x, y, m)
            if len(found):
                for i in range(m):
                    found[k, start + i] = at[i] // np.int32(6)
        _move(transitions[n_layers], x, y, z, m)
        _turn_columns(transitions[n_layers], jac, m)
        for i in range(m):
            out[start + i, 0] = x[i]
            out[start + i, 1] = y[i]
            out[start + i, 2] = z[i]
            for r in range(3):
                for c in range(3):
                    jacobians[start + i, r, c] = jac[3 * r + c, i]


@kernel
def _smallest_coordinate(forms, c, u, v):
    """The smallest coordinate of rest point (u, v) in cell c, and which one it is."""
    smallest = forms[c, 0] * u + forms[c, 1] * v + forms[c, 2]
    which = 0
    for j in range(1, 3):
        value = forms[c, 3 * j] * u + forms[c, 3 * j + 1] * v + forms[c, 3 * j + 2]
        if value < smallest:
            smallest = value
            which = j
    return smallest, which


@kernel
def _walk(table, forms, neighbours, x, y, cell):
    """The cell whose image holds (x, y), starting the search at a cell near by."""
    best, best_value = cell, -np.inf
    previous = -1
    for _ in range(64 + len(neighbours) // 8):
        a = 6 * cell
        u = table[a] * x + table[a + 1] * y + table[a + 4]
        v = table[a + 2] * x + table[a + 3] * y + table[a + 5]
        value, which = _smallest_coordinate(forms, cell, u, v)
        if value > best_value:
            best, best_value = cell, value
        if value >= 0.0:
            return cell
        onwards = neighbours[cell, which]
        if onwards == previous:
            # Each of two cells points at the other: the point lies on their edge, to rounding.
            return best
        previous, cell = cell, onwards
    for cell in range(len(neighbours)):
        a = 6 * cell
        u = table[a] * x + table[a + 1] * y + table[a + 4]
        v = table[a + 2] * x + table[a + 3] * y + table[a + 5]
        value, _ = _smallest_coordinate(forms, cell, u, v)
        if value > best_value:
            best, best_value = cell, value
    return best


@parallel_kernel
def _guess(cells, forms, neighbours, n_triangles, side, guesses):
    """Fill the guess grids: the cell of each sample's centre, found by walking along the rows."""
    for k in prange(len(cells)):
        table = cells[k]
        row = 0
        for i in range(side):
            x = (i + 0.5) * 2.0 / side - 1.0
            cell = row
            for j in range(side):
                y = (j + 0.5) * 2.0 / side - 1.0
                cell = _walk(table, forms, neighbours, x, y, cell)
                guesses[k, i * side + j] = cell
                if j == 0:
                    row = cell


@point_kernel
def _invert(
    points, cells, transitions, guesses, forms, neighbours, resolution, with_jacobian,
    out, jacobians, found,
):  # fmt: skip
    kind = points.dtype.type
    zero, half, one = kind(0.0), kind(0.5), kind(1.0)
    n_side = np.int32(resolution - 1)
    scale, last = kind(0.5 * n_side), kind(n_side - 0.5)
    grid, grid_scale, grid_last = (
        np.int32(GUESS_GRID),
        kind(0.5 * GUESS_GRID),
        kind(GUESS_GRID - 0.5),
    )
    n_layers, n = len(cells), len(points)
    for b in prange((n + BLOCK - 1) // BLOCK):
        x = np.empty(BLOCK, points.dtype)
        y = np.empty(BLOCK, points.dtype)
        z = np.empty(BLOCK, points.dtype)
        u = np.empty(BLOCK, points.dtype)
        v = np.empty(BLOCK, points.dtype)
        jac = np.zeros((9, BLOCK), points.dtype)
        at = np.empty(BLOCK, np.int32)
        missed = np.empty(BLOCK, np.int32)
        start = b * BLOCK
        m = min(BLOCK, n - start)
        for i in range(m):
            x[i] = points[start + i, 0]
            y[i] = points[start + i, 1]
            z[i] = points[start + i, 2]
        jac[0, :m] = one
        jac[4, :m] = one
        jac[8, :m] = one
        for k in range(n_layers):
            _move(transitions[k], x, y, z, m)
            if with_jacobian:
                _turn_columns(transitions[k], jac, m)
            table = cells[k]
            guess = guesses[k]
            for i in range(m):
                # Points outside the square are guessed from where their ray leaves it.
                shrink = one / max(max(abs(x[i]), abs(y[i])), one)
                gu = np.int32(min((x[i] * shrink + one) * grid_scale, grid_last))
                gv = np.int32(min((y[i] * shrink + one) * grid_scale, grid_last))
                at[i] = guess[gu * grid + gv]
            for i in range(m):
                a = at[i] * np.int32(6)
                p, q = x[i], y[i]
                u[i] = table[a] * p + table[a + 1] * q + table[a + 4]
                v[i] = table[a + 2] * p + table[a + 3] * q + table[a + 5]
            for i in range(m):
                cell = _cell_at_rest(u[i], v[i], scale, last, one, half, zero, n_side)
                missed[i] = cell - at[i]
            for i in range(m):
                if missed[i] != 0:
                    cell = _walk(table, forms, neighbours, x[i], y[i], at[i])
                    at[i] = cell
                    a = 6 * cell
                    u[i] = table[a] * x[i] + table[a + 1] * y[i] + table[a + 4]
                    v[i] = table[a + 2] * x[i] + table[a + 3] * y[i] + table[a + 5]
            if len(found):
                found[k, start : start + m] = at[:m]
            for i in range(m):
                x[i] = u[i]
                y[i] = v[i]
                at[i] *= np.int32(6)
            if with_jacobian:
                _mix_columns(table, at, jac, m)
        _move(transitions[n_layers], x, y, z, m)
        if with_jacobian:
            _turn_columns(transitions[n_layers], jac, m)
        for i in range(m):
            out[start + i, 0] = x[i]
            out[start + i, 1] = y[i]
            out[start + i, 2] = z[i]
            if with_jacobian:
                for r in range(3):
                    for c in range(3):
                        jacobians[start + i, r, c] = jac[3 * r + c, i]
