"""Colours for numbers: perceptually even, and neutral where nothing is distorted.

Two families.  *Diverging* scales, for factors (det J, stretches), are logarithmic and centred at 1:
a half and a double are equally far from the neutral middle.  *Sequential* scales, for energies and
errors, start at the neutral colour.  Neutral is the grey of an unpainted mesh.

Colours are curves in OKLab (Ottosson 2020), walked at constant speed, so that equal steps of a
value look equally large; lightness is monotonic from the neutral colour outwards, which keeps the
order readable in grey and to colour-blind eyes (blue against orange, never red against green).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from fields.arguments import number
from implicit_warp.errors import InputError

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

STEPS = 256
"""Colours of a scale."""

MISSING = (186, 186, 191, 255)
"""Where there is no value: NaN."""

# Lightness, chroma and hue in degrees, from the neutral colour outwards.
_NEUTRAL = (0.91, 0.006, 90.0)
_WARM = (
    _NEUTRAL,
    (0.80, 0.085, 75.0),
    (0.66, 0.150, 52.0),
    (0.50, 0.160, 34.0),
    (0.34, 0.110, 25.0),
)
_COOL = (
    _NEUTRAL,
    (0.80, 0.062, 220.0),
    (0.66, 0.105, 240.0),
    (0.50, 0.130, 257.0),
    (0.34, 0.110, 268.0),
)
_HEAT = (
    _NEUTRAL,
    (0.86, 0.115, 90.0),
    (0.72, 0.150, 58.0),
    (0.57, 0.175, 22.0),
    (0.42, 0.145, 345.0),
    (0.27, 0.090, 310.0),
)

_TAIL = 0.5
"""Percent of the values that a fitted range leaves out at an end: single slivers would else take
all of the colours."""


@dataclass(frozen=True)
class _Kind:
    label: str
    diverging: bool
    logarithmic: bool
    floor: float
    """The least range: a factor (diverging, from 1 outwards), a ratio, or a share of `unit`."""


KINDS: dict[str, _Kind] = {
    "det": _Kind("volume, det J", True, True, 1.1),
    "stretch": _Kind("largest stretch", True, True, 1.1),
    "squeeze": _Kind("smallest stretch", True, True, 1.1),
    "ratio": _Kind("largest / smallest stretch", False, True, 1.1),
    "energy": _Kind("elastic energy", False, False, 1e-3),
    "error": _Kind("handle error", False, False, 1e-12),
}
"""The quantities that have a scale: those of `distortion.QUANTITIES`, and the handles' error."""


@dataclass(frozen=True, eq=False)
class ColorScale:
    """Values to colours, and the legend of it.

    Attributes:
        name: of the quantity.
        label: in words, for the legend.
        low, high: the values of the first and the last colour; values beyond have that colour.
        logarithmic: are equal factors equal steps?
        table: (256, 4) uint8 RGBA.
    """

    name: str
    label: str
    low: float
    high: float
    logarithmic: bool
    table: Bytes

    def position(self, values: ArrayLike) -> Array:
        """Where values are on the scale, 0 to 1; NaN stays NaN."""
        values = np.asarray(values, dtype=np.float64)
        low, high = self.low, self.high
        if self.logarithmic:
            values = np.log(np.maximum(values, 1e-300))
            low, high = np.log(low), np.log(high)
        return np.clip((values - low) / (high - low), 0.0, 1.0)

    def __call__(self, values: ArrayLike) -> Bytes:
        """RGBA (..., 4) uint8 of values (...); `MISSING` where they are NaN."""
        at = self.position(values)
        known = np.isfinite(at)
        index = np.rint(np.where(known, at, 0.0) * (STEPS - 1)).astype(np.int64)
        return np.where(known[..., None], self.table[index], np.uint8(MISSING))

    def ticks(self, most: int = 5) -> list[tuple[float, str]]:
        """Positions (0 to 1) and texts for a legend, both ends' neighbourhoods included."""
        chosen = _log_ticks if self.logarithmic else _even_ticks
        values = chosen(self.low, self.high, most)
        return [(float(self.position(v)), f"{v:.4g}") for v in values]

    def bar(self, width: int, height: int) -> Bytes:
        """The legend's bar (height, width, 4) uint8, low to high along the longer side."""
        across = width >= height
        at = np.rint(np.linspace(0, STEPS - 1, width if across else height)).astype(np.int64)
        line = self.table[at] if across else self.table[at[::-1]]
        shape = (height, width, 4)
        return np.ascontiguousarray(np.broadcast_to(line[None] if across else line[:, None], shape))


def color_scale(
    name: str, values: ArrayLike = (), *, low: float | None = None, high: float | None = None
) -> ColorScale:
    """A scale for a quantity, its range from the values or as given.

    A diverging scale reaches equally far, as a factor, to both sides of 1; so one given end decides
    the other.  A fitted range leaves out the last half percent of the values at an end.

    Args:
        name: one of `KINDS`.
        values: any shape; NaN and infinite ones do not count.
        low, high: the ends, instead of fitted ones.

    Raises:
        InputError: no such quantity; ends that are no range, or not around 1 where they must be.
    """
    if name not in KINDS:
        raise InputError("name", name, "no such quantity", f"use one of {', '.join(KINDS)}")
    kind = KINDS[name]
    ends = [
        None if end is None else number(what, end) for what, end in (("low", low), ("high", high))
    ]
    if kind.diverging:
        ends = _around_one(ends, values, kind.floor)
    else:
        ends = _from_nothing(ends, values, kind)
    table = diverging_colors() if kind.diverging else sequential_colors()
    return ColorScale(name, kind.label, *ends, kind.logarithmic, table)


def _finite(values: ArrayLike) -> Array:
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    return flat[np.isfinite(flat)]


def _around_one(ends: list[float | None], values: ArrayLike, floor: float) -> list[float]:
    low, high = ends
    if (low is not None and not 0 < low < 1) or (high is not None and not high > 1):
        raise InputError(
            "low, high", ends, "a scale of factors runs from below 1 to above 1", "pass e.g. 0.5, 2"
        )
    if low is None and high is None:
        found = np.abs(np.log(np.maximum(_finite(values), 1e-300)))
        reach = float(np.exp(np.percentile(found, 100 - _TAIL))) if len(found) else floor
        high = _rounded_up(max(reach, floor))
    low = 1.0 / high if low is None else low
    return [low, 1.0 / low if high is None else high]


def _from_nothing(ends: list[float | None], values: ArrayLike, kind: _Kind) -> list[float]:
    start = 1.0 if kind.logarithmic else 0.0
    low, high = ends
    low = start if low is None else low
    if high is None:
        found = _finite(values)
        reach = float(np.percentile(found, 100 - _TAIL)) if len(found) else kind.floor
        high = _rounded_up(max(reach, kind.floor, low + (low == start) * kind.floor * 1e-3))
    if not low < high or (kind.logarithmic and low <= 0):
        raise InputError("low, high", [low, high], "not a range", "pass low < high")
    return [low, high]


def _rounded_up(value: float) -> float:
    """The next number with two digits, or with steps of 0.05 near one."""
    if 1.0 < value < 2.0:
        return float(np.ceil(value * 20 - 1e-9) / 20)
    power = 10.0 ** (np.floor(np.log10(value)) - 1)
    return float(f"{np.ceil(value / power - 1e-9) * power:.12g}")


def _even_ticks(low: float, high: float, most: int) -> list[float]:
    for step in _steps((high - low) / max(most - 1, 1)):
        first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
        if last - first + 1 <= most:
            return [float(f"{n * step:.12g}") + 0.0 for n in np.arange(first, last + 1)]
    return [low, high]


def _steps(least: float):
    power = 10.0 ** np.floor(np.log10(least))
    for scale in (1, 10):
        for digit in (1, 2, 2.5, 5):
            if digit * scale * power >= least * (1 - 1e-9):
                yield digit * scale * power


def _log_ticks(low: float, high: float, most: int) -> list[float]:
    """Both ends, and values of few digits between them; 1 among them if it is inside."""
    middle = 1.0 if low < 1.0 < high else float(np.sqrt(low * high))
    places = [low, middle, high]
    if most >= 5:
        places = [low, np.sqrt(low * middle), middle, np.sqrt(middle * high), high]
    digits = 2 if high >= 1.5 else 3
    return [float(f"{place:.{digits}g}") for place in places]


@lru_cache(maxsize=1)
def diverging_colors() -> Bytes:
    """(256, 4) RGBA: blue, neutral in the middle, orange to dark red."""
    # Both middles are neutral: an even number of colours has no single one.
    warm, cool = (_walk(knots, STEPS // 2) for knots in (_WARM, _COOL))
    return _frozen(np.concatenate([cool[::-1], warm]))


@lru_cache(maxsize=1)
def sequential_colors() -> Bytes:
    """(256, 4) RGBA: neutral, then yellow, orange, red, dark violet."""
    return _frozen(_walk(_HEAT, STEPS))


def _frozen(rgb: Array) -> Bytes:
    table = np.full((len(rgb), 4), 255, dtype=np.uint8)
    table[:, :3] = np.rint(rgb * 255)
    table.setflags(write=False)
    return table


def _walk(knots: tuple[tuple[float, float, float], ...], count: int) -> Array:
    """sRGB (count, 3) in [0, 1] at even steps along a smooth curve through colours in OKLab."""
    lightness, chroma, hue = np.array(knots).T
    angle = np.radians(hue)
    places = np.stack([lightness, chroma * np.cos(angle), chroma * np.sin(angle)], axis=1)
    curve = PchipInterpolator(np.arange(len(places)), places)
    fine = curve(np.linspace(0, len(places) - 1, 4096))
    steps = np.linalg.norm(np.diff(fine, axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    even = np.linspace(0, length[-1], count)
    return _srgb(np.stack([np.interp(even, length, fine[:, k]) for k in range(3)], axis=1))


def _srgb(lab: Array) -> Array:
    """OKLab (n, 3) to sRGB in [0, 1], clipped to what screens show."""
    to_cone = np.array(
        [
            [1, 0.3963377774, 0.2158037573],
            [1, -0.1055613458, -0.0638541728],
            [1, -0.0894841775, -1.291485548],
        ]
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.707614701],
        ]
    )
    linear = np.clip((lab @ to_cone.T) ** 3 @ to_linear.T, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
