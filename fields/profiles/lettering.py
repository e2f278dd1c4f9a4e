"""Text in the outlines of a font file."""

from __future__ import annotations

import os
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from fields import arguments, notation
from fields.errors import InputError, MissingDependency, needing
from fields.field import Field, make_field
from fields.profiles.curves import Contour
from fields.profiles.filling import Shape, filled
from fields.profiles.kerning import kerning
from fields.profiles.outline import outline_body
from fields.profiles.pens import drawn_contours

Align = Literal["left", "center", "right"]


def text(
    string: str,
    font: str | os.PathLike[str] | None = None,
    size: float = 1.0,
    align: Align = "center",
    tolerance: float | None = None,
) -> Field:
    """A profile: letters in the outlines of a font, baseline of the first line at y = 0.

    Glyphs are placed by their advance widths and the font's pair kerning ("kern" in GPOS, or the
    older table). There is no shaping: ligatures, Arabic joining, combining marks and writing from
    right to left are not applied. Overlapping outlines are united. The field is an exact distance
    to chords of the curves, within the tolerance.

    Args:
        string: one line, or more with line breaks between; tabs are not known.
        font: path of a TTF, OTF, TTC (its first font) or WOFF file; None for DejaVu Sans, if
            matplotlib, which brings it, is installed.
        size: height of the font's em square, as of a font of so many points; a capital is some
            0.7 of it.
        align: what of every line is at x = 0.
        tolerance: the largest distance of the curves from the chords; None for 1/1000 of the longer
            side of the whole.

    Raises:
        InputError: nothing to draw; the font has no such glyph, cannot be read, or has no outlines.
        MissingDependency: fontTools is not installed, or matplotlib for the default font.
    """
    _check_string(string)
    scale = arguments.positive("size", size)
    if align not in get_args(Align):
        raise InputError(
            "align", align, "there is no such alignment", f"use one of {', '.join(get_args(Align))}"
        )
    path = _default_font() if font is None else Path(font)
    with _opened(path) as source:
        glyphs = _typeset(source, path, string, align)
        unit = scale / source["head"].unitsPerEm
    shapes: list[Shape] = [([contour * unit for contour in glyph], "nonzero") for glyph in glyphs]
    body = outline_body(filled("string", string, shapes, tolerance))
    given = {"string": string, "font": font, "size": size, "align": align, "tolerance": tolerance}
    return make_field(body, notation.recorded("text", (), given, notation.defaults(text)))


def _check_string(string: object) -> None:
    if not isinstance(string, str):
        raise InputError("string", string, "it is not a string", "pass text in quotes")
    if not string.strip():
        raise InputError("string", string, "there is nothing to draw", "pass at least one letter")


def _default_font() -> Path:
    """DejaVu Sans, where matplotlib keeps it; matplotlib itself is not imported."""
    found = find_spec("matplotlib")
    place = Path("mpl-data", "fonts", "ttf", "DejaVuSans.ttf")
    if found is not None and found.origin is not None:
        path = Path(found.origin).parent / place
        if path.is_file():
            return path
    raise MissingDependency(
        "matplotlib",
        "text without a font file",
        "Pass font='path.ttf', or install what brings DejaVu Sans with `pip install matplotlib`",
    )


def _opened(path: Path) -> Any:
    with needing("fonttools", "text"):
        from fontTools.ttLib import TTFont
    if not path.is_file():
        raise InputError("font", str(path), "there is no such file", "check the path")
    try:
        source = TTFont(path, fontNumber=0)
        source.getGlyphSet()
        source.getBestCmap()
    except Exception as error:  # the library raises whatever a broken file leads it into
        raise InputError(
            "font", str(path), f"it cannot be read as a font ({error})", "pass a TTF or OTF file"
        ) from error
    return source


def _typeset(source: Any, path: Path, string: str, align: Align) -> list[list[Contour]]:
    """The contours of every glyph in its place, in the font's units."""
    shift = {"left": 0.0, "center": 0.5, "right": 1.0}[align]
    pitch = source["hhea"].ascent - source["hhea"].descent + source["hhea"].lineGap
    glyphs, known, kern = source.getGlyphSet(), source.getBestCmap() or {}, kerning(source)
    placed: list[list[Contour]] = []
    for row, line in enumerate(string.split("\n")):
        names = [_glyph_name(known, path, letter) for letter in line]
        kerns = [kern(left, right) for left, right in pairwise(names)]
        steps = [glyphs[name].width + k for name, k in zip(names, [*kerns, 0.0], strict=False)]
        starts = np.cumsum([0.0, *steps])
        for name, start in zip(names, starts - shift * starts[-1], strict=False):
            origin = np.array([start, -row * pitch])
            contours = drawn_contours(glyphs[name].draw, glyphs)
            placed.append([contour + origin for contour in contours])
    return placed


def _glyph_name(known: dict[int, str], path: Path, letter: str) -> str:
    name = known.get(ord(letter))
    if name is None:
        raise InputError(
            "string",
            letter,
            f"the font {path.name} has no glyph for it (U+{ord(letter):04X})",
            "use another font or another letter",
        )
    return name
