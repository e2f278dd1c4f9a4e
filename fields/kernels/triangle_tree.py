"""A tree of boxes around triangles, and the nearest triangle to a point; all in float64.

The tree is binary. A node is a row of two arrays, which describe its two children: `boxes`
`(n, 2, 6)`, minimum and maximum, and `links` `(n, 2)`, the number of the child's own node, or
for a leaf the code of its triangles (`leaf_range`). Nodes come before their children.
Triangles are in the order of the leaves, so every child owns a range of them.

Splits follow the surface area heuristic, binned (Wald, "On fast construction of SAH-based
bounding volume hierarchies", 2007).

Guarantee: the triangle found is the nearest up to the rounding of float64.
"""

from __future__ import annotations

import numba
import numpy as np

from fields.jit import inlined, kernel, parallel_kernel

LEAF = 4
"""Most triangles in a leaf."""

_BINS = 16
_DEEPEST = 40
"""Depth from which nodes are halved by number, so that no stack overflows."""

STACK = 80
"""Entries that a walk down the tree can need: another 38 levels hold more than memory does."""

_RUN = 256
"""Points searched in a row by one thread. Each begins with the triangle of the one before,
which in a lattice is next to its own and leaves little to look at."""


@inlined
def leaf_range(code):
    """The first triangle of a leaf, and the one after its last."""
    first = (-1 - code) // (LEAF + 1)
    return first, first + (-1 - code) % (LEAF + 1)


@kernel
def build(corners):
    """The tree of triangles `(f, 3, 3)`: their order, boxes and links."""
    count = len(corners)
    low, high = np.empty((count, 3)), np.empty((count, 3))
    for t in range(count):
        for a in range(3):
            x, y, z = corners[t, 0, a], corners[t, 1, a], corners[t, 2, a]
            low[t, a], high[t, a] = min(x, y, z), max(x, y, z)
    order = np.arange(count)
    boxes, links = np.empty((count + 1, 2, 6)), np.empty((count + 1, 2), np.int64)
    stack = np.empty((STACK, 4), np.int64)
    stack[0] = 0, count, 0, 0  # a range of triangles, its depth, and where its number goes
    size, made = 1, 0
    while size:
        size -= 1
        begin, end, depth, place = stack[size]
        links[place // 2, place % 2] = made  # of the first node nobody reads this
        middle = _split(order, begin, end, low, high, depth)
        for side in range(1, -1, -1):
            first, last = (middle, end) if side else (begin, middle)
            for a in range(3):
                least, most = np.inf, -np.inf
                for i in range(first, last):
                    least = min(least, low[order[i], a])
                    most = max(most, high[order[i], a])
                boxes[made, side, a], boxes[made, side, a + 3] = least, most
            if last - first <= LEAF:
                links[made, side] = -1 - (first * (LEAF + 1) + last - first)
            else:
                stack[size] = first, last, depth + 1, 2 * made + side
                size += 1
        made += 1
    return order, boxes[:made].copy(), links[:made].copy()


@kernel
def _split(order, begin, end, low, high, depth):
    """Arrange a range of `order` in two parts and return where the second begins."""
    if depth >= _DEEPEST or end - begin <= LEAF:
        return (begin + end) // 2
    best, best_axis, best_cut = np.inf, -1, 0
    least, most = np.full(3, np.inf), np.full(3, -np.inf)
    for i in range(begin, end):
        for a in range(3):
            middle = low[order[i], a] + high[order[i], a]
            least[a], most[a] = min(least[a], middle), max(most[a], middle)
    for a in range(3):
        if most[a] <= least[a]:
            continue
        scale = _BINS / (most[a] - least[a])
        number = np.zeros(_BINS, np.int64)
        bottom, top = np.full((_BINS, 3), np.inf), np.full((_BINS, 3), -np.inf)
        for i in range(begin, end):
            t = order[i]
            b = min(int((low[t, a] + high[t, a] - least[a]) * scale), _BINS - 1)
            number[b] += 1
            for c in range(3):
                bottom[b, c] = min(bottom[b, c], low[t, c])
                top[b, c] = max(top[b, c], high[t, c])
        cost = np.zeros(_BINS)  # of cutting before each bin
        for backward in range(2):
            edge_low, edge_high, inside = np.full(3, np.inf), np.full(3, -np.inf), 0
            for step in range(_BINS - 1):
                b = _BINS - 1 - step if backward else step
                inside += number[b]
                for c in range(3):
                    edge_low[c] = min(edge_low[c], bottom[b, c])
                    edge_high[c] = max(edge_high[c], top[b, c])
                if inside:
                    x, y, z = edge_high - edge_low
                    cost[b if backward else b + 1] += inside * (x * y + y * z + z * x)
                else:
                    cost[b if backward else b + 1] = np.inf
        for cut in range(1, _BINS):
            if cost[cut] < best:
                best, best_axis, best_cut = cost[cut], a, cut
    if best_axis < 0:
        return (begin + end) // 2  # all middles coincide: nothing tells the triangles apart
    a = best_axis
    scale = _BINS / (most[a] - least[a])
    i, j = begin, end
    while i < j:
        t = order[i]
        if min(int((low[t, a] + high[t, a] - least[a]) * scale), _BINS - 1) < best_cut:
            i += 1
        else:
            j -= 1
            order[i], order[j] = order[j], order[i]
    return i


@inlined
def _box_distance(boxes, node, side, x, y, z):
    """The squared distance of a point to the box of a child."""
    dx = max(boxes[node, side, 0] - x, 0.0, x - boxes[node, side, 3])
    dy = max(boxes[node, side, 1] - y, 0.0, y - boxes[node, side, 4])
    dz = max(boxes[node, side, 2] - z, 0.0, z - boxes[node, side, 5])
    return dx * dx + dy * dy + dz * dz


@inlined
def _on_edge(corners, t, k, x, y, z):
    """The point of a triangle's edge k nearest to (x, y, z), the feature it is on, its distance.

    Features: 0 the inside, 1 + k the edge from corner k to corner k + 1, 4 + k corner k.
    """
    n = (k + 1) % 3
    ax, ay, az = corners[t, k, 0], corners[t, k, 1], corners[t, k, 2]
    bx, by, bz = corners[t, n, 0], corners[t, n, 1], corners[t, n, 2]
    ex, ey, ez = bx - ax, by - ay, bz - az
    squared = ex * ex + ey * ey + ez * ez
    along = (x - ax) * ex + (y - ay) * ey + (z - az) * ez
    if along <= 0 or squared == 0:
        feature, cx, cy, cz = 4 + k, ax, ay, az
    elif along >= squared:
        feature, cx, cy, cz = 4 + n, bx, by, bz
    else:
        s = along / squared
        feature, cx, cy, cz = 1 + k, ax + s * ex, ay + s * ey, az + s * ez
    return (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2, feature, cx, cy, cz


@kernel
def _on_triangle(corners, t, x, y, z):
    """The nearest point of a triangle: squared distance, feature and point.

    The nearest of three edge points and, where it is in the triangle, of the foot of the
    perpendicular: every candidate is on the triangle, so that a bad division in a needle
    of a triangle can only lose to the others.
    """
    best = _on_edge(corners, t, 0, x, y, z)
    for k in range(1, 3):
        other = _on_edge(corners, t, k, x, y, z)
        if other[0] < best[0]:
            best = other
    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
    ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
    vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = nx * nx + ny * ny + nz * nz
    if area > 0:
        px, py, pz = x - ax, y - ay, z - az
        v = ((py * vz - pz * vy) * nx + (pz * vx - px * vz) * ny + (px * vy - py * vx) * nz) / area
        w = ((uy * pz - uz * py) * nx + (uz * px - ux * pz) * ny + (ux * py - uy * px) * nz) / area
        if v > 0 and w > 0 and v + w < 1:
            cx, cy, cz = ax + v * ux + w * vx, ay + v * uy + w * vy, az + v * uz + w * vz
            squared = (x - cx) ** 2 + (y - cy) ** 2 + (z - cz) ** 2
            if squared < best[0]:
                best = (squared, 0, cx, cy, cz)
    return best


@inlined
def _squared_distance(corners, t, x, y, z):
    """The squared distance to a triangle, by the region of it that is nearest (Ericson,
    "Real-time collision detection", 2005, section 5.1.5): at most one division.
    """
    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
    ux, uy, uz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
    vx, vy, vz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
    px, py, pz = x - ax, y - ay, z - az
    d1, d2 = ux * px + uy * py + uz * pz, vx * px + vy * py + vz * pz
    uu, uv, vv = (
        ux * ux + uy * uy + uz * uz,
        ux * vx + uy * vy + uz * vz,
        vx * vx + vy * vy + vz * vz,
    )
    d3, d4, d5, d6 = d1 - uu, d2 - uv, d1 - uv, d2 - vv
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        v, w = 0.0, 0.0
    elif d3 >= 0 and d4 <= d3:
        v, w = 1.0, 0.0
    elif d6 >= 0 and d5 <= d6:
        v, w = 0.0, 1.0
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        v, w = d1 / (d1 - d3), 0.0
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        v, w = 0.0, d2 / (d2 - d6)
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    elif va + vb + vc > 0:
        scale = 1.0 / (va + vb + vc)
        v, w = vb * scale, vc * scale
    else:  # no area
        return _on_triangle(corners, t, x, y, z)[0]
    dx, dy, dz = px - v * ux - w * vx, py - v * uy - w * vy, pz - v * uz - w * vz
    return dx * dx + dy * dy + dz * dz


@parallel_kernel
def nearest(points, corners, boxes, links, limit):
    """The nearest triangle to each point `(n, 3)`, what of it is nearest, and the point there.

    Triangles are numbered as in `corners`, and -1 where none is nearer than `limit`.
    """
    count = len(points)
    triangles = np.full(count, -1, np.int64)
    features = np.zeros(count, np.int64)
    feet = np.empty((count, 3))
    for run in numba.prange(-(-count // _RUN)):
        stack, bounds = np.empty(STACK, np.int64), np.empty(STACK)
        guess = -1
        for i in range(run * _RUN, min(count, (run + 1) * _RUN)):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            best, found = limit * limit, -1
            if guess >= 0:
                squared = _on_triangle(corners, guess, x, y, z)[0]
                if squared < best:
                    best, found = squared, guess
            stack[0], bounds[0], size = 0, 0.0, 1
            while size:
                size -= 1
                if bounds[size] >= best:
                    continue
                node = stack[size]
                if node < 0:
                    first, last = leaf_range(node)
                    for t in range(first, last):
                        squared = _squared_distance(corners, t, x, y, z)
                        if squared < best:
                            best, found = squared, t
                    continue
                one = _box_distance(boxes, node, 0, x, y, z)
                two = _box_distance(boxes, node, 1, x, y, z)
                near = 0 if one <= two else 1
                if max(one, two) < best:
                    stack[size], bounds[size] = links[node, 1 - near], max(one, two)
                    size += 1
                if min(one, two) < best:
                    stack[size], bounds[size] = links[node, near], min(one, two)
                    size += 1
            triangles[i] = found
            if found >= 0:
                guess = found
                _, features[i], feet[i, 0], feet[i, 1], feet[i, 2] = _on_triangle(
                    corners, found, x, y, z
                )
            else:
                feet[i] = np.nan
    return triangles, features, feet
