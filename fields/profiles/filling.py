"""Outlines that overlap, made into polygons that do not."""

from __future__ import annotations

from typing import Literal

import numpy as np

from fields.errors import InputError, needing
from fields.profiles.curves import Contour, checked_tolerance, chords
from fields.profiles.edges import Points

FillRule = Literal["nonzero", "evenodd"]

_SIZE = 2.0**20
"""Clipper rounds to 1e-8; outlines are scaled to this size, so that it is 1e-14 of them."""

Shape = tuple[list[Contour], FillRule]
"""Closed contours that are filled together."""


def filled(
    argument: str, value: object, shapes: list[Shape], tolerance: float | None
) -> list[Points]:
    """The polygons around the union of shapes, with the inside on their left.

    Curves become chords; each shape is filled by its own rule and all are united, by Clipper
    (through Manifold), with coordinates rounded to some 1e-14 of the whole.

    Args:
        argument: where the shapes come from, for errors.
        value: the same.
        shapes: what is filled.
        tolerance: of the chords; None for 1/1000 of the longer side.

    Raises:
        InputError: nothing is inside.
        MissingDependency: Manifold is not installed.
    """
    shapes = [(contours, rule) for contours, rule in shapes if contours]
    if shapes:
        accuracy = checked_tolerance(tolerance, [c for contours, _ in shapes for c in contours])
        polygons = [([chords(c, accuracy) for c in contours], rule) for contours, rule in shapes]
        result = _united(polygons)
        if result:
            return result
    raise InputError(argument, value, "it encloses nothing", "pass something with a filled area")


def _united(shapes: list[tuple[list[Points], FillRule]]) -> list[Points]:
    with needing("manifold3d", "filling outlines"):
        from manifold3d import CrossSection, OpType
        from manifold3d import FillRule as Rule

    every = np.concatenate([polygon for polygons, _ in shapes for polygon in polygons])
    center = (every.min(axis=0) + every.max(axis=0)) / 2
    extent = float(np.ptp(every, axis=0).max())
    if extent == 0:
        return []
    factor = 2.0 ** np.floor(np.log2(_SIZE / extent))
    rules = {"nonzero": Rule.NonZero, "evenodd": Rule.EvenOdd}
    sections = [
        CrossSection(
            [(polygon - center) * factor for polygon in polygons if len(polygon) > 2], rules[rule]
        )
        for polygons, rule in shapes
    ]
    whole = sections[0]
    if len(sections) > 1:
        whole = CrossSection.batch_boolean(sections, OpType.Add)
    polygons = [np.asarray(p, np.float64) / factor + center for p in whole.to_polygons()]
    return [polygon for polygon in map(_without_repeats, polygons) if len(polygon) > 2]


def _without_repeats(polygon: Points) -> Points:
    return polygon[(polygon != np.roll(polygon, 1, axis=0)).any(axis=1)]
