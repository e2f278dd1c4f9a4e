"""Triangle meshes that are no surface of a solid, and what can be said of inside and outside.

The sign comes from the generalised winding number: inside is where it is above one half. It is a
whole number around closed surfaces, counts overlapping parts twice and cavities as what is left,
and fades smoothly across holes, so that the sign switches at a membrane over each hole. It needs
faces whose orientations agree, so those are first turned to agree with their neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fields.closed_mesh import (
    Closest,
    directed,
    extent_of,
    signed_volume,
    uses_a_vertex_twice,
)
from fields.tags import Tags
from fields.triangle_tree import Floats, Integers, TriangleTree


@dataclass(frozen=True, slots=True, eq=False)
class TriangleSoup:
    """Triangles with a sign by winding number.

    Attributes:
        vertices: `(v, 3)`.
        faces: `(f, 3)`.
        is_closed: does every edge have as many faces on one side as on the other?
    """

    vertices: Floats
    faces: Integers
    is_closed: bool

    @property
    def tags(self) -> Tags:
        """What holds of the signed distance to a soup.

        The unsigned distance is exact, and 1-Lipschitz. Around closed triangles the winding
        number is constant off the surface, so the sign changes where the distance is 0, and the
        field is 1-Lipschitz; not exact, as where they intersect some are inside the solid.
        Across a hole the sign changes where the distance is not 0: no bound holds.
        Extent: points outside the box are outside by definition, and {f <= t} is within t of
        the triangles.
        """
        extent = extent_of(self.vertices, self.faces)
        return Tags(False, 1.0 if self.is_closed else None, extent, growth=1.0)

    def closest(self, points: Floats, tree: TriangleTree) -> Closest:
        """Signed distances and their gradients at points `(n, 3)`, by the tree of the faces."""
        triangle, _, foot = tree.nearest(points)
        low, high = extent_of(self.vertices, self.faces)
        in_box = ((points >= low) & (points <= high)).all(axis=1)
        sign = np.ones(len(points))
        sign[in_box] = np.where(tree.winding_number(points[in_box]) > 0.5, -1.0, 1.0)
        a, b, c = np.moveaxis(self.vertices[self.faces[triangle]], 1, 0)
        size = np.abs([a, b, c]).max(axis=(0, 2))
        return directed(points - foot, sign, np.cross(b - a, c - a), np.zeros(len(a), bool), size)


def triangle_soup(vertices: Floats, faces: Integers) -> TriangleSoup:
    """Checked triangles, degenerate ones left out, with orientations that agree where they can.

    Every patch of faces connected through edges of two faces is turned as most of its area is.
    If the result is closed and inside out, all of it is turned.
    """
    f = faces[~uses_a_vertex_twice(faces)]
    if len(f) == 0:
        f = faces
    f = _agreeing(vertices, f)
    is_closed = _is_closed(f)
    if is_closed and signed_volume(vertices[f]) < 0:
        f = f[:, ::-1].copy()
    return TriangleSoup(vertices, f, is_closed)


def _edges(faces: Integers) -> tuple[Integers, Integers, Integers]:
    """Each edge of each face: a number for its two ends, its direction 1 or -1, and the order
    of the numbers."""
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    key = np.minimum(start, end) * (faces.max() + 1) + np.maximum(start, end)
    return key, np.where(start < end, 1, -1), np.argsort(key, kind="stable")


def _is_closed(faces: Integers) -> bool:
    key, direction, order = _edges(faces)
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    return not np.add.reduceat(direction[order], begins).any()


def _agreeing(vertices: Floats, faces: Integers) -> Integers:
    from fields.kernels.orientation import patches

    key, direction, order = _edges(faces)
    begins = np.flatnonzero(np.diff(key[order], prepend=-1))
    pairs = begins[np.diff(begins, append=len(order)) == 2]
    one, two = order[pairs], order[pairs + 1]
    across = np.full(faces.size, -1)
    across[one], across[two] = two // 3, one // 3
    disagrees = np.zeros(faces.size, dtype=bool)
    disagrees[one] = disagrees[two] = direction[one] == direction[two]
    patch, turned = patches(across.reshape(-1, 3), disagrees.reshape(-1, 3))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    # Above 0 where most of a patch would be turned: then the others are.
    balance = np.bincount(patch, np.where(turned, area, -area))
    turned ^= (balance > 0)[patch]
    return np.where(turned[:, None], faces[:, ::-1], faces)
