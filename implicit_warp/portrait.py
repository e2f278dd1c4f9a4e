"""A shape as it is to be seen: deformed or not, coloured by a quantity or by handles, cut open.

`portrait` and `cut_portrait` put together what pictures and turntables need; both are drawn by the
same renderer, so that a film looks like its picture.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

import fields
from fields import Field
from implicit_warp.color_scales import ColorScale, color_scale
from implicit_warp.cross_sections import INK, line_spacing, section_colors
from implicit_warp.deformation import deform
from implicit_warp.distortion import handle_distance, measure_distortion
from implicit_warp.errors import InputError
from implicit_warp.films import Film, Look, turntable
from implicit_warp.handles import Handle
from implicit_warp.maps import Map
from implicit_warp.render import render
from implicit_warp.render.camera import DEFAULT_DIRECTION, picture_size
from implicit_warp.render.legend import legend_height, with_legend
from implicit_warp.render.picture import Image
from implicit_warp.render.surface import CLAY, Array, Color
from implicit_warp.slices import Plane, Slice, frame_of, slice_values

if TYPE_CHECKING:
    import trimesh

PICTURE_SIZE = (1280, 960)

_LINE = 0.045
"""Half the width of an iso-line on a cut, of the lines' spacing."""

_SAMPLES = 512
"""Of the field on the longer side of a cut."""

_TURN_TO_CUT = 0.75
"""How far the camera leans towards a cut: 0 not at all, 1 half-way between it and the usual."""


@dataclass(frozen=True, eq=False)
class Portrait:
    """What is shown, and how.

    Attributes:
        mesh: as it is shown.
        color, places: as in `render`.
        scale: whose legend stands under the picture; None for none.
        direction: from the shape to the camera.
    """

    mesh: trimesh.Trimesh
    color: Color = None
    places: Array | None = None
    scale: ColorScale | None = None
    direction: tuple[float, float, float] = DEFAULT_DIRECTION

    def picture(self, size: tuple[int, int] = PICTURE_SIZE, supersampling: int = 2) -> Image:
        """The picture, legend included, `(height, width, 3)` uint8.

        Raises:
            InputError, MissingDependency: as `render`.
        """
        from implicit_warp.render import Camera

        width, height = picture_size(size)
        strip = 0 if self.scale is None else legend_height((width, height))
        inner = (width, height - strip)
        image = render(
            self.mesh,
            size=inner,
            camera=Camera.fit_points(
                self.mesh.vertices[np.unique(self.mesh.faces)], direction=self.direction, size=inner
            ),
            color=self.color,
            places=self.places,
            supersampling=supersampling,
        )
        return image if self.scale is None else with_legend(image, self.scale, strip)

    def turntable(self, look: Look | None = None) -> Film:
        """Once around it; see `films.turntable`."""
        look = replace(look or Look(), direction=self.direction)
        return turntable(
            self.mesh, color=self.color, places=self.places, scale=self.scale, look=look
        )


def portrait(
    rest: trimesh.Trimesh,
    map_: Map | None = None,
    handles: Sequence[Handle] = (),
    quantity: str | None = None,
) -> Portrait:
    """A mesh at rest as a map deforms it, its vertices moved.

    Args:
        rest: the mesh.
        map_: the map; None shows it at rest.
        handles: their regions are coloured if no quantity is; "error" is about them.
        quantity: what the colours show: one of `distortion.QUANTITIES`, "error", or None.

    Raises:
        InputError: a quantity without a map, or "error" without handles; an unknown quantity.
    """
    places = np.asarray(rest.vertices, dtype=np.float64)
    mesh = rest if map_ is None else deform(rest, map_)
    if quantity is None:
        if not handles:
            return Portrait(mesh)
        from implicit_warp.pipeline import handle_colors

        return Portrait(mesh, handle_colors(handles), places)
    values = _values(map_, handles, quantity, places)
    scale = color_scale(quantity, values)
    return Portrait(mesh, scale(values)[:, :3] / 255.0, places, scale)


def cut_portrait(
    rest: trimesh.Trimesh,
    field: Field,
    plane: Plane,
    map_: Map | None = None,
    handles: Sequence[Handle] = (),
    quantity: str | None = None,
) -> Portrait:
    """A shape, deformed or not, cut open by a plane; the half behind the cut is shown.

    The cut shows the field's own lines at equal spacing; the rest is coloured as in `portrait`,
    but every point by its own value.

    Args:
        rest: a closed mesh of the shape at rest.
        field: the shape at rest.
        plane: as for `slice_values`, in the space of the deformed shape.
        map_, handles, quantity: as for `portrait`.

    Raises:
        InputError: as `portrait`; the plane does not cut the shape; or the mesh has no inside.
    """
    frame = frame_of(plane)
    normal = np.array(fields.arguments.direction("plane[0]", plane[0]))
    usual = np.array(DEFAULT_DIRECTION) / np.linalg.norm(DEFAULT_DIRECTION)
    below = bool(normal @ usual >= 0)
    outward = normal if below else -normal
    whole = rest if map_ is None else deform(rest, map_)
    mesh = half_of(whole, normal, float(frame.origin @ normal), below=below)
    height = (mesh.vertices - frame.origin) @ outward
    # The cut's vertices lie in the plane; what a ray hits there is rounded to float32.
    near = 1e-5 * float(np.linalg.norm(mesh.extents))
    skin = mesh.vertices[height <= -near]
    shape = field if map_ is None else deform(field, map_)
    cut_color = _cut_color(slice_values(shape, plane, _SAMPLES, bounds=whole.bounds))
    scale = None
    if quantity is not None:
        places = skin if map_ is None else map_.inv(skin)
        scale = color_scale(quantity, _values(map_, handles, quantity, places))
    skin_color = _skin_color(map_, handles, quantity, scale)

    def color(points: Array) -> Array:
        cut = (points - frame.origin) @ outward > -near
        found = np.empty((len(points), 3))
        found[cut], found[~cut] = cut_color(points[cut]), skin_color(points[~cut])
        return found

    toward = usual + _TURN_TO_CUT * outward
    return Portrait(mesh, color, None, scale, tuple((toward / np.linalg.norm(toward)).tolist()))


def half_of(
    mesh: trimesh.Trimesh, normal: Array, offset: float, *, below: bool = True
) -> trimesh.Trimesh:
    """The part of a closed mesh with normal . p <= offset, or that above, closed by a flat face.

    Raises:
        InputError: the mesh is no solid, or lies on one side of the plane.
    """
    import manifold3d
    import trimesh

    vertices = np.ascontiguousarray(mesh.vertices, dtype=np.float64)
    heights = vertices @ normal
    if not heights.min() < offset < heights.max():
        raise InputError(
            "plane",
            offset,
            f"it does not cut the shape, which reaches from {heights.min():.4g} to "
            f"{heights.max():.4g} along {(normal + 0.0).tolist()}",
            "choose a value between these",
        )
    faces = np.ascontiguousarray(mesh.faces, dtype=np.uint64)
    solid = manifold3d.Manifold(manifold3d.Mesh64(vert_properties=vertices, tri_verts=faces))
    if solid.status() != manifold3d.Error.NoError or solid.is_empty():
        raise InputError(
            "mesh",
            mesh,
            f"it is no solid that can be cut ({solid.status().name})",
            "close it first; `implicit-warp check` says where it is open",
        )
    sign = -1.0 if below else 1.0
    half = solid.trim_by_plane((sign * normal).tolist(), sign * offset).to_mesh64()
    return trimesh.Trimesh(half.vert_properties[:, :3], half.tri_verts, process=False)


def _cut_color(section: Slice) -> Callable[[Array], Array]:
    """Colours of points of a sampled plane: pale at the surface, lines at equal spacing."""
    from scipy.ndimage import map_coordinates

    step = float(section.right[1] - section.right[0])
    inside = np.minimum(section.values, 0.0)
    spacing, deepest = line_spacing(inside), max(float(-inside.min()), 1e-300)
    slopes = np.hypot(*np.gradient(section.values, step))

    def color(points: Array) -> Array:
        local = points - section.frame.origin
        places = [
            (local @ section.frame.up - section.up[0]) / step,
            (local @ section.frame.right - section.right[0]) / step,
        ]
        values, slope = (
            map_coordinates(samples, places, order=1, mode="nearest")
            for samples in (section.values, slopes)
        )
        found = section_colors(np.minimum(values, -1e-300), deepest, 1.0)
        # As wide everywhere as where the field is a distance.
        off = np.abs((values / spacing + 0.5) % 1.0 - 0.5) / np.clip(slope, 0.05, None)
        ink = np.clip((1.5 * _LINE - off) / _LINE, 0.0, 1.0)[:, None] * 0.75
        return found + ink * (np.array(INK) / 255.0 - found)

    return color


def _values(map_: Map | None, handles: Sequence[Handle], quantity: str, places: Array) -> Array:
    if map_ is None:
        raise InputError(
            "quantity", quantity, "nothing is deformed, so there is none", "pass a map as well"
        )
    if quantity != "error":
        return measure_distortion(map_, places).quantity(quantity)
    if not handles:
        raise InputError(
            "quantity", quantity, "it is the distance from the handles' targets", "pass handles"
        )
    return handle_distance(map_, handles, places)[0]


def _skin_color(
    map_: Map | None, handles: Sequence[Handle], quantity: str | None, scale: ColorScale | None
) -> Callable[[Array], Array]:
    """Colours of the surface by where its points are."""
    from implicit_warp.pipeline import handle_colors

    by_handles = handle_colors(handles)

    def color(points: Array) -> Array:
        if not len(points) or (scale is None and not handles):
            return np.broadcast_to(np.array(CLAY), points.shape)
        places = points if map_ is None else map_.inv(points)
        if scale is None:
            return by_handles(places)
        return scale(_values(map_, handles, quantity, places))[:, :3] / 255.0

    return color
