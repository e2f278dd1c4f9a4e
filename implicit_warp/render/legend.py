"""The legend of a colour scale, as a strip under a picture."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from implicit_warp.render.picture import Image, pillow

if TYPE_CHECKING:
    from implicit_warp.color_scales import ColorScale

_FINE = 4  # drawn so much larger and reduced


def legend_height(size: tuple[int, int]) -> int:
    """Rows of the strip that belongs under a picture of some width and height in all."""
    # Readable, but not most of a small picture.
    return 2 * round(max(min(38, min(size) / 3), 0.105 * min(size)) / 2)


def with_legend(image: Image, scale: ColorScale, height: int) -> Image:
    """A picture (h, w, 3) with the legend of a scale under it, (h + height, w, 3).

    The strip goes on in the colours of the picture's last rows.

    Raises:
        MissingDependency: Pillow cannot be imported.
    """
    library = pillow("Image")
    width = image.shape[1]
    # The last rows hold one period of the dither.
    strip = np.tile(image[-8:], (-(-height // 8), 1, 1))[:height]
    ink = (225, 225, 225, 255) if strip.mean() < 128 else (72, 76, 82, 255)
    layer = library.new("RGBA", (width * _FINE, height * _FINE), (*ink[:3], 0))
    draw = pillow("ImageDraw").Draw(layer)
    font = pillow("ImageFont").load_default(height * _FINE * 0.26)
    long, high = round(0.44 * width * _FINE), round(0.2 * height * _FINE)
    left, top = (width * _FINE - long) // 2, round(0.16 * height * _FINE)
    layer.paste(library.fromarray(scale.bar(long, high)), (left, top))
    draw.rectangle((left, top, left + long - 1, top + high), outline=ink, width=_FINE // 2)
    draw.text((left - 0.03 * long, top + high / 2), scale.label, fill=ink, font=font, anchor="rm")
    for at, text in scale.ticks():
        x = left + at * (long - 1)
        draw.line((x, top + high, x, top + 1.3 * high), fill=ink, width=_FINE // 2)
        draw.text((x, top + 1.5 * high), text, fill=ink, font=font, anchor="ma")
    small = layer.resize((width, height), library.Resampling.BOX)
    below = library.fromarray(strip).convert("RGBA")
    below.alpha_composite(small)
    return np.concatenate([image, np.asarray(below.convert("RGB"))])
