"""Compiled: a shorter program for a box on which some choices are known.

Where a minimum takes the same argument on all of a box, the other one need not be computed, nor
anything that only it needs (as in fidget, and before it libfive). The shorter program gives the
same bits: choices are only made where they hold for computed values (see `intervals`).
"""

from __future__ import annotations

import numpy as np

from fields.evaluators import opcodes as op
from fields.evaluators.intervals import BOTH, FIRST
from fields.jit import piece

_ARITIES = np.array(op.ARITIES, np.int32)


@piece
def _taken(code, choice):
    """Which argument is the result of a choice that is known."""
    if code == op.WHERE_NEGATIVE:
        return 1 if choice == FIRST else 2
    return 0 if choice == FIRST or code == op.ABSOLUTE else 1


@piece
def shorten(inputs, program, size, output, choices, shorter, renamed):
    """Write the program that computes one slot on a box, given what is known there.

    Args:
        inputs: number of inputs, the same for both programs.
        program: its codes, arguments, constants and rounded constants.
        size: how many instructions of the arrays are in use.
        output: the slot that is wanted.
        choices: `(size,)`, found by `fields.evaluators.intervals.run_box`.
        shorter: arrays for the result, as `program`.
        renamed: `(slots,)`, used here.

    Returns:
        How many instructions were written, and the slot of their result.
    """
    codes, arguments, constants, rounded = program
    new_codes, new_arguments, new_constants, new_rounded = shorter
    # Backwards, to find what is needed (marked by 0); forwards, to number it anew.
    for slot in range(inputs + size):
        renamed[slot] = slot if slot < inputs else -1
    if output >= inputs:
        renamed[output] = 0
    for index in range(size - 1, -1, -1):
        if renamed[inputs + index] < 0:
            continue
        code, choice = codes[index], choices[index]
        if choice != BOTH:
            slot = arguments[index, _taken(code, choice)]
            renamed[slot] = max(renamed[slot], 0)
        else:
            for position in range(_ARITIES[code]):
                slot = arguments[index, position]
                renamed[slot] = max(renamed[slot], 0)
    count = 0
    for index in range(size):
        if renamed[inputs + index] < 0:
            continue
        code, choice = codes[index], choices[index]
        if choice != BOTH and (code != op.ABSOLUTE or choice == FIRST):
            renamed[inputs + index] = renamed[arguments[index, _taken(code, choice)]]
            continue
        new_codes[count] = op.NEGATIVE if choice != BOTH else code
        for position in range(3):
            used = position < _ARITIES[code]
            new_arguments[count, position] = renamed[arguments[index, position]] if used else 0
        new_constants[count], new_rounded[count] = constants[index], rounded[index]
        renamed[inputs + index] = inputs + count
        count += 1
    return count, renamed[output]
