"""Distances and solid angles of triangles in plain numpy, to test the tree against."""

from __future__ import annotations

import numpy as np


def closest_on_triangles(points, corners):
    """Nearest points of n triangles to n points, and what they lie on; vectorised, and written
    differently from the kernel: the best of three edges and of the foot of the perpendicular."""
    best, feature = np.empty_like(points), np.zeros(len(points), dtype=np.int64)
    least = np.full(len(points), np.inf)
    for k in range(3):
        start, end = corners[:, k], corners[:, (k + 1) % 3]
        edge = end - start
        squared = np.einsum("ij,ij->i", edge, edge)
        along = np.einsum("ij,ij->i", points - start, edge)
        t = np.clip(along / np.where(squared > 0, squared, 1.0), 0.0, 1.0)
        candidate = np.where(t[:, None] < 1, start + t[:, None] * edge, end)
        distance = np.linalg.norm(points - candidate, axis=1)
        nearer = distance < least
        best[nearer], least[nearer] = candidate[nearer], distance[nearer]
        on = np.where(t <= 0, 4 + k, np.where(t >= 1, 4 + (k + 1) % 3, 1 + k))
        feature[nearer] = on[nearer]
    origin = corners[:, 0]
    first, second = corners[:, 1] - origin, corners[:, 2] - origin
    cross = np.cross(first, second)
    area = np.einsum("ij,ij->i", cross, cross)
    scale = np.where(area > 0, area, np.inf)
    v = np.einsum("ij,ij->i", np.cross(points - origin, second), cross) / scale
    w = np.einsum("ij,ij->i", np.cross(first, points - origin), cross) / scale
    foot = origin + v[:, None] * first + w[:, None] * second
    inside = (v > 0) & (w > 0) & (v + w < 1)
    inside &= np.linalg.norm(points - foot, axis=1) < least
    best[inside], feature[inside] = foot[inside], 0
    return best, feature


def solid_angles(points, corners):
    """The sum over all triangles, over 4 pi (van Oosterom and Strackee 1983)."""
    total = np.zeros(len(points))
    for triangle in corners:
        a, b, c = (corner - points for corner in triangle)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        numerator = np.einsum("ij,ij->i", a, np.cross(b, c))
        denominator = (
            la * lb * lc
            + np.einsum("ij,ij->i", a, b) * lc
            + np.einsum("ij,ij->i", b, c) * la
            + np.einsum("ij,ij->i", c, a) * lb
        )
        total += 2 * np.arctan2(numerator, denominator)
    return total / (4 * np.pi)
