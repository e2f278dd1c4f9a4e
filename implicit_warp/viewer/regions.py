"""What the selection tools select, as fields.

A selection is a region of space from the first click on: a union of balls, boxes and half-spaces
that `fields.parse` reads.  So what is picked in the page is the very text that a handle file holds,
and the command line selects the same points.  Picks of single vertices (a rectangle on the screen,
a connected part) are covered by balls that leave all other vertices out.

All functions are pure; 15,000 vertices take a few milliseconds.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import fields
from fields import Field
from implicit_warp.errors import InputError

Mask = NDArray[np.bool_]

DIGITS = 6
"""Significant digits of the numbers in regions: nobody picks more precisely than a millionth."""

MOST_BALLS = 2000
"""Balls that cover a pick of vertices, at most: a narrow band on the preview mesh takes some
hundreds."""


class Camera(NamedTuple):
    """A pinhole camera, as the page knows it.

    Attributes:
        position: (3,)
        wxyz: (4,) rotation from camera to world; the camera looks along +z, y down.
        fov: vertical, in radians.
        aspect: width over height.
    """

    position: NDArray[np.float64]
    wxyz: NDArray[np.float64]
    fov: float
    aspect: float

    def on_screen(self, points: NDArray[np.float64]) -> tuple[NDArray[np.float64], Mask]:
        """(n, 2) places on the screen, from (0, 0) top left to (1, 1), and which are in front."""
        local = Rotation.from_quat(self.wxyz, scalar_first=True).inv().apply(points - self.position)
        ahead = local[:, 2] > 1e-9
        depth = np.where(ahead, local[:, 2], 1.0)
        half = np.tan(0.5 * self.fov)
        x = 0.5 + 0.5 * local[:, 0] / (depth * half * self.aspect)
        return np.stack([x, 0.5 + 0.5 * local[:, 1] / (depth * half)], axis=1), ahead


def ball(center: ArrayLike, radius: float) -> Field:
    """What a brush of this radius picks at a point (3,)."""
    return fields.sphere(_rounded(radius), _rounded(center, radius))


def block(position: ArrayLike, wxyz: ArrayLike, size: ArrayLike) -> Field:
    """A box of a size (3,) at a pose."""
    rotation = Rotation.from_quat(np.asarray(wxyz, np.float64), scalar_first=True)
    turned = fields.box(_rounded(size))
    if rotation.magnitude() > 1e-6:
        vector = rotation.as_rotvec(degrees=True)
        degrees = float(np.linalg.norm(vector))
        turned = turned.rotate(_rounded(degrees), _rounded(vector / degrees))
    return turned.translate(_rounded(position, float(np.min(size))))


def selected(region: Field | None, vertices: NDArray[np.float64]) -> Mask:
    """(n,) which vertices (n, 3) a region holds; none if there is no region."""
    if region is None or not len(vertices):
        return np.zeros(len(vertices), np.bool_)
    return np.asarray(region(vertices)) <= 0


def combined(old: Field | None, new: Field, how: str) -> Field | None:
    """A selection changed by a pick: "new", "add" or "subtract"."""
    if how not in ("new", "add", "subtract"):
        raise InputError("how", how, "no such way", 'use "new", "add" or "subtract"')
    if how == "new" or (old is None and how == "add"):
        return new
    if how == "add":
        return fields.union(old, new)
    return None if old is None else fields.difference(old, new)


def grown(region: Field, distance: float, vertices: NDArray[np.float64]) -> Field:
    """The region and what is within a distance of it; by a negative one, what is left of it that
    far from the vertices (n, 3) outside.

    Raises:
        InputError: no vertex would be left.
    """
    # Within a union, its value knows of one part only: less of it would have gaps between parts.
    if distance > 0 or region.exact:
        changed = region.offset(_rounded(distance))
        if selected(changed, vertices).any():
            return changed
        kept = np.zeros(len(vertices), np.bool_)
    else:
        kept = selected(region, vertices)
        if kept.any() and not kept.all():
            gap = cKDTree(vertices[~kept]).query(vertices[kept])[0]
            kept[kept] = gap > -distance
    if not kept.any():
        raise InputError(
            "selection", 0, "nothing would be left of it", "keep it, or pick a larger area"
        )
    return covering(vertices, kept)


def inverted(region: Field | None, bounds: ArrayLike) -> Field:
    """Everything else of a shape within some bounds (2, 3)."""
    low, high = np.asarray(bounds, np.float64)
    size = high - low
    middle = _rounded(0.5 * (low + high), float(size.max()))
    everything = fields.box(_rounded(1.2 * size), middle)
    return everything if region is None else fields.difference(everything, region)


def in_rectangle(
    vertices: NDArray[np.float64],
    faces: NDArray[np.int64],
    camera: Camera,
    low: ArrayLike,
    high: ArrayLike,
    *,
    through: bool,
) -> Mask:
    """(n,) the vertices (n, 3), as displayed, in a rectangle on the screen.

    Args:
        vertices, faces: the mesh that is shown.
        camera: it is seen by.
        low, high: corners (2,) of the rectangle, on the screen from (0, 0) to (1, 1).
        through: also those that are hidden behind the shape?
    """
    places, ahead = camera.on_screen(vertices)
    inside = ahead & ((places >= low) & (places <= high)).all(axis=1)
    if through or not inside.any():
        return inside
    visible = np.zeros(len(vertices), np.bool_)
    chosen = np.flatnonzero(inside)
    visible[chosen] = _seen(vertices, faces, camera.position, chosen)
    return visible


def _seen(vertices, faces, eye, chosen) -> Mask:
    """Whether nothing is between the eye and some vertices."""
    ways = vertices - eye
    found = _cast(ways, faces, np.zeros_like(ways[chosen]), ways[chosen])
    # Of a ray to a vertex, its own faces are hit at 1; rounding in float32 is far below this.
    return found["t_hit"].numpy() > 1.0 - 1e-4


def _cast(vertices, faces, origins, directions):
    """First hits of rays (n, 3), all given from somewhere near, for float32 to be enough."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.asarray(vertices, np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
    return scene.cast_rays(o3d.core.Tensor(rays))


def part_of(faces: NDArray[np.int64], mask: Mask) -> Mask:
    """(n,) all vertices that hang together with some of those chosen."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), ends.T), shape=(len(mask), len(mask)))
    part = connected_components(links, directed=False)[1]
    return np.isin(part, part[mask])


def covering(vertices: NDArray[np.float64], mask: Mask) -> Field:
    """A union of balls that holds the chosen vertices (n, 3) and none of the others.

    Raises:
        InputError: no vertex is chosen, or so scattered ones that balls cannot keep them apart
            from the others.
    """
    if not mask.any():
        raise InputError("selection", 0, "there is nothing in it", "pick a larger area")
    inside = vertices[mask]
    centers, radii = _roomiest(inside, vertices[~mask], float(np.ptp(vertices, axis=0).max()))
    tree = cKDTree(inside)
    left = np.ones(len(inside), np.bool_)
    balls = []
    # The largest first, so that few are needed; at the border they are as small as the mesh.
    for i in np.argsort(-radii, kind="stable"):
        if not left[i]:
            continue
        if len(balls) == MOST_BALLS:
            raise InputError(
                "selection",
                int(mask.sum()),
                f"its vertices are too scattered: {MOST_BALLS} balls do not cover them",
                "pick one area at a time, or a larger one",
            )
        balls.append(ball(centers[i], radii[i]))
        left[tree.query_ball_point(centers[i], (1.0 - 1e-5) * radii[i])] = False
        left[i] = False
    return reduce_union(balls)


def _roomiest(inside, outside, size):
    """For each point inside, the centre and radius of a large ball that holds it and no outside
    ones: about itself, or about a point further from the nearest one outside."""
    centers, radii = inside.copy(), np.full(len(inside), 0.1 * size)
    if not len(outside):
        return centers, radii
    others = cKDTree(outside)
    room, nearest = others.query(inside)
    radii = np.minimum(0.9 * room, radii)
    away = inside - outside[nearest]
    for factor in (1.0, 3.0, 9.0, 27.0):
        tried = np.flatnonzero((factor * room < 0.1 * size) & (room > 0.0))
        shift = factor * room[tried]
        middle = inside[tried] + factor * away[tried]
        gap = others.query(middle)[0] - shift
        # A gap much smaller than the ball would be lost when its numbers are rounded.
        better = gap > 1e-3 * shift
        tried, middle = tried[better], middle[better]
        centers[tried] = middle
        radii[tried] = shift[better] + 0.9 * gap[better]
    # Two vertices in one place, one chosen and one not, cannot be told apart.
    return centers, np.maximum(radii, 1e-6 * size)


def reduce_union(parts: list[Field]) -> Field:
    """The union of one field or more, as a balanced tree: long chains are slow to read."""
    while len(parts) > 8:
        parts = [fields.union(*parts[i : i + 8]) for i in range(0, len(parts), 8)]
    return parts[0] if len(parts) == 1 else reduce(lambda a, b: a | b, parts)


def picked_point(
    rest: trimesh.Trimesh, shown: NDArray[np.float64], origin: ArrayLike, direction: ArrayLike
) -> NDArray[np.float64] | None:
    """(3,) where at rest a ray first meets the mesh as shown (n, 3); None if it passes by."""
    faces = np.asarray(rest.faces)
    start = np.asarray(origin, np.float64)
    found = _cast(shown - start, faces, np.zeros((1, 3)), np.asarray(direction)[None])
    if not np.isfinite(found["t_hit"].numpy()[0]):
        return None
    u, v = found["primitive_uvs"].numpy()[0].astype(np.float64)
    corners = np.asarray(rest.vertices)[faces[int(found["primitive_ids"].numpy()[0])]]
    return np.array([1.0 - u - v, u, v]) @ corners


def _rounded(values: ArrayLike, unit: float = 0.0):
    """Numbers, or one, as they are written: to `DIGITS` significant digits, and no less than to
    those of a unit (a shape may lie far from the origin)."""
    array = np.asarray(values, np.float64)
    short = []
    for value in array.reshape(-1):
        digits = DIGITS
        if unit > 0.0 and abs(value) > unit:
            digits += int(np.ceil(np.log10(abs(value) / unit)))
        short.append(float(f"{value:.{min(digits, 17)}g}"))
    return short[0] if array.ndim == 0 else tuple(short)
