"""CGAL as an independent referee, through its Python wheel (GPL-3: for the tests only).

The wheel's `self_intersections` gives handles that cannot be told apart, so only its verdict on
whole meshes and its predicate on two triangles are used; both work with exact predicates.
"""

from __future__ import annotations

import numpy as np
from CGAL.CGAL_Kernel import Point_3, Triangle_3, do_intersect
from CGAL.CGAL_Polygon_mesh_processing import (
    Int_Vector,
    Point_3_Vector,
    Polygon_Vector,
    does_self_intersect,
    polygon_soup_to_polygon_mesh,
)
from CGAL.CGAL_Polyhedron_3 import Polyhedron_3


def triangles_meet(points: np.ndarray) -> bool:
    """Whether the closed triangles of corners 0, 1, 2 and 3, 4, 5 of `(6, 3)` points meet.

    Neither may have zero area.
    """
    corners = [Point_3(*p) for p in points.tolist()]
    return do_intersect(Triangle_3(*corners[:3]), Triangle_3(*corners[3:]))


def self_intersects(vertices: np.ndarray, faces: np.ndarray) -> bool | None:
    """CGAL's verdict on a mesh; None if it cannot hold all of its faces and vertices."""
    mesh = polyhedron(vertices, faces)
    if mesh.size_of_facets() != len(faces) or mesh.size_of_vertices() != len(vertices):
        return None
    return does_self_intersect(mesh)


def polyhedron(vertices: np.ndarray, faces: np.ndarray) -> Polyhedron_3:
    """The mesh as CGAL's half-edge structure.

    That has no place for non-manifold edges and faces of opposite orientation: what does not fit
    is dropped or split in silence.
    """
    points, polygons, mesh = Point_3_Vector(), Polygon_Vector(), Polyhedron_3()
    for vertex in vertices.tolist():
        points.append(Point_3(*vertex))
    for face in faces.tolist():
        corners = Int_Vector()
        for index in face:
            corners.append(index)
        polygons.append(corners)
    polygon_soup_to_polygon_mesh(points, polygons, mesh)
    return mesh
