"""What a deformation of a mesh did, in figures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class PushForwardReport:
    """How the image of a mesh came about.

    Attributes:
        method: "vertices", "adaptive" or "exact".
        faces_in, faces_out: number of faces of the mesh and of its image.
        source_faces: (faces_out,) the face of the given mesh that each face is a part of.
        rest_vertices: (V, 3) where each vertex of the image lies on the given mesh.
        dropped_faces: given faces with a repeated vertex. They are no triangles, and "adaptive" and
            "exact" leave them out.
        smallest_edge: length of the shortest edge of the image; infinity without faces.
        seconds: time taken.
        polygons: exact: the pieces before they were triangulated, each in one cell of every layer.
        uncut: exact: pieces that a layer should have cut but left whole, because rounding had bent
            them; 0 unless coordinates are huge.  Their images are not exact.
        tolerance: adaptive: the distance asked for.
        largest_error: adaptive: the largest distance found, at the midpoints of the final edges and
            the centroids of the final faces, between the image and the flat faces.
        rounds: adaptive: how many times faces were divided.
        self_intersections: with `until_clean` or `clean_for`: pairs of faces of the result that
            intersect, and faces of no area; None if nobody looked.
        collapsed: with `clean_for`: edges collapsed because rounding made contacts there.
    """

    method: str
    faces_in: int
    faces_out: int
    source_faces: NDArray[np.int64]
    rest_vertices: NDArray[np.float64]
    dropped_faces: NDArray[np.int64]
    smallest_edge: float
    seconds: float
    polygons: int | None = None
    uncut: int | None = None
    tolerance: float | None = None
    largest_error: float | None = None
    rounds: int | None = None
    self_intersections: int | None = None
    collapsed: int | None = None

    def __str__(self) -> str:
        parts = [f"{self.method}: {self.faces_in} faces -> {self.faces_out}"]
        if self.polygons is not None:
            parts.append(f"{self.polygons} convex pieces")
            if self.uncut:
                parts.append(f"{self.uncut} of them NOT cut as they should be")
        if self.tolerance is not None:
            parts.append(f"largest error found {self.largest_error:.3g} of {self.tolerance:.3g}")
        if self.collapsed is not None:
            parts.append(
                f"{self.collapsed} edges collapsed, {self.self_intersections} contacts left"
            )
        if len(self.dropped_faces):
            parts.append(f"{len(self.dropped_faces)} faces with a repeated vertex dropped")
        parts.append(f"smallest edge {self.smallest_edge:.3g}, {self.seconds:.2f} s")
        return ", ".join(parts)
