"""Numba back end: map, inverse and Jacobians on the CPU.

Points go through all layers block by block, so that memory beyond the result stays constant.  A
block lies in arrays of the size of the first-level cache, one a coordinate; each layer is a few
loops over the block: one moves into the layer's frame, one locates the cell of each point (both
vectorise), and one looks up that cell's six numbers and applies them.

The inverse guesses a cell from a uniform grid over the image square, pulls the point back with it,
and locates the result at rest: the same cell means the guess was right.  Points that miss try the
cell in which they were located instead; the few that miss again walk over neighbouring cells.  A
walk that does not end within its bound falls back to testing every cell, so location always ends,
in the right cell up to rounding.

For developers: Numba's cache of a compiled function does not notice changes in functions of other
modules.  After editing the pieces here that `numba_gradients` uses, or `jit`, delete this
folder's `__pycache__`.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import torch
from numba import prange
from torch import Tensor

from fields.jit import inlined, kernel, parallel_kernel, point_kernel
from implicit_warp.layers import LayerStack
from implicit_warp.square_mesh import SquareMesh, rest_forms

BLOCK = 512
"""Points a block: twelve float32 arrays of this length fit the first-level cache."""

GUESS_GRID = 96
"""Samples a side of the grid of guessed cells: small enough for the first-level cache."""

_NUMPY = {torch.float32: np.float32, torch.float64: np.float64}


class Tables(NamedTuple):
    """A stack as the kernels read it: contiguous, of one dtype."""

    cells: np.ndarray  # (K, C * 6) affine maps
    transitions: np.ndarray  # (K + 1, 12)


class Location(NamedTuple):
    """What the inverse needs to find cells."""

    guesses: np.ndarray  # (K, G * G), as narrow as the number of cells allows
    forms: np.ndarray  # (C, 9) coordinates of a rest cell as affine forms
    neighbours: np.ndarray  # (C, 3) int32


def traverse(stack: LayerStack, points: Tensor, jacobian: bool) -> tuple[Tensor, Tensor | None]:
    """f(points) for points (n, 3) and, if asked for, the Jacobians (n, 3, 3); no gradients."""
    tables = compiled_tables(stack, points.dtype, inverse=False)
    return run(points, tables, nowhere(points.dtype), stack.mesh, jacobian)


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
    location: Location,
    mesh: SquareMesh,
    jacobian: bool,
    found: np.ndarray | None = None,
) -> tuple[Tensor, Tensor | None]:
    """Take points through all layers of the tables.

    Args:
        points: (n, 3), float32 or float64 on the CPU.
        tables: of the same dtype, in the order in which layers are met.
        location: of the inverse; `nowhere` for the map itself.
        mesh: the rest mesh.
        jacobian: are the Jacobians wanted?
        found: (K, n) int32, filled with each point's cell in each layer, if given.
    """
    x = np.ascontiguousarray(points.detach().numpy())
    y = np.empty_like(x)
    jac = np.empty((len(x) if jacobian else 0, 9), x.dtype)
    found = np.empty((0, 0), np.int32) if found is None else found
    compiled = _KERNELS[len(location.guesses) > 0, jacobian]
    compiled(x, *tables, *location, mesh.resolution, y, jac, found)
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
        mesh = stack.mesh
        cells = compiled_tables(stack, dtype, inverse=True).cells
        forms = rest_forms(mesh).astype(_NUMPY[dtype]).reshape(-1, 9)
        neighbours = mesh.neighbours.astype(np.int32)
        guesses = np.empty((stack.n_layers, GUESS_GRID**2), np.min_scalar_type(mesh.n_cells))
        _guess(cells, forms, neighbours, GUESS_GRID, guesses)
        return Location(guesses, forms, neighbours)

    return _once(stack, (dtype, "location"), make)


@lru_cache(maxsize=2)
def nowhere(dtype: torch.dtype) -> Location:
    """The location of a traversal that needs none, because it locates at rest."""
    no_guesses = np.empty((0, 0), np.uint16)
    return Location(no_guesses, np.empty((0, 9), _NUMPY[dtype]), np.empty((0, 3), np.int32))


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
def _clamped(value, low, high):
    """Value within [low, high]; low if it is NaN, whose conversion to an integer is undefined."""
    above = value if value > low else low
    return above if above < high else high


@inlined
def _cell_at_rest(x, y, scale, last, one, half, zero, n_side):
    """The cell of the rest mesh that holds (x, y); straight-line code, so that it vectorises.

    Whatever x and y are, the cell exists: NaN fails every comparison and so ends up as zero.
    """
    u = (x + one) * scale
    v = (y + one) * scale
    iu = np.int32(_clamped(u, zero, last))
    iv = np.int32(_clamped(v, zero, last))
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
    step = np.int32(_clamped((along / max(reach, one) + one) * scale, zero, last))
    turn = np.int32(1) if vertical else np.int32(0)
    turn += np.int32(0) if across > zero else np.int32(2)
    cone = np.int32(4) * n_side * n_side + turn * n_side + step
    return triangle if reach <= one else cone


@inlined
def _locate(x, y, at, m, resolution):
    """at = the rest cell of every point of a block."""
    kind = x.dtype.type
    zero, half, one = kind(0.0), kind(0.5), kind(1.0)
    n_side = np.int32(resolution - 1)
    scale, last = kind(0.5 * n_side), kind(n_side - 0.5)
    for i in range(m):
        at[i] = _cell_at_rest(x[i], y[i], scale, last, one, half, zero, n_side)


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
def _apply_cell(table, cell, x, y, u, v, linear, i, keep):
    """(u, v) = the cell's map of point i of a block; its 2x2 part goes to linear (4, m)."""
    a = cell * np.int32(6)
    p, q = x[i], y[i]
    a00, a01, a10, a11 = table[a], table[a + 1], table[a + 2], table[a + 3]
    u[i] = a00 * p + a01 * q + table[a + 4]
    v[i] = a10 * p + a11 * q + table[a + 5]
    if keep:
        linear[0, i] = a00
        linear[1, i] = a01
        linear[2, i] = a10
        linear[3, i] = a11


@inlined
def apply_cells(table, at, x, y, u, v, linear, m, keep):
    """(u, v) = each point's own cell applied to (x, y), which may be the same arrays.

    The loop ends early at a cell beyond the table, which there never is: without that exit LLVM
    spreads the gathers over vector lanes, one load and one insertion each, which was measured to
    cost half as much again (Zen 4; its hardware gathers are slower still).
    """
    i = 0
    while i < m:
        if at[i] >= len(table):
            break
        _apply_cell(table, at[i], x, y, u, v, linear, i, keep)
        i += 1


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
    for c in range(3):
        for i in range(m):
            p, q, r = jac[c, i], jac[c + 3, i], jac[c + 6, i]
            u = t00 * p + t01 * q + t02 * r
            v = t10 * p + t11 * q + t12 * r
            jac[c + 6, i] = t20 * p + t21 * q + t22 * r
            jac[c, i] = linear[0, i] * u + linear[1, i] * v
            jac[c + 3, i] = linear[2, i] * u + linear[3, i] * v


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
def _guess(cells, forms, neighbours, side, guesses):
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


@inlined
def _pull_back_guess(table, guess, x, y, at, u, v, linear, m, keep):
    """(u, v) = the guessed cell of every point applied to it; at = that cell.

    Points outside the square are guessed from where their ray leaves it.
    """
    kind = x.dtype.type
    zero, one = kind(0.0), kind(1.0)
    scale, last = kind(0.5 * GUESS_GRID), kind(GUESS_GRID - 0.5)
    side = np.int32(GUESS_GRID)
    for i in range(m):
        shrink = one / max(max(abs(x[i]), abs(y[i])), one)
        gu = np.int32(_clamped((x[i] * shrink + one) * scale, zero, last))
        gv = np.int32(_clamped((y[i] * shrink + one) * scale, zero, last))
        at[i] = gu * side + gv
    i = 0
    while i < m:
        cell = np.int32(guess[at[i]])
        if cell >= len(table):  # never: see apply_cells
            break
        at[i] = cell
        _apply_cell(table, cell, x, y, u, v, linear, i, keep)
        i += 1


@inlined
def _correct(
    table, forms, neighbours, x, y, u, v, at, found, which, p, q, linear, m, keep, resolution
):
    """Mend the points whose guess was wrong: found is where their (u, v) lies at rest.

    Nearly always that is the right cell: a guess is off by one edge, beyond which the true map
    continues the guessed one.  Those points are tried again together, with their pulled-back
    places in (p, q), so that location vectorises; the few that miss a second time walk.
    """
    missed = 0
    for i in range(m):
        which[missed] = i
        missed += np.int32(found[i] != at[i])
    for j in range(missed):
        i = which[j]
        at[i] = found[i]
        _apply_cell(table, at[i], x, y, u, v, linear, i, keep)
        p[j] = u[i]
        q[j] = v[i]
    _locate(p, q, found, missed, resolution)
    for j in range(missed):
        i = which[j]
        if found[j] != at[i]:
            at[i] = _walk(table, forms, neighbours, x[i], y[i], at[i])
            _apply_cell(table, at[i], x, y, u, v, linear, i, keep)


def _compile(inverse: bool, jacobian: bool):
    """The kernel of one operation: what it does not need is not there when it is compiled."""

    @point_kernel
    def traverse_points(
        points, cells, transitions, guesses, forms, neighbours, resolution, out, jacobians, found
    ):
        kind = points.dtype.type
        n_layers, n = len(cells), len(points)
        for b in prange((n + BLOCK - 1) // BLOCK):
            x, y, z = np.empty(BLOCK, kind), np.empty(BLOCK, kind), np.empty(BLOCK, kind)
            at = np.empty(BLOCK, np.int32)
            start = b * BLOCK
            m = min(BLOCK, n - start)
            for i in range(m):
                x[i] = points[start + i, 0]
                y[i] = points[start + i, 1]
                z[i] = points[start + i, 2]
            linear, jac = np.empty((4, BLOCK), kind), np.zeros((9, BLOCK), kind)
            if jacobian:
                for c in range(0, 9, 4):
                    jac[c, :m] = kind(1.0)
            if inverse:
                u, v = np.empty(BLOCK, kind), np.empty(BLOCK, kind)
                p, q = np.empty(BLOCK, kind), np.empty(BLOCK, kind)
                other, which = np.empty(BLOCK, np.int32), np.empty(BLOCK + 1, np.int32)
            for k in range(n_layers):
                _move(transitions[k], x, y, z, m)
                if inverse:
                    _pull_back_guess(cells[k], guesses[k], x, y, at, u, v, linear, m, jacobian)
                    _locate(u, v, other, m, resolution)
                    _correct(
                        cells[k], forms, neighbours, x, y, u, v, at, other, which, p, q, linear,
                        m, jacobian, resolution,
                    )  # fmt: skip
                    for i in range(m):
                        x[i] = u[i]
                        y[i] = v[i]
                else:
                    _locate(x, y, at, m, resolution)
                    apply_cells(cells[k], at, x, y, x, y, linear, m, jacobian)
                if jacobian:
                    _turn_and_mix(transitions[k], linear, jac, m)
                if len(found):
                    found[k, start : start + m] = at[:m]
            _move(transitions[n_layers], x, y, z, m)
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
