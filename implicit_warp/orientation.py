"""Exact proof that the layers of a warp are homeomorphisms, from the stored float64 numbers.

What is proved.  Let psi be the plane map of a layer in exact arithmetic: linear on every triangle,
from its corners at rest to their stored images, and linear on every cone, from its two boundary
vertices to their images.  psi is continuous, since cells agree on shared edges and rays.

    If (1) every triangle and every cone has an image of positive oriented area, and (2) the image
    of the boundary loop winds once around the origin, then psi is a homeomorphism of the plane
    that keeps its orientation.

Proof.  By (1) psi is injective on each of the finitely many cells, and on the cones it grows at
least linearly, so it is proper and has a degree.  Far out the degree is the winding number of the
image of a large multiple of the boundary loop, which by (2) is 1.  A point y off the image of all
edges and rays has finitely many preimages, each inside a cell and counted with sign +1 by (1), so
exactly one.  Around any point p, psi maps the sectors of the cells that meet there onto sectors,
each linearly and turning the same way; together they turn a positive multiple of 2 pi about
psi(p), at least once.  So the image of every neighbourhood of p is a neighbourhood of psi(p).  Had
two points p and q the same image y, then points near y and off all edges would have a preimage
near p and another one near q, which was excluded.  So psi is injective; being proper and of degree
one it is onto, and a proper continuous bijection has a continuous inverse.

(1) alone is not enough: positive triangles can wind twice around an inner vertex, as z -> z^2 does.
The sector argument also shows that a layer as a map of R^3, psi beside the identity along the
normal, is a homeomorphism, and so is every composition with invertible affine maps.

How it is decided.  A cell's orientation is the sign of a 2 x 2 determinant of differences of
stored coordinates, a frame's that of a 3 x 3 determinant.  First in float64, after scaling by a
power of two, with the error bounds that `checking.predicates` proves; they hold under underflow
too, because whatever is below 2^-1000 of the scale squared counts as unsure.  What stays unsure is
decided on Python integers.  The winding needs comparisons only, see `windings`.

Guarantee: a returned sign is the sign of the exact determinant of the given float64 numbers.
Non-guarantee: evaluating the map rounds; points within rounding of each other can get equal images.
"""

from __future__ import annotations

from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel
from implicit_warp.checking import exact
from implicit_warp.checking.predicates import UNDERFLOW, UNIT_ROUNDOFF, orient2d, orient3d
from implicit_warp.errors import NotInjective
from implicit_warp.square_mesh import SquareMesh

# Bound on the error of a computed 2 x 2 determinant relative to its terms: Shewchuk's, and
# derived in `checking.predicates`, whose kernels use it too.
_BOUND_2D = (3.0 + 16.0 * UNIT_ROUNDOFF) * UNIT_ROUNDOFF


class Decided(NamedTuple):
    """How many signs were found, and how."""

    by_filter: int
    exactly: int


def prove_layers(embeddings: NDArray[np.float64], mesh: SquareMesh) -> Decided:
    """Prove that every layer is a homeomorphism, by the theorem above.

    Args:
        embeddings: (K, V, 2) finite image vertices of the layers.
        mesh: the rest mesh.

    Raises:
        NotInjective: an oriented area is not positive, or a boundary does not wind once.
    """
    signs, decided = cell_signs(embeddings, mesh)
    if not (signs > 0).all():
        layer, cell = (int(i) for i in np.argwhere(signs <= 0)[0])
        n = mesh.n_triangles
        kind, index = ("triangle", cell) if cell < n else ("cone", cell - n)
        area = exact_area(_corners(embeddings, mesh, layer, cell))
        raise NotInjective(layer, index, kind, f"oriented area {_shown(area)} is not positive")
    turns = windings(embeddings, mesh)
    if not (turns == 1).all():
        layer = int(np.argmax(turns != 1))
        raise NotInjective(
            layer,
            None,
            "boundary",
            f"its image winds {turns[layer]} times around the origin instead of once",
        )
    return decided


def cell_signs(
    embeddings: NDArray[np.float64], mesh: SquareMesh
) -> tuple[NDArray[np.int8], Decided]:
    """(K, C) exact signs of the oriented areas of all image triangles and cones."""
    scaled, _ = _unit_scaled(embeddings)
    signs = np.empty((len(embeddings), mesh.n_cells), np.int8)
    _filter_cells(scaled, mesh.cells, signs)
    unsure = np.argwhere(signs == 0)
    for layer, cell in unsure:
        signs[layer, cell] = exact.sign(exact_area(_corners(embeddings, mesh, layer, cell)))
    return signs, Decided(signs.size - len(unsure), len(unsure))


def windings(embeddings: NDArray[np.float64], mesh: SquareMesh) -> NDArray[np.int64]:
    """(K,) how often each image of the boundary loop winds around the origin.

    Given that all cones have positive area, so that each step of the loop turns counter-clockwise
    by more than 0 and less than pi.  With the polar angle of a vertex in [0, 2 pi), a step from
    y < 0 (angle above pi) to y >= 0 (angle at most pi) must pass angle 0, and no other step can:
    each such step is one turn.  Comparisons with zero are exact.
    """
    below = embeddings[:, mesh.boundary, 1] < 0.0
    return (below & ~np.roll(below, -1, axis=1)).sum(1)


def determinant_signs(matrices: NDArray[np.float64]) -> tuple[NDArray[np.int8], Decided]:
    """(k,) exact signs of the determinants of finite matrices (k, 3, 3)."""
    scaled, _ = _unit_scaled(matrices)
    signs = np.empty(len(matrices), np.int8)
    _filter_determinants(np.concatenate([scaled, np.zeros_like(scaled[:, :1])], 1), signs)
    unsure = np.flatnonzero(signs == 0)
    for i in unsure:
        signs[i] = exact.orient3d(*exact.integer_points(matrices[i]), (0, 0, 0))
    return signs, Decided(len(signs) - len(unsure), len(unsure))


def area_bounds(
    embeddings: NDArray[np.float64], mesh: SquareMesh
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(K, C) lower and upper bounds of twice the oriented areas.

    Areas that float64 leaves uncertain by more than one part in 10^12 are computed exactly. What
    is too small for a normal float64 has the lower bound 0.
    """
    scaled, exponents = _unit_scaled(embeddings)
    first, second, origin = (scaled[:, mesh.cells[:, j]] for j in (1, 2, 0))
    p, q = first - origin, second - origin
    left, right = p[..., 0] * q[..., 1], p[..., 1] * q[..., 0]
    area, error = left - right, _BOUND_2D * (np.abs(left) + np.abs(right)) + UNDERFLOW
    doubled = 2 * exponents[:, None]
    with np.errstate(over="ignore", under="ignore"):
        low, high = (_outward(np.ldexp(area + s * error, doubled), s) for s in (-1, 1))
    for layer, cell in np.argwhere(~(error <= 1e-12 * area)):
        value = _as_float(exact_area(_corners(embeddings, mesh, layer, cell)))
        low[layer, cell], high[layer, cell] = _outward(value, -1), _outward(value, 1)
    low[low < np.finfo(np.float64).tiny] = 0.0
    return low, high


def smallest_area(embeddings: NDArray[np.float64], mesh: SquareMesh) -> Fraction:
    """Twice the smallest oriented area over all cells of all layers, exactly."""
    low, high = area_bounds(embeddings, mesh)
    candidates = np.argwhere(low <= high.min())
    return min(exact_area(_corners(embeddings, mesh, k, c)) for k, c in candidates)


def exact_area(corners: NDArray[np.float64]) -> Fraction:
    """Twice the oriented area of a triangle with corners (3, 2), without rounding."""
    # Denominators of floats are powers of two: over the largest one all become integers.
    ratios = [x.as_integer_ratio() for x in corners.ravel().tolist()]
    common = max(d for _, d in ratios)
    ax, ay, bx, by, cx, cy = (n * (common // d) for n, d in ratios)
    return Fraction((bx - ax) * (cy - ay) - (by - ay) * (cx - ax), common * common)


def _corners(embeddings, mesh: SquareMesh, layer: int, cell: int) -> NDArray[np.float64]:
    at = mesh.cells[cell]
    corners = np.zeros((3, 2))  # the virtual vertex of a cone stays at the origin
    real = at < embeddings.shape[1]
    corners[real] = embeddings[layer, at[real]]
    return corners


def _unit_scaled(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Scale each (m, n) array of a batch by a power of two, its largest entry to [1/2, 1).

    A row of zeros is appended to planar points: the origin, where cones begin.
    """
    exponents = np.frexp(np.abs(values).max((1, 2)))[1]
    scaled = np.zeros((len(values), values.shape[1] + (values.shape[2] == 2), values.shape[2]))
    with np.errstate(under="ignore"):
        np.ldexp(values, -exponents[:, None, None], out=scaled[:, : values.shape[1]])
    return scaled, exponents


def _outward(value, direction: int):
    """One rounding away from the value, since scaling back may round."""
    return np.nextafter(value, direction * np.inf)


def _as_float(value: Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def _shown(area: Fraction) -> str:
    value = _as_float(area)
    if value == 0.0 and area != 0:
        return "below zero by less than 5e-324"
    return f"{value:.3g}"


@kernel
def _filter_cells(scaled, cells, signs):
    for k in range(len(scaled)):
        v = scaled[k]
        for c in range(len(cells)):
            # Differences to the first corner: for a cone, the origin, they do not even round.
            signs[k, c] = orient2d(v, cells[c, 1], cells[c, 2], cells[c, 0], 0, 1)


@kernel
def _filter_determinants(scaled, signs):
    for i in range(len(scaled)):
        signs[i] = orient3d(scaled[i], 0, 1, 2, 3)
