"""Compiled loops over the vertices of hash grids (see `fields.neural.hash_grid`).

Each grid is handled by one thread, from its first point to its last, so that scattered sums come
out the same whatever the number of threads, and a grid's table stays in the cache of one core.

All three loops take `directions`, `(n, 3)` or `(0, 3)`. With none, a vertex counts with its
trilinear weight w; with some, with the derivative of w along the point's direction. So the same
loops serve first and second derivatives.

The eight corners of a cell are written out, x running fastest: a loop over them with its branches
was measured three times slower.
"""

from __future__ import annotations

from numba import prange

from fields.jit import inlined, point_kernel

PRIME_Y, PRIME_Z = 2654435761, 805459861
"""Of the paper's hash (x * 1) ^ (y * PRIME_Y) ^ (z * PRIME_Z); products fit into int64, and the
low bits that count are those of the paper's unsigned 32-bit arithmetic."""


@inlined
def _place(coordinate, resolution, number):
    """The cell of a coordinate in [0, 1], and the position in it; outer cells reach on."""
    position = coordinate * number(resolution)
    cell = min(max(int(position), 0), resolution - 1)
    return cell, position - number(cell)


@inlined
def _rows(i, j, k, resolution, offset, mask):
    """The rows of the table that hold a cell's corners; a mask of -1 means no hashing."""
    if mask < 0:
        next_y = resolution + 1
        next_z = next_y * next_y
        row = offset + i + next_y * j + next_z * k
        above = row + next_z
        return (
            row,
            row + 1,
            row + next_y,
            row + next_y + 1,
            above,
            above + 1,
            above + next_y,
            above + next_y + 1,
        )
    y, z = j * PRIME_Y, k * PRIME_Z
    front, behind = y ^ z, (y + PRIME_Y) ^ z
    front_above, behind_above = y ^ (z + PRIME_Z), (y + PRIME_Y) ^ (z + PRIME_Z)
    return (
        offset + ((i ^ front) & mask),
        offset + (((i + 1) ^ front) & mask),
        offset + ((i ^ behind) & mask),
        offset + (((i + 1) ^ behind) & mask),
        offset + ((i ^ front_above) & mask),
        offset + (((i + 1) ^ front_above) & mask),
        offset + ((i ^ behind_above) & mask),
        offset + (((i + 1) ^ behind_above) & mask),
    )


@inlined
def _weights(x, y, z, one):
    """Trilinear weights of the corners at a position in the unit cell."""
    u, v, w = one - x, one - y, one - z
    near, right, far, far_right = u * v, x * v, u * y, x * y
    return (
        near * w,
        right * w,
        far * w,
        far_right * w,
        near * z,
        right * z,
        far * z,
        far_right * z,
    )


@inlined
def _weights_along(x, y, z, one, resolution, direction):
    """Derivatives of the trilinear weights along a direction of space."""
    a, b, c = direction[0] * resolution, direction[1] * resolution, direction[2] * resolution
    u, v, w = one - x, one - y, one - z
    near, right, far, far_right = u * v, x * v, u * y, x * y
    # The derivatives of the four products just named.
    d_near, d_right, d_far, d_far_right = (
        -a * v - u * b,
        a * v - x * b,
        u * b - a * y,
        a * y + x * b,
    )
    return (
        d_near * w - near * c,
        d_right * w - right * c,
        d_far * w - far * c,
        d_far_right * w - far_right * c,
        d_near * z + near * c,
        d_right * z + right * c,
        d_far * z + far * c,
        d_far_right * z + far_right * c,
    )


@inlined
def _corners(points, directions, p, n, offset, mask, number):
    """The rows and weights of the corners of a point's cell."""
    i, x = _place(points[p, 0], n, number)
    j, y = _place(points[p, 1], n, number)
    k, z = _place(points[p, 2], n, number)
    if len(directions):
        weights = _weights_along(x, y, z, number(1), number(n), directions[p])
    else:
        weights = _weights(x, y, z, number(1))
    return _rows(i, j, k, n, offset, mask), weights


@point_kernel
def gather(points, table, resolutions, offsets, masks, directions, features):
    """features[2 l + f, p] = sum over the corners v of the cell of w_v table[v, f]."""
    number = points.dtype.type
    for level in prange(len(resolutions)):
        n, offset, mask = resolutions[level], offsets[level], masks[level]
        for p in range(len(points)):
            rows, weights = _corners(points, directions, p, n, offset, mask, number)
            first, second = number(0), number(0)
            for corner in range(8):
                first += weights[corner] * table[rows[corner], 0]
                second += weights[corner] * table[rows[corner], 1]
            features[2 * level, p] = first
            features[2 * level + 1, p] = second


@point_kernel
def scatter(points, upstream, resolutions, offsets, masks, directions, table):
    """table[v, f] += w_v upstream[2 l + f, p]: the transpose of `gather`."""
    number = points.dtype.type
    for level in prange(len(resolutions)):
        n, offset, mask = resolutions[level], offsets[level], masks[level]
        for p in range(len(points)):
            rows, weights = _corners(points, directions, p, n, offset, mask, number)
            first, second = upstream[2 * level, p], upstream[2 * level + 1, p]
            for corner in range(8):
                table[rows[corner], 0] += weights[corner] * first
                table[rows[corner], 1] += weights[corner] * second


@point_kernel
def slope(points, table, upstream, resolutions, offsets, masks, directions, slopes):
    """slopes[l, p] = the gradient, by the point, of the part of grid l in
    sum over v of w_v (table[v] . upstream[p])."""
    number = points.dtype.type
    one = number(1)
    for level in prange(len(resolutions)):
        n, offset, mask = resolutions[level], offsets[level], masks[level]
        scale = number(n)
        for p in range(len(points)):
            i, x = _place(points[p, 0], n, number)
            j, y = _place(points[p, 1], n, number)
            k, z = _place(points[p, 2], n, number)
            u, v, w = one - x, one - y, one - z
            r = _rows(i, j, k, n, offset, mask)
            first, second = upstream[2 * level, p], upstream[2 * level + 1, p]
            a = table[r[0], 0] * first + table[r[0], 1] * second
            b = table[r[1], 0] * first + table[r[1], 1] * second
            c = table[r[2], 0] * first + table[r[2], 1] * second
            d = table[r[3], 0] * first + table[r[3], 1] * second
            e = table[r[4], 0] * first + table[r[4], 1] * second
            f = table[r[5], 0] * first + table[r[5], 1] * second
            g = table[r[6], 0] * first + table[r[6], 1] * second
            h = table[r[7], 0] * first + table[r[7], 1] * second
            if len(directions):
                by_xy = w * (d - c - b + a) + z * (h - g - f + e)
                by_xz = v * (f - e - b + a) + y * (h - g - d + c)
                by_yz = u * (g - e - c + a) + x * (h - f - d + b)
                s, t, q = directions[p, 0], directions[p, 1], directions[p, 2]
                slopes[level, p, 0] = scale * scale * (t * by_xy + q * by_xz)
                slopes[level, p, 1] = scale * scale * (s * by_xy + q * by_yz)
                slopes[level, p, 2] = scale * scale * (s * by_xz + t * by_yz)
            else:
                slopes[level, p, 0] = scale * (
                    w * (v * (b - a) + y * (d - c)) + z * (v * (f - e) + y * (h - g))
                )
                slopes[level, p, 1] = scale * (
                    w * (u * (c - a) + x * (d - b)) + z * (u * (g - e) + x * (h - f))
                )
                slopes[level, p, 2] = scale * (
                    v * (u * (e - a) + x * (f - b)) + y * (u * (g - c) + x * (h - d))
                )
