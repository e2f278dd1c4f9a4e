"""Prisms, plates and frames."""

from __future__ import annotations

from itertools import product

import numpy as np

import fields as sdf
from fields import Field
from tests.fields.catalogue.surface import REACH, Surface
from tests.fields.second_descriptions import arc, extruded, hull, line, outline

EXAMPLES: dict[str, Field] = {
    "slab": sdf.slab(x0=-0.5, x1=1.0, y1=0.8, z0=-0.2),
    "slab, closed": sdf.slab(-0.5, -0.4, -0.3, 1.0, 0.8, 0.6),
    "prism": sdf.prism(5, 1.1, 0.8),
    "prism, seven sides": sdf.prism(7, 0.9, 1.5),
    "hexagonal_prism": sdf.hexagonal_prism(1.3, 0.7),
    "triangular_prism": sdf.triangular_prism(1.6, 0.9),
    "rhombic_prism": sdf.rhombic_prism(2.0, 1.1, 0.5),
    "wedge": sdf.wedge(1.8, 1.0, 0.9),
    "wedge, cut off": sdf.wedge(1.8, 1.0, 0.9, top=0.5),
    "wedge, a block": sdf.wedge(1.0, 1.0, 0.9, top=1.0),
    "tube": sdf.tube(0.9, 0.5, 1.2),
    "sector": sdf.sector(1.2, 70, 0.8),
    "sector, most of a disc": sdf.sector(1.0, 280, 0.8),
    "sector, half": sdf.sector(1.0, 180, 0.8),
    "box_frame": sdf.box_frame((1.6, 2.2, 1.2), 0.25),
}


def _regular(sides: int, radius: float, height: float) -> np.ndarray:
    angles = 2 * np.pi * np.arange(sides) / sides
    flat = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=1)
    ends = (np.full(sides, z) for z in (-height / 2, height / 2))
    return np.concatenate([np.column_stack([flat, z]) for z in ends])


def _block(low: tuple[float, ...], high: tuple[float, ...]) -> np.ndarray:
    return np.array(list(product(*zip(low, high, strict=True))))


def _wedge(top: float) -> np.ndarray:
    profile = [(-0.9, -0.45), (0.9, -0.45), (-0.9 + top, 0.45), (-0.9, 0.45)]
    return np.array([(x, y, z) for x, z in profile for y in (-0.5, 0.5)])


def _sector(angle: float):
    def inside(x, y):
        return (np.hypot(x, y) < 1.2) & (np.abs(np.degrees(np.arctan2(y, x))) < angle / 2)

    rim = arc((0, 0), 1.2, -angle / 2, angle / 2)
    low, high = (tuple(rim(np.array([t]))[0]) for t in (0.0, 1.0))
    return [rim, line((0, 0), low), line((0, 0), high)], inside


def _on_slab(rng, n):
    """Four unbounded faces; the edges cut them off."""
    low, high = np.array([-0.5, -9.0, -0.2]), np.array([1.0, 0.8, 9.0])
    low, high = np.maximum(low, -2 * REACH), np.minimum(high, 2 * REACH)
    points = rng.uniform(low, high, (n, 3))
    for part, (axis, value) in enumerate(((0, -0.5), (0, 1.0), (1, 0.8), (2, -0.2))):
        points[part::4, axis] = value
    return points


FRAME = np.array([0.8, 1.1, 0.6])


def _in_frame(p):
    within = np.abs(p) < FRAME
    edge = np.abs(p) > FRAME - 0.25
    return within.all(axis=1) & (edge.sum(axis=1) >= 2)


def _on_frame(rng, n):
    """Faces of the box and of the windows through it, without what is missing."""
    planes = []
    for offset in (0.0, 0.25):
        points = rng.uniform(-FRAME, FRAME, (3 * n, 3))
        axis = rng.integers(0, 3, len(points))
        rows = np.arange(len(points))
        points[rows, axis] = rng.choice([-1.0, 1.0], len(points)) * (FRAME - offset)[axis]
        edge = np.abs(points) > FRAME - 0.25
        edge[rows, axis] = False
        # An outer face needs one more coordinate at an edge; a window's wall exactly one.
        count = edge.sum(axis=1)
        planes.append(points[(count >= 1) if offset == 0 else (count == 1)])
    return np.concatenate(planes)


SURFACES = {
    "slab": Surface(
        EXAMPLES["slab"],
        _on_slab,
        lambda p: (p[:, 0] > -0.5) & (p[:, 0] < 1.0) & (p[:, 1] < 0.8) & (p[:, 2] > -0.2),
    ),
    "slab, closed": hull(EXAMPLES["slab, closed"], _block((-0.5, -0.4, -0.3), (1.0, 0.8, 0.6))),
    "prism": hull(EXAMPLES["prism"], _regular(5, 1.1, 0.8)),
    "prism, seven sides": hull(EXAMPLES["prism, seven sides"], _regular(7, 0.9, 1.5)),
    "hexagonal_prism": hull(
        EXAMPLES["hexagonal_prism"], _regular(6, 0.65 / np.cos(np.pi / 6), 0.7)
    ),
    "triangular_prism": hull(
        EXAMPLES["triangular_prism"], _regular(3, 0.8 / np.sin(np.pi / 3), 0.9)
    ),
    "rhombic_prism": hull(
        EXAMPLES["rhombic_prism"],
        np.array(
            [(x, y, z) for x, y in ((1, 0), (-1, 0), (0, 0.55), (0, -0.55)) for z in (-0.25, 0.25)]
        ),
    ),
    "wedge": hull(EXAMPLES["wedge"], _wedge(0.0)),
    "wedge, cut off": hull(EXAMPLES["wedge, cut off"], _wedge(0.5)),
    "tube": extruded(
        EXAMPLES["tube"],
        [arc((0, 0), 0.9, 0, 360), arc((0, 0), 0.5, 0, 360)],
        lambda x, y: (np.hypot(x, y) > 0.5) & (np.hypot(x, y) < 0.9),
        1.2,
    ),
    "sector": extruded(EXAMPLES["sector"], *_sector(70), 0.8),
    "sector, more than half": extruded(sdf.sector(1.2, 280, 0.8), *_sector(280), 0.8),
    "box_frame": Surface(EXAMPLES["box_frame"], _on_frame, _in_frame),
}
SURFACES["wedge, as a profile"] = extruded(
    EXAMPLES["wedge"],
    outline((-0.9, -0.45), (0.9, -0.45), (-0.9, 0.45), (-0.9, -0.45)),
    lambda x, z: (x > -0.9) & (z > -0.45) & ((x + 0.9) / 1.8 + (z + 0.45) / 0.9 < 1),
    1.0,
    axes=(0, 2, 1),
)
