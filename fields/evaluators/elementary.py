"""Compiled: sin, cos, exp, log, atan2 and power, branch-free, so that loops of them vectorise.

The formulas and coefficients are those of fdlibm (S. Moshier's and K.-C. Ng's reductions and
minimax polynomials, Sun Microsystems 1993; https://www.netlib.org/fdlibm), arranged without
branches. All work in float64, also for float32 arguments, whose results are then rounded once.

Errors, in units in the last place of the result: float64 below 1 for sin, cos, exp and log, below
2 for atan2; float32 at most 0.501. Beyond |x| = 1e6, `sine` and `cosine` are inaccurate: loops
call `math.sin` for those, one by one (`HUGE`).
"""

from __future__ import annotations

import math

import numpy as np

from fields.jit import accurate, piece

HUGE = 1e6
"""Angles beyond this many radians need a longer pi than `sine` and `cosine` have."""


@piece
def root(a):
    """The square root; 0 below 0."""
    return 0.0 if a <= 0 else np.sqrt(a)


@piece
def minimum(a, b):
    """The smaller one; NaN if either is NaN."""
    return a if (a < b) | (a != a) else b


@piece
def maximum(a, b):
    """The larger one; NaN if either is NaN."""
    return a if (a > b) | (a != a) else b


_TWO_OVER_PI = 2 / math.pi
# pi/2 as a sum whose first two terms have 33 bits, so that their products with whole numbers
# below 2**20 are exact.
_PIO2_1, _PIO2_2, _PIO2_3 = (
    1.57079632673412561417e00,
    6.07710050630396597660e-11,
    2.02226624879595063154e-21,
)


@accurate
def _quadrant_and_rest(x):
    """x = quadrant * pi/2 + rest + correction, the quadrant in 0, 1, 2, 3."""
    whole = np.floor(x * _TWO_OVER_PI + 0.5)
    near = x - whole * _PIO2_1
    step = whole * _PIO2_2
    rest = near - step
    back = rest - near
    lost = (near - (rest - back)) - (step + back)
    correction = lost - whole * _PIO2_3
    total = rest + correction
    return whole - 4.0 * np.floor(whole * 0.25), total, (rest - total) + correction


@accurate
def _sine_and_cosine_of_rest(x, correction):
    """Both, for |x| <= pi/4; the correction is what x lacks."""
    z = x * x
    r = 8.33333333332248946124e-03 + z * (
        -1.98412698298579493134e-04
        + z
        * (
            2.75573137070700676789e-06
            + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
        )
    )
    v = z * x
    sine_value = x - (
        (z * (0.5 * correction - v * r) - correction) + v * 1.66666666666666324348e-01
    )
    c = z * (
        4.16666666666666019037e-02
        + z
        * (
            -1.38888888888741095749e-03
            + z
            * (
                2.48015872894767294178e-05
                + z
                * (
                    -2.75573143513906633035e-07
                    + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
                )
            )
        )
    )
    half = 0.5 * z
    one = 1.0 - half
    return sine_value, one + (((1.0 - one) - half) + (z * c - x * correction))


@accurate
def sine(x):
    """sin(x) for |x| <= HUGE."""
    quadrant, rest, correction = _quadrant_and_rest(np.float64(x))
    s, c = _sine_and_cosine_of_rest(rest, correction)
    value = s if (quadrant == 0.0) | (quadrant == 2.0) else c
    return -value if quadrant >= 2.0 else value


@accurate
def cosine(x):
    """cos(x) for |x| <= HUGE."""
    quadrant, rest, correction = _quadrant_and_rest(np.float64(x))
    s, c = _sine_and_cosine_of_rest(rest, correction)
    value = c if (quadrant == 0.0) | (quadrant == 2.0) else s
    return -value if (quadrant == 1.0) | (quadrant == 2.0) else value


_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
_ONE_BITS = 0x3FF0000000000000
_MANTISSA = 0x000FFFFFFFFFFFFF
# Adding 2**52 to a whole number below it leaves the number in the low bits; and back.
_SHIFT, _SHIFT_BITS = 2.0**52, 0x4330000000000000


@accurate
def _power_of_two(exponent):
    """2**exponent for a whole number from -1022 to 1023."""
    bits = np.float64(exponent + (_SHIFT + 1023.0)).view(np.int64)
    return np.int64(bits << 52).view(np.float64)


@accurate
def exponential(x):
    """e**x."""
    x = np.float64(x)
    bounded = 720.0 if x > 720.0 else x
    bounded = -760.0 if bounded < -760.0 else bounded
    whole = np.floor(bounded * 1.44269504088896338700 + 0.5)
    high = bounded - whole * _LN2_HIGH
    low = whole * _LN2_LOW
    r = high - low
    t = r * r
    c = r - t * (
        1.66666666666666019037e-01
        + t
        * (
            -2.77777777770155933842e-03
            + t
            * (
                6.61375632143793436117e-05
                + t * (-1.65339022054652515390e-06 + t * 4.13813679705723846039e-08)
            )
        )
    )
    value = 1.0 - ((low - (r * c) / (2.0 - c)) - high)
    # In two steps, as one factor would overflow or vanish before the product does.
    half = np.floor(0.5 * whole)
    return value * _power_of_two(half) * _power_of_two(whole - half)


@accurate
def logarithm(x):
    """log(x) for a normal x > 0."""
    x = np.float64(x)
    bits = x.view(np.int64)
    mantissa = np.int64((bits & _MANTISSA) | _ONE_BITS).view(np.float64)
    exponent = np.int64((bits >> 52) | _SHIFT_BITS).view(np.float64) - (_SHIFT + 1023.0)
    is_large = mantissa > 1.41421356237309504880
    exponent = exponent + 1.0 if is_large else exponent
    f = (0.5 * mantissa if is_large else mantissa) - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    even = w * (
        3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01)
    )
    odd = z * (
        6.666666666666735130e-01
        + w
        * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01))
    )
    half = 0.5 * f * f
    value = exponent * _LN2_HIGH - ((half - (s * (half + (even + odd)) + exponent * _LN2_LOW)) - f)
    return value if x < np.inf else x


@accurate
def clamped_logarithm(x, least):
    """log(max(x, least))."""
    return logarithm(least if x < least else x)


_SIGN = -(2**63)


@accurate
def angle(y, x):
    """atan2(y, x); 0 at the origin."""
    y, x = np.float64(y), np.float64(x)
    across, along = abs(y), abs(x)
    is_steep = across > along
    small, large = (along, across) if is_steep else (across, along)
    # atan(t) = pi/4 + atan((t - 1) / (t + 1)), to keep |t| below tan(pi/8).
    is_wide = small >= 0.41421356237309503 * large
    difference = 0.0 if small == large else small - large
    top = difference if is_wide else small
    bottom = small + large if is_wide else large
    t = top / (1.0 if bottom == 0.0 else bottom)
    z = t * t
    w = z * z
    odd = z * (
        3.33333333333329318027e-01
        + w
        * (
            1.42857142725034663711e-01
            + w
            * (
                9.09088713343650656196e-02
                + w
                * (
                    6.66107313738753120669e-02
                    + w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)
                )
            )
        )
    )
    even = w * (
        -1.99999999998764832476e-01
        + w
        * (
            -1.11111104054623557880e-01
            + w
            * (
                -7.69187620504482999495e-02
                + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02)
            )
        )
    )
    turn = t - t * (odd + even)
    turn = 7.85398163397448278999e-01 + (turn + 3.06161699786838301793e-17) if is_wide else turn
    turn = 1.57079632679489655800e00 - (turn - 6.12323399573676603587e-17) if is_steep else turn
    turn = 3.14159265358979311600e00 - (turn - 1.22464679914735317720e-16) if x < 0.0 else turn
    turn = 0.0 if (across == 0.0) & (along == 0.0) else turn
    signed = np.int64(np.float64(turn).view(np.int64) | (y.view(np.int64) & _SIGN)).view(np.float64)
    return turn if turn != turn else signed


@accurate
def power_single(base, exponent):
    """base**exponent to float32's precision; 0 at a base <= 0."""
    base, exponent = np.float64(base), np.float64(exponent)
    is_flat = base <= 0.0
    value = exponential(exponent * logarithm(1.0 if is_flat else base))
    value = 1.0 if (exponent == 0.0) | (base == 1.0) else value
    return 0.0 if is_flat else value


@piece
def power_double(base, exponent):
    """base**exponent to float64's precision, by the C library; 0 at a base <= 0."""
    return 0.0 if base <= 0.0 else math.pow(base, exponent)
