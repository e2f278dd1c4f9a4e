"""Colours, texture coordinates, groups and other attributes of a mesh, carried to its image."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from implicit_warp.errors import InputError
from implicit_warp.push_forward.lineage import Lineage

if TYPE_CHECKING:
    import trimesh


def refuse_attributes(source: trimesh.Trimesh) -> None:
    """Raise `InputError` where an attribute does not have one entry a vertex, or a face."""
    visual, of_vertices = source.visual, dict(source.vertex_attributes)
    if visual.kind == "texture":
        of_vertices |= visual.vertex_attributes
    for attributes, count, owner in (
        (of_vertices, len(source.vertices), "vertices"),
        (source.face_attributes, len(source.faces), "faces"),
    ):
        for name, values in attributes.items():
            if len(values) != count:
                raise InputError(
                    "mesh",
                    name,
                    f"this attribute has {len(values)} entries, the mesh {count} {owner}",
                    "set it anew, or delete it",
                )


def carry_attributes(
    source: trimesh.Trimesh,
    target: trimesh.Trimesh,
    lineage: Lineage,
    kept: NDArray[np.int64] | slice,
    source_faces: NDArray[np.int64],
) -> None:
    """Give a subdivided mesh what the mesh it comes from has.

    Texture coordinates, vertex colours and floating-point vertex attributes are interpolated
    linearly over each given triangle; colours are rounded. Other vertex attributes (labels) are
    those of a nearby given vertex; faces get what their source face has. Materials and metadata are
    copied. Normals are not carried: trimesh computes those of the image.

    Args:
        source: the given mesh.
        target: its image; changed in place.
        lineage: where the vertices of the target come from.
        kept: those of the lineage's vertices that the target has.
        source_faces: (F,) the face of the source that each face of the target is a part of.
    """
    target.metadata.update(copy.deepcopy(source.metadata))
    visual = source.visual
    if visual.kind == "texture":
        moved = visual.copy()
        for name, values in visual.vertex_attributes.items():
            moved.vertex_attributes[name] = _at_vertices(values, lineage)[kept]
        if visual.face_materials is not None:
            moved.face_materials = np.asarray(visual.face_materials)[source_faces]
        target.visual = moved
    elif visual.kind == "vertex":
        colours = lineage.interpolate(np.asarray(visual.vertex_colors, dtype=np.float64))
        target.visual.vertex_colors = np.rint(colours[kept]).astype(np.uint8)
    elif visual.kind == "face":
        target.visual.face_colors = np.asarray(visual.face_colors)[source_faces]
    for name, values in source.vertex_attributes.items():
        target.vertex_attributes[name] = _at_vertices(values, lineage)[kept]
    for name, values in source.face_attributes.items():
        target.face_attributes[name] = np.asarray(values)[source_faces]


def _at_vertices(values, lineage: Lineage) -> np.ndarray:
    array = np.asarray(values)
    if array.dtype.kind != "f":
        return array[lineage.nearest_given()]
    flat = array.reshape(len(array), -1).astype(np.float64)
    return lineage.interpolate(flat).reshape(-1, *array.shape[1:]).astype(array.dtype)
