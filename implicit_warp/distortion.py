"""How a map distorts space at points: singular values, det J, elastic energy, handle error.

For display and analysis.  Everything comes from one evaluation of the Jacobians, block by block,
so that memory beyond the result is constant.  The elastic energy is the very function that the
solve minimises (`energy.elastic_energy`).

The Jacobian of a warp is constant within a cell and jumps between cells: a value at a vertex on a
crease is that of one of its cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numba import prange
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fields.jit import kernel, parallel_kernel
from implicit_warp.energy import elastic_energy
from implicit_warp.errors import InputError
from implicit_warp.handles import Handle
from implicit_warp.maps import Map, flatten_points

BLOCK = 1 << 16
"""Points whose Jacobians are held at once: 4.7 MB of float64."""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Distortion:
    """What a map does around each of n points.

    Attributes:
        image: (n, 3) where the points go.
        stretches: (n, 3) the singular values of the Jacobian, largest first.
        determinant: (n,) det J, the factor on volumes; positive for injective maps that keep the
            orientation.
        energy: (n,) || J^T J - I ||_F^2, zero exactly where the map is rigid.
    """

    image: Array
    stretches: Array
    determinant: Array
    energy: Array

    @property
    def largest(self) -> Array:
        """(n,) the largest factor on lengths."""
        return self.stretches[:, 0]

    @property
    def smallest(self) -> Array:
        """(n,) the smallest factor on lengths."""
        return self.stretches[:, 2]

    @property
    def ratio(self) -> Array:
        """(n,) largest over smallest: 1 where the map is a similarity."""
        return self.stretches[:, 0] / self.stretches[:, 2]

    def quantity(self, name: str) -> Array:
        """(n,) one of `QUANTITIES`.

        Raises:
            InputError: there is no such quantity.
        """
        if name not in QUANTITIES:
            raise InputError(
                "name", name, "no such quantity", f"use one of {', '.join(QUANTITIES)}"
            )
        return QUANTITIES[name](self)


QUANTITIES: dict[str, Callable[[Distortion], Array]] = {
    "det": lambda d: d.determinant,
    "stretch": lambda d: d.largest,
    "squeeze": lambda d: d.smallest,
    "ratio": lambda d: d.ratio,
    "energy": lambda d: d.energy,
}
"""What can be shown of a map, by the name it has in the page and on the command line."""


def measure_distortion(map_: Map, points: ArrayLike | Tensor) -> Distortion:
    """Measure a map at points of the rest shape.

    Args:
        map_: any map; warps on the CPU are evaluated by their compiled kernels.
        points: (n, 3), vertices of a mesh at rest for instance; measured in float64.

    Raises:
        InputError: no map; points of another shape, or not finite.
    """
    if not isinstance(map_, Map):
        raise InputError("map_", map_, "not a map", "pass a Warp, TutteNet, Affine, ...")
    given = _rows(points)
    image, stretches = np.empty(given.shape), np.empty(given.shape)
    determinant, energy = np.empty(len(given)), np.empty(len(given))
    for part, tensor in _blocks(given):
        there, jacobian = map_.call_and_jacobian(tensor)
        jacobian = jacobian.double().contiguous()
        image[part] = there.double().numpy()
        energy[part] = elastic_energy(jacobian).numpy()
        _decompose(jacobian.numpy(), stretches[part], determinant[part])
    return Distortion(image, stretches, determinant, energy)


def handle_distance(
    map_: Map, handles: Sequence[Handle], points: ArrayLike | Tensor
) -> tuple[Array, NDArray[np.int64]]:
    """How far handles' points are from where the handles want them.

    Args:
        map_: the map.
        handles: what is held and moved.
        points: (n, 3) of the shape at rest.

    Returns:
        (n,) distances in the user's units, NaN for points that no handle selects, and (n,) which
        handle selects a point, -1 for none.  Where regions overlap, the first counts: a solve
        accepts that only if they agree.

    Raises:
        InputError: points of another shape, or not finite.
    """
    given = _rows(points)
    distance, chosen = np.full(len(given), np.nan), np.full(len(given), -1, dtype=np.int64)
    for part, tensor in _blocks(given):
        image = map_(tensor).double()
        for number, handle in enumerate(handles):
            free = torch.from_numpy(chosen[part] < 0)
            inside = (handle.region.evaluate(tensor) <= 0) & free
            gap = (image[inside] - handle.motion(tensor[inside])).norm(dim=-1)
            rows = np.arange(part.start, part.stop)[inside.numpy()]
            distance[rows], chosen[rows] = gap.numpy(), number
    return distance, chosen


def _rows(points: ArrayLike | Tensor) -> Tensor:
    flat = flatten_points(points)[0]
    if np.ndim(points) != 2:
        raise InputError("points", tuple(np.shape(points)), "not of shape (n, 3)", "reshape them")
    return flat.detach().to("cpu", torch.float64)


def _blocks(points: Tensor) -> Iterator[tuple[slice, Tensor]]:
    with torch.no_grad():
        for start in range(0, len(points), BLOCK):
            part = slice(start, min(start + BLOCK, len(points)))
            yield part, points[part]


@parallel_kernel
def _decompose(jacobians, stretches, determinants):
    """Singular values, largest first, and determinants of (n, 3, 3) matrices."""
    for i in prange(len(jacobians)):
        m = jacobians[i].copy()
        determinants[i] = (
            m[0, 0] * (m[1, 1] * m[2, 2] - m[1, 2] * m[2, 1])
            + m[0, 1] * (m[1, 2] * m[2, 0] - m[1, 0] * m[2, 2])
            + m[0, 2] * (m[1, 0] * m[2, 1] - m[1, 1] * m[2, 0])
        )
        # One-sided Jacobi: turn pairs of columns until all are at right angles; their lengths are
        # then the singular values, the small ones as accurate as the large ones.
        for _ in range(12):
            turned = _turn_columns(m, 0, 1)
            turned = _turn_columns(m, 0, 2) or turned
            turned = _turn_columns(m, 1, 2) or turned
            if not turned:
                break
        for j in range(3):
            stretches[i, j] = np.sqrt(m[0, j] ** 2 + m[1, j] ** 2 + m[2, j] ** 2)
        for j, k in ((0, 1), (0, 2), (1, 2)):
            if stretches[i, j] < stretches[i, k]:
                stretches[i, j], stretches[i, k] = stretches[i, k], stretches[i, j]


@kernel
def _turn_columns(m, p, q):
    """One rotation that brings two columns to right angles; were they not already?"""
    pp = pq = qq = 0.0
    for r in range(3):
        pp += m[r, p] * m[r, p]
        pq += m[r, p] * m[r, q]
        qq += m[r, q] * m[r, q]
    if pq * pq <= 1e-32 * pp * qq:
        return False
    half = (qq - pp) / (2.0 * pq)
    t = 1.0 / (abs(half) + np.sqrt(half * half + 1.0))
    if half < 0.0:
        t = -t
    c = 1.0 / np.sqrt(t * t + 1.0)
    s = t * c
    for r in range(3):
        a, b = m[r, p], m[r, q]
        m[r, p] = c * a - s * b
        m[r, q] = s * a + c * b
    return True
