"""The oracle of extraction: every lattice point sampled, and marching cubes by scikit-image."""

from __future__ import annotations

import numpy as np
import torch
from skimage.measure import marching_cubes

from fields import Field
from implicit_warp.extraction.lattice import lattice_for


def dense_crossings(
    field: Field, resolution: int, bounds=None
) -> tuple[set[tuple[int, ...]], np.ndarray, np.ndarray]:
    """The crossed lattice edges (low end and axis), and scikit-image's mesh of the signs.

    Its vertices are the middles of these edges, in units of half a voxel.
    """
    lattice = lattice_for(field, resolution, bounds)
    index = np.stack(np.meshgrid(*map(np.arange, lattice.shape), indexing="ij"), axis=-1)
    points = torch.from_numpy(lattice.origin + lattice.voxel * index).to(torch.float32)
    with torch.no_grad():
        signs = np.where(field.evaluate(points).numpy() < 0, np.float32(-1), np.float32(1))
    middles, faces, _, _ = marching_cubes(signs, 0.0, method="lorensen")
    doubled = np.rint(2 * middles).astype(int)
    edges = {(*map(int, d >> 1), int(np.argmax(d & 1))) for d in doubled}
    return edges, doubled, faces


def crossed_edges(vertices: np.ndarray, field: Field, resolution: int, bounds=None):
    """The lattice edge on which each vertex of an extracted mesh lies."""
    lattice = lattice_for(field, resolution, bounds)
    places = (vertices - lattice.origin) / lattice.voxel
    off = np.abs(places - np.rint(places))
    axis = off.argmax(axis=1)  # a vertex keeps off the ends of its edge, and lies on a line
    low = np.rint(places).astype(int)
    rows = np.arange(len(low))
    low[rows, axis] = np.floor(places[rows, axis]).astype(int)
    return {(*map(int, a), int(b)) for a, b in zip(low, axis, strict=True)}
