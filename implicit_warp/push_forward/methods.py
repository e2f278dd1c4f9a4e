"""Three ways to carry a mesh forward by a map, under one function."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from numbers import Real
from typing import TYPE_CHECKING, Literal

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import parallel_kernel
from implicit_warp.checking.mesh_arrays import mesh_arrays
from implicit_warp.errors import InputError
from implicit_warp.maps import Map
from implicit_warp.push_forward.attributes import carry_attributes, refuse_attributes
from implicit_warp.push_forward.lineage import Lineage
from implicit_warp.push_forward.report import PushForwardReport

if TYPE_CHECKING:
    import trimesh

Method = Literal["vertices", "adaptive", "exact"]
METHODS: tuple[Method, ...] = ("vertices", "adaptive", "exact")
Precision = Literal["float32", "float64"]

_LARGEST = 1e100
"""Largest coordinate taken: squares of images, stretched by whatever map, stay finite."""

Progress = Callable[[int, int], None]


def deform_mesh(
    mesh: trimesh.Trimesh,
    map_: Map,
    method: Method = "vertices",
    *,
    tolerance: float | None = None,
    until_clean: bool = False,
    clean_for: Precision | None = None,
    progress: Progress | None = None,
) -> tuple[trimesh.Trimesh, PushForwardReport]:
    """The image of a mesh under a map, and a report.

    * "vertices": vertices move, faces stay as they are.  **No guarantee**: a flat triangle is not
      the image of a triangle, and a coarse mesh can come out with self-intersections.
    * "adaptive": faces are divided until the image is followed within `tolerance`, where sampled;
      with `until_clean`, until an exact test finds no self-intersection.  For any map.
    * "exact": faces are cut along all creases of the map, and the result is the image itself: every
      face lies in one cell of every layer, to 1e-12 of the larger of the layers' square and the
      mesh.  Under a map that is injective, a mesh that does not intersect itself gets an image that
      does not either, up to the rounding of coordinates to float64; `check` says whether rounding
      did any harm.  For a Warp, a TutteNet, an Affine, and compositions of these.

    "adaptive" and "exact" keep watertight what is watertight, and open and non-manifold meshes as
    they are; components and genus stay.  Faces with a repeated vertex are dropped.  Vertices that
    coincide without being shared (texture seams) still do afterwards, bit for bit.

    Args:
        mesh: (V, 3) vertices and (F, 3) faces, such as a `trimesh.Trimesh`; it is not changed.
            Colours, texture coordinates, attributes and metadata are carried over.
        map_: the map.
        method: see above.
        tolerance: of "adaptive", in the units of the image; by default 1/1000 of the diagonal of
            the image's box.
        until_clean: of "adaptive".
        clean_for: of "exact" and "adaptive": round coordinates to "float32" (STL, PLY, GLB) or
            "float64", and collapse the short edges at which that makes contacts; see `rounding`.
            Takes a search for self-intersections, or a few.
        progress: called with the steps done and in all.

    Raises:
        InputError: not a mesh or map; vertices not finite; an unknown method, or an option of
            another one; "exact" for other maps than those above; "adaptive" cannot reach what was
            asked for (see `divide_and_push`).
    """
    import trimesh

    begin = time.perf_counter()
    _refuse_bad_options(map_, method, tolerance, until_clean)
    _refuse_bad_precision(method, clean_for)
    vertices, faces = mesh_arrays(mesh)
    _refuse_non_finite(vertices)
    if isinstance(mesh, trimesh.Trimesh):
        refuse_attributes(mesh)
    repeated = (faces == np.roll(faces, -1, 1)).any(axis=1)
    dropped = np.empty(0, np.int64) if method == "vertices" else np.flatnonzero(repeated)
    kept = np.delete(np.arange(len(faces)), dropped)
    figures = {}
    if method == "vertices":
        points, corners, sources = map_(vertices), faces, kept
        lineage = Lineage(len(vertices), np.empty((0, 2), np.int64), np.empty(0))
    elif method == "adaptive":
        from implicit_warp.push_forward.adaptive import divide_and_push

        result, tolerance = divide_and_push(
            vertices, faces[kept], map_, tolerance, until_clean=until_clean, progress=progress
        )
        points, corners, sources = result.images, result.faces, kept[result.sources]
        lineage = result.lineage
        figures = {
            "tolerance": tolerance,
            "largest_error": result.largest_error,
            "rounds": result.rounds,
            "self_intersections": 0 if until_clean else None,
        }
    else:
        from implicit_warp.push_forward.exact import cut_and_push
        from implicit_warp.push_forward.triangulation import triangulate

        polygons, uncut = cut_and_push(vertices, faces[kept], map_, progress)
        corners, sources = triangulate(polygons)
        points, sources = polygons.points[: polygons.n_vertices], kept[sources]
        lineage = polygons.lineage
        figures = {"polygons": int(polygons.n_polygons), "uncut": uncut}

    rest, kept_vertices = lineage.interpolate(vertices), slice(None)
    if clean_for is not None:
        from implicit_warp.push_forward.rounding import settle

        settled = settle(points, rest, corners, clean_for)
        points, kept_vertices = settled.points[settled.kept_vertices], settled.kept_vertices
        renumbered = np.full(len(settled.points), -1)
        renumbered[kept_vertices] = np.arange(len(kept_vertices))
        corners, sources = renumbered[settled.faces], sources[settled.kept_faces]
        figures |= {"collapsed": settled.collapsed, "self_intersections": settled.contacts}

    image = trimesh.Trimesh(points, corners, process=False)
    if isinstance(mesh, trimesh.Trimesh):
        carry_attributes(mesh, image, lineage, kept_vertices, sources)
    report = PushForwardReport(
        method=method,
        faces_in=len(faces),
        faces_out=len(corners),
        source_faces=sources,
        rest_vertices=rest[kept_vertices],
        dropped_faces=dropped,
        smallest_edge=_smallest_edge(points, corners),
        seconds=time.perf_counter() - begin,
        **figures,
    )
    return image, report


@parallel_kernel
def _smallest_edge(points, faces):
    smallest = np.inf
    for f in prange(len(faces)):
        for k in range(3):
            a, b = faces[f, k], faces[f, k - 1]
            squared = 0.0
            for d in range(3):
                squared += (points[a, d] - points[b, d]) ** 2
            smallest = min(smallest, squared)
    return math.sqrt(smallest)


def _refuse_bad_options(
    map_: object, method: object, tolerance: float | None, until_clean: object
) -> None:
    if not isinstance(map_, Map):
        raise InputError("map_", map_, "not a map", "pass a Warp, TutteNet, Affine, ...")
    if method not in METHODS:
        raise InputError("method", method, "no such method", f"use one of {', '.join(METHODS)}")
    for name, value in (("tolerance", tolerance), ("until_clean", until_clean or None)):
        if value is not None and method != "adaptive":
            raise InputError(
                name, value, f'method "{method}" has no such option', 'use method="adaptive"'
            )
    is_number = isinstance(tolerance, Real) and not isinstance(tolerance, bool)
    if tolerance is not None and not (is_number and 0.0 < tolerance < np.inf):
        raise InputError(
            "tolerance", tolerance, "not a positive distance", "give it in units of the image"
        )


def _refuse_bad_precision(method: str, clean_for: object) -> None:
    if clean_for not in (None, "float32", "float64"):
        raise InputError("clean_for", clean_for, "no such precision", 'use "float32" or "float64"')
    if clean_for is not None and method == "vertices":
        raise InputError(
            "clean_for",
            clean_for,
            "the faces of a mesh that is moved by its vertices intersect for other reasons",
            'use method="exact" or "adaptive"',
        )


def _refuse_non_finite(vertices: NDArray[np.float64]) -> None:
    bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(bad):
        raise InputError(
            "mesh",
            vertices[bad[0]].tolist(),
            f"{len(bad)} vertices are NaN or infinite, the first is vertex {bad[0]}",
            "repair the mesh first; check names all of them",
        )
    if len(vertices) and np.abs(vertices).max() > _LARGEST:
        raise InputError(
            "mesh",
            float(np.abs(vertices).max()),
            f"a coordinate beyond {_LARGEST:g}, where lengths overflow",
            "give the mesh in larger units",
        )
