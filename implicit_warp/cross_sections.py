"""Cross-sections to look at: outlines of meshes and fields in a plane, and a picture with its pose.

`slices` samples fields on planes and traces contours; here are planes through a point, outlines of
meshes, iso-lines as lines in space, and a picture of a field on a plane for a textured rectangle.

A mesh's outline runs so that the solid lies to its left, seen from the side to which the plane's
normal points, and is closed (the first point again at the end) where the mesh is.  A vertex exactly
in the plane counts as above it, so that no face gives a point or an area.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import Field, arguments
from implicit_warp.errors import InputError
from implicit_warp.slices import Frame, Plane, Slice, frame_of, slice_values

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_INSIDE = ((22, 65, 94), (111, 168, 196), (221, 236, 241))
"""From the deepest value to the surface; the blues and browns of `slice_plot`."""
_OUTSIDE = ((251, 241, 226), (238, 189, 135), (185, 101, 44))
INK = (29, 36, 41)
_LINES = 14


def plane_through(point: ArrayLike, normal: str | ArrayLike) -> Plane:
    """The plane through a point `(3,)` with a normal, an axis name or a vector of any length.

    Raises:
        InputError: no such point or normal.
    """
    unit = arguments.direction("normal", normal)
    return unit, float(np.dot(unit, arguments.vector("point", point)))


def mesh_section(mesh: trimesh.Trimesh, plane: Plane) -> list[Array]:
    """Where a plane cuts a mesh: polylines in space, `(n, 3)` each; none if it does not.

    Args:
        mesh: triangles, closed or open.
        plane: as for `slice_values`.

    Raises:
        InputError: no plane.
    """
    frame = frame_of(plane)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    height = (vertices - frame.origin) @ _normal(plane)
    above = height >= 0
    cut = np.flatnonzero((above[faces] != above[faces[:, :1]]).any(axis=1))
    if not len(cut):
        return []
    # Two edges of such a face cross the plane: one downwards along the face's own sense, where
    # the section leaves the face (the solid is then on the left), and one upwards.
    corners = faces[cut]
    side = above[corners]
    follow = np.roll(corners, -1, axis=1)
    down, up = side & ~np.roll(side, -1, axis=1), ~side & np.roll(side, -1, axis=1)
    ends = np.stack(
        [np.stack([corners[which], follow[which]], axis=1) for which in (down, up)], axis=1
    )
    edges, number = np.unique(np.sort(ends, axis=2).reshape(-1, 2), axis=0, return_inverse=True)
    first, last = vertices[edges[:, 0]], vertices[edges[:, 1]]
    a, b = height[edges[:, 0], None], height[edges[:, 1], None]
    points = first + (a / (a - b)) * (last - first)
    return [points[chain] for chain in chains(number.reshape(-1, 2))]


def chains(links: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Directed links (k, 2) between points joined into chains; closed ones end where they begin.

    Every link is used once.  Open chains come first, from their beginnings.
    """
    following: dict[int, list[int]] = {}
    balance: dict[int, int] = {}
    for start, end in links.tolist():
        following.setdefault(start, []).append(end)
        balance[start] = balance.get(start, 0) + 1
        balance[end] = balance.get(end, 0) - 1
    beginnings = [p for p, n in balance.items() for _ in range(max(n, 0))]
    found = []
    for start in [*beginnings, *following]:
        while following.get(start):
            chain = [start]
            while following.get(chain[-1]):
                chain.append(following[chain[-1]].pop())
                if chain[-1] == start and balance[start] <= 0:
                    break
            found.append(np.array(chain))
            if balance[start] > 0:
                break
    return found


def iso_lines(
    field: Field,
    plane: Plane = ("z", 0.0),
    levels: Sequence[float] = (0.0,),
    resolution: int = 256,
    *,
    bounds: ArrayLike | None = None,
) -> dict[float, list[Array]]:
    """Lines of equal value in a plane, in space: for each level its polylines `(n, 3)`.

    The field is sampled once, whatever the number of levels.  Arguments and errors as for
    `slice_values`.
    """
    section = slice_values(field, plane, resolution, bounds=bounds)
    return {
        float(level): [section.frame.in_space(line) for line in section.contours(level)]
        for level in levels
    }


def as_segments(lines: Sequence[Array]) -> Array:
    """Polylines as one array of segments `(k, 2, 3)`, which viewers draw at once."""
    pieces = [np.stack([line[:-1], line[1:]], axis=1) for line in lines if len(line) > 1]
    return np.concatenate(pieces) if pieces else np.empty((0, 2, 3))


@dataclass(frozen=True, eq=False)
class SectionPicture:
    """A picture of a field on a plane, and where it belongs.

    Attributes:
        image: `(h, w, 4)` uint8 RGBA, first row at the top.
        center: `(3,)` the middle of the rectangle.
        wxyz: `(4,)` unit quaternion of the rectangle's frame: x to the picture's right, y *down*
            the picture, z away from who sees it unmirrored, as cameras have it.
        width, height: of the rectangle, in the field's units.
        spacing: between the thin lines.
    """

    image: Bytes
    center: Array
    wxyz: Array
    width: float
    height: float
    spacing: float


def section_picture(
    field: Field,
    plane: Plane = ("z", 0.0),
    resolution: int = 384,
    *,
    spacing: float | None = None,
    bounds: ArrayLike | None = None,
    opacity: float = 0.85,
) -> SectionPicture:
    """Paint a field on a plane: inside blue, outside brown, thin lines at equal spacing, the
    surface as a thick one.

    Args:
        field: what to sample, a warped one for instance.
        plane: as for `slice_values`.
        resolution: pixels along the longer side.
        spacing: between the thin lines; a round number that gives about 14 if None.
        bounds: the box `(2, 3)` to cover; by default the field's own and 8 % more.
        opacity: of what is outside of the shape, 0 to 1; the inside and the lines are opaque.

    Raises:
        InputError: as `slice_values` does; a spacing or opacity that is none.
    """
    if not 0 <= arguments.number("opacity", opacity) <= 1:
        raise InputError("opacity", opacity, "not in 0 to 1", "0.85 lets a shape shine through")
    section = slice_values(field, plane, resolution, bounds=bounds)
    values = section.values
    spacing = line_spacing(values) if spacing is None else arguments.positive("spacing", spacing)
    image = np.empty((*values.shape, 4))
    image[..., :3] = section_colors(values, -values.min(), values.max()) * 255.0
    image[..., 3] = np.where(values < 0, 1.0, opacity)
    # How far a pixel is from a line, in pixels: the value's distance over its slope.
    slope = np.maximum(np.hypot(*np.gradient(values)), 1e-12 * spacing)
    thin = np.abs((values / spacing + 0.5) % 1.0 - 0.5) * spacing / slope
    # Where lines would touch, there are none: they would only darken it.
    crowded = np.clip(spacing / slope / 6.0, 0.0, 1.0)
    _draw(image, np.clip(1.1 - thin, 0, 1) * 0.4 * crowded)
    _draw(image, np.clip(1.8 - np.abs(values) / slope, 0, 1))
    pixels = np.rint(image[::-1] * np.array([1, 1, 1, 255])).astype(np.uint8)
    return _placed(section, pixels, spacing)


def line_spacing(values: Array) -> float:
    """A round distance between lines that gives about 14 of them."""
    from implicit_warp.slice_picture import round_step

    return round_step(float(np.ptp(values)) / _LINES)


def section_colors(values: Array, deepest: float, farthest: float) -> Array:
    """sRGB (..., 3) in [0, 1] of a field's values (...): blue inside, brown outside, pale at the
    surface.

    Args:
        values: of the field.
        deepest, farthest: how far from zero the darkest colours of the two sides are.
    """
    sides = [
        _ramp(np.abs(values) / max(reach, 1e-300), colors) / 255.0
        for reach, colors in ((deepest, _INSIDE[::-1]), (farthest, _OUTSIDE))
    ]
    return np.where((values < 0)[..., None], *sides)


def _normal(plane: Plane) -> Array:
    return np.array(arguments.direction("plane[0]", plane[0]))


def _ramp(share: Array, colors: Sequence[tuple[int, int, int]]) -> Array:
    table = np.array(colors, dtype=np.float64)
    at = np.linspace(0.0, 1.0, len(table))
    return np.stack([np.interp(share, at, table[:, k]) for k in range(3)], axis=-1)


def _draw(image: Array, cover: Array) -> None:
    """Ink over an image (h, w, 4), as much as (h, w) says."""
    image[..., :3] += cover[..., None] * (np.array(INK) - image[..., :3])
    image[..., 3] += cover * (1.0 - image[..., 3])


def _placed(section: Slice, pixels: Bytes, spacing: float) -> SectionPicture:
    from scipy.spatial.transform import Rotation

    frame: Frame = section.frame
    step = section.right[1] - section.right[0]
    middle = np.array([section.right[[0, -1]].mean(), section.up[[0, -1]].mean()])
    axes = np.stack([frame.right, -frame.up, np.cross(frame.right, -frame.up)], axis=1)
    return SectionPicture(
        image=np.ascontiguousarray(pixels),
        center=frame.in_space(middle),
        wxyz=Rotation.from_matrix(axes).as_quat(scalar_first=True),
        # Samples are the middles of pixels.
        width=step * len(section.right),
        height=step * len(section.up),
        spacing=spacing,
    )
