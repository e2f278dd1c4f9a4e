"""Which cell a point lies in, at rest and in a layer's image: pieces of the Numba kernels.

At rest that is a floor and a few comparisons.  In the image it is looked up in a uniform grid over
the square.  A sample of that grid names the one edge of the image mesh that passes through it, or
one of the edges of the cell that it lies in; the side of that edge's line on which a point lies is
its cell.  Where several edges pass, that is a guess: those points are pulled back with the guessed
cell and located at rest, where the same cell means that the guess was right.  Points that miss try
the cell in which they were located instead; the few that miss again walk over neighbouring cells.
A walk that does not end within its bound falls back to testing every cell, so location always ends,
in the right cell up to rounding.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import prange

from fields.jit import inlined, kernel, parallel_kernel
from implicit_warp.layers import LayerStack
from implicit_warp.numba_rows import apply_cell
from implicit_warp.square_mesh import cell_edges, rest_forms

GUESS_GRID = 96
"""Samples a side of the grid of the inverse.  Coarser, more samples hold several edges (at N = 11,
11 in 100 points fall into such at 96, 21 at 64); finer, the grids of all layers leave the cache."""

_MARGIN = 1e-4
"""Of a sample, by which edges count as passing through it that pass it by: far above rounding."""

_VECTORS = 64
"""Points that a vectorised loop takes at a time, or a multiple of that; divides every block."""

_TRIES = 2
"""Locations at rest, of all points that missed together, before those that miss still walk."""


class Location(NamedTuple):
    """What the inverse needs to find cells."""

    guesses: np.ndarray  # (K, G * G) twice an edge, plus one if others pass too; narrow
    lines: np.ndarray  # (K, L * 3) of the edges: a x + b y + c, positive on the left
    sides: np.ndarray  # (L * 2,) uint32 cells to the right and left of each edge
    extent: float  # half the side of the square that the grids cover
    forms: np.ndarray  # (C, 9) coordinates of a rest cell as affine forms
    neighbours: np.ndarray  # (C, 3) int32


def location_of(stack: LayerStack, cells: np.ndarray) -> Location:
    """What the inverse of a stack needs to find cells.

    Args:
        stack: of layers.
        cells: (K, C * 6) its inverse tables, in the order in which the inverse meets the layers.
    """
    mesh, kind = stack.mesh, cells.dtype
    forms = rest_forms(mesh).astype(kind).reshape(-1, 9)
    neighbours = mesh.neighbours.astype(np.int32)
    edges = cell_edges(mesh)
    u = stack.embeddings.detach().double().flip(0).numpy()
    # Boundaries lie on the square's outline or within, but nothing here depends on that.
    extent = float(np.abs(u).max(initial=1.0))
    lines = np.empty((len(u), len(edges.ends), 3))
    guesses = np.empty((len(u), GUESS_GRID**2), np.min_scalar_type(2 * len(edges.ends)))
    _draw(u, *edges, cells, forms, neighbours, extent, lines, guesses)
    flat = lines.reshape(len(u), -1).astype(kind)
    sides = edges.sides.ravel().astype(np.uint32)
    return Location(guesses, flat, sides, extent, forms, neighbours)


@lru_cache(maxsize=2)
def no_location(kind: np.dtype) -> Location:
    """What stands for it in a traversal that locates at rest."""
    return Location(
        np.empty((0, 0), np.uint16), np.empty((0, 0), kind), np.empty(0, np.uint32), 1.0,
        np.empty((0, 9), kind), np.empty((0, 3), np.int32),
    )  # fmt: skip


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
def locate(x, y, at, m, resolution):
    """at = the rest cell of every point of a block."""
    kind = x.dtype.type
    zero, half, one = kind(0.0), kind(0.5), kind(1.0)
    n_side = np.int32(resolution - 1)
    scale, last = kind(0.5 * n_side), kind(n_side - 0.5)
    for i in range(m):
        at[i] = _cell_at_rest(x[i], y[i], scale, last, one, half, zero, n_side)


@kernel
def _smallest_coordinate(table, forms, c, x, y):
    """The smallest coordinate in cell c of the point whose image is (x, y), and its number."""
    a = 6 * c
    u = table[a] * x + table[a + 1] * y + table[a + 4]
    v = table[a + 2] * x + table[a + 3] * y + table[a + 5]
    smallest = forms[c, 0] * u + forms[c, 1] * v + forms[c, 2]
    which = 0
    for j in range(1, 3):
        value = forms[c, 3 * j] * u + forms[c, 3 * j + 1] * v + forms[c, 3 * j + 2]
        if value < smallest:
            smallest = value
            which = j
    return smallest, which


@kernel
def walk(table, forms, neighbours, x, y, cell):
    """The cell whose image holds (x, y), starting the search at a cell near by."""
    best, best_value = cell, -np.inf
    previous = -1
    for _ in range(64 + len(neighbours) // 8):
        value, which = _smallest_coordinate(table, forms, cell, x, y)
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
        value, _ = _smallest_coordinate(table, forms, cell, x, y)
        if value > best_value:
            best, best_value = cell, value
    return best


@parallel_kernel
def _draw(embeddings, ends, sides, of_cell, cells, forms, neighbours, extent, lines, guesses):
    """Draw every layer's edges into its grid: fill lines (K, L, 3) and guesses (K, G * G)."""
    for k in prange(len(embeddings)):
        passing = np.zeros(GUESS_GRID * GUESS_GRID, np.int32)
        _draw_edges(embeddings[k], ends, extent, lines[k], guesses[k], passing)
        _fill_between(
            lines[k], sides, of_cell, cells[k], forms, neighbours, extent, passing, guesses[k]
        )


@kernel
def _draw_edges(u, ends, extent, lines, guess, passing):
    """Count the edges that pass through each sample, and enter the one nearest to its centre."""
    size = 2.0 * extent / GUESS_GRID
    margin = _MARGIN * size
    nearest = np.full(len(guess), np.inf)
    for e in range(len(ends)):
        px, py, qx, qy = _segment(u, ends[e, 0], ends[e, 1], extent, lines[e])
        if px > qx:
            px, py, qx, qy = qx, qy, px, py
        slope = (qy - py) / (qx - px) if qx > px else 0.0
        for i in range(_sample(px - margin, extent), _sample(qx + margin, extent) + 1):
            # The part of the edge within this row of samples.
            low = py + slope * (max(px, i * size - extent - margin) - px)
            high = py + slope * (min(qx, (i + 1) * size - extent + margin) - px)
            if qx == px:
                high = qy
            if low > high:
                low, high = high, low
            for j in range(_sample(low - margin, extent), _sample(high + margin, extent) + 1):
                at = i * GUESS_GRID + j
                passing[at] += 1
                distance = abs(_height(lines[e], i, j, size, extent))
                if distance < nearest[at]:
                    nearest[at] = distance
                    guess[at] = 2 * e


@kernel
def _segment(u, first, second, extent, line):
    """The ends (px, py, qx, qy) of an edge within the grid's square; its line is filled in."""
    origin = len(u)
    px, py = (0.0, 0.0) if first == origin else (u[first, 0], u[first, 1])
    qx, qy = (0.0, 0.0) if second == origin else (u[second, 0], u[second, 1])
    length = np.hypot(qx - px, qy - py)
    line[0], line[1] = (py - qy) / length, (qx - px) / length
    line[2] = (px * qy - py * qx) / length
    if first == origin:
        onwards = extent / max(abs(qx), abs(qy))
        px, py = onwards * qx, onwards * qy
    elif second == origin:
        onwards = extent / max(abs(px), abs(py))
        qx, qy = onwards * px, onwards * py
    return px, py, qx, qy


@kernel
def _sample(coordinate, extent):
    """The row or column of samples that a coordinate lies in."""
    place = (coordinate + extent) * (0.5 * GUESS_GRID / extent)
    return int(min(max(place, 0.0), GUESS_GRID - 1.0))


@kernel
def _height(line, i, j, size, extent):
    """Of the centre of sample (i, j) above a line."""
    return line[0] * ((i + 0.5) * size - extent) + line[1] * ((j + 0.5) * size - extent) + line[2]


@kernel
def _fill_between(lines, sides, of_cell, table, forms, neighbours, extent, passing, guess):
    """Enter an edge of their cell where no edge passes, and mark where several do."""
    size = 2.0 * extent / GUESS_GRID
    cell = 0
    for i in range(GUESS_GRID):
        for j in range(GUESS_GRID):
            at = i * GUESS_GRID + j
            if passing[at] == 0:
                x, y = (i + 0.5) * size - extent, (j + 0.5) * size - extent
                cell = walk(table, forms, neighbours, x, y, cell)
                guess[at] = 2 * of_cell[cell]
            else:
                e = guess[at] // 2
                cell = sides[e, int(_height(lines[e], i, j, size, extent) >= 0.0)]
                if passing[at] > 1:
                    guess[at] += 1


@inlined
def look_up(guess, lines, sides, extent, x, y, at, which, m):
    """at = the cell of every point of a block; returns how many are unsure, listed in which.

    Points outside the grid's square are looked up where their ray from the origin leaves it.
    """
    kind = x.dtype.type
    zero = kind(0.0)
    reach, last = kind(extent), kind(GUESS_GRID - 0.5)
    scale = kind(0.5 * GUESS_GRID / extent)
    side = np.int32(GUESS_GRID)
    for i in range(m):
        shrink = reach / max(max(abs(x[i]), abs(y[i])), reach)
        gu = np.int32(_clamped((x[i] * shrink + reach) * scale, zero, last))
        gv = np.int32(_clamped((y[i] * shrink + reach) * scale, zero, last))
        at[i] = gu * side + gv
    # Unsigned, because for a signed index it is asked each time whether it counts from the end.
    unsure, two, three = np.uint32(0), np.uint32(2), np.uint32(3)
    for i in range(m):
        word = np.uint32(guess[np.uint32(at[i])])
        which[unsure] = i
        unsure += word & np.uint32(1)
        edge = word >> np.uint32(1)
        a = three * edge
        height = lines[a] * x[i] + (lines[a + np.uint32(1)] * y[i] + lines[a + two])
        at[i] = np.int32(sides[two * edge + np.uint32(height >= zero)])
    return np.intp(unsure)


@inlined
def correct(
    unsure, table, forms, neighbours, x, y, uv, at, which, p, q, found, linear, keep, resolution
):
    """Mend the unsure points whose cell is wrong: the right one is where (u, v) lies at rest.

    Nearly always that is so at once: a guess is off by one edge, beyond which the true map
    continues the guessed one.  So points are tried again together, with their pulled-back places
    in (p, q), and the few that still miss walk.
    """
    for j in range(unsure):
        i = which[j]
        p[j], q[j] = uv[2 * i], uv[2 * i + 1]
    for attempt in range(_TRIES):
        # A whole number of vectors: what is left over would be located one by one.
        locate(p, q, found, (unsure + _VECTORS - 1) // _VECTORS * _VECTORS, resolution)
        missed = 0
        for j in range(unsure):
            i, cell = which[j], found[j]
            which[missed], found[missed] = i, cell
            missed += np.intp(cell != at[i])
        if missed == 0 or attempt == _TRIES - 1:
            break
        unsure = missed
        for j in range(unsure):
            i = which[j]
            at[i] = found[j]
            apply_cell(table, at[i], x, y, uv, linear, i, keep)
            p[j], q[j] = uv[2 * i], uv[2 * i + 1]
    for j in range(missed):
        i = which[j]
        at[i] = walk(table, forms, neighbours, x[i], y[i], found[j])
        apply_cell(table, at[i], x, y, uv, linear, i, keep)
