"""Fields that are no distances, turned into distances on a grid.

A warped field, a smooth union or an implicit polynomial has the right surface, and values that
say little of how far it is. Here the surface is extracted as a mesh, and a grid takes the exact
distances to that mesh, everywhere: with a tree around its triangles this costs microseconds a
sample, so nothing has to be propagated from sample to sample, and no error piles up far away.

Accuracy: of second order in the voxel, where the field is smooth. Three errors are of that order:
crossings are placed by linear interpolation, faces are chords of the surface, and the grid is
interpolated (`interpolation="cubic"` takes away the last, away from the medial axis). Edges of the
shape are bevelled by about a voxel, as in every extraction by marching cubes. The report has the
errors measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

import fields as sdf
from fields import Field
from fields.closed_mesh import closed_mesh
from fields.field import make_field
from fields.grid import Interpolation
from fields.grid_samples import Places, places
from fields.mesh import MeshOracle
from fields.notation import Opaque
from implicit_warp.errors import InputError
from implicit_warp.extraction import extract

if TYPE_CHECKING:
    import trimesh

_PROBES = 20_000
"""Points at which errors are measured."""


@dataclass(frozen=True)
class RedistanceReport:
    """What came out of re-distancing, in the field's units.

    Attributes:
        shape: samples along each axis.
        spacing: between samples.
        faces: of the mesh that distances were measured to.
        surface_error: the largest |value| of the new field at points of the surface, which are
            vertices of the mesh brought onto the old field's zero by Newton's method.
        distance_error: the largest difference between the new field and the exact distance to the
            mesh, at random points of the box (within the band, if there is one).
        distance_error_mean: the mean of the same differences.
    """

    shape: tuple[int, int, int]
    spacing: float
    faces: int
    surface_error: float
    distance_error: float
    distance_error_mean: float


def redistance(
    field: Field,
    resolution: int = 128,
    *,
    bounds: ArrayLike | None = None,
    band: float | None = None,
    interpolation: Interpolation = "linear",
    progress: Callable[[int, int], None] | None = None,
) -> Field:
    """A field with the same surface whose values are distances to it, sampled on a grid.

    Not exact, but with errors of second order; see the module's docstring, and
    `redistance_report` for the errors of the case at hand. Beyond the grid's box the field goes on
    as `fields.grid` says, as a lower bound of the distance.

    Args:
        field: negative inside.
        resolution: voxels along the longest side of the box.
        bounds: the box `(2, 3)`, by default the field's own and some voxels more. The surface must
            lie inside it.
        band: if given, distances above it are cut off at it (and below its negative at that),
            which takes less time.
        interpolation: of the grid, "linear" or "cubic".
        progress: called with the planes of the grid done and in all.

    Raises:
        InputError: as `extract` does; or a band that is not positive.
        MissingDependency: scikit-image or trimesh is not installed.
    """
    return redistance_report(
        field,
        resolution,
        bounds=bounds,
        band=band,
        interpolation=interpolation,
        progress=progress,
    )[0]


def redistance_report(
    field: Field,
    resolution: int = 128,
    *,
    bounds: ArrayLike | None = None,
    band: float | None = None,
    interpolation: Interpolation = "linear",
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Field, RedistanceReport]:
    """The field that `redistance` gives, and how good it is."""
    if band is not None and (not isinstance(band, int | float) or not 0 < band < np.inf):
        raise InputError(
            "band", band, "not a positive distance", "Leave it out, or pass a few voxels"
        )
    mesh = extract(field, resolution, bounds=bounds, dtype=torch.float64)
    box = field.bounds if bounds is None else np.asarray(bounds, dtype=np.float64)
    where = places(field, float(np.ptp(box, axis=0).max()) / resolution, bounds)
    oracle = MeshOracle(closed_mesh(mesh.vertices, mesh.faces))
    values = np.empty(where.shape)
    for some, points in where.blocks():
        values[some] = _distances(field, oracle, points.reshape(-1, 3), band).reshape(
            points.shape[:-1]
        )
        if progress is not None:
            progress(some.stop, where.shape[0])
    made = sdf.grid(values, spacing=where.step, origin=where.origin, interpolation=interpolation)
    text = f"redistanced on {' x '.join(str(n) for n in where.shape)} samples"
    result = make_field(made._body, Opaque(text))
    return result, _measured(field, result, mesh, oracle, where, band)


def _distances(
    field: Field, oracle: MeshOracle, points: NDArray[np.float64], band: float | None
) -> NDArray[np.float64]:
    if band is None:
        return oracle.closest(points).signed_distance
    near = oracle.within(points, band)
    far = np.isnan(near)
    near[far] = np.where(field(points[far]) < 0, -band, band)
    return near


def _measured(
    field: Field,
    result: Field,
    mesh: trimesh.Trimesh,
    oracle: MeshOracle,
    where: Places,
    band: float | None,
) -> RedistanceReport:
    rng = np.random.default_rng(0)
    low, high = where.origin, where.origin + where.step * (np.array(where.shape) - 1)
    probes = rng.uniform(low, high, (_PROBES, 3))
    truth = oracle.closest(probes).signed_distance
    if band is not None:
        truth = truth.clip(-band, band)
    error = np.abs(result(probes) - truth)
    vertices = np.asarray(mesh.vertices)
    chosen = rng.permutation(len(vertices))[:_PROBES]
    surface = _onto_surface(field, vertices[chosen], float(where.step[0]))
    return RedistanceReport(
        shape=where.shape,
        spacing=float(where.step[0]),
        faces=len(mesh.faces),
        surface_error=float(np.abs(result(surface)).max()),
        distance_error=float(error.max()),
        distance_error_mean=float(error.mean()),
    )


def _onto_surface(field: Field, points: NDArray[np.float64], voxel: float) -> NDArray[np.float64]:
    """Points near the surface, moved onto it by Newton's steps of half a voxel or less.

    Left as they are where that does not bring the value down, as at an edge.
    """
    start, moved = np.abs(field(points)), points
    for _ in range(4):
        gradient = field.gradient(moved)
        square = (gradient**2).sum(axis=1, keepdims=True)
        step = field(moved)[:, None] * gradient / np.where(square > 0, square, np.inf)
        size = np.linalg.norm(step, axis=1, keepdims=True)
        moved = moved - step * np.minimum(1.0, 0.5 * voxel / np.where(size > 0, size, np.inf))
    better = np.abs(field(moved)) <= start
    return np.where(better[:, None], moved, points)
