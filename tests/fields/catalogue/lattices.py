"""Triply periodic minimal surfaces."""

from __future__ import annotations

import numpy as np

import fields as sdf
from fields import Field
from tests.fields.second_descriptions import level_set

EXAMPLES: dict[str, Field] = {
    "gyroid": sdf.gyroid(1.5),
    "gyroid, walls": sdf.gyroid(1.2, 0.1),
    "gyroid, in a ball": sdf.gyroid(0.9, thickness=0.15) & sdf.sphere(1.2),
    "schwarz_p": sdf.schwarz_p(1.4),
    "schwarz_p, walls": sdf.schwarz_p(1.4, 0.2),
    "schwarz_d": sdf.schwarz_d(1.6),
    "schwarz_d, walls": sdf.schwarz_d(1.6, 0.15),
    "neovius": sdf.neovius(1.8),
    "neovius, walls": sdf.neovius(1.8, 0.08),
}


def _rate(cell, function):
    """A function of angles as one of lengths."""
    return lambda x, y, z: function(*(2 * np.pi * axis / cell for axis in (x, y, z)))


def _gyroid(x, y, z):
    """By the sum of shifted products, with sines only."""
    half = np.pi / 2
    return (
        np.sin(x) * np.sin(y + half) + np.sin(y) * np.sin(z + half) + np.sin(z) * np.sin(x + half)
    )


def _diamond(x, y, z):
    """Four plane waves along the diagonals of a cube."""
    waves = (x + y + z, x + y - z, x - y + z, -x + y + z)
    return sum(np.sin(wave) for wave in waves) / 2


def _neovius(x, y, z):
    """4 cos x cos y cos z as four waves."""
    waves = (x + y + z, x + y - z, x - y + z, -x + y + z)
    return 3 * (np.cos(x) + np.cos(y) + np.cos(z)) + sum(np.cos(wave) for wave in waves)


def _primitive(x, y, z):
    """1 - 2 sin^2 of half the angles."""
    return 3 - 2 * (np.sin(x / 2) ** 2 + np.sin(y / 2) ** 2 + np.sin(z / 2) ** 2)


SURFACES = {
    "gyroid": level_set(EXAMPLES["gyroid"], _rate(1.5, _gyroid)),
    "gyroid, walls": level_set(
        EXAMPLES["gyroid, walls"],
        lambda x, y, z: np.abs(_rate(1.2, _gyroid)(x, y, z)) - 0.05 * np.sqrt(3) * 2 * np.pi / 1.2,
    ),
    "schwarz_p": level_set(EXAMPLES["schwarz_p"], _rate(1.4, _primitive)),
    "schwarz_d": level_set(EXAMPLES["schwarz_d"], _rate(1.6, _diamond)),
    "neovius": level_set(EXAMPLES["neovius"], _rate(1.8, _neovius)),
}
