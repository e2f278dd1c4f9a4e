"""The tree of triangles against plain loops over all of them."""

from __future__ import annotations

import numpy as np
import pytest

from fields.triangle_tree import TriangleTree
from tests.fields.plain_triangles import closest_on_triangles, solid_angles


def _soup(rng, kind):
    """Triangles of one kind, `(f, 3, 3)`."""
    corners = rng.normal(size=(300, 3, 3))
    if kind == "small":
        corners = rng.uniform(-1, 1, (300, 1, 3)) + 0.1 * corners
    elif kind == "needles":
        corners[:, 2] = corners[:, 0] + rng.uniform(0, 1, (300, 1)) * (
            corners[:, 1] - corners[:, 0]
        )
        corners[:100, 2] += 1e-9 * rng.normal(size=(100, 3))
    elif kind == "points":
        corners = np.repeat(corners[:, :1], 3, axis=1)
    elif kind == "all the same":
        corners[:] = corners[0]
    elif kind == "one":
        corners = corners[:1]
    return corners


@pytest.mark.parametrize("kind", ["large", "small", "needles", "points", "all the same", "one"])
def test_the_nearest_point_is_the_nearest_of_all(kind, rng):
    corners = _soup(rng, kind)
    on_corners = corners[rng.integers(0, len(corners), 20), 1]
    points = np.concatenate([rng.uniform(-2, 2, (180, 3)), on_corners])
    triangle, feature, foot = TriangleTree(corners).nearest(points)
    repeated = np.repeat(points, len(corners), axis=0)
    candidates, _ = closest_on_triangles(repeated, np.tile(corners, (len(points), 1, 1)))
    distances = np.linalg.norm(repeated - candidates, axis=1).reshape(len(points), -1)
    found = np.linalg.norm(points - foot, axis=1)
    # Both round sums of products of coordinates below 5.
    np.testing.assert_allclose(found, distances.min(axis=1), atol=1e-14)
    again, again_feature = closest_on_triangles(points, corners[triangle])
    np.testing.assert_allclose(foot, again, atol=1e-14)
    if kind in ("large", "small"):
        np.testing.assert_array_equal(feature, again_feature)


def test_nothing_is_found_beyond_the_limit(rng):
    tree = TriangleTree(_soup(rng, "small"))
    points = rng.uniform(-2, 2, (500, 3))
    everything = tree.nearest(points)
    distance = np.linalg.norm(points - everything.point, axis=1)
    near = tree.nearest(points, limit=0.3)
    np.testing.assert_array_equal(near.triangle >= 0, distance < 0.3)
    np.testing.assert_array_equal(near.point[distance < 0.3], everything.point[distance < 0.3])
    assert np.isnan(near.point[distance >= 0.3]).all()


@pytest.mark.parametrize("kind", ["large", "small", "needles", "points"])
def test_the_winding_number_is_the_sum_of_solid_angles(kind, rng):
    corners = _soup(rng, kind)
    points = rng.uniform(-2, 2, (500, 3))
    # The worst sum for the expansion: triangles at random, whose dipoles do not cancel. Its
    # remainder is of third order in radius / distance = 1/2, summed over a few clusters.
    expected = solid_angles(points, corners)
    np.testing.assert_allclose(
        TriangleTree(corners).winding_number(points), expected, atol=0.02 * len(corners) ** 0.5
    )


def test_the_expansion_is_of_second_order(rng):
    """Seen from twice as far, the relative error of one cluster falls by 2**3 or more."""
    from fields.kernels.winding_number import _expansion, moments

    corners = np.ascontiguousarray(0.5 * _soup(rng, "large")[:3])
    tree = TriangleTree(np.concatenate([corners, corners + 9.0]))
    cluster = moments(tree._corners, tree._links)[0, 0]
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    members = tree._corners[np.abs(tree._corners).max(axis=(1, 2)) < 5]
    errors = []
    for distance in (8.0, 16.0, 32.0):
        points = cluster[:3] - distance * directions
        found = [_expansion.py_func(cluster, *(cluster[:3] - point)) for point in points]
        errors.append(np.abs(found - solid_angles(points, members)).max() * distance**2)
    assert errors[0] > 7 * errors[1] > 49 * errors[2]


def test_a_point_that_is_none_harms_no_other(rng):
    tree = TriangleTree(_soup(rng, "small"))
    points = rng.uniform(-2, 2, (100, 3))
    expected = tree.nearest(points).point
    points[[3, 50]] = np.nan
    found = tree.nearest(points)
    assert (found.triangle[[3, 50]] == -1).all()
    assert np.isnan(found.point[[3, 50]]).all()
    others = np.delete(np.arange(100), [3, 50])
    np.testing.assert_array_equal(found.point[others], expected[others])
