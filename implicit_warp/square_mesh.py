"""The triangulated square on which every layer lives, and the cones around it.

`resolution` = N vertices a side on [-1, 1]^2 plus the (N-1)^2 cell centres, four triangles a
cell.  All interior edges lie on whole lines (x = t_i, y = t_j and the diagonals), so a point at
rest is located by a floor and two comparisons.  Outside the square every boundary edge spans a
cone from the origin; triangles and cones together are the *cells*, which tile the plane.

Numbering, used by every back end:

* vertex ``i * N + j`` stands at (t_i, t_j); centre ``N * N + i * (N - 1) + j`` in cell (i, j);
* triangle ``4 * (i * (N - 1) + j) + s`` lies on side s of that cell, s = 0, 1, 2, 3 for
  +x, +y, -x, -y; its corners are the centre and then the side's ends, counter-clockwise;
* cone ``4 * (N - 1)**2 + m`` stands on the boundary edge from vertex m to m + 1 of the loop,
  which runs counter-clockwise from the corner (-1, -1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from implicit_warp.errors import InputError


@dataclass(frozen=True, eq=False)
class SquareMesh:
    """Topology and rest geometry of one resolution. Build it with `square_mesh`.

    Attributes:
        resolution: N, the number of vertices a side.
        vertices: (V, 2) rest positions, V = N^2 + (N-1)^2.
        triangles: (T, 3) vertex indices, T = 4 (N-1)^2.
        boundary: (M,) vertex indices of the boundary loop, M = 4 (N-1).
        boundary_angles: (M,) polar angle of each boundary vertex, increasing from -3 pi / 4.
        boundary_increments: (M,) angle spanned by each boundary edge; they sum to 2 pi.
        centre_corners: ((N-1)^2, 4) the corners a centre is averaged from.
        inner: ((N-2)^2,) the grid vertices that are not on the boundary.
        inner_neighbours: ((N-2)^2, 8) their neighbours: four on the grid, then four centres.
        edges: (E, 2) directed edges (i, j), i interior, in the order of the weights: first
            `centre_corners`, then `inner_neighbours`, row by row.
        cells: (T + M, 3) the corners of every cell. A cone's first corner is the origin, stored
            as the virtual vertex V, so that one formula serves triangles and cones.
        neighbours: (T + M, 3) the cell across from each corner: where the k-th barycentric
            coordinate of cell c changes sign, one enters ``neighbours[c, k]``.
    """

    resolution: int
    vertices: np.ndarray
    triangles: np.ndarray
    boundary: np.ndarray
    boundary_angles: np.ndarray
    boundary_increments: np.ndarray
    centre_corners: np.ndarray
    inner: np.ndarray
    inner_neighbours: np.ndarray
    edges: np.ndarray
    cells: np.ndarray
    neighbours: np.ndarray

    @property
    def n_triangles(self) -> int:
        """T, four a cell."""
        return len(self.triangles)

    @property
    def n_cones(self) -> int:
        """M, one a boundary edge."""
        return len(self.boundary)

    @property
    def n_cells(self) -> int:
        """C = T + M."""
        return len(self.triangles) + len(self.boundary)

    @property
    def n_edges(self) -> int:
        """E, the number of weights."""
        return len(self.edges)


@lru_cache(maxsize=64)
def square_mesh(resolution: int) -> SquareMesh:
    """The mesh of the given resolution; one shared, read-only object per resolution.

    Raises:
        InputError: resolution is not an integer of at least 2.
    """
    if not isinstance(resolution, (int, np.integer)) or resolution < 2:
        raise InputError(
            "resolution",
            resolution,
            "the square mesh needs an integer number of vertices a side, at least 2",
            "pass e.g. 11, the default",
        )
    n = int(resolution)
    ticks = np.linspace(-1.0, 1.0, n)
    middles = 0.5 * (ticks[:-1] + ticks[1:])
    grid = np.arange(n * n).reshape(n, n)
    centres = n * n + np.arange((n - 1) ** 2).reshape(n - 1, n - 1)
    vertices = np.concatenate([_pairs(ticks), _pairs(middles)])

    a, b, c, d = grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]
    sides = [(b, c), (c, d), (d, a), (a, b)]
    triangles = np.stack([np.stack([centres, *ends], -1) for ends in sides], -2).reshape(-1, 3)

    boundary = np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]])
    x, y = vertices[boundary].T
    angles = np.unwrap(np.arctan2(y, x))
    increments = np.diff(np.append(angles, angles[0] + 2 * np.pi))

    inside = slice(1, -1)
    low, high = slice(None, -1), slice(1, None)
    inner = grid[inside, inside]
    inner_neighbours = np.stack(
        [
            grid[2:, inside],
            grid[inside, 2:],
            grid[:-2, inside],
            grid[inside, :-2],
            centres[high, high],
            centres[low, high],
            centres[low, low],
            centres[high, low],
        ],
        -1,
    ).reshape(-1, 8)
    centre_corners = np.stack([a, b, c, d], -1).reshape(-1, 4)
    edges = np.concatenate(
        [
            np.stack([np.repeat(centres.ravel(), 4), centre_corners.ravel()], -1),
            np.stack([np.repeat(inner.ravel(), 8), inner_neighbours.ravel()], -1),
        ]
    )
    origin = np.full(len(boundary), len(vertices))
    cones = np.stack([origin, boundary, np.roll(boundary, -1)], -1)
    arrays = (
        vertices,
        triangles,
        boundary,
        angles,
        increments,
        centre_corners,
        inner.ravel(),
        inner_neighbours,
        edges,
        np.concatenate([triangles, cones]),
        _cell_neighbours(n),
    )
    for array in arrays:
        array.setflags(write=False)
    return SquareMesh(n, *arrays)


@lru_cache(maxsize=512)
def mesh_tensor(mesh: SquareMesh, name: str, dtype: torch.dtype, device: torch.device) -> Tensor:
    """One of the mesh's arrays as a tensor; cached, so do not write to it."""
    # Outside inference mode whatever the caller's mode is: others will train with it.
    with torch.inference_mode(False):
        return torch.tensor(getattr(mesh, name), dtype=dtype, device=device)


@lru_cache(maxsize=64)
def rest_forms(mesh: SquareMesh) -> np.ndarray:
    """(C, 3, 3) barycentric coordinates of each rest cell as affine forms (x, y, 1).

    A cone's coordinate at the origin changes sign, so that being inside any cell means that all
    three are non-negative.
    """
    corners = np.concatenate([mesh.vertices, np.zeros((1, 2))])[mesh.cells]
    homogeneous = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], -1)
    forms = np.linalg.inv(homogeneous).transpose(0, 2, 1)
    forms[mesh.n_triangles :, 0] *= -1.0
    forms = np.ascontiguousarray(forms)
    forms.setflags(write=False)
    return forms


class CellEdges(NamedTuple):
    """The L edges and rays between the C cells.

    Attributes:
        ends: (L, 2) vertices; V, where there is none, is the origin, and the edge the ray from it
            through the other end, beyond that end.
        sides: (L, 2) the cells to the right and to the left of the line from first to second end.
        of_cell: (C,) one of each cell's edges.
    """

    ends: np.ndarray
    sides: np.ndarray
    of_cell: np.ndarray


@lru_cache(maxsize=64)
def cell_edges(mesh: SquareMesh) -> CellEdges:
    """Each edge between two cells once; cached, read-only."""
    cell, corner = np.repeat(np.arange(mesh.n_cells), 3), np.tile(np.arange(3), mesh.n_cells)
    across = mesh.neighbours.ravel()
    # Corners run counter-clockwise, so a cell lies on the left of its own sides; a cone lies on
    # the other side of its boundary edge, which its triangle gives.
    once = cell < across
    cell, corner, across = cell[once], corner[once], across[once]
    ends = np.stack([mesh.cells[cell, (corner + 1) % 3], mesh.cells[cell, (corner + 2) % 3]], -1)
    of_cell = np.empty(mesh.n_cells, np.int64)
    for side in (across, cell):
        of_cell[side] = np.arange(len(cell))
    parts = (ends, np.stack([across, cell], -1), of_cell)
    for part in parts:
        part.setflags(write=False)
    return CellEdges(*parts)


def _pairs(ticks: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(ticks, ticks, indexing="ij"), -1).reshape(-1, 2)


def _cell_neighbours(n: int) -> np.ndarray:
    m = n - 1
    cell = np.arange(m * m).reshape(m, m)
    loop = np.arange(4 * m)
    cones = 4 * m * m + loop
    # Across the edge opposite the centre: the neighbouring cell's facing triangle, or a cone.
    across = np.empty((m, m, 4), dtype=np.int64)
    across[:-1, :, 0] = 4 * cell[1:] + 2
    across[:, :-1, 1] = 4 * cell[:, 1:] + 3
    across[1:, :, 2] = 4 * cell[:-1]
    across[:, 1:, 3] = 4 * cell[:, :-1] + 1
    across[:, 0, 3] = cones[:m]
    across[-1, :, 0] = cones[m : 2 * m]
    across[::-1, -1, 1] = cones[2 * m : 3 * m]
    across[0, ::-1, 2] = cones[3 * m :]
    triangle = np.empty((m, m, 4, 3), dtype=np.int64)
    for s in range(4):
        triangle[:, :, s, 0] = across[:, :, s]
        # Corner 1 is shared with the previous side's triangle, so the edge opposite corner 1
        # (centre to corner 2) is shared with the next one.
        triangle[:, :, s, 1] = 4 * cell + (s + 1) % 4
        triangle[:, :, s, 2] = 4 * cell + (s + 3) % 4
    below = np.concatenate(
        [
            4 * cell[:, 0] + 3,
            4 * cell[-1, :],
            4 * cell[::-1, -1] + 1,
            4 * cell[0, ::-1] + 2,
        ]
    )
    cone = np.stack([below, np.roll(cones, -1), np.roll(cones, 1)], -1)
    return np.concatenate([triangle.reshape(-1, 3), cone])
