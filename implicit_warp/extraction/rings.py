"""The loops of single cells as polygons of vertices, to which points can be added."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.cube import tables

MOST = 36
"""Points of a ring: 24 crossings, if every edge were crossed twice, and room for points added."""


class Rings(NamedTuple):
    """Closed polygons on the faces of cells.

    Attributes:
        cells: (c,) the cell of each.
        length: (c,) number of points.
        points: (c, MOST) vertices in order, -1 beyond the length.
        faces: (c, MOST) the face of the cell in which the step from each point to the next lies.
    """

    cells: NDArray[np.int64]
    length: NDArray[np.int64]
    points: NDArray[np.int64]
    faces: NDArray[np.int64]

    def where(self, chosen: NDArray[np.bool_]) -> Rings:
        """Some of the rings."""
        return Rings(*(column[chosen] for column in self))

    def joined(self, other: Rings) -> Rings:
        """These and others."""
        return Rings(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    @staticmethod
    def blank(cells: NDArray[np.int64]) -> Rings:
        """Rings of some cells without any points yet."""
        points = np.full((len(cells), MOST), -1, np.int64)
        return Rings(cells, np.zeros(len(cells), np.int64), points, points.copy())


def rings_of(surface: Surface, cells: NDArray[np.int64]) -> Rings:
    """The rings of cells with a single loop, as the surface has them."""
    rings, t = Rings.blank(cells), tables()
    patterns = surface.patterns[cells]
    edges = t.loop_edges[patterns, 0]
    rings.length[:] = t.loop_length[patterns, 0]
    used = np.arange(edges.shape[1]) < rings.length[:, None]
    corners = np.take_along_axis(surface.cell_edges[cells], edges, axis=1)
    rings.points[:, : edges.shape[1]] = np.where(used, corners, -1)
    rings.faces[:, : edges.shape[1]] = np.where(used, t.loop_faces[patterns, 0], -1)
    return rings


def with_points(
    rings: Rings, row: NDArray[np.int64], step: NDArray[np.int64], points: NDArray[np.int64]
) -> Rings:
    """The rings with points put into some of their steps, at most one a step."""
    inserted = np.full(rings.points.shape, -1, np.int64)
    inserted[row, step] = points
    result = Rings.blank(rings.cells)
    _insert(rings.length, rings.points, rings.faces, inserted, *result[1:])
    return result


@kernel
def _insert(length, points, faces, inserted, new_length, new_points, new_faces):
    for i in range(len(length)):
        n = 0
        for j in range(length[i]):
            new_points[i, n] = points[i, j]
            new_faces[i, n] = faces[i, j]
            n += 1
            if inserted[i, j] >= 0:
                new_points[i, n] = inserted[i, j]
                new_faces[i, n] = faces[i, j]
                n += 1
        new_length[i] = n
