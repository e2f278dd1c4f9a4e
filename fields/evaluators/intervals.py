"""Compiled: rigorous bounds of a program on boxes, by interval arithmetic.

For every slot three numbers are computed, in float64: `low` and `high`, between which lie all of
its values on the box, and `error`. "Values" means both: those of the exact formula, in real
numbers, and those that an evaluator computes in a dtype with unit roundoff u (2**-24 for float32,
2**-53 for float64), torch or compiled; the two differ by at most `error`. Points of the box are
taken to be exact in the dtype.

How rounding is covered. Each bound is moved outwards by its own size times 2 u, and by the least
normal number of the dtype. Half of that covers the dtype's own rounding (at most u, or an
underflow); the rest covers that of the bound itself, which was computed in float64 from correct
operations (at most 2**-53 <= u). The elementary functions, here and in the evaluators, are within
4 units in the last place (2 u each; measured in the tests: below 2 for ours, and vendors state 1
for torch's and the C library's), so their bounds are moved by 16 u. A bound beyond the dtype's
largest number becomes infinite where that is outwards.

Non-guarantees: nothing is said of points where an intermediate value is NaN, as in 0 / 0 or
infinity - infinity, where it overflows in the dtype, or of oracles that break their word.
"""

from __future__ import annotations

import math

import numpy as np

from fields.evaluators import opcodes as op
from fields.jit import inlined, kernel, piece

BOTH, FIRST, SECOND = 0, 1, 2
"""What was found out about a choice (minimum, maximum, where_negative, absolute): which of the
two branches is taken at all points of the box, in exact and in computed arithmetic alike. The
branches of `absolute` are a and -a, those of where_negative its second and third argument."""

ELEMENTARY = 8.0
"""How much wider the margin of elementary functions is than that of arithmetic."""


@piece
def _outwards(low, high, margin, tiny, largest):
    """Bounds moved outwards by a relative margin; NaN becomes "unknown"."""
    low = low - abs(low) * margin - tiny if abs(low) < np.inf else low
    high = high + abs(high) * margin + tiny if abs(high) < np.inf else high
    if not low >= -largest:
        low = -np.inf
    elif low > largest:
        low = largest
    if not high <= largest:
        high = np.inf
    elif high < -largest:
        high = -largest
    return low, high


@piece
def _size(low, high):
    return max(abs(low), abs(high))


@piece
def _product(a, b):
    return 0.0 if a == 0.0 or b == 0.0 else a * b  # bounds stand for finite numbers


@piece
def _multiply(al, ah, bl, bh):
    first, second = _product(al, bl), _product(al, bh)
    third, fourth = _product(ah, bl), _product(ah, bh)
    return min(first, second, third, fourth), max(first, second, third, fourth)


@piece
def _divide(al, ah, bl, bh):
    if bl <= 0.0 <= bh:
        return -np.inf, np.inf
    first, second, third, fourth = al / bl, al / bh, ah / bl, ah / bh
    if np.isnan(first + second + third + fourth) and (abs(al) == np.inf or abs(ah) == np.inf):
        return -np.inf, np.inf
    return min(first, second, third, fourth), max(first, second, third, fourth)


@piece
def _square(low, high):
    nearest = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    farthest = _size(low, high)
    return nearest * nearest, farthest * farthest


@piece
def _sine(low, high, shift):
    """Bounds of sin(a + shift), where shift is 0 or pi/2 and the function sin or cos."""
    if not (high - low < 6.0) or _size(low, high) > 1e9:
        return -1.0, 1.0
    first = math.sin(low) if shift == 0.0 else math.cos(low)
    last = math.sin(high) if shift == 0.0 else math.cos(high)
    # Is there a crest at pi/2 - shift + 2 pi k between them? 1e-6 covers the rounding of
    # angles up to 1e9; a crest wrongly taken to be inside costs at most 1e-12.
    turn = 2.0 * math.pi
    crest, trough = 0.5 * math.pi - shift, -0.5 * math.pi - shift
    next_crest = crest + turn * math.ceil((low - 1e-6 - crest) / turn)
    next_trough = trough + turn * math.ceil((low - 1e-6 - trough) / turn)
    most = 1.0 if next_crest <= high + 1e-6 else max(first, last)
    least = -1.0 if next_trough <= high + 1e-6 else min(first, last)
    return least, most


@piece
def _angle(yl, yh, xl, xh):
    """Bounds of atan2; all angles if the box meets the half-line y = 0, x < 0."""
    if (xl < 0.0 and yl <= 0.0 <= yh) or np.isnan(xl + xh + yl + yh):
        return -math.pi, math.pi
    first, second = math.atan2(yl, xl), math.atan2(yl, xh)
    third, fourth = math.atan2(yh, xl), math.atan2(yh, xh)
    return min(first, second, third, fourth), max(first, second, third, fourth)


@piece
def _power(al, ah, bl, bh):
    """Bounds of power: at the corners, as it is monotone in each argument for a base > 0."""
    if ah <= 0.0:
        return 0.0, 0.0
    top = max(math.pow(ah, bl), math.pow(ah, bh))
    if al <= 0.0:  # 0 at the base 0; next to it 0, 1 or infinity, as the exponent is +, 0 or -
        return 0.0, np.inf if bl < 0.0 else max(top, 1.0 if bl == 0.0 else 0.0)
    first, second = math.pow(al, bl), math.pow(al, bh)
    least = min(first, second, math.pow(ah, bl), math.pow(ah, bh))
    return least, max(first, second, top)


@inlined
def run_box(inputs, codes, arguments, constants, rounded, size, least, rounding, bounds, choices):
    """Bounds of every slot of a program on one box.

    Args:
        inputs, codes, arguments, constants: those of a `Program`.
        rounded: its constants in the dtype.
        size: how many instructions.
        least: least normal number of the dtype.
        rounding: twice its unit roundoff.
        bounds: `(slots, 3)`: low, high and error of the inputs are read, all others written.
        choices: `(size,)`, written; BOTH for instructions that are no choice.
    """
    largest = 3.4028234663852886e38 if rounding > 1e-10 else 1.7976931348623157e308
    for index in range(size):
        code = codes[index]
        first, second, third = arguments[index, 0], arguments[index, 1], arguments[index, 2]
        al, ah, ae = bounds[first, 0], bounds[first, 1], bounds[first, 2]
        bl, bh, be = bounds[second, 0], bounds[second, 1], bounds[second, 2]
        margin, floor_of, choice = rounding, least, BOTH
        if code == op.ADD:
            low, high, error = al + bl, ah + bh, ae + be
        elif code == op.SUBTRACT:
            low, high, error = al - bh, ah - bl, ae + be
            if first == second:
                low, high, error = 0.0, 0.0, 0.0
        elif code == op.MULTIPLY:
            if first == second:
                low, high = _square(al, ah)
            else:
                low, high = _multiply(al, ah, bl, bh)
            error = _product(_size(al, ah), be) + _product(_size(bl, bh), ae)
        elif code == op.DIVIDE:
            low, high = _divide(al, ah, bl, bh)
            error = (ae + _product(_size(low, high), be)) / min(abs(bl), abs(bh))
        elif code == op.MINIMUM or code == op.MAXIMUM:
            margin, floor_of = 0.0, 0.0
            if code == op.MINIMUM:
                low, high = min(al, bl), min(ah, bh)
                choice = FIRST if ah <= bl else (SECOND if bh <= al else BOTH)
            else:
                low, high = max(al, bl), max(ah, bh)
                choice = FIRST if al >= bh else (SECOND if bl >= ah else BOTH)
            error = ae if choice == FIRST else (be if choice == SECOND else max(ae, be))
        elif code == op.WHERE_NEGATIVE:
            margin, floor_of = 0.0, 0.0
            choice = FIRST if ah < 0.0 else (SECOND if al >= 0.0 else BOTH)
            cl, ch, ce = bounds[third, 0], bounds[third, 1], bounds[third, 2]
            if choice == FIRST:
                low, high, error = bl, bh, be
            elif choice == SECOND:
                low, high, error = cl, ch, ce
            else:
                low, high = min(bl, cl), max(bh, ch)
                error = max(be, ce) if ae == 0.0 else np.inf
        elif code == op.ABSOLUTE:
            margin, floor_of = 0.0, 0.0
            choice = FIRST if al >= 0.0 else (SECOND if ah <= 0.0 else BOTH)
            low = 0.0 if choice == BOTH else min(abs(al), abs(ah))
            high, error = _size(al, ah), ae
        elif code == op.NEGATIVE:
            margin, floor_of = 0.0, 0.0
            low, high, error = -ah, -al, ae
        elif code == op.SQUARE:
            low, high = _square(al, ah)
            error = 2.0 * _product(_size(al, ah), ae)
        elif code == op.SQRT:
            margin *= 2.0  # torch's may be off by a whole unit in the last place
            low, high = math.sqrt(max(al, 0.0)), math.sqrt(max(ah, 0.0))
            error = min(math.sqrt(ae), np.inf if low == 0.0 else 0.5 * ae / low)
        elif code == op.CONSTANT:
            margin, floor_of = 0.0, 0.0
            low, high = min(constants[index], rounded[index]), max(constants[index], rounded[index])
            error = high - low
        elif code == op.FLOOR:
            margin, floor_of = 0.0, 0.0
            low, high = np.floor(al), np.floor(ah)
            error = 0.0 if ae == 0.0 else np.inf
        elif code == op.SIN or code == op.COS:
            margin *= ELEMENTARY
            low, high = _sine(al, ah, 0.0 if code == op.SIN else 0.5 * math.pi)
            error = ae
        elif code == op.EXP:
            margin *= ELEMENTARY
            low, high = math.exp(al), math.exp(ah)
            error = _product(high, ae)
        elif code == op.LOG:
            margin *= ELEMENTARY
            # Below the dtype's least number the value depends on the dtype: cover all.
            low = math.log(max(al, 2.2250738585072014e-308))
            high = math.log(max(ah, least))
            error = 0.0 if ae == 0.0 and al >= least else np.inf if al < least else ae / al
        elif code == op.ATAN2:
            margin *= ELEMENTARY
            low, high = _angle(al, ah, bl, bh)
            dx = 0.0 if bl <= 0.0 <= bh else min(abs(bl), abs(bh))
            dy = 0.0 if al <= 0.0 <= ah else min(abs(al), abs(ah))
            slope = np.inf if dx == 0.0 and dy == 0.0 else 1.0 / math.hypot(dx, dy)
            error = _product(slope, ae + be) if high - low < 6.0 else np.inf
        else:  # POWER
            margin *= ELEMENTARY
            low, high = _power(al, ah, bl, bh)
            if ae == 0.0 and be == 0.0:
                error = 0.0
            elif be == 0.0 and al > 0.0:
                error = _product(_size(bl, bh) * high / al, ae)
            else:
                error = np.inf
        low, high = _outwards(low, high, margin, floor_of, largest)
        if not error <= high - low:
            error = high - low
        error = error * (1.0 + 1e-14) + _size(low, high) * margin + floor_of
        slot = inputs + index
        bounds[slot, 0], bounds[slot, 1] = low, high
        bounds[slot, 2] = min(error, high - low) if high - low < np.inf else np.inf
        choices[index] = choice


@kernel
def bounds_of(inputs, codes, arguments, constants, rounded, outputs, least, rounding, given, found):
    """Bounds of a program's outputs on n boxes.

    Args:
        inputs, codes, arguments, constants, outputs: those of a `Program`.
        rounded, least, rounding: see `run_box`.
        given: `(n, k, 3)`, low, high and error of its inputs on each box.
        found: `(n, m, 3)`, written: those of its outputs.
    """
    size = codes.size
    bounds = np.zeros((inputs + size, 3))
    choices = np.empty(size, np.int8)
    for box in range(given.shape[0]):
        for slot in range(inputs):
            for position in range(3):
                bounds[slot, position] = given[box, slot, position]
        run_box(
            inputs, codes, arguments, constants, rounded, size, least, rounding, bounds, choices
        )
        for position in range(outputs.size):
            for number in range(3):
                found[box, position, number] = bounds[outputs[position], number]
