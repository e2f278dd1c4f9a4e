"""Grids of samples as fields: interpolation, bounds and what lies beyond."""

from __future__ import annotations

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields.grid_oracle import GridOracle
from tests.fields.catalogue.leaves import NOISE, TORUS, sampled

SPACING, ORIGIN = np.array([0.4, 0.5, 0.3]), np.array([-1.0, -1.0, -0.8])
BOX = np.stack([ORIGIN, ORIGIN + SPACING * (np.array(NOISE.shape) - 1)])
KINDS = pytest.mark.parametrize("kind", ["linear", "cubic"])


def _noise(kind, **options):
    return sdf.grid(NOISE, spacing=SPACING, origin=ORIGIN, interpolation=kind, **options)


def _oracle(field) -> GridOracle:
    return next(i.payload for i in field.tape.instructions if isinstance(i.payload, GridOracle))


def _trilinear(points):
    """The eight samples around each point, weighted; one point after the other."""
    values = []
    for t in (points - ORIGIN) / SPACING:
        cell = np.minimum(np.floor(t), np.array(NOISE.shape) - 2).astype(int)
        u = t - cell
        values.append(
            sum(
                NOISE[tuple(cell + corner)] * np.where(corner, u, 1 - u).prod()
                for corner in np.ndindex(2, 2, 2)
            )
        )
    return np.array(values)


def test_linear_interpolation_is_the_weighted_mean_of_eight(rng):
    points = rng.uniform(*BOX, (300, 3))
    np.testing.assert_allclose(_noise("linear")(points), _trilinear(points), atol=1e-14)


def test_cubic_interpolation_is_scipys_spline(rng):
    """Along one axis after the other, by a library that writes splines in another way."""
    interpolate = pytest.importorskip("scipy.interpolate", reason="the independent spline")
    points = rng.uniform(*BOX, (200, 3))
    axes = [o + s * np.arange(n) for o, s, n in zip(ORIGIN, SPACING, NOISE.shape, strict=True)]
    planes = interpolate.make_interp_spline(axes[0], NOISE, k=3)(points[:, 0])
    expected = []
    for plane, (_, y, z) in zip(planes, points, strict=True):
        line = interpolate.make_interp_spline(axes[1], plane, k=3)(y)
        expected.append(interpolate.make_interp_spline(axes[2], line, k=3)(z))
    np.testing.assert_allclose(_noise("cubic")(points), expected, atol=1e-12)


@KINDS
def test_samples_are_met(kind):
    index = np.argwhere(np.ones(NOISE.shape, bool))
    values = _noise(kind)(ORIGIN + SPACING * index)
    np.testing.assert_allclose(values, NOISE.reshape(-1), atol=1e-13)


@pytest.mark.parametrize(("kind", "degree"), [("linear", 1), ("cubic", 3)])
def test_polynomials_are_reproduced_up_to_the_walls(kind, degree, rng):
    """One of the degree along each axis."""
    factors = rng.normal(size=(3, degree + 1))

    def product(points):
        return np.prod([np.polyval(f, x) for f, x in zip(factors, points.T, strict=True)], axis=0)

    lattice = np.stack(np.meshgrid(*[np.linspace(-1, 1, 6)] * 3, indexing="ij"), axis=-1)
    values = product(lattice.reshape(-1, 3)).reshape(6, 6, 6)
    field = sdf.grid(values, bounds=((-1,) * 3, (1,) * 3), interpolation=kind)
    points = rng.uniform(-1, 1, (500, 3))
    np.testing.assert_allclose(field(points), product(points), atol=1e-11)


@pytest.mark.parametrize(("kind", "order"), [("linear", 2), ("cubic", 4)])
def test_the_error_falls_at_the_declared_order(kind, order, rng):
    def wave(points):
        return np.sin(1.3 * points[..., 0]) * np.cos(points[..., 1]) + np.sin(points.sum(axis=-1))

    points = rng.uniform(-1, 1, (4_000, 3))
    errors = []
    for count in (9, 17, 33):
        lattice = np.stack(np.meshgrid(*[np.linspace(-1, 1, count)] * 3, indexing="ij"), axis=-1)
        field = sdf.grid(wave(lattice), bounds=((-1,) * 3, (1,) * 3), interpolation=kind)
        errors.append(np.abs(field(points) - wave(points)).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, order, atol=0.35)


@KINDS
def test_the_compiled_loop_and_torch_agree(kind, rng):
    oracle = _oracle(_noise(kind))
    points = torch.from_numpy(rng.uniform(BOX[0] - 0.1, BOX[1] + 0.1, (500, 3)))
    np.testing.assert_allclose(oracle(points)[:, 0], oracle._in_torch(points), atol=1e-13)
    single = oracle._in_torch(points.float())
    assert single.dtype == torch.float32
    np.testing.assert_allclose(oracle(points.float())[:, 0], single, atol=1e-5)


@KINDS
def test_gradients_pass_gradcheck_to_second_order(kind, rng):
    field = _noise(kind)
    # Around the middles of cells, where a finite difference crosses no face; and beyond the box.
    inside = ORIGIN + SPACING * (rng.integers(0, 4, (4, 3)) + rng.uniform(0.3, 0.7, (4, 3)))
    points = torch.tensor(np.concatenate([inside, [[2.0, 0.1, 0.2], [-2.1, 3.0, 0.3]]]))
    points.requires_grad_()
    assert torch.autograd.gradcheck(field.evaluate, points)
    assert torch.autograd.gradgradcheck(field.evaluate, points)


def test_cubic_splines_have_two_continuous_derivatives():
    field = _noise("cubic")
    y, z = 0.13, 0.21
    across = ORIGIN[0] + SPACING[0] * np.arange(1, 5)

    def second(x):
        points = torch.tensor([[v, y, z] for v in x], dtype=torch.float64, requires_grad=True)
        (slope,) = torch.autograd.grad(field(points).sum(), points, create_graph=True)
        (curvature,) = torch.autograd.grad(slope[:, 0].sum(), points)
        return slope[:, 0].detach().numpy(), curvature[:, 0].numpy()

    for before, after in zip(second(across - 1e-9), second(across + 1e-9), strict=True):
        np.testing.assert_allclose(before, after, atol=1e-5)  # third derivative times 2e-9


def test_the_linear_lipschitz_bound_is_attained_at_a_corner_of_a_cell():
    cells = np.argwhere(np.ones(np.array(NOISE.shape) - 1, bool))
    corners = np.array(list(np.ndindex(2, 2, 2)))
    near = cells[:, None] + np.where(corners, 1 - 1e-9, 1e-9)
    slopes = np.linalg.norm(_noise("linear").gradient(ORIGIN + SPACING * near), axis=-1)
    assert slopes.max() == pytest.approx(_oracle(_noise("linear")).steepest, rel=1e-6)


def test_the_cubic_lipschitz_bound_is_not_much_above_the_slopes_seen(rng):
    points = rng.uniform(-1.5, 1.5, (50_000, 3))
    wave = sdf.from_function(lambda p: torch.sin(2 * p[..., 0]) * torch.cos(p[..., 1] + p[..., 2]))
    for field, factor in (
        (_noise("cubic"), 3.0),
        (sampled(wave, (21,) * 3, interpolation="cubic"), 1.1),
    ):
        seen = np.linalg.norm(field.gradient(points), axis=1).max()
        assert seen <= _oracle(field).steepest < factor * seen


@KINDS
def test_of_a_distance_the_slope_is_hardly_more_than_one(kind):
    """A plane is met exactly; around a torus only its core and medial axis bend the samples."""
    plane = sampled(sdf.plane((1, 2, -2)), (8, 9, 10), interpolation=kind)
    slope = _oracle(plane).steepest
    # For the cubic, each component is bounded by itself, but here all three are constant.
    assert slope == pytest.approx(1, abs=1e-9)


@KINDS
@pytest.mark.parametrize("size", [0.01, 0.3, 2.0, 9.0])
def test_boxes_are_enclosed(kind, size, rng):
    oracle = _oracle(_noise(kind))
    low = rng.uniform(BOX[0], BOX[1], (300, 3))
    high = np.minimum(low + rng.uniform(0, size, (300, 3)), BOX[1])
    bounds = oracle.enclose(np.stack([low, high], axis=1))
    assert bounds.shape == (300, 1, 2)
    points = low[:, None] + rng.uniform(0, 1, (300, 60, 3)) * (high - low)[:, None]
    values = oracle(torch.from_numpy(points))[..., 0].numpy()
    assert (values >= bounds[:, :1, 0]).all()
    assert (values <= bounds[:, :1, 1]).all()


def test_enclosures_of_single_cells_are_the_samples_of_their_corners(rng):
    oracle = _oracle(_noise("linear"))
    cells = rng.integers(0, np.array(NOISE.shape) - 1, (50, 3))
    low = ORIGIN + SPACING * (cells + 0.1)
    bounds = oracle.enclose(np.stack([low, low + 0.8 * SPACING], axis=1))[:, 0]
    for cell, (least, most) in zip(cells, bounds, strict=True):
        corners = NOISE[tuple(slice(c, c + 2) for c in cell)]
        np.testing.assert_allclose((least, most), (corners.min(), corners.max()), atol=1e-11)


def test_enclosures_of_many_cells_are_not_much_wider(rng):
    """Blocks of half the width are looked up, three an axis: at most one too many on each side."""
    values = rng.normal(size=(40, 40, 40)).cumsum(axis=0)
    oracle = GridOracle(values, np.zeros(3), np.ones(3), 1)
    for low, high in ((3, 20), (11, 12), (0, 39), (30, 38)):
        least, most = oracle.enclose(np.array([[[low + 0.5] * 3, [high - 0.5] * 3]]))[0, 0]
        wide = (slice(max(low - 8, 0), high + 9),) * 3
        assert values[wide].min() - 1e-9 <= least <= values[(slice(low, high + 1),) * 3].min()
        assert values[(slice(low, high + 1),) * 3].max() <= most <= values[wide].max() + 1e-9


# --- beyond the box ---


@KINDS
def test_beyond_the_box_it_goes_on_as_stated(kind, rng):
    points = rng.uniform(-4, 4, (3_000, 3))
    nearest = np.clip(points, *BOX)
    away = np.linalg.norm(points - nearest, axis=1)
    value = _noise(kind)(nearest)
    expected = np.where(value > 0, np.hypot(value, away), value + away)
    expected[away == 0] = value[away == 0]
    np.testing.assert_allclose(_noise(kind)(points), expected, atol=1e-12)
    np.testing.assert_allclose(_noise(kind, outside="clamp")(points), value, atol=1e-12)


def test_beyond_the_box_a_distance_stays_a_lower_bound(rng):
    """The nearest point of the surface is in the box, so the angle at the wall is obtuse."""
    ball = sdf.sphere(0.8, (0.2, 0, 0))
    field = sampled(ball, (41, 41, 41), half=1.0)
    points = rng.uniform(-6, 6, (5_000, 3))
    outside = np.abs(points).max(axis=1) > 1
    ratio = field(points[outside]) / ball(points[outside])
    # Samples of a convex function: interpolation is above it, by h^2 / (8 * 0.8) * 3 or less.
    assert ratio.max() < 1 + 3 * 0.05**2
    assert ratio.min() > 0.7


def test_tags_of_a_shape_within_its_box():
    field = sampled(TORUS, (31, 31, 31))
    assert not field.exact
    assert 1 <= field.lipschitz < 1.75
    step = 0.1
    low, high = field.bounds
    true = TORUS.bounds
    assert (low >= true[0].clip(-1.5) - 2 * step - 1e-9).all()
    assert (high <= true[1].clip(max=1.5) + 2 * step + 1e-9).all()


def test_clamped_grids_are_bounded_only_if_their_walls_are_outside():
    assert _noise("linear", outside="clamp").bounds is None
    closed = sampled(sdf.sphere(1.0), (9, 9, 9), outside="clamp")
    assert np.abs(closed.bounds).max() <= 1.5
    assert closed.offset(0.1).bounds is None  # level sets may reach the walls, and then beyond


def test_a_grid_without_an_inside_is_empty():
    field = sdf.grid(np.ones((4, 4, 4)), spacing=1.0)
    assert (np.ptp(field.bounds, axis=0) == 0).any()


# --- arguments ---


def test_bounds_and_spacing_say_the_same():
    a = sdf.grid(NOISE, bounds=BOX)
    points = np.random.default_rng(1).uniform(-2, 2, (100, 3))
    np.testing.assert_allclose(a(points), _noise("linear")(points), atol=1e-12)


def test_samples_are_copied():
    values = NOISE.copy()
    field = sdf.grid(values, spacing=1.0)
    before = field([1.0, 2.0, 3.0])
    values[:] = 7
    assert field([1.0, 2.0, 3.0]) == before


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int16, np.uint8, ">f4"])
def test_numbers_of_any_kind_are_samples(dtype):
    values = np.arange(27).reshape(3, 3, 3).astype(dtype)
    field = sdf.grid(values, spacing=1.0)
    assert field([1.0, 1.0, 0.5]) == 12.5
    kept = np.float32 if np.dtype(dtype).kind == "f" and np.dtype(dtype).itemsize <= 4 else float
    assert _oracle(field).samples.dtype == kept


HOLED = NOISE.copy()
HOLED[2, 3, 4] = np.nan


@pytest.mark.parametrize(
    ("values", "options", "argument", "cause"),
    [
        (HOLED, {}, "values", r"1 of 210 samples .*, the first at index \(2, 3, 4\)"),
        (NOISE * np.inf, {}, "values", "210 of 210"),
        (NOISE[0], {}, "values", "three axes"),
        (NOISE[None], {}, "values", "three axes"),
        (NOISE[:1], {}, "values", "2 samples along each axis"),
        (NOISE[:3], {"interpolation": "cubic"}, "values", "4 samples along each axis"),
        (NOISE[:0], {}, "values", "2 samples"),
        (NOISE + 1j, {}, "values", "real numbers"),
        (NOISE > 0, {}, "values", "marks"),
        ([[["a"]]], {}, "values", "real numbers"),
        ([[[1, 2], [3]]], {}, "values", "real numbers"),
        (NOISE, {"interpolation": "nearest"}, "interpolation", "no such choice"),
        (NOISE, {"outside": "wrap"}, "outside", "no such choice"),
        (NOISE, {"spacing": None}, "spacing", "either by spacing or by bounds"),
        (NOISE, {"bounds": BOX}, "spacing", "either by spacing or by bounds"),
        (NOISE, {"spacing": (1, 0, 1)}, "spacing", "greater than zero"),
        (NOISE, {"spacing": (1, 1)}, "spacing", "three numbers"),
        (NOISE, {"origin": (0, 0, np.nan)}, r"origin[2]", "finite"),
        (NOISE, {"spacing": None, "bounds": ((0, 0, 0), (1, 1, 0))}, "bounds", "no volume"),
        (NOISE, {"spacing": None, "bounds": ((0, 0, 0),)}, "bounds", "two rows"),
    ],
)  # fmt: skip
def test_bad_arguments_are_named(values, options, argument, cause):
    with pytest.raises(InputError, match=cause) as caught:
        sdf.grid(values, **{"spacing": 1.0, **options})
    assert caught.value.argument == argument
