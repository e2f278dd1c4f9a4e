"""A field's surface as a triangle mesh, by marching cubes on a lattice of cubic voxels.

What makes the mesh sound is how its vertices are found:

* A sample is inside where its value is below the level, else outside; there is no third
  case. Marching cubes (Lorensen and Cline, 1987) runs on these signs alone, so its topology
  does not depend on rounding, and every vertex names its lattice edge exactly.
* The vertex is then placed along that edge by linear interpolation of the two samples, in
  float64, but never nearer than `NEAREST` of a voxel to either end. This has the effect of
  pushing near-level samples off the level, yet needs no idea of the field's scale: the field
  may be scaled or warped, and no distance at all. Vertices of different edges keep apart.
* Every lattice point is sampled once, and slabs are joined by the identity of lattice edges.

Guarantees: the mesh is watertight, edge- and vertex-manifold, and oriented outward, whatever
the samples are; its topology is that of the signs. Memory grows with the surface and with the
area of one slab, not with the volume.
Non-guarantees: parts thinner than a voxel may be missed or merged, edges and corners of the
shape are bevelled at the scale of a voxel, and faces may be slivers. No sample values are
known to make the faces intersect, but that is tested and not proved: `check` decides it for
the mesh at hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fields import Field
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.lattice import BLOCK, Lattice, Sampler, lattice_for

if TYPE_CHECKING:
    import trimesh

NEAREST = 1e-2
"""Closest that a vertex comes to an end of its lattice edge, in voxels."""

_SLAB_POINTS = 1 << 22
_WALLS = (("x min", "x max"), ("y min", "y max"), ("z min", "z max"))


def extract(
    field: Field,
    resolution: int = 128,
    *,
    bounds: ArrayLike | None = None,
    at_wall: Literal["error", "close"] = "error",
    level: float = 0.0,
    dtype: torch.dtype = torch.float32,
    block: int = 1 << 17,
    progress: Callable[[int, int], None] | None = None,
) -> trimesh.Trimesh:
    """The surface where a field equals a level, as a closed triangle mesh.

    Guarantees and non-guarantees are in the module's docstring. If the field has a Lipschitz
    bound, blocks that the surface certainly misses are not sampled.

    Args:
        field: negative (below `level`) inside. Wrap a function by `fields.from_function`.
        resolution: voxels along the longest side of the box. The other sides are rounded up
            to whole voxels, half of the excess at each end.
        bounds: the box `(2, 3)`, minimum and maximum corner; by default the field's own bounds
            and two voxels more on every side.
        at_wall: what to do where the inside reaches the box's wall: "error" raises, "close"
            caps it there with a flat face (within `NEAREST` of a voxel of the wall).
        level: the value of the surface; other than 0 it may leave the field's own bounds.
        dtype: of the points and values, torch.float32 or torch.float64. Vertices are float64.
        block: points a call of the field; bounds the memory that the field uses.
        progress: called with the lattice planes done and in all.

    Returns:
        The mesh, in the field's own units. Vertices are shared, no two coincide.

    Raises:
        InputError: not a field; no bounds; no surface in the box; the inside reaches a wall;
            NaN or infinite values; voxels too small for `dtype`; a field that changes faster
            than its `lipschitz` says.
        MissingDependency: scikit-image or trimesh is not installed.
    """
    try:
        import skimage.measure  # noqa: F401 - needed later: fail before the work, not after
        import trimesh
    except ImportError as error:
        raise MissingDependency(
            error.name or "scikit-image",
            "extracting a mesh",
            "Install it with `pip install scikit-image trimesh`",
        ) from error
    _refuse_bad_options(field, at_wall, level, dtype, block)
    lattice = lattice_for(field, resolution, bounds)
    _refuse_fine_voxels(lattice, resolution, dtype)
    level = float(torch.tensor(level, dtype=dtype))
    sampler = Sampler(field, lattice, level, dtype, block)
    mesher = _Mesher(lattice, level, at_wall, field.lipschitz)

    last = lattice.shape[0] - 1
    planes = max(1, _SLAB_POINTS // (lattice.shape[1] * lattice.shape[2]))
    planes = max(BLOCK, planes // BLOCK * BLOCK)
    carried = None
    for begin in range(0, last, planes):
        end = min(begin + planes, last)
        values, inside, sampled = sampler.slab(begin, end, carried)
        mesher.add(values, inside, sampled, begin)
        carried = values[-1].copy()  # a view would keep the whole slab alive
        if progress is not None:
            progress(end, last)

    vertices, faces = mesher.finish()
    if not len(faces):
        raise InputError(
            "field",
            field,
            f"no surface: the values sampled in the box lie between {sampler.lowest:.6g} and "
            f"{sampler.highest:.6g}, and none is below the level {level:g}",
            "Check the sign convention (negative inside), the bounds, and that the shape is "
            f"thicker than a voxel ({lattice.voxel:.3g})",
        )
    return trimesh.Trimesh(vertices, faces, process=False)


def _refuse_bad_options(
    field: object, at_wall: object, level: object, dtype: object, block: object
) -> None:
    if not isinstance(field, Field):
        raise InputError("field", field, "not a field", "Wrap a function by fields.from_function")
    if at_wall not in ("error", "close"):
        raise InputError("at_wall", at_wall, "no such choice", 'Use "error" or "close"')
    if not isinstance(level, int | float) or not np.isfinite(level):
        raise InputError("level", level, "not a finite number", "Use 0 for the field's surface")
    if dtype not in (torch.float32, torch.float64):
        raise InputError("dtype", dtype, "not supported", "Use torch.float32 or torch.float64")
    if not isinstance(block, int) or block < 1:
        raise InputError("block", block, "not a positive whole number", "Leave it out")


def _refuse_fine_voxels(lattice: Lattice, resolution: int, dtype: torch.dtype) -> None:
    """Neighbouring samples must be distinct points after rounding to `dtype`."""
    farthest = float(np.abs([lattice.origin, lattice.far_corner]).max())
    if lattice.voxel < 8.0 * torch.finfo(dtype).eps * farthest:
        raise InputError(
            "resolution",
            resolution,
            f"a voxel of {lattice.voxel:.3g} is lost in the rounding of {dtype} coordinates of "
            f"size {farthest:.3g}",
            "Use dtype=torch.float64, move the shape to the origin, or lower the resolution",
        )


@dataclass(frozen=True)
class _Piece:
    """The part of the mesh in one slab: an id for each vertex names its lattice edge."""

    edge_ids: NDArray[np.int64]
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]


class _Mesher:
    """Turns slabs of samples, handed over in order, into one mesh.

    To close the surface at the walls, the lattice is extended by one layer of points on every
    side that are outside, at infinity; ids of edges always count on the extended lattice.
    """

    def __init__(
        self, lattice: Lattice, level: float, at_wall: str, lipschitz: float | None
    ) -> None:
        self._lattice = lattice
        self._level = level
        self._lipschitz = lipschitz
        self._close = at_wall == "close"
        self._extended = tuple(n + 2 for n in lattice.shape)
        self._pieces: list[_Piece] = []

    def add(
        self,
        values: NDArray[np.floating],
        inside: NDArray[np.bool_],
        sampled: NDArray[np.bool_] | None,
        begin: int,
    ) -> None:
        """Mesh the slab whose first plane is x = begin."""
        at_end = begin + len(values) == self._lattice.shape[0]
        shift = np.array([begin + 1, 1, 1])
        if self._close:
            pad = ((int(begin == 0), int(at_end)), (1, 1), (1, 1))
            values = np.pad(values, pad, constant_values=np.inf)
            inside = np.pad(inside, pad, constant_values=False)
            sampled = None if sampled is None else _with_walls(sampled, pad)
            shift -= [pad[0][0], 1, 1]
        else:
            self._refuse_inside_at_wall(inside, begin, at_end)
        if not inside.any() or inside.all():
            return
        low_ends, axes, faces = _surface_of_signs(inside, sampled)
        positions = low_ends + shift - 1.0  # index coordinates of the lattice proper
        positions[np.arange(len(axes)), axes] += self._fractions(values, low_ends, axes)
        vertices = self._lattice.origin + self._lattice.voxel * positions
        edge_ids = 3 * np.ravel_multi_index((low_ends + shift).T, self._extended) + axes
        self._pieces.append(_Piece(edge_ids, vertices, faces))

    def finish(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Vertices and faces of all slabs, joined where they name the same lattice edge."""
        if not self._pieces:
            return np.empty((0, 3)), np.empty((0, 3), dtype=np.int64)
        offsets = np.cumsum([0] + [len(p.vertices) for p in self._pieces])
        _, first, joined = np.unique(
            np.concatenate([p.edge_ids for p in self._pieces]),
            return_index=True,
            return_inverse=True,
        )
        vertices = np.concatenate([p.vertices for p in self._pieces])[first]
        faces = np.concatenate(
            [p.faces + offset for p, offset in zip(self._pieces, offsets, strict=False)]
        )
        return vertices, joined[faces]

    def _fractions(
        self,
        values: NDArray[np.floating],
        low_ends: NDArray[np.int64],
        axes: NDArray[np.int64],
    ) -> NDArray[np.float64]:
        """Where the level is crossed along each edge, from 0 at its low end to 1."""
        high_ends = low_ends.copy()
        high_ends[np.arange(len(axes)), axes] += 1
        low = np.abs(values[tuple(low_ends.T)].astype(np.float64) - self._level)
        high = np.abs(values[tuple(high_ends.T)].astype(np.float64) - self._level)
        # A value at infinity, beyond a wall, puts the vertex at the wall, whatever is there.
        low, high = np.where(np.isinf(high), 0.0, low), np.where(np.isinf(low), 0.0, high)
        skipped = np.isnan(low) | np.isnan(high)
        if skipped.any():
            raise InputError(
                "field.lipschitz",
                self._lipschitz,
                f"the field changes sign on {int(skipped.sum())} lattice edges that its "
                "Lipschitz bound rules out",
                "State the true bound, or none (lipschitz=None)",
            )
        # Scaled first, so that neither huge nor tiny values over- or underflow in the sum.
        limits = np.finfo(np.float64)
        scale = np.clip(np.maximum(low, high), limits.tiny, limits.max)
        low, high = np.minimum(low, scale) / scale, np.minimum(high, scale) / scale
        return np.clip(low / (low + high), NEAREST, 1.0 - NEAREST)

    def _refuse_inside_at_wall(self, inside: NDArray[np.bool_], begin: int, at_end: bool) -> None:
        walls = [
            name
            for axis in range(3)
            for name, plane, present in (
                (_WALLS[axis][0], 0, axis > 0 or begin == 0),
                (_WALLS[axis][1], -1, axis > 0 or at_end),
            )
            if present and np.take(inside, plane, axis=axis).any()
        ]
        if walls:
            box = [self._lattice.origin.tolist(), self._lattice.far_corner.tolist()]
            raise InputError(
                "bounds",
                box,
                f"the inside of the field reaches the wall of this box at {', '.join(walls)}, "
                "so the surface would be open there",
                'Pass larger bounds, or at_wall="close" to cap the shape at the wall',
            )


def _with_walls(sampled: NDArray[np.bool_], pad: tuple[tuple[int, int], ...]) -> NDArray[np.bool_]:
    """Extend a mask to the padding, and to the wall's own points: the cap lies between."""
    core = tuple(slice(2 * before, -2 * after or None) for before, after in pad)
    walls = np.ones([n + sum(p) for n, p in zip(sampled.shape, pad, strict=True)], dtype=bool)
    walls[core] = False
    walls[tuple(slice(before, -after or None) for before, after in pad)] |= sampled
    return walls


def _surface_of_signs(
    inside: NDArray[np.bool_], sampled: NDArray[np.bool_] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Marching cubes on signs alone.

    Returns:
        The lattice edge of each vertex as its low end `(V, 3)` and its axis `(V,)`, and the
        faces `(F, 3)`, outward.
    """
    from skimage.measure import marching_cubes

    signs = np.where(inside, np.float32(-1.0), np.float32(1.0))
    # Between -1 and 1 every crossing is an edge's midpoint, exact in float32. Cells none of
    # whose corners were sampled hold no surface, and the mask spares looking at them.
    midpoints, faces, _, _ = marching_cubes(signs, 0.0, method="lorensen", mask=sampled)
    doubled = np.rint(2.0 * midpoints).astype(np.int64)
    return doubled >> 1, np.argmax(doubled & 1, axis=1), faces.astype(np.int64)
