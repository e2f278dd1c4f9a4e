"""What an extracted mesh can say of each of its vertices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fields import Field
from implicit_warp.deformation import origin
from implicit_warp.errors import InputError
from implicit_warp.extraction.sides import units

if TYPE_CHECKING:
    import trimesh

Attribute = Literal["rest_position", "normal", "distance_error"]

Colours = Callable[[NDArray[np.float64]], NDArray[np.floating]]
"""From points at rest (n, 3) to colours (n, 3), each from 0 to 1."""


def add_attributes(
    mesh: trimesh.Trimesh,
    field: Field,
    level: float,
    wanted: Sequence[Attribute],
    colours: Colours | None,
) -> None:
    """Put attributes into `mesh.vertex_attributes`, and colours into its visuals.

    Args:
        mesh: extracted from the field.
        field: the field.
        level: the value of the surface.
        wanted: any of "rest_position", (V, 3) where each vertex was before the maps that carried
            the field, or its own place if none did; "normal", (V, 3) unit, the field's gradient;
            "distance_error", (V,) the vertex's distance from the surface, to first order.
        colours: called with the rest positions.

    Raises:
        InputError: there is no such attribute; colours that are no array (n, 3) from 0 to 1.
    """
    unknown = [name for name in wanted if name not in get_args(Attribute)]
    if unknown:
        raise InputError(
            "attributes", unknown, "no such attribute", f"Use any of {get_args(Attribute)}"
        )
    points = np.array(mesh.vertices)
    if "normal" in wanted or "distance_error" in wanted:
        value, gradient = field.value_and_gradient(points)
        if "normal" in wanted:
            mesh.vertex_attributes["normal"] = units(gradient)
        if "distance_error" in wanted:
            slope = np.linalg.norm(gradient, axis=1)
            error = np.abs(value - level) / np.where(slope > 0, slope, 1.0)
            mesh.vertex_attributes["distance_error"] = error
    if "rest_position" in wanted or colours is not None:
        rest = rest_positions(field, points)
        if "rest_position" in wanted:
            mesh.vertex_attributes["rest_position"] = rest
        if colours is not None:
            mesh.visual.vertex_colors = _colours(colours, rest)


def rest_positions(field: Field, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where points (n, 3) come from, through all maps that carried a field."""
    moved = origin(field)
    while moved is not None:
        points = moved.map.inv(points)
        moved = origin(moved.rest)
    return points


def _colours(colours: Colours, rest: NDArray[np.float64]) -> NDArray[np.uint8]:
    values = np.asarray(colours(rest))
    if values.shape != rest.shape or not ((values >= 0) & (values <= 1)).all():
        raise InputError(
            "colours",
            values.shape,
            f"for points {rest.shape} it gave no array of that shape with values from 0 to 1",
            "Return red, green and blue of every point",
        )
    return np.rint(255 * values).astype(np.uint8)
