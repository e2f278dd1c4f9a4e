"""Blocks of a lattice: none is missed, and samples are the values of the whole formula."""

from __future__ import annotations

import numpy as np
import pytest

import fields as sdf
from fields import InputError
from fields.expression import X
from fields.lattice import crossed_blocks, lattice_points, sample_blocks

ORIGIN = (-2.01, -2.0, -1.97)
VOXEL = (0.13, 0.125, 0.1301)


def _grid(blocks: int, size: int) -> np.ndarray:
    axis = np.arange(blocks) * size
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _values(field: sdf.Field, corners: np.ndarray, size: int, dtype: type) -> np.ndarray:
    with sdf.back_end("numba"):
        return field(lattice_points(ORIGIN, VOXEL, corners, size, dtype))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_blocks_left_out_have_no_sample_on_the_other_side(example, dtype):
    corners = _grid(6, 5)
    values = _values(example, corners, 5, dtype)
    for level in (0.0, 0.15):
        found = sample_blocks(example, ORIGIN, VOXEL, corners, 5, level=level, dtype=dtype)
        above, below = (values > level).all(axis=1), (values < level).all(axis=1)
        assert (above | below)[~found.crossed].all()
        assert (found.bounds[:, :1] <= values).all()
        assert (values <= found.bounds[:, 1:]).all()
        np.testing.assert_array_equal(found.values[found.crossed], values[found.crossed])
        assert found.values.dtype == dtype
        np.testing.assert_array_equal(
            crossed_blocks(example, ORIGIN, VOXEL, corners, 5, level=level, dtype=dtype),
            found.crossed,
        )
        if example.exact:  # few blocks are kept for nothing: the bounds are good for something
            assert found.crossed.sum() <= 4 * (~(above | below)).sum() + 30


def _scene(rng, n: int) -> sdf.Field:
    scene = sdf.sphere(0.1)
    for i in range(n):
        part = sdf.sphere(0.15) if i % 2 else sdf.box((0.1, 0.2, 0.3)).rotate(20 * i, (1, 2, i))
        part = part.translate(rng.uniform(-1.5, 1.5, 3))
        scene = scene.union(part, smooth=0.05) if i % 5 == 0 else scene | part
    return scene.shell(0.02) - sdf.below(-1)


@pytest.mark.parametrize("size", [1, 4, 9])
def test_shorter_programs_give_the_same_bits(rng, size):
    scene = _scene(rng, 60)
    corners = rng.permutation(_grid(24 // size + 1, size))
    found = sample_blocks(scene, ORIGIN, VOXEL, corners, size)
    some = np.flatnonzero(found.crossed)[:100]
    np.testing.assert_array_equal(
        found.values[some], _values(scene, corners[some], size, np.float32)
    )
    others = np.flatnonzero(~found.crossed)[:100]
    values = _values(scene, corners[others], size, np.float32)
    assert ((values > 0).all(axis=1) | (values < 0).all(axis=1)).all()


def test_results_do_not_depend_on_order_or_threads(rng, monkeypatch):
    scene = _scene(rng, 20)
    corners = _grid(8, 4)
    found = sample_blocks(scene, ORIGIN, VOXEL, corners, 4)
    order = rng.permutation(len(corners))
    other = sample_blocks(scene, ORIGIN, VOXEL, corners[order], 4)
    np.testing.assert_array_equal(other.bounds, found.bounds[order])
    np.testing.assert_array_equal(other.crossed, found.crossed[order])
    monkeypatch.setattr("numba.get_num_threads", lambda: 4)
    again = sample_blocks(scene, ORIGIN, VOXEL, corners, 4)
    np.testing.assert_array_equal(again.bounds, found.bounds)
    np.testing.assert_array_equal(again.values[again.crossed], found.values[found.crossed])


def test_a_field_with_an_oracle_takes_the_same_blocks():
    """The identity as an oracle: bounds are hardly looser, values the same."""
    base = sdf.sphere(1) & sdf.box(1.5)
    warped = base.remap(lambda p: p * 1.0, lipschitz=1.0)
    corners = _grid(8, 4)
    plain = sample_blocks(base, ORIGIN, VOXEL, corners, 4)
    found = sample_blocks(warped, ORIGIN, VOXEL, corners, 4)
    assert found.crossed[plain.crossed & (plain.values.min(axis=1) < 0)].all()
    both = plain.crossed & found.crossed
    np.testing.assert_array_equal(found.values[both], plain.values[both])
    assert found.crossed.sum() < 2 * plain.crossed.sum()


def test_blocks_may_be_anywhere_and_overlap():
    field = sdf.sphere(1)
    corners = np.array([[3, -7, 2], [3, -7, 2], [4, -7, 2], [1000, 5, 5], [-3, 8, 8]])
    found = sample_blocks(field, (0.0, 1.0, 0.0), 0.1, corners, 6)
    assert found.crossed.tolist() == [True, True, True, False, False]
    np.testing.assert_array_equal(found.values[0], found.values[1])
    assert found.values[0, 0] == field(lattice_points((0, 1, 0), 0.1, corners, 6, np.float32))[0, 0]


def test_no_blocks_a_plane_and_a_constant():
    none = np.zeros((0, 3), np.int64)
    assert crossed_blocks(sdf.sphere(1), ORIGIN, VOXEL, none, 4).shape == (0,)
    assert sample_blocks(sdf.sphere(1), ORIGIN, VOXEL, none, 4).values.shape == (0, 125)
    warped = sdf.sphere(1).remap(lambda p: p * 1.0, lipschitz=1.0)
    assert crossed_blocks(warped, ORIGIN, VOXEL, none, 4).shape == (0,)
    corners = _grid(3, 4)
    for field in (sdf.Field(X), sdf.Field(X - X)):
        found = sample_blocks(field, ORIGIN, VOXEL, corners, 4)
        values = _values(field, corners, 4, np.float32)
        np.testing.assert_array_equal(found.values[found.crossed], values[found.crossed])
        assert found.crossed[((values <= 0).any(axis=1)) & (values >= 0).any(axis=1)].all()


def test_a_surface_far_from_the_origin_is_not_lost():
    """Where float32 resolves 0.03: rounding is bounded too, so no change of sign is left out."""
    field = sdf.sphere(40.0, (500_000.0, 0, 0))
    corners = _grid(10, 8)
    origin = (499_950.0, -50.0, -50.0)
    values = field(lattice_points(origin, 1.25, corners, 8, np.float32))
    crossed = crossed_blocks(field, origin, 1.25, corners, 8)
    assert crossed[(values.min(axis=1) <= 0) & (values.max(axis=1) >= 0)].all()


@pytest.mark.parametrize(
    ("change", "argument"),
    [
        ({"corners": [[0, 0]]}, "corners"),
        ({"corners": [[0.5, 0, 0]]}, "corners"),
        ({"size": 0}, "size"),
        ({"size": 2.5}, "size"),
        ({"voxel": -1}, "voxel"),
        ({"origin": (0, 0)}, "origin"),
        ({"level": float("nan")}, "level"),
        ({"dtype": np.float16}, "dtype"),
    ],
)
def test_bad_arguments_are_named(change, argument):
    given = {"origin": (0, 0, 0), "voxel": 0.1, "corners": [[0, 0, 0]], "size": 4} | change
    with pytest.raises(InputError) as caught:
        sample_blocks(sdf.sphere(1), **given)
    assert caught.value.argument == argument
