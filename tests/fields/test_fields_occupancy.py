"""Marked voxels as fields, against all pairs of voxels."""

from __future__ import annotations

import numpy as np
import pytest

import fields as sdf
from fields import InputError


def _distances(marks, spacing):
    """From every voxel's middle to the nearest marked voxel, as boxes; all pairs."""
    middles = np.argwhere(np.ones_like(marks))
    gaps = np.abs(middles[:, None] - np.argwhere(marks)[None]) - 0.5
    return np.linalg.norm(gaps.clip(0) * spacing, axis=-1).min(axis=1).reshape(marks.shape)


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 0.9])
@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (0.3, 2.0, 0.7)])
def test_middles_have_the_exact_distance(share, spacing, rng):
    marks = rng.random((7, 9, 6)) < share
    marks[3, 4, 2] = True
    origin = np.array([5.0, -3.0, 0.5])
    padded = np.pad(marks, 2)
    expected = np.where(padded, -_distances(~padded, spacing), _distances(padded, spacing))
    field = sdf.from_occupancy(marks, spacing=spacing, origin=origin)
    index = np.argwhere(np.ones_like(padded)) - 2
    values = field(origin + np.array(spacing) * index)
    np.testing.assert_allclose(values, expected.reshape(-1), atol=1e-12)


def test_a_box_of_voxels_is_the_box(rng):
    """Faces are at half a voxel; only its edges and corners are rounded off."""
    marks = np.zeros((12, 12, 12), bool)
    marks[2:10, 3:9, 4:8] = True
    field = sdf.from_occupancy(marks)
    true = sdf.box((8, 6, 4), center=(5.5, 5.5, 5.5))
    points = rng.uniform(1, 10, (3_000, 3))
    assert np.abs(field(points) - true(points)).max() < 0.5
    on_faces = np.array([[1.5, 5, 5], [9.5, 6.2, 5], [5, 2.5, 5.5], [5, 5, 7.5]])
    np.testing.assert_allclose(field(on_faces), 0, atol=1e-12)


def test_a_marked_voxel_at_the_wall_is_closed():
    field = sdf.from_occupancy(np.ones((1, 1, 1), bool), spacing=2.0)
    assert field([0, 0, 0]) == -1
    assert field([2.0, 0, 0]) == 1
    assert (np.abs(field.bounds) <= 4).all()


@pytest.mark.parametrize(
    ("mask", "cause"),
    [
        (np.zeros((3, 3, 3), bool), "no voxel is marked"),
        (np.ones((3, 3), bool), "three axes"),
        (np.ones((3, 3, 3)), "booleans"),
        (np.ones((0, 3, 3), bool), "three axes"),
    ],
)
def test_bad_masks_are_named(mask, cause):
    with pytest.raises(InputError, match=cause) as caught:
        sdf.from_occupancy(mask)
    assert caught.value.argument == "mask"


def test_a_spacing_of_zero_is_refused():
    with pytest.raises(InputError, match="greater than zero"):
        sdf.from_occupancy(np.ones((2, 2, 2), bool), spacing=(1, 0, 1))
