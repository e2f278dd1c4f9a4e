"""Compiled: from a program to rows with few registers and constants in place.

A row is (code, form, result, first, second, third), the last four being registers. Constants
that are an argument of an operation with two arguments are not in registers but beside the row;
the form says which argument they are.

An instruction's result never has the register of one of its arguments, so that a loop over a
block reads and writes different memory, which is what compilers need to know to vectorise it.
"""

from __future__ import annotations

import numpy as np

from fields.evaluators import opcodes as op
from fields.jit import kernel, piece

WIDTH = 6
"""Numbers in a row."""

REGISTERS, FIRST_FIXED, SECOND_FIXED = 0, 1, 2
"""Forms: all arguments in registers; the first, or the second, is the number beside the row."""

_ARITIES = np.array(op.ARITIES, np.int32)


@kernel
def assign_registers(inputs, codes, arguments, constants, outputs, rows, numbers, places):
    """Write the rows of a program, and where its outputs will be.

    Args:
        inputs, codes, arguments, constants, outputs: those of a `Program`. Input j starts out in
            register j. Instructions that no output needs are left out if nothing reads them.
        rows: `(m, WIDTH)` integers, written.
        numbers: `(m,)`, written: the constant beside each row.
        places: as long as `outputs`, written: the registers that hold them in the end.

    Returns:
        How many rows were written, and how many registers they use.
    """
    size = codes.size
    last = np.full(inputs + size, -1, np.int32)
    for index in range(size):
        for position in range(_ARITIES[codes[index]]):
            last[arguments[index, position]] = index
    for slot in outputs:
        last[slot] = size
    register = np.full(inputs + size, -1, np.int32)
    free = np.empty(inputs + size, np.int32)
    vacant, used = 0, inputs
    for slot in range(inputs):
        register[slot] = slot
        if last[slot] < 0:
            free[vacant] = slot
            vacant += 1
    count = 0
    for index in range(size):
        slot, code = inputs + index, codes[index]
        if last[slot] < 0 or (code == op.CONSTANT and last[slot] < size):
            continue  # nobody reads it, or its readers take it as a number if they can
        arity = _ARITIES[code]
        fixed, number = -1, constants[index]
        if arity == 2:
            first, second = arguments[index, 0] - inputs, arguments[index, 1] - inputs
            if second >= 0 and codes[second] == op.CONSTANT:
                fixed, number = 1, constants[second]
            elif first >= 0 and codes[first] == op.CONSTANT:
                fixed, number = 0, constants[first]
        for position in range(arity):
            argument = arguments[index, position]
            if register[argument] < 0 and position != fixed:
                vacant, used = _take(register, argument, free, vacant, used)
                _write(rows, count, op.CONSTANT, REGISTERS, register[argument])
                numbers[count] = constants[argument - inputs]
                count += 1
        vacant, used = _take(register, slot, free, vacant, used)
        _write(rows, count, code, fixed + 1, register[slot])
        numbers[count] = number
        for position in range(arity):
            rows[count, 3 + position] = max(register[arguments[index, position]], 0)
        count += 1
        for position in range(arity):
            argument = arguments[index, position]
            if last[argument] == index and register[argument] >= 0:
                free[vacant] = register[argument]
                vacant += 1
                register[argument] = -1
    for position in range(outputs.size):
        places[position] = register[outputs[position]]
    return count, used


@piece
def _take(register, slot, free, vacant, used):
    """Give a slot a register: a free one, or a new one."""
    if vacant > 0:
        vacant -= 1
        register[slot] = free[vacant]
    else:
        register[slot] = used
        used += 1
    return vacant, used


@piece
def _write(rows, count, code, form, result):
    rows[count, 0] = code
    rows[count, 1] = form
    rows[count, 2] = result
    rows[count, 3:] = 0
