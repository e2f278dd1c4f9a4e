"""Compiled: bounds and samples of a program on blocks of a lattice, with ever shorter programs.

The blocks are sorted along a space-filling curve, so that those in a cube of 2**k blocks a side
are neighbours in the list. From the large cubes down: bound the program on the cube; if the level
is out of reach, the cube is done, and else the program is shortened to what matters there, and
used for the eight smaller ones. A single block that remains is sampled with its own program.
"""

from __future__ import annotations

import numpy as np

from fields.evaluators.enclosures import ASSUMED
from fields.evaluators.intervals import run_box
from fields.evaluators.registers import WIDTH, assign_registers
from fields.evaluators.shortening import shorten
from fields.evaluators.values import BLOCK, run_block
from fields.jit import kernel, piece


@piece
def _bounds(inputs, program, size, limits, bounds, choices):
    run_box(
        inputs,
        program[0],
        program[1],
        program[2],
        program[3],
        size,
        limits[0],
        limits[1],
        bounds,
        choices,
    )


@piece
def _at(lattice, axis, index, one):
    """A coordinate of a lattice point, rounded to the type of `one`."""
    return one.dtype.type(lattice[0, axis] + lattice[1, axis] * index)


@piece
def _sample(inputs, program, size, output, lattice, corner, side, rows, numbers, points, row):
    """The values at all lattice points of one block, z running fastest."""
    total = row.size
    i = 0
    for ix in range(side):
        x = _at(lattice, 0, corner[0] + ix, row)
        for iy in range(side):
            y = _at(lattice, 1, corner[1] + iy, row)
            for iz in range(side):
                points[0, i + iz] = x
                points[1, i + iz] = y
                points[2, i + iz] = _at(lattice, 2, corner[2] + iz, row)
            i += side
    wanted, places = np.array([output], np.int32), np.zeros(1, np.int32)
    count, registers = assign_registers(
        inputs,
        program[0][:size],
        program[1][:size],
        program[2][:size],
        wanted,
        rows,
        numbers,
        places,
    )
    file = np.zeros((max(registers, inputs), BLOCK), row.dtype)
    for start in range(0, total, BLOCK):
        for axis in range(3):
            for lane in range(BLOCK):
                file[axis, lane] = points[axis, start + lane]
        run_block(rows[:count], numbers[:count], file)
        for lane in range(min(BLOCK, total - start)):
            row[start + lane] = file[places[0], lane]


@kernel
def visit_blocks(
    codes,
    arguments,
    constants,
    rounded,
    output,
    limits,
    lipschitz,
    level,
    lattice,
    keys,
    corners,
    cells,
    starts,
    shift,
    bounds,
    crossed,
    sampled,
    values,
):
    """Bound, and sample, the blocks of some cubes.

    Args:
        codes, arguments, constants, output: those of a `Program` of x, y and z with one output.
        rounded: its constants in the dtype of the samples.
        limits: the dtype's least normal number and its epsilon.
        lipschitz: of the program, or infinity.
        level: blocks that cannot reach it are not sampled.
        lattice: `(2, 3)`, origin and spacing.
        keys: `(n,)`, of the blocks along the curve, ascending.
        corners: `(n, 3)`, their first lattice points, in the same order.
        cells: along an edge of a block.
        starts: where the blocks of each cube begin, and where those of the last end; those of a
            cube agree in `keys >> 3 * shift`.
        shift: see above.
        bounds, crossed: `(n, 2)` and `(n,)`, written.
        sampled: are values wanted?
        values: `(n, points)`, written for the crossed blocks; gives the dtype in any case.
    """
    inputs = 3
    length, depth = codes.size, shift + 2
    # A program for each size of cube, in the room that the whole one would take; number 0 is that.
    whole = (codes, arguments, constants, rounded)
    all_codes = np.empty((depth, length), np.int32)
    all_arguments = np.empty((depth, length, 3), np.int32)
    all_constants, all_rounded = np.empty((depth, length)), np.empty((depth, length))
    sizes, outputs = np.empty(depth + 1, np.int64), np.empty(depth + 1, np.int64)
    sizes[0], outputs[0] = length, output
    slots = np.zeros((inputs + length, 3))
    middle = np.zeros((inputs + length, 3))
    choices, unused = np.zeros(length, np.int8), np.zeros(length, np.int8)
    renamed = np.empty(inputs + length, np.int32)
    rows = np.empty((length, WIDTH), np.int32)
    numbers = np.empty(length, values.dtype)
    side = cells + 1
    points = np.zeros((3, (side**3 + BLOCK - 1) // BLOCK * BLOCK), values.dtype)
    # What is still to be visited: a range of blocks, the cube's size and the program's number.
    stack = np.empty((8 * depth + 8, 4), np.int64)
    waiting = 0
    for cube in range(starts.size - 2, -1, -1):
        if waiting == len(stack):
            stack = np.concatenate((stack, np.empty_like(stack)))
        stack[waiting, 0], stack[waiting, 1] = starts[cube], starts[cube + 1]
        stack[waiting, 2], stack[waiting, 3] = shift, 0
        waiting += 1
    while waiting > 0:
        waiting -= 1
        start, stop = stack[waiting, 0], stack[waiting, 1]
        scale, number = stack[waiting, 2], stack[waiting, 3]
        program = whole
        if number > 0:
            program = (
                all_codes[number - 1],
                all_arguments[number - 1],
                all_constants[number - 1],
                all_rounded[number - 1],
            )
        shorter = (
            all_codes[number],
            all_arguments[number],
            all_constants[number],
            all_rounded[number],
        )
        radius = farthest = 0.0
        for axis in range(3):
            least, most = corners[start, axis], corners[start, axis]
            for block in range(start + 1, stop):
                least, most = min(least, corners[block, axis]), max(most, corners[block, axis])
            low = np.float64(_at(lattice, axis, least, values))
            high = np.float64(_at(lattice, axis, most + cells, values))
            centre = 0.5 * (low + high)
            slots[axis, 0], slots[axis, 1] = low, high
            middle[axis, 0], middle[axis, 1] = centre, centre
            farthest = max(farthest, abs(low), abs(high))
            radius += max(high - centre, centre - low) ** 2
        _bounds(inputs, program, sizes[number], limits, slots, choices)
        result = outputs[number]
        low, high, error = slots[result, 0], slots[result, 1], slots[result, 2]
        is_crossed = low <= level <= high
        if is_crossed:
            size, result = shorten(
                inputs, program, sizes[number], outputs[number], choices, shorter, renamed
            )
            sizes[number + 1], outputs[number + 1] = size, result
            if lipschitz < np.inf:
                _bounds(inputs, shorter, size, limits, middle, unused)
                reach = lipschitz * np.sqrt(radius) * (1.0 + 1e-12)
                value = max(abs(middle[result, 0]), abs(middle[result, 1])) + reach
                reach += min(error, ASSUMED * limits[1] * max(value, farthest))
                low = max(low, middle[result, 0] - reach)
                high = min(high, middle[result, 1] + reach)
                is_crossed = low <= level <= high
        if stop - start == 1 or not is_crossed:
            for block in range(start, stop):
                bounds[block, 0], bounds[block, 1] = low, high
                crossed[block] = is_crossed
            if is_crossed and sampled:
                _sample(
                    inputs,
                    shorter,
                    sizes[number + 1],
                    outputs[number + 1],
                    lattice,
                    corners[start],
                    side,
                    rows,
                    numbers,
                    points,
                    values[start],
                )
            continue
        # Cut where the next three bits of the key change; blocks with the same key one by one.
        while stop > start:
            split = stop - 1
            while (
                scale > 0
                and split > start
                and keys[split - 1] >> (3 * (scale - 1)) == keys[stop - 1] >> (3 * (scale - 1))
            ):
                split -= 1
            if waiting == len(stack):
                stack = np.concatenate((stack, np.empty_like(stack)))
            stack[waiting, 0], stack[waiting, 1] = split, stop
            stack[waiting, 2], stack[waiting, 3] = max(scale - 1, 0), number + 1
            waiting += 1
            stop = split
