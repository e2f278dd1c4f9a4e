"""Solids with flat faces: hulls, pyramids, regular and rhombic solids."""

from __future__ import annotations

from itertools import product

import numpy as np

import fields as sdf
from fields import Field
from tests.fields.second_descriptions import hull

G = (1 + np.sqrt(5)) / 2
SIGNS = np.array(list(product((-1.0, 1.0), repeat=3)))
AXES = np.concatenate([np.eye(3), -np.eye(3)])
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)


def _cyclic(a: float, b: float, c: float) -> np.ndarray:
    """All signs and cyclic orders of three coordinates."""
    once = np.unique(SIGNS * [a, b, c], axis=0)
    return np.concatenate([np.roll(once, shift, axis=1) for shift in range(3)])


ICOSAHEDRON = _cyclic(G, 0, 1) / np.hypot(1, G)
DODECAHEDRON = np.concatenate([SIGNS, _cyclic(0, G, 1 / G)]) / np.sqrt(3)
# The rhombic solids: each corner of one kind is as far out as makes the rhombi flat.
RHOMBIC_DODECAHEDRON = np.concatenate([AXES, SIGNS / 2])
RHOMBIC_TRIACONTAHEDRON = np.concatenate([_cyclic(G, 0, 1), SIGNS, _cyclic(0, G, 1 / G)])
RHOMBIC_TRIACONTAHEDRON /= np.hypot(1, G)

GEM = np.random.default_rng(3).normal(size=(14, 3))
ROOF = np.array([*product((0.0, 1.2), (-0.5, 0.5), (0.0,)), (0.3, 0, 0.7), (0.9, 0, 0.7)])
BRICK = np.array(list(product((0.0, 1.0), (0.0, 0.6), (0.0, 0.4)))) - 0.3

EXAMPLES: dict[str, Field] = {
    "convex_hull": sdf.convex_hull(GEM),
    "convex_hull, roof": sdf.convex_hull(ROOF),
    "convex_hull, brick": sdf.convex_hull([*BRICK, (0.2, 0.0, 0.0), (0.2, 0.0, -0.3), BRICK[3]]),
    "pyramid": sdf.pyramid(1.4, 1.1),
    "pyramid, steep": sdf.pyramid(0.6, 2.0),
    "tetrahedron": sdf.tetrahedron(1.2),
    "octahedron": sdf.octahedron(1.1),
    "dodecahedron": sdf.dodecahedron(1.0),
    "icosahedron": sdf.icosahedron(1.0),
    "rhombic_dodecahedron": sdf.rhombic_dodecahedron(1.2),
    "rhombic_triacontahedron": sdf.rhombic_triacontahedron(1.0),
}

_BASE = [(x, y, -0.5) for x, y in product((-0.5, 0.5), repeat=2)]
_CORNERS = {
    "convex_hull": GEM,
    "convex_hull, roof": ROOF,
    "convex_hull, brick": BRICK,
    "pyramid": np.array([*_BASE, (0, 0, 0.5)]) * [1.4, 1.4, 1.1],
    "pyramid, steep": np.array([*_BASE, (0, 0, 0.5)]) * [0.6, 0.6, 2.0],
    "tetrahedron": 1.2 * TETRAHEDRON,
    "octahedron": 1.1 * AXES,
    "dodecahedron": DODECAHEDRON,
    "icosahedron": ICOSAHEDRON,
    "rhombic_dodecahedron": 1.2 * RHOMBIC_DODECAHEDRON,
    "rhombic_triacontahedron": RHOMBIC_TRIACONTAHEDRON,
}

SURFACES = {name: hull(EXAMPLES[name], corners) for name, corners in _CORNERS.items()}
