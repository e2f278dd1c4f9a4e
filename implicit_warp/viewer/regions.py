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

MOST_BALLS = 400
"""Balls that cover a pick of vertices, at most."""


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
    return fields.sphere(_rounded(radius), _rounded(center))


def block(position: ArrayLike, wxyz: ArrayLike, size: ArrayLike) -> Field:
    """A box of a size (3,) at a pose."""
    rotation = Rotation.from_quat(np.asarray(wxyz, np.float64), scalar_first=True)
    turned = fields.box(_rounded(size))
    if rotation.magnitude() > 1e-6:
        vector = rotation.as_rotvec(degrees=True)
        degrees = float(np.linalg.norm(vector))
        turned = turned.rotate(_rounded(degrees), _rounded(vector / degrees))
    return turned.translate(_rounded(position))


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


def grown(region: Field, distance: float) -> Field:
    """The region and what is within a distance of it; less of it, by a negative one."""
    return region.offset(_rounded(distance))


def inverted(region: Field | None, bounds: ArrayLike) -> Field:
    """Everything else of a shape within some bounds (2, 3)."""
    low, high = np.asarray(bounds, np.float64)
    size = high - low
    everything = fields.box(_rounded(1.2 * size), _rounded(0.5 * (low + high)))
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
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    ways = vertices[chosen] - eye
    rays = np.concatenate([np.broadcast_to(eye, ways.shape), ways], axis=1).astype(np.float32)
    hit = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return hit > 1.0 - 1e-3


def part_of(faces: NDArray[np.int64], mask: Mask) -> Mask:
    """(n,) all vertices that hang together with some of those chosen."""
    ends = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    links = coo_array((np.ones(len(ends)), ends.T), shape=(len(mask), len(mask)))
    part = connected_components(links, directed=False)[1]
    return np.isin(part, part[mask])


def covering(vertices: NDArray[np.float64], mask: Mask) -> Field:
    """A union of balls that holds the chosen vertices (n, 3) and none of the others.

    Raises:
        InputError: no vertex is chosen.
    """
    if not mask.any():
        raise InputError("selection", 0, "there is nothing in it", "pick a larger area")
    inside, outside = vertices[mask], vertices[~mask]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    largest = 0.1 * size
    room = np.full(len(inside), largest)
    if len(outside):
        room = np.minimum(0.95 * cKDTree(outside).query(inside)[0], largest)
    tree = cKDTree(inside)
    left = np.ones(len(inside), np.bool_)
    balls = []
    # The roomiest first, so that few are needed; at the border they are as small as the mesh.
    for i in np.argsort(-room, kind="stable"):
        if not left[i]:
            continue
        reach = max(float(room[i]), 1e-6 * size)
        balls.append(ball(inside[i], reach))
        left[tree.query_ball_point(inside[i], 0.999 * reach)] = False
        left[i] = False
        if len(balls) == MOST_BALLS:
            break
    return reduce_union(balls)


def reduce_union(parts: list[Field]) -> Field:
    """The union of one field or more, as a balanced tree: long chains are slow to read."""
    while len(parts) > 8:
        parts = [fields.union(*parts[i : i + 8]) for i in range(0, len(parts), 8)]
    return parts[0] if len(parts) == 1 else reduce(lambda a, b: a | b, parts)


def picked_point(
    rest: trimesh.Trimesh, shown: NDArray[np.float64], origin: ArrayLike, direction: ArrayLike
) -> NDArray[np.float64] | None:
    """(3,) where at rest a ray first meets the mesh as shown (n, 3); None if it passes by."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    faces = np.asarray(rest.faces)
    scene.add_triangles(
        o3d.core.Tensor(np.asarray(shown, np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
    )
    ray = np.concatenate([np.asarray(origin), np.asarray(direction)]).astype(np.float32)
    found = scene.cast_rays(o3d.core.Tensor(ray[None]))
    if not np.isfinite(found["t_hit"].numpy()[0]):
        return None
    u, v = found["primitive_uvs"].numpy()[0].astype(np.float64)
    corners = np.asarray(rest.vertices)[faces[int(found["primitive_ids"].numpy()[0])]]
    return np.array([1.0 - u - v, u, v]) @ corners


def _rounded(values: ArrayLike):
    """Numbers, or one, as they are written: to `DIGITS` significant digits."""
    array = np.asarray(values, np.float64)
    short = [float(f"{value:.{DIGITS}g}") for value in array.reshape(-1)]
    return short[0] if array.ndim == 0 else tuple(short)
