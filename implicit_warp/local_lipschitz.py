"""Bounds on what a warp does to a box: its stretch there, and where the box goes.

The global Lipschitz constant of a warp is a product over layers of the largest stretch of any
cell, which no single place combines.  On a box one can do better.  Let c be the box's centre, h
its half lengths, f_k the map up to layer k and J_k its Jacobian.  In every layer one matrix A
stands for those of all cells that the box's image may meet: the middle of these matrices A_t, entry
by entry.  M_k is the product of the A's and transitions so far, P_kj that of those after layer j,
and d_j = max |A_t - A| over the cells met in layer j.  Replacing layer by layer the A_t by A gives

    J_k(x) = M_k + sum_j P_kj (A_t - A)_j J_j-1(x),
    |J_k(x) - M_k| <= sum_j |P_kj| d_j L_j-1,

and likewise, since the box is convex, with s_j the radius of the image's shadow on layer j's plane,

    f_k(x) = f_k(c) + M_k (x - c) + sum_j P_kj r_j,    |r_j| <= d_j s_j.

So the image lies in a parallelepiped and discs around it, whose shadow says which cells are met
(separating lines: the cells' sides); and L_k, the bound on |J_k|, is the smaller of |M_k| plus the
sum above and of the product of the largest norms of met cells.  Where a box meets one cell of every
layer the bound is the norm of the Jacobian itself.

Rounding is part of the bounds.  e holds the errors of tabulated matrices, transitions and products;
rho holds how far the computed image of c may be from the exact one; cells count as met unless they
are apart by more than both.  Of the cells in which the image of c may lie, given rounding, all are
applied, and rho holds how far their results differ.

Guarantee: the bounds hold for the exact map that the stored numbers define.  Non-guarantee: they
are not the smallest ones; several cells met in many layers make them loose, up to the global
constant, which they never exceed.
"""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fields.jit import kernel, parallel_kernel
from implicit_warp.layer_geometry import Geometry, bucket_of
from implicit_warp.local_bounds import LocalBounds, middle_and_half
from implicit_warp.matrix_norms import norm_2x2, quick_norm, spectral_norm

_U = 2.0**-53

_CHUNK = 256
"""Boxes that share scratch memory."""


def layered_bounds(geometry: Geometry, n_triangles: int, boxes: NDArray) -> LocalBounds:
    """Local bounds of a stack of layers, in the direction that the geometry describes."""
    centres, halves = middle_and_half(boxes)
    n = len(boxes)
    found = LocalBounds(np.empty(n), np.empty((n, 3)), np.empty(n), np.empty((n, 2, 3)))
    _walk_boxes(
        centres,
        halves,
        geometry.cells,
        geometry.buckets,
        geometry.transitions,
        n_triangles,
        geometry.lipschitz,
        found.lipschitz,
        found.centres,
        found.radii,
        found.boxes,
    )
    return found


@parallel_kernel
def _walk_boxes(
    centres, halves, cells, buckets, transitions, n_triangles, largest, lipschitz, images, radii,
    image_boxes,
):  # fmt: skip
    n = len(centres)
    for chunk in prange((n + _CHUNK - 1) // _CHUNK):
        low, high = chunk * _CHUNK, min(n, (chunk + 1) * _CHUNK)
        _walk_chunk(
            centres[low:high], halves[low:high], cells, buckets, transitions, n_triangles,
            largest, lipschitz[low:high], images[low:high], radii[low:high], image_boxes[low:high],
        )  # fmt: skip


# Not in the loop above: Numba takes several times as long to compile a large parallel function.
@kernel
def _walk_chunk(
    centres, halves, cells, buckets, transitions, n_triangles, largest, lipschitz, images, radii,
    image_boxes,
):  # fmt: skip
    linear, error, norm, start, target, sides, sizes, overall = cells
    side, corners, first, triangles, outside = buckets
    matrix, t_norm, t_error, t_offset_error = transitions
    n_layers, n_cells = len(linear), linear.shape[1]
    # Each bound is made by some tens of roundings a layer.
    margin = 64.0 * _U * (n_layers + 4)
    slack = 1.0 + margin
    c, m, moved, g = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 2))
    carried = np.empty((n_layers, 3, 2))
    drift, change = np.empty(n_layers), np.empty(n_layers)
    seen, met = np.full(n_cells, -1, np.int64), np.empty(n_cells, np.int64)
    for box in range(len(centres)):
        h = halves[box]
        reach = np.sqrt(h[0] * h[0] + h[1] * h[1] + h[2] * h[2]) * (1.0 + 8.0 * _U)
        c[:] = centres[box]
        m[:] = 0.0
        for i in range(3):
            m[i, i] = 1.0
        terms, e, rho, bound, frobenius, lost = 0, 0.0, 0.0, 1.0, 2.0, False
        changes = 0.0
        for k in range(n_layers + 1):
            # The transition. Products of 3 x 3 matrices round by less than 8 u |T| |M|.
            size = abs(c[0]) + abs(c[1]) + abs(c[2])
            rho = t_norm[k] * rho + (t_error[k] + 16.0 * _U * t_norm[k]) * size
            rho += t_offset_error[k]
            e = t_norm[k] * e + t_error[k] * bound
            e += 16.0 * _U * t_norm[k] * (frobenius + changes)
            _transform(matrix[k], c)
            frobenius = _multiply(matrix[k], m, moved)
            changes, wide, high = _carry(matrix[k], carried, terms, change, drift)
            bound = min(bound * t_norm[k], frobenius + changes + e)
            if k == n_layers:
                break
            # The cells that may be met by the shadow of the image.
            ks = k if len(sizes) > 1 else 0
            across, along = 0.0, 0.0
            for j in range(3):
                g[j, 0], g[j, 1] = moved[0, j] * h[j], moved[1, j] * h[j]
                across += abs(g[j, 0])
                along += abs(g[j, 1])
            wide += e * reach
            high += e * reach
            shadow = np.hypot(across + wide, along + high) * (1.0 + 16.0 * _U)
            loose = sizes[ks] + abs(c[0]) + abs(c[1]) + across + along + wide + high + rho
            loose = rho + margin * loose
            lost = not loose < np.inf
            if lost:
                break
            count = _met_cells(
                c[0], c[1], g, across + wide + loose, along + high + loose, wide + loose,
                high + loose, sides[ks], side, corners[ks], first[ks], triangles[ks],
                outside[ks], n_triangles, seen, np.int64(box) * n_layers + k, met,
            )  # fmt: skip
            several = count != 1
            if several:
                bound = min(bound, quick_norm(moved) + changes + e)
            a, deviation, most = _summary(linear[k], error[k], norm[k], overall[k], met, count)
            middle_norm = max(1.0, norm_2x2(*a))
            # The centre.
            if count < 0:
                count = _cells_of_bucket(
                    c[0], c[1], side, corners[ks], first[ks], triangles[ks], outside[ks],
                    n_triangles, n_cells, met,
                )  # fmt: skip
            u, v, doubt = _apply(
                c[0], c[1], linear[k], error[k], start[ks], target[k], sides[ks], met, count
            )
            rho = most * rho + doubt
            c[0], c[1] = u, v
            # The Jacobian.
            for j in range(3):
                p, q = moved[0, j], moved[1, j]
                m[0, j] = a[0] * p + a[1] * q
                m[1, j] = a[2] * p + a[3] * q
                m[2, j] = moved[2, j]
            e = middle_norm * (e + 16.0 * _U * (frobenius + changes))
            for j in range(terms):
                for i in range(2):
                    p, q = carried[j, 0, i], carried[j, 1, i]
                    carried[j, 0, i] = a[0] * p + a[1] * q
                    carried[j, 1, i] = a[2] * p + a[3] * q
            if not several:
                e += deviation * bound
            else:
                carried[terms] = 0.0
                carried[terms, 0, 0] = carried[terms, 1, 1] = 1.0
                change[terms] = deviation * bound
                drift[terms] = deviation * min(bound * reach, shadow)
                terms += 1
            bound *= most
            frobenius *= middle_norm
            changes = middle_norm * changes + deviation * bound
        # The walk's end: `moved` is M, and wide and high are of its first two rows.
        stretch = min(bound, spectral_norm(moved) + changes + e) * slack
        if lost or not stretch < largest:
            stretch = largest
        rho = np.inf if lost else (rho + e * reach) * slack
        rho += 16.0 * _U * (abs(c[0]) + abs(c[1]) + abs(c[2]))
        lipschitz[box] = stretch
        squares = 0.0
        for i in range(3):
            half = abs(moved[i, 0]) * h[0] + abs(moved[i, 1]) * h[1] + abs(moved[i, 2]) * h[2]
            for j in range(terms):
                half += drift[j] * np.hypot(carried[j, i, 0], carried[j, i, 1])
            squares += half * half
            half = min(half, stretch * reach) * slack + rho
            images[box, i] = c[i]
            image_boxes[box, 0, i] = c[i] - half if half < np.inf else -np.inf
            image_boxes[box, 1, i] = c[i] + half if half < np.inf else np.inf
        ball = min(np.sqrt(squares), stretch * reach) * slack + rho
        radii[box] = ball if ball < np.inf else np.inf


@kernel
def _transform(t, c):
    """c = t(c) for an affine map t (3, 4)."""
    x, y, z = c[0], c[1], c[2]
    for i in range(3):
        c[i] = t[i, 0] * x + t[i, 1] * y + t[i, 2] * z + t[i, 3]


@kernel
def _carry(t, carried, terms, change, drift):
    """Multiply the terms' matrices (3, 2) by the linear part of t.

    Returns the sums over terms of change |P| and of drift times the norms of P's first two rows.
    """
    changes, wide, high = 0.0, 0.0, 0.0
    for j in range(terms):
        p = carried[j]
        for i in range(2):
            x, y, z = p[0, i], p[1, i], p[2, i]
            p[0, i] = t[0, 0] * x + t[0, 1] * y + t[0, 2] * z
            p[1, i] = t[1, 0] * x + t[1, 1] * y + t[1, 2] * z
            p[2, i] = t[2, 0] * x + t[2, 1] * y + t[2, 2] * z
        # The larger eigenvalue of P^T P.
        d = p[0, 0] * p[0, 0] + p[1, 0] * p[1, 0] + p[2, 0] * p[2, 0]
        f = p[0, 1] * p[0, 1] + p[1, 1] * p[1, 1] + p[2, 1] * p[2, 1]
        b = p[0, 0] * p[0, 1] + p[1, 0] * p[1, 1] + p[2, 0] * p[2, 1]
        eigenvalue = 0.5 * (d + f + np.sqrt((d - f) * (d - f) + 4.0 * b * b))
        changes += change[j] * np.sqrt(eigenvalue)
        wide += drift[j] * np.sqrt(p[0, 0] * p[0, 0] + p[0, 1] * p[0, 1])
        high += drift[j] * np.sqrt(p[1, 0] * p[1, 0] + p[1, 1] * p[1, 1])
    rounding = 1.0 + 64.0 * _U
    return changes * rounding, wide * rounding, high * rounding


@kernel
def _summary(linear, error, norm, overall, met, count):
    """One matrix for the met cells, how far they are from it, and the largest norm (at least 1).

    Of all cells of the layer if the count is negative.
    """
    if count < 0:
        middle = (overall[0], overall[1], overall[2], overall[3])
        return middle, overall[4], max(1.0, overall[5])
    t = met[0]
    if count == 1:
        middle = (linear[t, 0], linear[t, 1], linear[t, 2], linear[t, 3])
        return middle, error[t], max(1.0, norm[t])
    l0, l1, l2, l3 = linear[t, 0], linear[t, 1], linear[t, 2], linear[t, 3]
    g0, g1, g2, g3 = l0, l1, l2, l3
    most = 1.0
    for i in range(count):
        t = met[i]
        l0, g0 = min(l0, linear[t, 0]), max(g0, linear[t, 0])
        l1, g1 = min(l1, linear[t, 1]), max(g1, linear[t, 1])
        l2, g2 = min(l2, linear[t, 2]), max(g2, linear[t, 2])
        l3, g3 = min(l3, linear[t, 3]), max(g3, linear[t, 3])
        most = max(most, norm[t])
    middle = (0.5 * (l0 + g0), 0.5 * (l1 + g1), 0.5 * (l2 + g2), 0.5 * (l3 + g3))
    deviation = 0.0
    for i in range(count):
        t = met[i]
        off = norm_2x2(
            linear[t, 0] - middle[0], linear[t, 1] - middle[1],
            linear[t, 2] - middle[2], linear[t, 3] - middle[3],
        )  # fmt: skip
        deviation = max(deviation, off + error[t])
    return middle, deviation, most


@kernel
def _multiply(t, m, out):
    """out = the linear part of t times m; returns its Frobenius norm, rounded up."""
    squares = 0.0
    for i in range(3):
        for j in range(3):
            out[i, j] = t[i, 0] * m[0, j] + t[i, 1] * m[1, j] + t[i, 2] * m[2, j]
            squares += out[i, j] * out[i, j]
    return np.sqrt(squares) * (1.0 + 16.0 * _U)


@kernel
def _apart(x, y, g, wide, high, sides):
    """Is a hexagon about (x, y), widened along the axes, certainly beyond one side of a cell?

    The widening holds the rounding of these sums too, so that False is the answer in doubt.
    """
    for s in range(3):
        p, q = sides[s, 0], sides[s, 1]
        value = p * (x - sides[s, 2]) + q * (y - sides[s, 3])
        reach = abs(p * g[0, 0] + q * g[0, 1]) + abs(p * g[1, 0] + q * g[1, 1])
        reach += abs(p * g[2, 0] + q * g[2, 1]) + abs(p) * wide + abs(q) * high
        if value + reach < 0.0:
            return True
    return False


@kernel
def _met_cells(
    x, y, g, across, along, wide, high, sides, side, corners, first, triangles, outside,
    n_triangles, seen, stamp, met,
):  # fmt: skip
    """Fill met with the cells that the hexagon may meet; their number, or -1 for nearly all."""
    i0 = bucket_of(x - across, corners[0], corners[2], side)
    i1 = bucket_of(x + across, corners[0], corners[2], side)
    j0 = bucket_of(y - along, corners[1], corners[3], side)
    j1 = bucket_of(y + along, corners[1], corners[3], side)
    if 2 * (i1 - i0 + 1) * (j1 - j0 + 1) > side * side:
        return -1
    right, top = corners[0] + side / corners[2], corners[1] + side / corners[3]
    cones = (
        x - across <= corners[0]
        or x + across >= right
        or y - along <= corners[1]
        or y + along >= top
    )
    count = 0
    for i in range(i0, i1 + 1):
        for j in range(j0, j1 + 1):
            bucket = i * side + j
            cones = cones or outside[bucket]
            for index in range(first[bucket], first[bucket + 1]):
                t = triangles[index]
                if seen[t] == stamp:
                    continue
                seen[t] = stamp
                if not _apart(x, y, g, wide, high, sides[t]):
                    met[count] = t
                    count += 1
    if cones:
        for t in range(n_triangles, len(sides)):
            if not _apart(x, y, g, wide, high, sides[t]):
                met[count] = t
                count += 1
    return count if count > 0 else -1


@kernel
def _cells_of_bucket(x, y, side, corners, first, triangles, outside, n_triangles, n_cells, met):
    """Fill met with the cells of a point's bucket, among which is the point's own; their number."""
    right, top = corners[0] + side / corners[2], corners[1] + side / corners[3]
    inside = corners[0] <= x and x <= right and corners[1] <= y and y <= top
    bucket = bucket_of(x, corners[0], corners[2], side) * side
    bucket += bucket_of(y, corners[1], corners[3], side)
    count = 0
    if inside:
        for index in range(first[bucket], first[bucket + 1]):
            met[count] = triangles[index]
            count += 1
    if outside[bucket] or not inside:
        for t in range(n_triangles, n_cells):
            met[count] = t
            count += 1
    return count


@kernel
def _apply(x, y, linear, error, start, target, sides, met, count):
    """The image of a point under the plane map, and a bound on its distance to the exact one.

    Of the met cells, every one that the point may lie in, given rounding, is applied: the exact
    image is that of one of them. A single one needs no test.
    """
    u, v, doubt = 0.0, 0.0, -1.0
    for index in range(count):
        t = met[index]
        possible = True
        for s in range(3 if count > 1 else 0):
            p, q = sides[t, s, 0], sides[t, s, 1]
            value = p * (x - sides[t, s, 2]) + q * (y - sides[t, s, 3])
            size = abs(x) + abs(sides[t, s, 2]) + abs(y) + abs(sides[t, s, 3])
            if value < -8.0 * _U * (abs(p) + abs(q)) * size:
                possible = False
                break
        if not possible:
            continue
        px, py = x - start[t, 0], y - start[t, 1]
        tu = linear[t, 0] * px + linear[t, 1] * py
        tv = linear[t, 2] * px + linear[t, 3] * py
        entries = abs(linear[t, 0]) + abs(linear[t, 1]) + abs(linear[t, 2]) + abs(linear[t, 3])
        own = (error[t] + 8.0 * _U * entries) * (abs(px) + abs(py))
        tu += target[t, 0]
        tv += target[t, 1]
        own += 4.0 * _U * (abs(tu) + abs(tv) + abs(target[t, 0]) + abs(target[t, 1]))
        if doubt < 0.0:
            u, v, doubt = tu, tv, own
        else:
            doubt = max(doubt, own + abs(tu - u) + abs(tv - v))
    return (u, v, doubt) if doubt >= 0.0 else (u, v, np.inf)
