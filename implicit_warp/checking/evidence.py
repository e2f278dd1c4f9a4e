"""Which face, edge and vertex of a mesh has which defect, as colours; and a PLY file of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking.exact import IntersectionKind
from implicit_warp.files import atomic_write, refuse_target

if TYPE_CHECKING:
    from implicit_warp.checking.report import CheckReport

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class DefectClass:
    """One entry of the legend.

    Attributes:
        count: its name in `CheckReport.counts`.
        label: its name in words.
        color: sRGB in [0, 1].
    """

    count: str
    label: str
    color: tuple[float, float, float]


# From what matters least to what matters most: a face with several defects has the last one's
# colour. Faces beside a bad edge or vertex have its colour too, so that it can be seen from afar.
CLASSES = (
    DefectClass("sliver_faces", "sliver", (0.72, 0.68, 0.25)),
    DefectClass("inside_out_components", "component inside out", (0.45, 0.58, 0.95)),
    DefectClass("misnested_components", "component nested wrongly", (0.62, 0.47, 0.85)),
    DefectClass("nonfinite_vertices", "coordinate not finite", (0.25, 0.27, 0.30)),
    DefectClass("pinched_vertices", "pinched vertex", (0.08, 0.62, 0.60)),
    DefectClass("open_edges", "open edge", (0.95, 0.58, 0.10)),
    DefectClass("misoriented_edges", "orientation changes", (0.10, 0.42, 0.80)),
    DefectClass("nonmanifold_edges", "three or more faces at an edge", (0.80, 0.20, 0.68)),
    DefectClass("repeated_vertex_faces", "vertex used twice", (0.60, 0.42, 0.25)),
    DefectClass("zero_area_faces", "zero area", (0.44, 0.28, 0.14)),
    DefectClass("self_intersections.touching", "touching", (0.96, 0.80, 0.22)),
    DefectClass("self_intersections.degenerate", "meets a face of zero area", (0.66, 0.55, 0.44)),
    DefectClass("self_intersections.fold", "folded flat", (0.96, 0.48, 0.66)),
    DefectClass("self_intersections.overlap", "coplanar overlap", (0.52, 0.08, 0.24)),
    DefectClass("self_intersections.duplicate", "duplicate", (0.20, 0.56, 0.26)),
    DefectClass("self_intersections.crossing", "crossing", (0.86, 0.10, 0.12)),
)
SOUND = (0.86, 0.85, 0.83)
"""The colour of faces without a defect."""

_EDGES = ("open_edges", "nonmanifold_edges", "misoriented_edges")
_VERTICES = ("pinched_vertices", "nonfinite_vertices")
_FACES = ("sliver_faces", "zero_area_faces", "repeated_vertex_faces")
_COMPONENTS = ("inside_out_components", "misnested_components")


@dataclass(frozen=True, eq=False)
class Evidence:
    """Defects by place. Classes are positions in `CLASSES`, in arrays with -1 for none.

    Attributes:
        face_class: `(F,)` the most serious class of each face.
        edges: `(k, 2)` vertices of bad edges.
        edge_class: `(k,)`.
        vertices: `(m,)` bad vertices.
        vertex_class: `(m,)`.
        counts: for each class of `CLASSES`, the report's count.
    """

    face_class: NDArray[np.int8]
    edges: Indices
    edge_class: NDArray[np.int8]
    vertices: Indices
    vertex_class: NDArray[np.int8]
    counts: tuple[int, ...]

    def face_colors(self) -> NDArray[np.float64]:
        """sRGB in [0, 1] of each face, `(F, 3)`."""
        palette = np.array([*(c.color for c in CLASSES), SOUND])
        return palette[self.face_class]


def evidence(report: CheckReport) -> Evidence:
    """Where the defects of a report are."""
    counts = report.counts()
    topology, faces = report.topology, report.faces
    found = dict.fromkeys((c.count for c in CLASSES), np.empty(0, dtype=np.int64))
    found |= {name: getattr(topology, name) for name in _FACES}
    for name in _COMPONENTS:
        found[name] = np.flatnonzero(
            np.isin(topology.component_of_face, getattr(report.nesting, name))
        )
    for name in _EDGES:
        found[name] = _faces_at_edges(faces, getattr(topology, name), topology.num_vertices)
    for name in _VERTICES:
        bad = getattr(topology, name)
        found[name] = np.flatnonzero(np.isin(faces, bad).any(axis=1)) if len(bad) else bad
    pairs = report.self_intersections
    for kind in IntersectionKind:
        if kind is not IntersectionKind.NONE:
            name = f"self_intersections.{kind.name.lower()}"
            found[name] = np.unique(pairs.pairs[pairs.kinds == kind])

    face_class = np.full(len(faces), -1, dtype=np.int8)
    edges, edge_class, vertices, vertex_class = [], [], [], []
    for number, defect in enumerate(CLASSES):
        face_class[found[defect.count]] = number
        if defect.count in _EDGES:
            edges.append(getattr(topology, defect.count))
            edge_class += [number] * len(edges[-1])
        if defect.count in _VERTICES:
            vertices.append(getattr(topology, defect.count))
            vertex_class += [number] * len(vertices[-1])
    return Evidence(
        face_class=face_class,
        edges=np.concatenate(edges),
        edge_class=np.array(edge_class, dtype=np.int8),
        vertices=np.concatenate(vertices),
        vertex_class=np.array(vertex_class, dtype=np.int8),
        counts=tuple(counts[c.count] for c in CLASSES),
    )


def write_ply(path: Path, vertices: NDArray[np.float64], faces: Indices, found: Evidence) -> None:
    """Write a mesh and its defects as a binary PLY file; see `CheckReport.write_coloured_mesh`.

    Edges are not written as elements of their own: trimesh refuses a mesh that has any with
    colours. The faces beside a bad edge have its colour instead.
    """
    refuse_target(path, (".ply",))
    color = [("red", "u1"), ("green", "u1"), ("blue", "u1"), ("defect", "i1")]
    vertex_rows = np.zeros(len(vertices), dtype=[("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    for k, name in enumerate("xyz"):
        vertex_rows[name] = vertices[:, k]
    face_rows = np.zeros(len(faces), dtype=[("n", "u1"), ("corners", "<i4", 3), *color])
    face_rows["n"] = 3
    face_rows["corners"] = faces
    palette = np.rint(np.array([*(c.color for c in CLASSES), SOUND]) * 255).astype(np.uint8)
    face_rows["red"], face_rows["green"], face_rows["blue"] = palette[found.face_class].T
    face_rows["defect"] = found.face_class
    header = [
        "ply",
        "format binary_little_endian 1.0",
        "comment defect -1: none",
        *(f"comment defect {n}: {c.label}" for n, c in enumerate(CLASSES)),
        f"element vertex {len(vertices)}",
        *(f"property double {name}" for name in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
        "property char defect",
        "end_header\n",
    ]
    with atomic_write(path) as temporary, open(temporary, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        for rows in (vertex_rows, face_rows):
            rows.tofile(file)


def _faces_at_edges(faces: Indices, edges: Indices, num_vertices: int) -> Indices:
    """Faces that have one of some undirected edges `(k, 2)`, smaller index first."""
    if not len(edges):
        return np.empty(0, dtype=np.int64)
    wanted = edges[:, 0] * num_vertices + edges[:, 1]
    at = np.zeros(len(faces), dtype=bool)
    for k in range(3):
        a, b = faces[:, k - 1], faces[:, k]
        at |= np.isin(np.minimum(a, b) * num_vertices + np.maximum(a, b), wanted)
    return np.flatnonzero(at)
