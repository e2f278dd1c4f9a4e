"""A warp's layers with rigorous error bounds: what certificates and local bounds are made of.

Everything here speaks about the *exact* map, the one that the stored numbers define in exact
arithmetic.  Each cell's matrix comes with a bound on how far float64 put it from the exact one, so
that bounds built from both hold for the exact map, slivers included.

With u = 2^-53, source corners s_i and target corners t_i, a cell's matrix is

    A = ((t_1 - t_0) x rot(s_2 - s_0) - (t_2 - t_0) x rot(s_1 - s_0)) / area(s).

Differences, products, the sum and the quotient round by less than 8 u of the terms' absolute
values; with the uncertainty of the area (see `orientation.area_bounds`) and as much again for
safety, |error| <= (16 u + uncertainty) (|t_1| |s_2| + |t_2| |s_1|) / area, in the Frobenius norm.
"""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import kernel, parallel_kernel
from implicit_warp import orientation
from implicit_warp.layers import LayerStack
from implicit_warp.matrix_norms import norms_2x2, spectral_norms

ROUNDOFF = 2.0**-53

FORWARD, INVERSE = False, True


class CellMaps(NamedTuple):
    """The plane maps of all layers in one direction, in the order in which layers are met.

    Where the source is the rest mesh, all layers share the arrays marked S, of length 1.
    """

    linear: NDArray[np.float64]  # (K, C, 4) A, row by row
    error: NDArray[np.float64]  # (K, C) bound on the error of A
    norm: NDArray[np.float64]  # (K, C) upper bound of the spectral norm of the exact A
    start: NDArray[np.float64]  # S (K, C, 2) first source corner
    target: NDArray[np.float64]  # (K, C, 2) its image
    sides: NDArray[np.float64]  # S (K, C, 3, 4) inward normal and a point of each side
    sizes: NDArray[np.float64]  # S (K,) largest |coordinate| of the source
    overall: NDArray[np.float64]  # (K, 6) middle of all matrices, deviation from it, largest norm


class Buckets(NamedTuple):
    """A uniform grid over the source of each layer, listing the triangles that meet each bucket."""

    side: int
    corners: NDArray[np.float64]  # (K, 4) low corner, and buckets per unit length, x and y
    first: NDArray[np.int32]  # (K, side^2 + 1) where each bucket's list begins
    triangles: NDArray[np.int32]  # (K, longest)
    outside: NDArray[np.bool_]  # (K, side^2) does a cone meet the bucket?


class Transitions(NamedTuple):
    """Affine maps with bounds on how far float64 put them from the exact ones."""

    matrix: NDArray[np.float64]  # (k, 3, 4), k = K + 1 in a stack
    norm: NDArray[np.float64]  # (k,) upper bound of the spectral norm of the exact matrix
    error: NDArray[np.float64]  # (k,) bound on the error of the linear part
    offset_error: NDArray[np.float64]  # (k,) bound on the error of offset and sum


class Geometry(NamedTuple):
    """One direction of a stack."""

    cells: CellMaps
    buckets: Buckets
    transitions: Transitions

    @property
    def largest(self) -> NDArray[np.float64]:
        """(K,) upper bounds of the norm of each layer as a map of space."""
        return np.maximum(1.0, self.cells.norm.max(1))  # the normal keeps its length

    @property
    def lipschitz(self) -> float:
        """The product of the norms of all layers and transitions, rounded upwards."""
        with np.errstate(over="ignore"):
            product = self.largest.prod() * self.transitions.norm.prod()
        return float(product) * (1.0 + 4.0 * ROUNDOFF * len(self.largest))


_cache: weakref.WeakKeyDictionary = weakref.WeakKeyDictionary()


def geometry(stack: LayerStack, inverse: bool) -> Geometry:
    """One direction of a stack whose layers are proved; made once, dropped with the stack."""
    made = _cache.setdefault(stack, {})
    if inverse not in made:
        made[inverse] = _geometry(stack, inverse)
    return made[inverse]


def _geometry(stack: LayerStack, inverse: bool) -> Geometry:
    mesh = stack.mesh
    rest = mesh.vertices[None]
    image = stack.embeddings.detach().cpu().numpy()
    if inverse:
        image = image[::-1]
    source, target = (image, rest) if inverse else (rest, image)
    low, high = orientation.area_bounds(source, mesh)
    cells = _cell_maps(_corners(source, mesh), _corners(target, mesh), low, high, mesh.n_triangles)
    return Geometry(cells, _buckets(source, cells, mesh), _transitions(stack, inverse))


def _corners(vertices, mesh):
    with_origin = np.concatenate([vertices, np.zeros((len(vertices), 1, 2))], 1)
    return with_origin[:, mesh.cells]


def _cell_maps(source, target, low, high, n_triangles: int) -> CellMaps:
    s1, s2 = source[:, :, 1] - source[:, :, 0], source[:, :, 2] - source[:, :, 0]
    t1, t2 = target[:, :, 1] - target[:, :, 0], target[:, :, 2] - target[:, :, 0]

    def size(v):
        return np.hypot(v[..., 0], v[..., 1])

    with np.errstate(all="ignore"):
        area = 0.5 * low + 0.5 * high
        uncertainty = (high - low) / low + 16.0 * ROUNDOFF
        quarter = np.stack([s2[..., 1], -s2[..., 0]], -1), np.stack([-s1[..., 1], s1[..., 0]], -1)
        linear = (
            t1[..., :, None] * quarter[0][..., None, :]
            + t2[..., :, None] * quarter[1][..., None, :]
        ) / area[..., None, None]
        error = uncertainty * (size(t1) * size(s2) + size(t2) * size(s1)) / low
        # Areas beyond the range of float64 leave the matrix undecided.
        lost = ~np.isfinite(error) | ~np.isfinite(linear).all((-1, -2))
        linear[lost], error[lost] = 0.0, np.inf
        linear = linear.reshape(*linear.shape[:2], 4)
        norm = norms_2x2(linear) + error
        spread = np.stack([linear.min(1), linear.max(1)])
        middle = spread.mean(0)
        deviation = (norms_2x2(linear - middle[:, None]) + error).max(1)
    along = np.stack([source[:, :, (2, 0, 1)][:, :, k] - source[:, :, (1, 2, 0)][:, :, k]
                      for k in range(3)], 2)  # fmt: skip
    normals = np.stack([-along[..., 1], along[..., 0]], -1)
    sides = np.concatenate([normals, source[:, :, (1, 2, 0)]], -1)
    sides[:, n_triangles:, 0, :2] *= -1.0  # a cone lies beyond the edge that faces the origin
    parts = (
        linear,
        error,
        norm,
        source[:, :, 0],
        np.broadcast_to(target[:, :, 0], (len(linear), *target.shape[1:2], 2)),
        sides,
        np.abs(source).max((1, 2, 3)),
        np.concatenate([middle, deviation[:, None], norm.max(1)[:, None]], 1),
    )
    # Copies, all writable and in C order: Numba compiles anew for every other layout.
    return CellMaps(*(np.array(part, order="C") for part in parts))


def _transitions(stack: LayerStack, inverse: bool) -> Transitions:
    given = stack.transitions.detach().cpu().numpy()
    if not inverse:
        return bounded_affine(given)
    back = stack.inverse_transitions.detach().cpu().numpy()[::-1]
    parts = bounded_affine(given, back)
    return Transitions(*(np.ascontiguousarray(part[::-1]) for part in parts))


def bounded_affine(
    given: NDArray[np.float64], inverse: NDArray[np.float64] | None = None
) -> Transitions:
    """Affine maps (k, 3, 4) with error bounds; those of their inverses if these are given too.

    Frames are rotations to 1e-6, so fusing two of them, or one with an affine map, rounds by less
    than 16 u of the product's norm. The bounds allow for twice that.
    """
    offsets = np.linalg.norm(given[..., 3], axis=1)
    norms = spectral_norms(given[..., :3])
    errors = 32.0 * ROUNDOFF * norms
    if inverse is None:
        matrix = np.ascontiguousarray(given)
        return Transitions(matrix, norms + errors, errors, 32.0 * ROUNDOFF * offsets)
    residual = np.eye(3) - given[..., :3] @ inverse[..., :3]
    backward = spectral_norms(inverse[..., :3])
    # T B = I - E gives T^-1 = B (I - E)^-1, so |T^-1 - B| <= |B| |E| / (1 - |E|).
    off = np.linalg.norm(residual, axis=(1, 2)) + (errors + 16.0 * ROUNDOFF * norms) * backward
    with np.errstate(all="ignore"):
        errors = np.where(off < 1.0, backward * off / (1.0 - off), np.inf)
    norms = backward + errors
    return Transitions(inverse, norms, errors, (errors + 32.0 * ROUNDOFF * norms) * offsets)


def _buckets(source, cells: CellMaps, mesh) -> Buckets:
    side = 2 * (mesh.resolution - 1)
    low, high = source.min(1), source.max(1)
    corners = np.concatenate([low, side / (high - low)], 1)
    first = np.zeros((len(source), side * side + 1), np.int32)
    outside = np.zeros((len(source), side * side), np.bool_)
    none = np.empty((len(source), 0), np.int32)
    points = source[:, mesh.triangles]
    boxes = np.concatenate([points.min(2), points.max(2)], 2)
    _sort_into_buckets(side, corners, boxes, cells.sides, cells.sizes, first, none, outside)
    triangles = np.empty((len(source), int(first[:, -1].max())), np.int32)
    _sort_into_buckets(side, corners, boxes, cells.sides, cells.sizes, first, triangles, outside)
    return Buckets(side, corners, first, triangles, outside)


@parallel_kernel
def _sort_into_buckets(side, corners, boxes, sides, sizes, first, triangles, outside):
    """Count the triangles of every bucket, or list them once the counts are known."""
    count_only = triangles.shape[1] == 0
    n = boxes.shape[1]
    for k in prange(len(boxes)):
        filled = first[k, :-1].copy()
        half_x, half_y = 0.5 / corners[k, 2], 0.5 / corners[k, 3]
        slack = 1e-9 * sizes[k]
        for c in range(sides.shape[1]):
            i0, i1, j0, j1 = 0, side - 1, 0, side - 1
            if c < n:
                i0 = bucket_of(boxes[k, c, 0] - slack, corners[k, 0], corners[k, 2], side)
                i1 = bucket_of(boxes[k, c, 2] + slack, corners[k, 0], corners[k, 2], side)
                j0 = bucket_of(boxes[k, c, 1] - slack, corners[k, 1], corners[k, 3], side)
                j1 = bucket_of(boxes[k, c, 3] + slack, corners[k, 1], corners[k, 3], side)
            elif not count_only:
                continue
            for i in range(i0, i1 + 1):
                x = corners[k, 0] + (2 * i + 1) * half_x
                for j in range(j0, j1 + 1):
                    y = corners[k, 1] + (2 * j + 1) * half_y
                    apart = False
                    for s in range(3):
                        a, b = sides[k, c, s, 0], sides[k, c, s, 1]
                        value = a * (x - sides[k, c, s, 2]) + b * (y - sides[k, c, s, 3])
                        reach = abs(a) * (half_x + slack) + abs(b) * (half_y + slack)
                        if value + reach < 0.0:
                            apart = True
                    if apart:
                        continue
                    bucket = i * side + j
                    if c >= n:
                        outside[k, bucket] = True
                    elif count_only:
                        first[k, bucket + 1] += 1
                    else:
                        triangles[k, filled[bucket]] = c
                        filled[bucket] += 1
        if count_only:
            for bucket in range(side * side):
                first[k, bucket + 1] += first[k, bucket]


@kernel
def bucket_of(x, low, per_unit, side):
    """The bucket of a coordinate, clamped to the grid."""
    position = (x - low) * per_unit
    if not position > 0.0:
        return 0
    if position >= side:
        return side - 1
    return int(position)
