"""The dark or bright part of a picture, with borders finer than its pixels."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments, notation
from fields.errors import InputError, needing
from fields.field import Field, make_field
from fields.notation import History, Opaque
from fields.profiles.edges import Points
from fields.profiles.outline import outline_body

Inside = Literal["bright", "dark"]

_OFF_LEVEL = 1e-6
"""Samples are kept so far off the level, as a part of the largest difference from it."""


def image(
    source: ArrayLike | str | os.PathLike[str],
    threshold: float = 0.5,
    width: float = 1.0,
    inside: Inside = "bright",
) -> Field:
    """A profile: where a picture is brighter (or darker) than a threshold; an exact distance.

    The border is the line on which brightness, between the centres of pixels, is the threshold: by
    marching squares, linear along the sides of each square, so smooth where edges in the picture
    are anti-aliased, and with corners cut off by half a pixel where it has two values only.
    Its distance is exact: searched, as of any polygon, and not interpolated from pixels.

    The picture is centred at the origin, its first row at the top, and around it is outside. So
    a shape that runs off the picture is closed there, within half a pixel of the picture's side.

    Args:
        source: the path of a PNG, JPEG or other file that Pillow reads, brought to grey between 0
            and 1, transparent parts white; or an array `(rows, columns)` of numbers or booleans,
            taken as it is.
        threshold: a brightness.
        width: of the whole picture.
        inside: which side of the threshold; "dark" for ink on paper.

    Raises:
        InputError: the file does not exist or cannot be read; the array is not a picture, or has
            NaN; or there is nothing inside.
        MissingDependency: scikit-image is not installed, or Pillow, if a file is to be read.
    """
    level = arguments.number("threshold", threshold)
    size = arguments.positive("width", width)
    if inside not in get_args(Inside):
        raise InputError("inside", inside, "there is no such side", "use 'bright' or 'dark'")
    history: History
    if isinstance(source, str | os.PathLike):
        pixels = _read(Path(source))
        given = {"source": source, "threshold": threshold, "width": width, "inside": inside}
        history = notation.recorded("image", (), given, notation.defaults(image))
    else:
        pixels = _checked(source)
        history = Opaque(f"image of {pixels.shape[1]} x {pixels.shape[0]} pixels")
    height = pixels - level if inside == "bright" else level - pixels
    return make_field(outline_body(_outlines(height, size)), history)


def _outlines(height: NDArray[np.float64], width: float) -> list[Points]:
    """Polygons around where the pixels' values are positive, with that on their left."""
    if not (height > 0).any():
        raise InputError(
            "threshold", "...", "nothing of the picture is inside", "change it, or swap `inside`"
        )
    # All there is around the picture is a negative frame, as far from the level as it can be
    # without the border leaving the picture by more than half a pixel.
    framed = np.pad(height, 1, constant_values=-float(height.max()))
    # Samples on the level would make edges of no length, and slits whose sides coincide.
    least = _OFF_LEVEL * np.abs(framed).max()
    framed = np.where(np.abs(framed) < least, np.where(framed > 0, least, -least), framed)
    with needing("scikit-image", "an image profile"):
        from skimage.measure import find_contours
    contours = find_contours(framed, 0.0, positive_orientation="high")
    rows, columns = height.shape
    center = np.array([rows + 1, columns + 1]) / 2
    pixel = width / columns
    outlines = []
    for contour in contours:
        row, column = ((contour[:-1] - center) * pixel).T
        points = np.stack([column, -row], axis=1)
        points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)]
        if len(points) > 2:
            outlines.append(points)
    return outlines


def _checked(source: ArrayLike) -> NDArray[np.float64]:
    pixels = np.asarray(source)
    if pixels.ndim != 2 or 0 in pixels.shape or pixels.dtype.kind not in "bfiu":
        raise InputError(
            "source",
            f"array {pixels.shape} {pixels.dtype}",
            "a picture is rows of numbers",
            "pass an array of shape (rows, columns), such as the mean of the colours",
        )
    pixels = pixels.astype(np.float64)
    if not np.isfinite(pixels).all():
        raise InputError("source", "...", "it has NaN or infinite pixels", "replace them")
    return pixels


def _read(path: Path) -> NDArray[np.float64]:
    with needing("pillow", "reading a picture"):
        from PIL import Image
    if not path.is_file():
        raise InputError("source", str(path), "there is no such file", "check the path")
    try:
        with Image.open(path) as opened:
            picture = opened.convert("RGBA")
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise InputError(
            "source", str(path), f"it cannot be read as a picture ({error})", "pass a PNG file"
        ) from error
    paper = Image.new("RGBA", picture.size, "white")
    grey = Image.alpha_composite(paper, picture).convert("L")
    return np.asarray(grey, dtype=np.float64) / 255
