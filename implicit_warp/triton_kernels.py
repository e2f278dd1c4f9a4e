"""The CUDA kernels, in Triton; `triton_backend` launches them.

One program takes a block of points through all layers.  A point is three tensors, a Jacobian
three columns of three; both are tuples, which exist only while compiling.

Layouts, chosen so that neighbouring lanes read neighbouring addresses:

    tables (K, 6, C), forms (9, C), transitions (K + 1, 12), guesses (K, G * G),
    found (K, n).

**Where a layer's table is read from.**  The gathers of `cell_map` decide the speed.  Two ways are
written, behind one flag: from global memory, which the first-level cache of each multiprocessor
holds (a layer of resolution 11 has 10.6 kB in float32), or from shared memory by `tl.gather`,
which stores the layer's six columns there anew for each block and layer.  The first is the default:
it is the plainest code, has no limit on the resolution, and needs no barrier.  On paper shared
memory wins for points in random order: one scattered load costs the cache up to one cycle for each
128-byte line touched (14 in a column of 440 numbers), and 32 banks serve random lanes in about 4.
Neither was timed on a GPU yet.

Arithmetic that decides an index is written so that no value, NaN and infinity included, leads
outside a table.
"""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def transition(transitions, k):
    """The twelve numbers of transition k, the same for every lane."""
    t = transitions + 12 * k
    return (
        tl.load(t), tl.load(t + 1), tl.load(t + 2), tl.load(t + 3),
        tl.load(t + 4), tl.load(t + 5), tl.load(t + 6), tl.load(t + 7),
        tl.load(t + 8), tl.load(t + 9), tl.load(t + 10), tl.load(t + 11),
    )  # fmt: skip


@triton.jit
def turn(t, v):
    """The linear part of a transition."""
    return (
        t[0] * v[0] + t[1] * v[1] + t[2] * v[2],
        t[4] * v[0] + t[5] * v[1] + t[6] * v[2],
        t[8] * v[0] + t[9] * v[1] + t[10] * v[2],
    )


@triton.jit
def move(t, p):
    """The whole transition."""
    return (
        t[0] * p[0] + t[1] * p[1] + t[2] * p[2] + t[3],
        t[4] * p[0] + t[5] * p[1] + t[6] * p[2] + t[7],
        t[8] * p[0] + t[9] * p[1] + t[10] * p[2] + t[11],
    )


@triton.jit
def _column(column, cell, N_CELLS: tl.constexpr, SHARED: tl.constexpr, PADDED: tl.constexpr):
    """Gather one number for each lane's cell; the place to change the gather's strategy."""
    if SHARED:
        entry = tl.arange(0, PADDED)
        return tl.gather(tl.load(column + entry, mask=entry < N_CELLS, other=0.0), cell, 0)
    return tl.load(column + cell)


@triton.jit
def cell_map(table, cell, N_CELLS: tl.constexpr, SHARED: tl.constexpr, PADDED: tl.constexpr):
    """Each lane's (a00, a01, a10, a11, d0, d1)."""
    return (
        _column(table, cell, N_CELLS, SHARED, PADDED),
        _column(table + N_CELLS, cell, N_CELLS, SHARED, PADDED),
        _column(table + 2 * N_CELLS, cell, N_CELLS, SHARED, PADDED),
        _column(table + 3 * N_CELLS, cell, N_CELLS, SHARED, PADDED),
        _column(table + 4 * N_CELLS, cell, N_CELLS, SHARED, PADDED),
        _column(table + 5 * N_CELLS, cell, N_CELLS, SHARED, PADDED),
    )


@triton.jit
def mix(a, v):
    """A cell's linear part: the plane coordinates mix, the normal one stays."""
    return a[0] * v[0] + a[1] * v[1], a[2] * v[0] + a[3] * v[1], v[2]


@triton.jit
def apply(a, p):
    """A cell's affine map."""
    return a[0] * p[0] + a[1] * p[1] + a[4], a[2] * p[0] + a[3] * p[1] + a[5], p[2]


@triton.jit
def _slot(u, LAST: tl.constexpr):
    """floor(u) cut off to 0 ... LAST; 0 for NaN."""
    return tl.where(u > 0.0, tl.minimum(u, LAST + 0.5), 0.0).to(tl.int32)


@triton.jit
def _cell_at_rest(x, y, N_SIDE: tl.constexpr):
    """The cell of the rest mesh that holds (x, y), without branches (see `square_mesh`)."""
    u = (x + 1.0) * (0.5 * N_SIDE)
    v = (y + 1.0) * (0.5 * N_SIDE)
    i = _slot(u, N_SIDE - 1)
    j = _slot(v, N_SIDE - 1)
    du = u - i.to(u.dtype) - 0.5
    dv = v - j.to(v.dtype) - 0.5
    # Which side of the two diagonals: +x 0, +y 1, -x 2, -y 3.
    beyond = du + dv >= 0.0
    right = du - dv >= 0.0
    side = tl.where(beyond, tl.where(right, 0, 1), tl.where(right, 3, 2))
    triangle = (i * N_SIDE + j) * 4 + side
    # Outside: the boundary edge that the ray from the origin leaves through.
    reach = tl.maximum(tl.abs(x), tl.abs(y))
    vertical = tl.abs(x) >= tl.abs(y)
    along = tl.where(vertical, y, x)
    across = tl.where(vertical, x, -y)
    along = tl.where(across > 0.0, along, -along)
    step = _slot((along / tl.maximum(reach, 1.0) + 1.0) * (0.5 * N_SIDE), N_SIDE - 1)
    turn = tl.where(vertical, 1, 0) + tl.where(across > 0.0, 0, 2)
    cone = 4 * N_SIDE * N_SIDE + turn * N_SIDE + step
    return tl.where(reach <= 1.0, triangle, cone)


@triton.jit
def _smallest_coordinate(table, forms, cell, x, y, N_CELLS: tl.constexpr):
    """Pull (x, y) back by a cell: the smallest coordinate in it at rest, and which one it is.

    A coordinate's sign says on which side of an edge the point lies; all three are non-negative
    inside, for triangles and cones alike.  The cell is one a lane, or one for all.
    """
    a = cell_map(table, cell, N_CELLS, False, 1)
    u = a[0] * x + a[1] * y + a[4]
    v = a[2] * x + a[3] * y + a[5]
    f = forms + cell
    first = tl.load(f) * u + tl.load(f + N_CELLS) * v + tl.load(f + 2 * N_CELLS)
    f += 3 * N_CELLS
    second = tl.load(f) * u + tl.load(f + N_CELLS) * v + tl.load(f + 2 * N_CELLS)
    f += 3 * N_CELLS
    third = tl.load(f) * u + tl.load(f + N_CELLS) * v + tl.load(f + 2 * N_CELLS)
    which = tl.where(second < first, 1, 0)
    smallest = tl.minimum(first, second)
    return tl.minimum(smallest, third), tl.where(third < smallest, 2, which)


@triton.jit
def _find(
    table, forms, neighbours, x, y, start, searching,
    N_CELLS: tl.constexpr, STEPS: tl.constexpr,
):  # fmt: skip
    """The cells whose images hold the lanes that are searching, walking from a start near by.

    Each step crosses the edge that the point lies farthest beyond.  A step back to where one just
    came from means that the point lies on the edge between the two, to rounding, and the better
    cell is taken.  Lanes still under way after STEPS steps (walks round a vertex, to rounding, or
    in circles, which very uneven meshes allow) try every cell: so location always ends, in the
    right cell up to rounding.  Lanes that are not searching keep their start.
    """
    cell = start
    previous = start * 0 - 1
    best = start
    best_value = x * 0.0 - float("inf")
    step = 0
    while (step < STEPS) & (tl.max(searching.to(tl.int32), 0) > 0):
        value, which = _smallest_coordinate(table, forms, cell, x, y, N_CELLS)
        better = searching & (value > best_value)
        best = tl.where(better, cell, best)
        best_value = tl.where(better, value, best_value)
        onwards = tl.load(neighbours + which * N_CELLS + cell)
        searching = searching & (value < 0.0) & (onwards != previous)
        previous = tl.where(searching, cell, previous)
        cell = tl.where(searching, onwards, cell)
        step += 1
    if tl.max(searching.to(tl.int32), 0) > 0:
        for c in range(N_CELLS):
            value, _ = _smallest_coordinate(table, forms, c, x, y, N_CELLS)
            better = searching & (value > best_value)
            best = tl.where(better, c, best)
            best_value = tl.where(better, value, best_value)
    return best


@triton.jit
def _cell_in_image(
    table, guesses, forms, neighbours, x, y,
    N_SIDE: tl.constexpr, N_CELLS: tl.constexpr, GRID: tl.constexpr, STEPS: tl.constexpr,
):  # fmt: skip
    """The cells whose images hold (x, y).

    A cell is guessed from a grid, where points outside the square use the place where their ray
    leaves it.  The guess pulls the point back; if the result lies in that very cell at rest, the
    guess was right.  If not, the cell it lies in is the better guess, because the map beyond an
    edge nearly continues the map before it, and the search starts there.
    """
    shrink = 1.0 / tl.maximum(tl.maximum(tl.abs(x), tl.abs(y)), 1.0)
    i = _slot((x * shrink + 1.0) * (0.5 * GRID), GRID - 1)
    j = _slot((y * shrink + 1.0) * (0.5 * GRID), GRID - 1)
    guess = tl.load(guesses + i * GRID + j)
    a = cell_map(table, guess, N_CELLS, False, 1)
    u = a[0] * x + a[1] * y + a[4]
    v = a[2] * x + a[3] * y + a[5]
    at = _cell_at_rest(u, v, N_SIDE)
    return _find(table, forms, neighbours, x, y, at, at != guess, N_CELLS, STEPS)


@triton.jit
def fill_guesses(
    tables, forms, neighbours, guesses,
    N_SIDE: tl.constexpr, N_CELLS: tl.constexpr, GRID: tl.constexpr, STEPS: tl.constexpr,
    BLOCK: tl.constexpr,
):  # fmt: skip
    """guesses[k, i * G + j]: the cell at the centre of square (i, j) of layer k's guess grid."""
    k = tl.program_id(1)
    lane = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    inside = lane < GRID * GRID
    table = tables + k * (6 * N_CELLS)
    centre = ((lane // GRID) + 0.5) * (2.0 / GRID) - 1.0
    x = centre.to(tables.dtype.element_ty)
    centre = ((lane % GRID) + 0.5) * (2.0 / GRID) - 1.0
    y = centre.to(tables.dtype.element_ty)
    start = _cell_at_rest(x, y, N_SIDE)
    cell = _find(table, forms, neighbours, x, y, start, inside, N_CELLS, STEPS)
    tl.store(guesses + k * (GRID * GRID) + lane, cell, mask=inside)


@triton.jit
def load_three(rows, index, stride, step, mask):
    """Three numbers a lane, `step` apart."""
    at = rows + index * stride
    return (
        tl.load(at, mask=mask, other=0.0),
        tl.load(at + step, mask=mask, other=0.0),
        tl.load(at + 2 * step, mask=mask, other=0.0),
    )


@triton.jit
def store_three(rows, index, stride, step, v, mask):
    """The converse of `load_three`."""
    at = rows + index * stride
    tl.store(at, v[0], mask=mask)
    tl.store(at + step, v[1], mask=mask)
    tl.store(at + 2 * step, v[2], mask=mask)


@triton.jit(do_not_specialize=["n", "n_layers"])
def traverse(
    points, tables, transitions, guesses, forms, neighbours, image, jacobians, found, n, n_layers,
    N_SIDE: tl.constexpr, N_CELLS: tl.constexpr, GRID: tl.constexpr, STEPS: tl.constexpr,
    INVERSE: tl.constexpr, JACOBIAN: tl.constexpr, RECORD: tl.constexpr,
    SHARED: tl.constexpr, PADDED: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    """Points (n, 3) through all layers: image, jacobians if JACOBIAN, cells found if RECORD.

    With INVERSE, tables and transitions are the inverse's, and cells are looked for in the image.
    """
    index = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    mask = index < n
    p = load_three(points, index, 3, 1, mask)
    zero, one = p[0] * 0.0, p[0] * 0.0 + 1.0
    ju, jv, jw = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for k in range(n_layers):
        t = transition(transitions, k)
        table = tables + k * (6 * N_CELLS)
        p = move(t, p)
        if INVERSE:
            cell = _cell_in_image(
                table, guesses + k * (GRID * GRID), forms, neighbours, p[0], p[1],
                N_SIDE, N_CELLS, GRID, STEPS,
            )  # fmt: skip
        else:
            cell = _cell_at_rest(p[0], p[1], N_SIDE)
        if RECORD:
            tl.store(found + tl.cast(k, tl.int64) * n + index, cell, mask=mask)
        a = cell_map(table, cell, N_CELLS, SHARED, PADDED)
        p = apply(a, p)
        if JACOBIAN:
            ju = mix(a, turn(t, ju))
            jv = mix(a, turn(t, jv))
            jw = mix(a, turn(t, jw))
    t = transition(transitions, n_layers)
    store_three(image, index, 3, 1, move(t, p), mask)
    if JACOBIAN:
        store_three(jacobians, index, 9, 3, turn(t, ju), mask)
        store_three(jacobians + 1, index, 9, 3, turn(t, jv), mask)
        store_three(jacobians + 2, index, 9, 3, turn(t, jw), mask)


INTERPRETED = not isinstance(traverse, triton.runtime.JITFunction)
"""Do the kernels run on the CPU, because TRITON_INTERPRET=1 was set when Triton was imported?"""
