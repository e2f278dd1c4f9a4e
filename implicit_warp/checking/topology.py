"""Connectivity and size of a triangle mesh, from directed edges and vertex links.

Terms, each with its own list of offenders, so that one defect raises one flag:

* open edge: an undirected edge of one face only (a hole's rim).
* non-manifold edge: an edge of three or more faces.
* misoriented edge: an edge of two faces that both run along it the same way.
* pinched vertex: its faces, joined across edges, form more than one fan (two cones that
  touch at their tips).
* watertight: every directed edge occurs exactly once, and so does its reverse; that is, no
  offender of the first three kinds.

Faces with a repeated vertex are no triangles: they are reported and left out of everything
else. Zero area is decided exactly. Lengths are in the vertices' unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking import exact
from implicit_warp.checking.edges import EdgeTable, Indices
from implicit_warp.checking.equal_vertices import first_of_equal
from implicit_warp.checking.measures import component_volumes, face_measures
from implicit_warp.checking.mesh_arrays import validated
from implicit_warp.checking.predicates import (
    certainly_not_collinear,
    finite_or_zero,
    unit_scaled,
)

SLIVER_RATIO = 1e-6
"""Faces whose smallest height is below this fraction of their longest side are slivers: the
float32 of an STL file keeps about 1e-7 of the coordinates, so their shape is mostly lost."""

OFFENDERS = (
    "open_edges",
    "nonmanifold_edges",
    "misoriented_edges",
    "pinched_vertices",
    "unreferenced_vertices",
    "duplicate_vertices",
    "nonfinite_vertices",
    "repeated_vertex_faces",
    "zero_area_faces",
    "sliver_faces",
    "duplicate_faces",
)
"""The attributes of `Topology` that list what is wrong or worth a note."""


@dataclass(frozen=True, eq=False)
class Topology:
    """What `analyse` found. Index arrays are sorted; edges are `(k, 2)`, smaller index first.

    Attributes:
        num_vertices: rows of the vertex array, referenced or not.
        num_faces: rows of the face array, degenerate or not.
        open_edges: edges of one face.
        nonmanifold_edges: edges of three or more faces.
        misoriented_edges: edges of two faces that run along them the same way.
        pinched_vertices: vertices with more than one fan of faces.
        unreferenced_vertices: vertices of no face.
        duplicate_vertices: vertices with exactly the coordinates of an earlier one.
        nonfinite_vertices: vertices with a NaN or infinite coordinate.
        repeated_vertex_faces: faces with two equal indices.
        zero_area_faces: faces of distinct indices and exactly zero area.
        sliver_faces: faces of non-zero area with a height ratio below `SLIVER_RATIO`.
        duplicate_faces: faces with the same three vertices as an earlier face.
        component_of_face: `(F,)` label of the edge-connected component, -1 for faces left out.
        genus: genus of each component; None where it is not watertight.
        component_volumes: signed volume of each component; negative inside out (a cavity),
            NaN where it is not watertight.
        component_signs: sign of each component's volume, exact; 0 where the volume is NaN, or
            exactly zero.
        unit_volume: the volume of the mesh scaled by a power of two to about unit size; it has
            the volume's sign even where that under- or overflows. NaN where not watertight.
        area: total area; NaN with non-finite vertices in use.
        smallest_height_ratio: smallest height over longest side, over all faces; an
            equilateral triangle has 0.87. NaN without faces.
        watertight_if_merged: the mesh is open, and would be watertight if the vertices with
            equal coordinates were one: its seams were never joined.
    """

    num_vertices: int
    num_faces: int
    open_edges: Indices
    nonmanifold_edges: Indices
    misoriented_edges: Indices
    pinched_vertices: Indices
    unreferenced_vertices: Indices
    duplicate_vertices: Indices
    nonfinite_vertices: Indices
    repeated_vertex_faces: Indices
    zero_area_faces: Indices
    sliver_faces: Indices
    duplicate_faces: Indices
    component_of_face: Indices
    genus: tuple[int | None, ...]
    component_volumes: NDArray[np.float64]
    component_signs: NDArray[np.int8]
    unit_volume: float
    area: float
    smallest_height_ratio: float
    watertight_if_merged: bool

    @property
    def num_components(self) -> int:
        """Number of edge-connected components."""
        return len(self.genus)

    @property
    def edge_manifold(self) -> bool:
        """No edge has more than two faces."""
        return not len(self.nonmanifold_edges)

    @property
    def vertex_manifold(self) -> bool:
        """The faces of every vertex form one fan."""
        return not len(self.pinched_vertices)

    @property
    def oriented(self) -> bool:
        """No two faces run along their common edge the same way."""
        return not len(self.misoriented_edges)

    @property
    def watertight(self) -> bool:
        """There are faces, and every directed edge is matched by its reverse, both once."""
        return (
            self.num_components > 0
            and not len(self.open_edges)
            and self.edge_manifold
            and self.oriented
        )

    @cached_property
    def volume(self) -> float | None:
        """Signed volume, positive when faces are counter-clockwise from outside; None if open."""
        if not self.watertight:
            return None
        with np.errstate(invalid="ignore"):  # volumes that overflow to both infinities: NaN
            return float(self.component_volumes.sum())


def analyse(vertices: NDArray[np.float64], faces: Indices) -> Topology:
    """Connectivity, degeneracies and size of a mesh, in linear time.

    Raises:
        InputError: wrong shapes or types, or an index out of range.
    """
    vertices, faces = validated(vertices, faces)
    repeated = (
        (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    )
    kept = np.flatnonzero(~repeated)
    triangles = faces[kept] if repeated.any() else faces
    finite = np.isfinite(vertices).all(axis=1)
    measurable = finite[triangles].all(axis=1)

    edges = EdgeTable(triangles, len(vertices))
    labels, num_components = edges.component_of_face, edges.num_components
    genus = edges.genus()
    first = first_of_equal(vertices)
    duplicate = np.flatnonzero(finite & (first != np.arange(len(vertices))))

    scaled, exponent = unit_scaled(finite_or_zero(vertices, finite))
    volumes, errors = component_volumes(scaled, triangles, labels, num_components)
    volumes[[g is None for g in genus]] = np.nan
    volumes[np.unique(labels[~measurable])] = np.nan
    area, ratios = face_measures(scaled, triangles)
    flat = _zero_area(vertices, scaled, triangles, measurable)

    component_of_face = labels
    if len(kept) < len(faces):
        component_of_face = np.full(len(faces), -1, dtype=np.int64)
        component_of_face[kept] = labels
    unreferenced = np.ones(len(vertices), dtype=bool)
    unreferenced[faces] = False
    return Topology(
        num_vertices=len(vertices),
        num_faces=len(faces),
        open_edges=edges.open_edges,
        nonmanifold_edges=edges.nonmanifold_edges,
        misoriented_edges=edges.misoriented_edges,
        pinched_vertices=np.flatnonzero(edges.fans_of_vertex() > 1),
        unreferenced_vertices=np.flatnonzero(unreferenced),
        duplicate_vertices=duplicate,
        nonfinite_vertices=np.flatnonzero(~finite),
        repeated_vertex_faces=np.flatnonzero(repeated),
        zero_area_faces=kept[flat],
        sliver_faces=kept[measurable & ~flat & (ratios < SLIVER_RATIO)],
        duplicate_faces=kept[_duplicates(triangles, edges.may_repeat)],
        component_of_face=component_of_face,
        genus=genus,
        component_signs=_volume_signs(vertices, triangles, labels, volumes, errors),
        unit_volume=float(volumes.sum()),
        component_volumes=_times_power_of_two(volumes, 3 * exponent),
        area=float(_times_power_of_two(area, 2 * exponent)) if measurable.all() else float("nan"),
        smallest_height_ratio=(
            float(ratios[measurable].min()) if measurable.any() else float("nan")
        ),
        watertight_if_merged=(
            not edges.closed and len(duplicate) > 0 and _closed(first[triangles], len(vertices))
        ),
    )


def _closed(faces: Indices, num_vertices: int) -> bool:
    """Whether the faces that have three distinct corners are watertight."""
    a, b, c = faces.T
    triangles = faces[(a != b) & (b != c) & (c != a)]
    return len(triangles) > 0 and EdgeTable(triangles, num_vertices).closed


def _volume_signs(
    vertices: NDArray[np.float64],
    triangles: Indices,
    labels: Indices,
    volumes: NDArray[np.float64],
    errors: NDArray[np.float64],
) -> NDArray[np.int8]:
    """Sign of each component's volume: where rounding could have turned it, from integers."""
    signs = np.sign(np.nan_to_num(volumes)).astype(np.int8)
    unsure = np.abs(volumes) <= errors
    faces = np.flatnonzero(unsure[labels])
    faces = faces[np.argsort(labels[faces], kind="stable")]
    ends = np.flatnonzero(np.diff(labels[faces])) + 1
    for component in np.split(faces, ends) if len(faces) else ():
        used, corners = np.unique(triangles[component], return_inverse=True)
        points = exact.integer_points(vertices[used])
        sign = exact.volume_sign(points, corners.reshape(-1, 3).tolist())
        signs[labels[component[0]]] = sign
    return signs


def _duplicates(triangles: Indices, may_repeat: NDArray[np.bool_]) -> Indices:
    """Positions of triangles whose corners an earlier triangle has too, in any order."""
    candidates = np.flatnonzero(may_repeat)
    corners = np.sort(triangles[candidates], axis=1)
    order = np.lexsort((corners[:, 2], corners[:, 1], corners[:, 0]))
    ordered = corners[order]
    again = (ordered[1:] == ordered[:-1]).all(axis=1)
    return np.sort(candidates[order[1:][again]])


def _zero_area(
    vertices: NDArray[np.float64],
    scaled: NDArray[np.float64],
    triangles: Indices,
    measurable: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Flag triangles of exactly zero area: a float filter, then integers."""
    flat = np.zeros(len(triangles), dtype=bool)
    unsure = np.flatnonzero(measurable & ~certainly_not_collinear(scaled, triangles))
    if len(unsure):
        used, corners = np.unique(triangles[unsure], return_inverse=True)
        points = exact.integer_points(vertices[used])
        flat[unsure] = [
            exact.visible_axis(*(points[i] for i in face)) is None
            for face in corners.reshape(-1, 3).tolist()
        ]
    return flat


def _times_power_of_two(values: NDArray[np.float64], exponent: int) -> NDArray[np.float64]:
    with np.errstate(over="ignore", under="ignore"):  # infinity and zero are honest answers
        return np.ldexp(values, exponent)
