"""Compiled: the values of a program at many points, a block of points at a time.

An interpreter, not a compiler: each row of the program (see `fields.evaluators.registers`) is one
loop over a block of `BLOCK` points, vectorised when this module is compiled, which happens once
for all expressions. What interpreting costs, some 10 ns a row, is shared by the block.

Guarantees: additions, multiplications and the other arithmetic give the same bits as torch does;
a value depends only on its point, not on its neighbours, its place or the number of threads. The
elementary functions are those of `fields.evaluators.elementary`, which may differ from torch's in
the last place. NaN and infinite points are computed like others.
"""

from __future__ import annotations

import math

import numpy as np

from fields.evaluators import opcodes as op
from fields.evaluators.elementary import (
    HUGE,
    angle,
    clamped_logarithm,
    cosine,
    exponential,
    maximum,
    minimum,
    power_double,
    power_single,
    root,
    sine,
)
from fields.evaluators.registers import FIRST_FIXED, SECOND_FIXED
from fields.jit import inlined, kernel, piece

BLOCK = 512
"""Points a block: eight registers of float32 are 16 KiB, half of a usual first-level cache."""


# --- what the operations mean, for one point ------------------------------------------


@piece
def _negative(a):
    return -a


@piece
def _absolute(a):
    return abs(a)


@piece
def _square(a):
    return a * a


@piece
def _floor(a):
    return np.floor(a)


@piece
def _add(a, b):
    return a + b


@piece
def _subtract(a, b):
    return a - b


@piece
def _multiply(a, b):
    return a * b


@piece
def _divide(a, b):
    return a / b


# --- loops over a block ---------------------------------------------------------------


@piece
def _fill(file, result, number):
    for i in range(BLOCK):
        file[result, i] = number


@inlined
def _unary(piece, file, result, a):
    for i in range(BLOCK):
        file[result, i] = piece(file[a, i])


@inlined
def _binary(piece, form, file, result, a, b, number):
    if form == SECOND_FIXED:
        for i in range(BLOCK):
            file[result, i] = piece(file[a, i], number)
    elif form == FIRST_FIXED:
        for i in range(BLOCK):
            file[result, i] = piece(number, file[b, i])
    else:
        for i in range(BLOCK):
            file[result, i] = piece(file[a, i], file[b, i])


@piece
def _where_negative(file, result, a, b, c):
    for i in range(BLOCK):
        negative_value, otherwise = file[b, i], file[c, i]
        file[result, i] = negative_value if file[a, i] < 0 else otherwise


@inlined
def _periodic(piece, exact, file, result, a):
    _unary(piece, file, result, a)
    for i in range(BLOCK):
        if abs(file[a, i]) > HUGE:
            file[result, i] = exact(np.float64(file[a, i]))


@piece
def _exact_sine(a):
    return math.sin(a)


@piece
def _exact_cosine(a):
    return math.cos(a)


@inlined
def run_block(rows, numbers, file):
    """Run all rows on one block; `file` is `(registers, BLOCK)`, the inputs in their places."""
    least = np.finfo(file.dtype).tiny
    for row in range(rows.shape[0]):
        code, form, result = rows[row, 0], rows[row, 1], rows[row, 2]
        a, b, number = rows[row, 3], rows[row, 4], numbers[row]
        if code == op.ADD:
            _binary(_add, form, file, result, a, b, number)
        elif code == op.SUBTRACT:
            _binary(_subtract, form, file, result, a, b, number)
        elif code == op.MULTIPLY:
            _binary(_multiply, form, file, result, a, b, number)
        elif code == op.DIVIDE:
            _binary(_divide, form, file, result, a, b, number)
        elif code == op.MINIMUM:
            _binary(minimum, form, file, result, a, b, number)
        elif code == op.MAXIMUM:
            _binary(maximum, form, file, result, a, b, number)
        elif code == op.SQUARE:
            _unary(_square, file, result, a)
        elif code == op.SQRT:
            _unary(root, file, result, a)
        elif code == op.ABSOLUTE:
            _unary(_absolute, file, result, a)
        elif code == op.NEGATIVE:
            _unary(_negative, file, result, a)
        elif code == op.WHERE_NEGATIVE:
            _where_negative(file, result, a, b, rows[row, 5])
        elif code == op.CONSTANT:
            _fill(file, result, number)
        elif code == op.FLOOR:
            _unary(_floor, file, result, a)
        elif code == op.SIN:
            _periodic(sine, _exact_sine, file, result, a)
        elif code == op.COS:
            _periodic(cosine, _exact_cosine, file, result, a)
        elif code == op.EXP:
            _unary(exponential, file, result, a)
        elif code == op.LOG:
            _binary(clamped_logarithm, SECOND_FIXED, file, result, a, b, least)
        elif code == op.ATAN2:
            _binary(angle, form, file, result, a, b, number)
        elif code == op.POWER:
            if file.itemsize == 4:
                _binary(power_single, form, file, result, a, b, number)
            else:
                _binary(power_double, form, file, result, a, b, number)


@kernel
def values_at(rows, numbers, registers, places, inputs, outputs):
    """Run a program at n points.

    Args:
        rows, numbers, registers, places: see `fields.evaluators.registers.assign_registers`.
        inputs: `(n, k)`, the program's inputs at each point.
        outputs: `(n, m)`, written: its outputs.
    """
    count = inputs.shape[0]
    file = np.zeros((registers, BLOCK), inputs.dtype)
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        for i in range(size):
            file[0, i] = inputs[start + i, 0]
            file[1, i] = inputs[start + i, 1]
            file[2, i] = inputs[start + i, 2]
        for column in range(3, inputs.shape[1]):
            for i in range(size):
                file[column, i] = inputs[start + i, column]
        run_block(rows, numbers, file)
        for column in range(places.size):
            place = places[column]
            for i in range(size):
                outputs[start + i, column] = file[place, i]
