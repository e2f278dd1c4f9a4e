"""Contours from whatever fontTools can draw: glyphs of fonts, path data of SVG files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fields.errors import needing
from fields.profiles.curves import Contour, straight


def drawn_contours(draw: Callable[[Any], None], glyphs: Any = None) -> list[Contour]:
    """What `draw(pen)` draws, every contour closed.

    Args:
        draw: calls the methods of a fontTools pen.
        glyphs: the glyph set that components are taken from, if there can be any.
    """
    with needing("fonttools", "drawing outlines"):
        from fontTools.pens.basePen import BasePen

    class Pen(BasePen):  # type: ignore[misc]
        """Collects cubic segments; the base class brings all other kinds to this form."""

        def __init__(self) -> None:
            super().__init__(glyphs)
            self.segments: list[list[tuple[float, float]]] = []
            self.contours: list[Contour] = []

        def _moveTo(self, point: tuple[float, float]) -> None:  # noqa: N802 (fontTools' name)
            self._endPath()
            self.start = point

        def _lineTo(self, point: tuple[float, float]) -> None:  # noqa: N802
            a, b = np.array([self._getCurrentPoint()]), np.array([point])
            self.segments.append(straight(a, b)[0].tolist())

        def _curveToOne(self, *handles_and_end: tuple[float, float]) -> None:  # noqa: N802
            self.segments.append([self._getCurrentPoint(), *handles_and_end])

        def _closePath(self) -> None:  # noqa: N802
            self._endPath()

        def _endPath(self) -> None:  # noqa: N802
            if self.segments:
                end, start = self.segments[-1][-1], self.segments[0][0]
                if end != start:
                    self.segments.append(straight(np.array([end]), np.array([start]))[0].tolist())
                self.contours.append(np.array(self.segments, dtype=np.float64))
            self.segments = []

    pen = Pen()
    draw(pen)
    pen._endPath()
    return pen.contours
