"""Random layers, folds planted in them, and orientations by rational arithmetic.

Nothing here is shared with the code under test but the numbering of the mesh.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from implicit_warp.embedding import boundary_positions, edge_weights, embed
from implicit_warp.square_mesh import SquareMesh, square_mesh
from implicit_warp.warp import Warp


def rational_area(corners) -> Fraction:
    """Twice the oriented area of a triangle (3, 2)."""
    (ax, ay), (bx, by), (cx, cy) = [[Fraction(float(x)) for x in corner] for corner in corners]
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def cell_corners(u: np.ndarray, mesh: SquareMesh, cell: int) -> np.ndarray:
    """The image corners (3, 2) of a triangle or cone of one layer (V, 2)."""
    return np.concatenate([u, np.zeros((1, 2))])[mesh.cells[cell]]


def random_layers(rng: np.random.Generator, layers: int, resolution: int) -> np.ndarray:
    """(layers, V, 2) embeddings; parameters of moderate size, or at the limits of the weights."""
    mesh = square_mesh(resolution)
    spread = rng.choice([0.3, 1.0, 3.0, 1e3])
    with torch.no_grad():
        weights = edge_weights(torch.from_numpy(spread * rng.normal(size=(layers, mesh.n_edges))))
        boundary = spread * rng.normal(size=(layers, mesh.n_cones)) * rng.integers(2)
        return embed(weights, boundary_positions(torch.from_numpy(boundary), mesh), mesh).numpy()


def random_warp_at_the_limits(rng: np.random.Generator) -> Warp:
    """1 to 64 layers of 2 to 25 vertices a side under random rotations."""
    layers, resolution = int(rng.integers(1, 65)), int(rng.integers(2, 26))
    frames = Rotation.random(layers, random_state=int(rng.integers(1 << 31))).as_matrix()
    return Warp(torch.from_numpy(random_layers(rng, layers, resolution)), torch.from_numpy(frames))


def plant_fold(
    rng: np.random.Generator, u: np.ndarray, mesh: SquareMesh, size: float
) -> tuple[np.ndarray, int]:
    """Move one vertex of a layer (V, 2) so that a random cell's area becomes about -size.

    Size 0 gives an area of exactly zero. Sizes below what float64 resolves at unit scale are
    reached by scaling the whole layer by a power of two, which is an injective layer as well.

    Returns:
        The layer, and the cell whose area is negative or zero by rational arithmetic.
    """
    u = u.copy()
    cell = int(rng.integers(mesh.n_cells))
    corners = mesh.cells[cell]
    mover = int(rng.integers(cell >= mesh.n_triangles, 3))  # a cone's first corner is no vertex
    at = [corners[(mover + i) % 3] for i in range(3)]
    first, second = (np.zeros(2) if v == len(u) else u[v] for v in at[1:])
    if size == 0.0:
        u[at[0]] = second if at[1] == len(u) else first
        return u, cell
    relative = size if size > 1e-14 else 10.0 ** rng.uniform(-16.0, -3.0)
    edge = second - first
    outward = np.array([edge[1], -edge[0]]) / (edge @ edge)
    place = first + rng.uniform(0.2, 0.8) * edge
    if len(u) in at[1:]:  # the edge of a cone is a ray, which goes on beyond the vertex
        place = (first + second) * rng.uniform(0.5, 1.5)
    for _ in range(60):
        u[at[0]] = place + relative * outward
        if rational_area(cell_corners(u, mesh, cell)) < 0:
            break
        relative *= 2.0  # rounding took the vertex back over the edge
    return np.ldexp(u, round(0.5 * np.log2(size / relative))), cell
