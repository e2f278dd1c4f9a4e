"""Exact Euclidean distances to a set of voxels, axis by axis.

The squared distance to a set of boxes is a minimum of sums, one term an axis, so it can be
minimised along one axis after the other. The lower envelope of parabolas along a line takes time
linear in its length (Felzenszwalb and Huttenlocher, "Distance transforms of sampled functions",
2012). A voxel is a box, not a point: the point of it nearest to another voxel's middle is, on each
axis, its own middle or one of its two faces, so parabolas stand on faces as well.
"""

from __future__ import annotations

import numba
import numpy as np

from fields.jit import kernel, parallel_kernel


@kernel
def _along(cost, spacing, result, at, height, sites):
    """Along one line: the least of cost[q] + (distance of the middle of p to voxel q)^2.

    Lengths are counted in halves of the spacing: faces are at even numbers, middles at odd ones.
    """
    count = len(cost)
    unit = 0.25 * spacing * spacing
    top = -1  # of the parabolas of the envelope; sites[i] is where parabola i begins to be least
    for s in range(2 * count + 1):
        q = s // 2
        before, after = (q, q) if s % 2 else (max(q - 1, 0), min(q, count - 1))
        value = min(cost[before], cost[after])
        if value == np.inf:
            continue
        begin = -np.inf
        while top >= 0:
            meet = (value - height[top]) / unit + float(s * s - at[top] * at[top])
            begin = meet / (2.0 * (s - at[top]))
            if begin > sites[top]:
                break
            top -= 1
            begin = -np.inf
        top += 1
        at[top], height[top], sites[top] = s, value, begin
    if top < 0:
        result[:] = np.inf
        return
    now = 0
    for p in range(count):
        x = 2 * p + 1
        while now < top and sites[now + 1] <= x:
            now += 1
        result[p] = height[now] + unit * (x - at[now]) ** 2


@parallel_kernel
def squared_distances(voxels, spacing):
    """From the middle of each voxel to the nearest voxel of the set, closed boxes; `(x, y, z)`.

    Infinite everywhere if the set is empty.
    """
    nx, ny, nz = voxels.shape
    longest = 2 * max(nx, ny, nz) + 1
    squared = np.empty(voxels.shape)
    for i in numba.prange(nx):
        at, height, sites = np.empty(longest, np.int64), np.empty(longest), np.empty(longest)
        cost, line = np.empty(max(ny, nz)), np.empty(max(ny, nz))
        for j in range(ny):
            for k in range(nz):
                cost[k] = 0.0 if voxels[i, j, k] else np.inf
            _along(cost[:nz], spacing[2], squared[i, j], at, height, sites)
        for k in range(nz):
            cost[:ny] = squared[i, :, k]
            _along(cost[:ny], spacing[1], line[:ny], at, height, sites)
            squared[i, :, k] = line[:ny]
    for j in numba.prange(ny):
        at, height, sites = np.empty(longest, np.int64), np.empty(longest), np.empty(longest)
        cost, line = np.empty(nx), np.empty(nx)
        for k in range(nz):
            cost[:] = squared[:, j, k]
            _along(cost, spacing[0], line, at, height, sites)
            squared[:, j, k] = line
    return squared
