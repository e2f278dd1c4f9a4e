"""The generalised winding number of triangles around points, by a tree; in float64.

The winding number of a point is the solid angle under which it sees the triangles, those from
behind counted negative, over 4 pi (Jacobson, Kavan and Sorkine-Hornung, "Robust inside-outside
segmentation using generalized winding numbers", 2013). Triangles near by are added up one by
one (van Oosterom and Strackee, 1983). A cluster that is far away for its size is replaced by
the Taylor expansion of its dipoles up to second order (Barill, Dickson, Schmidt, Levin and
Jacobson, "Fast winding numbers for soups and clouds", 2018).

Guarantee: every triangle is counted once, so of a closed oriented surface the exact sum would be
a whole number. Non-guarantee: the error of the expansion is not bounded here; tests find it below
0.01, which matters only where the winding number is that near to one half.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from fields.jit import inlined, kernel, parallel_kernel
from fields.kernels.triangle_tree import STACK, leaf_range

FAR = 2.0
"""How many radii away from its middle a cluster is expanded; the authors' choice."""

_MOMENTS = 26
"""Numbers a cluster: its middle (0-2) and squared radius (3), and for normals n and offsets d
integrated over it: n (4-6), n_i d_j (7-12, symmetric: xx yy zz xy xz yz), the vector
n_i d_j d_j + 2 n_j d_j d_i (13-15), and n_i d_j d_k (16-25, symmetric: xxx yyy zzz xxy xxz yyx
yyz zzx zzy xyz)."""

_RUN = 256


@kernel
def moments(corners, links):
    """The expansion of both children of every node, `(n, 2, 26)`."""
    count = len(links)
    ranges = np.empty((count, 2), np.int64)
    result = np.empty((count, 2, _MOMENTS))
    for node in range(count - 1, -1, -1):
        for side in range(2):
            child = links[node, side]
            first, last = leaf_range(child) if child < 0 else (ranges[child, 0], ranges[child, 1])
            ranges[node, side] = first if side == 0 else last
            _expand(corners, first, last, result[node, side])
    return result


@kernel
def _expand(corners, first, last, m):
    """Write the moments of a range of triangles."""
    m[:] = 0.0
    whole = 0.0
    for t in range(first, last):
        n = _area_vector(corners, t)
        area = math.sqrt(n[0] ** 2 + n[1] ** 2 + n[2] ** 2)
        whole += area
        for a in range(3):
            m[a] += area * (corners[t, 0, a] + corners[t, 1, a] + corners[t, 2, a]) / 3
    for a in range(3):
        m[a] = m[a] / whole if whole > 0 else corners[first, 0, a]
    d, second = np.empty((4, 3)), np.empty((3, 3))
    for t in range(first, last):
        n = _area_vector(corners, t)
        for a in range(3):
            for k in range(3):
                d[k, a] = corners[t, k, a] - m[a]
            d[3, a] = (d[0, a] + d[1, a] + d[2, a]) / 3
        for k in range(3):
            m[3] = max(m[3], d[k, 0] ** 2 + d[k, 1] ** 2 + d[k, 2] ** 2)
        for i in range(3):
            for j in range(3):
                corner_sum = d[0, i] * d[0, j] + d[1, i] * d[1, j] + d[2, i] * d[2, j]
                second[i, j] = (corner_sum + 9 * d[3, i] * d[3, j]) / 12
        trace = second[0, 0] + second[1, 1] + second[2, 2]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            m[4 + i] += n[i]
            m[7 + i] += n[i] * d[3, i]
            along = n[0] * second[0, i] + n[1] * second[1, i] + n[2] * second[2, i]
            m[13 + i] += n[i] * trace + 2 * along
            m[16 + i] += n[i] * second[i, i]
            # Three orders of (i, i, j) add up, of which two are equal.
            m[19 + 2 * i] += 2 * n[i] * second[i, min(j, k)] + n[min(j, k)] * second[i, i]
            m[20 + 2 * i] += 2 * n[i] * second[i, max(j, k)] + n[max(j, k)] * second[i, i]
        m[10] += n[0] * d[3, 1] + n[1] * d[3, 0]
        m[11] += n[0] * d[3, 2] + n[2] * d[3, 0]
        m[12] += n[1] * d[3, 2] + n[2] * d[3, 1]
        m[25] += 2 * (n[0] * second[1, 2] + n[1] * second[0, 2] + n[2] * second[0, 1])


@inlined
def _area_vector(corners, t):
    ux, uy, uz = (
        corners[t, 1, 0] - corners[t, 0, 0],
        corners[t, 1, 1] - corners[t, 0, 1],
        corners[t, 1, 2] - corners[t, 0, 2],
    )
    vx, vy, vz = (
        corners[t, 2, 0] - corners[t, 0, 0],
        corners[t, 2, 1] - corners[t, 0, 1],
        corners[t, 2, 2] - corners[t, 0, 2],
    )
    return 0.5 * (uy * vz - uz * vy), 0.5 * (uz * vx - ux * vz), 0.5 * (ux * vy - uy * vx)


@inlined
def _solid_angle(corners, t, x, y, z):
    """The solid angle of a triangle, over 4 pi."""
    ax, ay, az = corners[t, 0, 0] - x, corners[t, 0, 1] - y, corners[t, 0, 2] - z
    bx, by, bz = corners[t, 1, 0] - x, corners[t, 1, 1] - y, corners[t, 1, 2] - z
    cx, cy, cz = corners[t, 2, 0] - x, corners[t, 2, 1] - y, corners[t, 2, 2] - z
    a = math.sqrt(ax * ax + ay * ay + az * az)
    b = math.sqrt(bx * bx + by * by + bz * bz)
    c = math.sqrt(cx * cx + cy * cy + cz * cz)
    above = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    below = (
        a * b * c
        + (ax * bx + ay * by + az * bz) * c
        + (bx * cx + by * cy + bz * cz) * a
        + (cx * ax + cy * ay + cz * az) * b
    )
    return math.atan2(above, below) / (2 * math.pi)


@inlined
def _expansion(m, x, y, z):
    """A cluster's part of the winding number, at the point (x, y, z) from it.

    With K(r) = r / |r|^3 and r = middle - point: n . K, its gradient and its second
    derivatives, contracted with the moments.
    """
    square = x * x + y * y + z * z
    r1 = 1.0 / math.sqrt(square)
    r2 = r1 * r1
    r3 = r1 * r2
    r5, r7 = r3 * r2, r3 * r2 * r2
    dipole = m[4] * x + m[5] * y + m[6] * z
    trace = m[7] + m[8] + m[9]
    quadratic = (
        m[7] * x * x + m[8] * y * y + m[9] * z * z + m[10] * x * y + m[11] * x * z + m[12] * y * z
    )
    vector = m[13] * x + m[14] * y + m[15] * z
    cubic = (
        x * x * (m[16] * x + m[19] * y + m[20] * z)
        + y * y * (m[17] * y + m[21] * x + m[22] * z)
        + z * z * (m[18] * z + m[23] * x + m[24] * y)
        + m[25] * x * y * z
    )
    total = dipole * r3 + trace * r3 - 3 * quadratic * r5 - 1.5 * vector * r5 + 7.5 * cubic * r7
    return total / (4 * math.pi)


@parallel_kernel
def winding_number(points, corners, links, clusters):
    """Winding numbers `(n,)` of points `(n, 3)`."""
    count = len(points)
    result = np.empty(count)
    for run in numba.prange(-(-count // _RUN)):
        stack = np.empty(STACK, np.int64)
        for i in range(run * _RUN, min(count, (run + 1) * _RUN)):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            total = 0.0
            stack[0], size = 0, 1
            while size:
                size -= 1
                node = stack[size]
                for side in range(2):
                    m = clusters[node, side]
                    dx, dy, dz = m[0] - x, m[1] - y, m[2] - z
                    child = links[node, side]
                    if dx * dx + dy * dy + dz * dz > FAR * FAR * m[3]:
                        total += _expansion(m, dx, dy, dz)
                    elif child >= 0:
                        stack[size] = child
                        size += 1
                    else:
                        first, last = leaf_range(child)
                        for t in range(first, last):
                            total += _solid_angle(corners, t, x, y, z)
            result[i] = total
    return result
