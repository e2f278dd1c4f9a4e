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
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from implicit_warp.checking import exact
from implicit_warp.checking.mesh_arrays import validated
from implicit_warp.checking.predicates import certainly_not_collinear, unit_scaled

SLIVER_RATIO = 1e-6
"""Faces whose smallest height is below this fraction of their longest side are slivers: the
float32 of an STL file keeps about 1e-7 of the coordinates, so their shape is mostly lost."""

Indices = NDArray[np.int64]


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
        nonfinite_vertices: vertices with a NaN or infinite coordinate.
        repeated_vertex_faces: faces with two equal indices.
        zero_area_faces: faces of distinct indices and exactly zero area.
        sliver_faces: faces of non-zero area with a height ratio below `SLIVER_RATIO`.
        duplicate_faces: faces with the same three vertices as an earlier face.
        component_of_face: `(F,)` label of the edge-connected component, -1 for faces left out.
        genus: genus of each component; None where it is not watertight.
        component_volumes: signed volume of each component; negative inside out (a cavity),
            NaN where it is not watertight.
        unit_volume: the volume of the mesh scaled by a power of two to about unit size; it has
            the volume's sign even where that under- or overflows. NaN where not watertight.
        area: total area; NaN with non-finite vertices in use.
        smallest_height_ratio: smallest height over longest side, over all faces; an
            equilateral triangle has 0.87. NaN without faces.
    """

    num_vertices: int
    num_faces: int
    open_edges: Indices
    nonmanifold_edges: Indices
    misoriented_edges: Indices
    pinched_vertices: Indices
    unreferenced_vertices: Indices
    nonfinite_vertices: Indices
    repeated_vertex_faces: Indices
    zero_area_faces: Indices
    sliver_faces: Indices
    duplicate_faces: Indices
    component_of_face: Indices
    genus: tuple[int | None, ...]
    component_volumes: NDArray[np.float64]
    unit_volume: float
    area: float
    smallest_height_ratio: float

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
        return float(self.component_volumes.sum()) if self.watertight else None


def analyse(vertices: NDArray[np.float64], faces: Indices) -> Topology:
    """Connectivity, degeneracies and size of a mesh; O(F log F).

    Raises:
        InputError: wrong shapes or types, or an index out of range.
    """
    vertices, faces = validated(vertices, faces)
    repeated = (
        (faces[:, 0] == faces[:, 1]) | (faces[:, 1] == faces[:, 2]) | (faces[:, 2] == faces[:, 0])
    )
    kept = np.flatnonzero(~repeated)
    triangles = faces[kept]
    finite = np.isfinite(vertices).all(axis=1)
    measurable = finite[triangles].all(axis=1)

    edges = _Edges(triangles, len(vertices))
    labels, num_components = edges.components()
    genus = edges.genus(labels, num_components)

    scaled, exponent = unit_scaled(np.where(finite[:, None], vertices, 0.0))
    volumes = _component_volumes(scaled, triangles, labels, num_components)
    volumes[[g is None for g in genus]] = np.nan
    volumes[np.unique(labels[~measurable])] = np.nan
    areas, ratios = _areas_and_height_ratios(scaled, triangles)
    flat = _zero_area(vertices, scaled, triangles, measurable)

    component_of_face = np.full(len(faces), -1, dtype=np.int64)
    component_of_face[kept] = labels
    unreferenced = np.ones(len(vertices), dtype=bool)
    unreferenced[faces] = False
    return Topology(
        num_vertices=len(vertices),
        num_faces=len(faces),
        open_edges=edges.with_uses(edges.uses == 1),
        nonmanifold_edges=edges.with_uses(edges.uses > 2),
        misoriented_edges=edges.with_uses((edges.uses == 2) & (edges.balance != 0)),
        pinched_vertices=np.flatnonzero(edges.fans_of_vertex() > 1),
        unreferenced_vertices=np.flatnonzero(unreferenced),
        nonfinite_vertices=np.flatnonzero(~finite),
        repeated_vertex_faces=np.flatnonzero(repeated),
        zero_area_faces=kept[flat],
        sliver_faces=kept[measurable & ~flat & (ratios < SLIVER_RATIO)],
        duplicate_faces=kept[_duplicates(triangles, len(vertices))],
        component_of_face=component_of_face,
        genus=genus,
        unit_volume=float(volumes.sum()),
        component_volumes=_times_power_of_two(volumes, 3 * exponent),
        area=(
            float(_times_power_of_two(areas.sum(), 2 * exponent))
            if measurable.all()
            else float("nan")
        ),
        smallest_height_ratio=(
            float(ratios[measurable].min()) if measurable.any() else float("nan")
        ),
    )


class _Edges:
    """Undirected edges of triangles with distinct corners, and what hangs together by them.

    Half-edge h = F k + f runs from corner k of face f to the next one.
    """

    def __init__(self, triangles: Indices, num_vertices: int) -> None:
        self.num_faces = len(triangles)
        self.num_vertices = num_vertices
        self.tail = triangles.T.ravel()
        self.head = np.roll(triangles, -1, axis=1).T.ravel()
        low, high = np.minimum(self.tail, self.head), np.maximum(self.tail, self.head)
        key = low * max(num_vertices, 1) + high
        # Half-edges of one edge become neighbours in this order.
        self.order = np.argsort(key, kind="stable")
        ordered = key[self.order]
        starts = np.flatnonzero(np.diff(ordered, prepend=-1))
        self.first_of_edge = self.order[starts]
        self.uses = np.diff(starts, append=len(ordered))
        forward = np.where(self.tail < self.head, 1, -1)[self.order]
        self.balance = np.add.reduceat(forward, starts) if len(starts) else starts
        # Consecutive half-edges of one edge: (a[i], b[i]) are neighbours across it.
        same = np.ones(len(ordered), dtype=bool)
        same[starts] = False
        later = np.flatnonzero(same)
        self.neighbours = self.order[later - 1], self.order[later]

    def with_uses(self, selected: NDArray[np.bool_]) -> Indices:
        """End points `(k, 2)` of the selected edges, smaller index first."""
        half = self.first_of_edge[selected]
        return np.sort(np.column_stack([self.tail[half], self.head[half]]), axis=1)

    def components(self) -> tuple[Indices, int]:
        """Component label of each face, and the number of components."""
        a, b = self.neighbours
        return _labels(a % max(self.num_faces, 1), b % max(self.num_faces, 1), self.num_faces)

    @cached_property
    def _fans(self) -> tuple[Indices, int]:
        """Label of the fan that each corner belongs to, and the number of fans.

        Corner h is the tail of half-edge h. Across an edge, the corners at the same vertex
        belong to one fan.
        """
        count = len(self.tail)
        if not count:
            return np.empty(0, dtype=np.int64), 0
        a, b = self.neighbours
        after_a, after_b = (a + self.num_faces) % count, (b + self.num_faces) % count
        opposed = self.tail[a] == self.head[b]
        return _labels(
            np.concatenate([a, after_a]),
            np.concatenate([np.where(opposed, after_b, b), np.where(opposed, b, after_b)]),
            count,
        )

    def fans_of_vertex(self) -> Indices:
        """Number of fans at each vertex, `(V,)`."""
        labels, count = self._fans
        vertex_of_fan = np.empty(count, dtype=np.int64)
        vertex_of_fan[labels] = self.tail
        return np.bincount(vertex_of_fan, minlength=self.num_vertices)

    def genus(self, labels: Indices, num_components: int) -> tuple[int | None, ...]:
        """Genus of each component from V - E + F = 2 - 2 g; None where not watertight.

        A pinched vertex counts once for each fan: the genus is that of the surface with its
        pinches taken apart.
        """
        fans, num_fans = self._fans
        face_of_fan = np.empty(num_fans, dtype=np.int64)
        face_of_fan[fans] = np.arange(len(fans)) % max(self.num_faces, 1)
        component_of_edge = labels[self.first_of_edge % max(self.num_faces, 1)]

        def per_component(of: Indices) -> Indices:
            return np.bincount(of, minlength=num_components)

        euler = (
            per_component(labels[face_of_fan])
            - per_component(component_of_edge)
            + per_component(labels)
        )
        bad = per_component(component_of_edge[(self.uses != 2) | (self.balance != 0)]) > 0
        return tuple(
            None if b else (2 - e) // 2 for b, e in zip(bad.tolist(), euler.tolist(), strict=True)
        )


def _labels(a: Indices, b: Indices, count: int) -> tuple[Indices, int]:
    graph = coo_array((np.ones(len(a), dtype=np.int8), (a, b)), shape=(count, count))
    number, labels = connected_components(graph, directed=False)
    return labels.astype(np.int64), int(number)


def _duplicates(triangles: Indices, num_vertices: int) -> Indices:
    """Positions of triangles whose corners an earlier triangle has too, in any order."""
    corners = np.sort(triangles, axis=1)
    order = np.lexsort((corners[:, 2], corners[:, 1], corners[:, 0]))
    ordered = corners[order]
    again = (ordered[1:] == ordered[:-1]).all(axis=1)
    return np.sort(order[1:][again])


def _component_volumes(
    scaled: NDArray[np.float64], triangles: Indices, labels: Indices, num_components: int
) -> NDArray[np.float64]:
    """Sum of a . (b x c) / 6 over each component, about the mesh's centre for accuracy."""
    if not num_components:
        return np.empty(0)
    used = scaled[triangles]
    centre = 0.5 * (used.min(axis=(0, 1)) + used.max(axis=(0, 1)))
    a, b, c = (used[:, k] - centre for k in range(3))
    sixfold = np.einsum("ij,ij->i", a, np.cross(b, c))
    return np.bincount(labels, weights=sixfold, minlength=num_components) / 6.0


def _areas_and_height_ratios(
    scaled: NDArray[np.float64], triangles: Indices
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Area, and smallest height over longest side, of each triangle."""
    a, b, c = (scaled[triangles[:, k]] for k in range(3))
    double = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest_squared = np.max(
        [np.einsum("ij,ij->i", d, d) for d in (b - a, c - b, a - c)], axis=0, initial=0.0
    )
    ratio = np.divide(double, longest_squared, out=np.zeros_like(double), where=longest_squared > 0)
    return 0.5 * double, ratio


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
