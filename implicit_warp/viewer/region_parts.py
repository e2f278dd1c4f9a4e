"""A mesh cut along the borders of regions, so that each part has one colour and a smooth outline.

Colouring whole faces would leave a border like a saw.  The cut vertices lie on the mesh's faces, as
fixed means of its vertices; so they follow wherever the vertices go, without another evaluation of
the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, vstack

from fields import Field

HALVINGS = 4
"""Of a cut edge, to find where a region ends: a sixteenth of an edge is not seen."""


class Part(NamedTuple):
    """What one region has of a mesh.

    Attributes:
        weights: (m, n) sparse, rows sum to one: the part's vertices from the mesh's.
        faces: (k, 3) int, of the part's vertices.
    """

    weights: csr_array
    faces: NDArray[np.int64]


def cut_by_regions(mesh: trimesh.Trimesh, regions: Sequence[Field]) -> list[Part | None]:
    """The part of a mesh outside of all regions, then that of each; of overlapping ones the last.

    Args:
        mesh: n vertices.
        regions: negative inside.

    Returns:
        As many as regions and one; None where there is nothing.
    """
    rest = np.asarray(mesh.vertices, np.float64)
    faces = np.asarray(mesh.faces, np.int64)
    weights = csr_array(coo_array((np.ones(len(rest)), (np.arange(len(rest)),) * 2)))
    owner = np.zeros(len(faces), np.int64)
    for number, region in enumerate(regions, start=1):
        weights, faces, owner, inside = _cut(rest, weights, faces, owner, region)
        owner[inside] = number
    parts: list[Part | None] = []
    for number in range(len(regions) + 1):
        own = faces[owner == number]
        used, local = np.unique(own, return_inverse=True)
        parts.append(Part(weights[used], local.reshape(-1, 3)) if len(own) else None)
    return parts


def _cut(rest, weights, faces, owner, region):
    """Faces cut in two or three where a region ends, and which of them are in it."""
    value = np.asarray(region(weights @ rest))
    inner = value <= 0
    count = inner[faces].sum(axis=1)
    mixed = (count == 1) | (count == 2)
    cut = faces[mixed]
    # The corner that is alone on its side comes first; then two edges are cut in every face.
    lone = count[mixed] == 1
    first = np.argmax(inner[cut] == lone[:, None], axis=1)
    cut = np.take_along_axis(cut, (first[:, None] + np.arange(3)) % 3, axis=1)
    edges = np.sort(np.stack([cut[:, [0, 1]], cut[:, [0, 2]]], axis=1).reshape(-1, 2), axis=1)
    edges, where = np.unique(edges, axis=0, return_inverse=True)
    share = _crossing(rest, weights, edges, inner, region)
    added = (
        weights[edges[:, 0]].multiply((1 - share)[:, None])
        + weights[edges[:, 1]].multiply(share[:, None])
    )  # fmt: skip
    new = len(inner) + where.reshape(-1, 2)
    a, b, c = cut.T
    p, q = new.T
    pieces = [np.stack(t, axis=1) for t in ((a, p, q), (p, b, c), (p, c, q))]
    kept = faces[~mixed]
    faces = np.concatenate([kept, *pieces])
    inside = np.concatenate([count[~mixed] == 3, lone, ~lone, ~lone])
    owner = np.concatenate([owner[~mixed], *[owner[mixed]] * 3])
    if len(edges):
        weights = csr_array(vstack([weights, added], format="csr"))
    return weights, faces, owner, inside


def _crossing(rest, weights, edges, inner, region) -> NDArray[np.float64]:
    """(e,) where a region ends on edges (e, 2), 0 to 1 from one end to the other, by halving."""
    a, b = weights[edges[:, 0]] @ rest, weights[edges[:, 1]] @ rest
    low, high = np.zeros(len(edges)), np.ones(len(edges))
    side = inner[edges[:, 0]]
    for _ in range(HALVINGS if len(edges) else 0):
        middle = 0.5 * (low + high)
        same = (np.asarray(region(a + middle[:, None] * (b - a))) <= 0) == side
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    return 0.5 * (low + high)
