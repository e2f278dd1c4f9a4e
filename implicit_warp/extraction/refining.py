"""Finer lattices for shapes with parts thinner than a voxel."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from implicit_warp.extraction.cells import Found, Surface
from implicit_warp.extraction.samples import Sampler

FINEST = 8
"""How many times finer than asked for a lattice may get for thin parts."""


class ThinParts(UserWarning):
    """A shape has parts that the voxels asked for do not resolve."""


class Looked(NamedTuple):
    """What a lattice shows of a surface."""

    resolution: int
    sampler: Sampler
    found: Found
    surface: Surface
    missed: NDArray[np.int64]
    samples_at_rest: int


def refined(look: Callable[[int], Looked], looked: Looked) -> Looked:
    """The coarsest lattice that misses nothing it knows of, and shows what a finer one does."""
    factor = 1
    while factor < FINEST:
        finer = look(2 * factor)
        if not len(looked.missed) and _topology(looked.surface) == _topology(finer.surface):
            return looked
        looked, factor = finer, 2 * factor
    return looked


def _topology(surface: Surface) -> tuple[int, int]:
    """Number of components, and Euler characteristic."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n, faces = len(surface.axes), surface.faces
    ends = faces.T.reshape(-1), faces[:, [1, 2, 0]].T.reshape(-1)
    links = coo_array((np.ones(faces.size, np.bool_), ends), shape=(n, n))
    return int(connected_components(links, directed=False)[0]), n - len(faces) // 2


def warn_of_thin_parts(looked: Looked, thin: str) -> None:
    """Tell the caller of `extract` what its mesh lacks."""
    lattice, missed = looked.sampler.lattice, looked.missed
    place = lattice.origin + lattice.voxel * (missed[0] + 0.5)
    remedy = 'thin="refine"' if thin != "refine" else "a higher resolution"
    warnings.warn(
        f"parts of the shape, or gaps in it, are thinner than a voxel ({lattice.voxel:.3g} at "
        f"resolution {looked.resolution}) and are not in the mesh, or in pieces: {len(missed)} "
        f"cells, the first at {place.round(6).tolist()}. Use {remedy}.",
        ThinParts,
        stacklevel=4,
    )
