"""Compiled: values and gradients of a program by forward differentiation, block by block.

Every register holds a value and its derivatives along x, y and z (of the points, whatever the
inputs are). The values are computed by the same pieces as in `fields.evaluators.values`, so they
are the same bits; derivatives where none exists follow the table in `fields.expression`.
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
    logarithm,
    maximum,
    minimum,
    power_double,
    power_single,
    root,
    sine,
)
from fields.evaluators.registers import FIRST_FIXED, SECOND_FIXED
from fields.jit import inlined, kernel, piece

BLOCK = 128
"""Points a block; a register is four rows."""


# --- values and slopes, for one point -------------------------------------------------


@piece
def _negative_slope(a):
    return -a, -1.0


@piece
def _absolute_slope(a):
    return abs(a), 1.0 if a > 0 else (-1.0 if a < 0 else 0.0)


@piece
def _square_slope(a):
    return a * a, a + a


@piece
def _root_slope(a):
    value = root(a)
    return value, 0.0 if a <= 0 else 0.5 / value


@piece
def _sine_slope(a):
    return sine(a), cosine(a)


@piece
def _cosine_slope(a):
    return cosine(a), -sine(a)


@piece
def _exact_sine_slope(a):
    return math.sin(a), math.cos(a)


@piece
def _exact_cosine_slope(a):
    return math.cos(a), -math.sin(a)


@piece
def _floor_slope(a):
    return np.floor(a), 0.0


@piece
def _exponential_slope(a):
    value = exponential(a)
    return value, value


@piece
def _logarithm_slope(a, least):
    return clamped_logarithm(a, least), 0.0 if a < least else 1.0 / a, 0.0


@piece
def _add_slope(a, b):
    return a + b, 1.0, 1.0


@piece
def _subtract_slope(a, b):
    return a - b, 1.0, -1.0


@piece
def _multiply_slope(a, b):
    return a * b, b, a


@piece
def _divide_slope(a, b):
    value = a / b
    return value, 1.0 / b, -value / b


@piece
def _share(is_taken, is_tie):
    return 1.0 if is_taken else (0.5 if is_tie else 0.0)


@piece
def _minimum_slope(a, b):
    return minimum(a, b), _share(a < b, a == b), _share(b < a, a == b)


@piece
def _maximum_slope(a, b):
    return maximum(a, b), _share(a > b, a == b), _share(b > a, a == b)


@piece
def _angle_slope(y, x):
    wide, high = np.float64(x), np.float64(y)
    squared = wide * wide + high * high
    inverse = 0.0 if squared == 0.0 else 1.0 / squared
    return angle(y, x), wide * inverse, -high * inverse


@piece
def _power_slope(value, base, exponent):
    is_flat = base <= 0
    safe = 1.0 if is_flat else np.float64(base)
    along_base = 0.0 if is_flat | (exponent == 0) else exponent * value / safe
    return value, along_base, 0.0 if is_flat else value * logarithm(safe)


@piece
def _power_single_slope(base, exponent):
    return _power_slope(power_single(base, exponent), base, exponent)


@piece
def _power_double_slope(base, exponent):
    return _power_slope(power_double(base, exponent), base, exponent)


# --- loops over a block ---------------------------------------------------------------


@piece
def _fill(file, result, number):
    for i in range(BLOCK):
        file[result, 0, i] = number
    for axis in range(1, 4):
        for i in range(BLOCK):
            file[result, axis, i] = 0


@inlined
def _unary(piece, file, slopes, result, a):
    for i in range(BLOCK):
        value, slope = piece(file[a, 0, i])
        file[result, 0, i] = value
        slopes[0, i] = slope


@inlined
def _binary(piece, form, file, slopes, result, a, b, number):
    if form == SECOND_FIXED:
        for i in range(BLOCK):
            value, slope, _ = piece(file[a, 0, i], number)
            file[result, 0, i] = value
            slopes[0, i] = slope
    elif form == FIRST_FIXED:
        for i in range(BLOCK):
            value, _, slope = piece(number, file[b, 0, i])
            file[result, 0, i] = value
            slopes[1, i] = slope
    else:
        for i in range(BLOCK):
            value, first, second = piece(file[a, 0, i], file[b, 0, i])
            file[result, 0, i] = value
            slopes[0, i] = first
            slopes[1, i] = second


@piece
def _chain_rule(code, form, file, slopes, result, a, b):
    """The derivatives of a result whose slopes are known."""
    if code < op.ADD or form == SECOND_FIXED:
        for axis in range(1, 4):
            for i in range(BLOCK):
                file[result, axis, i] = slopes[0, i] * file[a, axis, i]
    elif form == FIRST_FIXED:
        for axis in range(1, 4):
            for i in range(BLOCK):
                file[result, axis, i] = slopes[1, i] * file[b, axis, i]
    else:
        for axis in range(1, 4):
            for i in range(BLOCK):
                along = slopes[0, i] * file[a, axis, i]
                file[result, axis, i] = along + slopes[1, i] * file[b, axis, i]


@piece
def _where_negative(file, result, a, b, c):
    for axis in range(4):
        for i in range(BLOCK):
            negative_part, otherwise = file[b, axis, i], file[c, axis, i]
            file[result, axis, i] = negative_part if file[a, 0, i] < 0 else otherwise


@inlined
def _periodic(piece, exact, file, slopes, result, a):
    _unary(piece, file, slopes, result, a)
    for i in range(BLOCK):
        if abs(file[a, 0, i]) > HUGE:
            file[result, 0, i], slopes[0, i] = exact(np.float64(file[a, 0, i]))


@inlined
def _run_block(rows, numbers, file, slopes):
    """Run all rows on one block.

    Args:
        rows, numbers: the program.
        file: `(registers, 4, BLOCK)`, the inputs in their places.
        slopes: `(2, BLOCK)`, for the derivatives of a result after its arguments.
    """
    least = np.finfo(file.dtype).tiny
    for row in range(rows.shape[0]):
        code, form, result = rows[row, 0], rows[row, 1], rows[row, 2]
        a, b, number = rows[row, 3], rows[row, 4], numbers[row]
        if code == op.WHERE_NEGATIVE:
            _where_negative(file, result, a, b, rows[row, 5])
            continue
        if code == op.CONSTANT:
            _fill(file, result, number)
            continue
        if code == op.ADD:
            _binary(_add_slope, form, file, slopes, result, a, b, number)
        elif code == op.SUBTRACT:
            _binary(_subtract_slope, form, file, slopes, result, a, b, number)
        elif code == op.MULTIPLY:
            _binary(_multiply_slope, form, file, slopes, result, a, b, number)
        elif code == op.DIVIDE:
            _binary(_divide_slope, form, file, slopes, result, a, b, number)
        elif code == op.MINIMUM:
            _binary(_minimum_slope, form, file, slopes, result, a, b, number)
        elif code == op.MAXIMUM:
            _binary(_maximum_slope, form, file, slopes, result, a, b, number)
        elif code == op.SQUARE:
            _unary(_square_slope, file, slopes, result, a)
        elif code == op.SQRT:
            _unary(_root_slope, file, slopes, result, a)
        elif code == op.ABSOLUTE:
            _unary(_absolute_slope, file, slopes, result, a)
        elif code == op.NEGATIVE:
            _unary(_negative_slope, file, slopes, result, a)
        elif code == op.FLOOR:
            _unary(_floor_slope, file, slopes, result, a)
        elif code == op.SIN:
            _periodic(_sine_slope, _exact_sine_slope, file, slopes, result, a)
        elif code == op.COS:
            _periodic(_cosine_slope, _exact_cosine_slope, file, slopes, result, a)
        elif code == op.EXP:
            _unary(_exponential_slope, file, slopes, result, a)
        elif code == op.LOG:
            _binary(_logarithm_slope, SECOND_FIXED, file, slopes, result, a, b, least)
        elif code == op.ATAN2:
            _binary(_angle_slope, form, file, slopes, result, a, b, number)
        elif code == op.POWER:
            if file.itemsize == 4:
                _binary(_power_single_slope, form, file, slopes, result, a, b, number)
            else:
                _binary(_power_double_slope, form, file, slopes, result, a, b, number)
        _chain_rule(code, form, file, slopes, result, a, b)


@kernel
def slopes_at(rows, numbers, registers, places, points, inputs, outputs):
    """Run a program at n points.

    Args:
        rows, numbers, registers, places: see `fields.evaluators.registers.assign_registers`.
        points: `(n, 3)`.
        inputs: `(n, 4, k)`, value and derivatives of the program's other inputs.
        outputs: `(n, 4, m)`, written: those of its outputs.
    """
    count = points.shape[0]
    file = np.zeros((registers, 4, BLOCK), points.dtype)
    slopes = np.zeros((2, BLOCK), points.dtype)
    for start in range(0, count, BLOCK):
        size = min(BLOCK, count - start)
        for column in range(3):
            for i in range(size):
                file[column, 0, i] = points[start + i, column]
            for axis in range(3):
                file[column, 1 + axis, :] = axis == column
        for column in range(inputs.shape[2]):
            for axis in range(4):
                for i in range(size):
                    file[3 + column, axis, i] = inputs[start + i, axis, column]
        _run_block(rows, numbers, file, slopes)
        for column in range(places.size):
            place = places[column]
            for i in range(size):
                for axis in range(4):
                    outputs[start + i, axis, column] = file[place, axis, i]
