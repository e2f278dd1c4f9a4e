"""The compiled evaluator beside torch: the same numbers, whatever the field and the points."""

from __future__ import annotations

import gc

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields import expression as ex
from fields.evaluators.choice import WORTHWHILE, runs_compiled
from fields.evaluators.compiled import CHUNK
from fields.expression import OPERATIONS, X, Y, Z
from fields.oracle import FunctionOracle
from tests.fields.random_expressions import all_finite, random_expression

DTYPES = (np.float32, np.float64)


def _both(field: sdf.Field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values by torch and by the compiled evaluator."""
    with sdf.back_end("torch"):
        expected = field(points)
    with sdf.back_end("numba"):
        return expected, field(points)


def _point_boxes(points: np.ndarray) -> np.ndarray:
    return np.stack([points, points], axis=1).astype(np.float64)


# --- agreement ---


@pytest.mark.parametrize("dtype", DTYPES)
def test_both_evaluators_are_within_the_bounds_of_rounding(example, cloud, dtype):
    points = cloud[::20].astype(dtype)
    torch_values, values = _both(example, points)
    assert values.dtype == dtype
    # Both are within `rounding` of the exact value, so within twice that of each other.
    bound = 2 * example.rounding(_point_boxes(points), dtype)
    if example.tape.calls_oracles:  # which may have told nothing about themselves
        bound = np.minimum(bound, 400 * np.finfo(dtype).eps)
    assert (np.abs(values - torch_values) <= bound).all()


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("oracles", [False, True])
def test_random_expressions_agree_within_the_bounds_of_rounding(rng, dtype, oracles):
    sharp = 0
    for _ in range(40):
        field = sdf.Field(random_expression(rng, int(rng.integers(1, 60)), oracles=oracles))
        points = rng.uniform(-2, 2, (50, 3)).astype(dtype)
        torch_values, values = _both(field, points)
        bounds = field.enclose(_point_boxes(points), dtype)
        known = all_finite(field.expression, torch.from_numpy(points))
        known &= np.isfinite(bounds).all(axis=1)
        for found in (torch_values, values):
            assert (bounds[known, 0] <= found[known]).all()
            assert (found[known] <= bounds[known, 1]).all()
        width = (bounds[known, 1] - bounds[known, 0]) / (1 + np.abs(values[known]))
        # An oracle enclosed by its Lipschitz bound allows 1e-9 for its rounding, and that grows.
        sharp += (width < max(1e4 * np.finfo(dtype).eps, 1e-5 * oracles)).sum()
    assert sharp > 40 * 50 / 2


SPECIAL = [0.0, -0.0, 1.0, -1.0, 0.5, -2.5, 3.0, 1e-40, -1e-40, 1e30, -1e30, 5e5, 2e6, 3e7]
SPECIAL += [np.inf, -np.inf, np.nan]


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_treats_special_values_as_torch_does(name, dtype):
    """With arguments in registers and as constants; signs of zeros apart."""
    arity = OPERATIONS[name].arity
    grid = np.stack(np.meshgrid(*[np.array(SPECIAL, dtype)] * 3, indexing="ij"), -1).reshape(-1, 3)
    points = torch.from_numpy(grid)
    forms = [ex.apply(name, *(X, Y, Z)[:arity])]
    if arity > 1:
        forms += [
            ex.apply(name, X, *(1.5,) * (arity - 1)),
            ex.apply(name, -2.0, *(Y, Z)[: arity - 1]),
        ]
    for form in forms:
        field = sdf.Field(form)
        with sdf.back_end("torch"):
            expected = field.evaluate(points)
        with sdf.back_end("numba"):
            found = field.evaluate(points)
        # Elementary functions and torch's sqrt: 2 and 1 units in the last place, each.
        eps = torch.finfo(points.dtype).eps
        torch.testing.assert_close(
            found, expected, rtol=4 * eps, atol=torch.finfo(points.dtype).tiny, equal_nan=True
        )


def test_arithmetic_is_the_same_bits(rng):
    """Of what torch itself computes exactly rounded: everything but elementary functions."""
    points = rng.uniform(-2, 2, (2_000, 3))
    shape = X * Y + abs(Z) / (2.5 + ex.square(X)) - ex.floor(3 * Y) * 0.1
    shape = ex.minimum(shape, ex.where_negative(Z, X - 0.3, 0.7 - Y), ex.maximum(-X, 0.2))
    for dtype in DTYPES:
        np.testing.assert_array_equal(*_both(sdf.Field(shape), points.astype(dtype)))


# --- gradients ---


@pytest.mark.parametrize("dtype", DTYPES)
def test_gradients_are_those_of_autograd(example, cloud, dtype):
    points = cloud[::20].astype(dtype)
    with sdf.back_end("torch"):
        values, expected = example.value_and_gradient(points)
    with sdf.back_end("numba"):
        found_values, found = example.value_and_gradient(points)
        if not example.tape.calls_oracles:  # theirs may differ where they keep a graph
            np.testing.assert_array_equal(found_values, example(points))
    assert found.dtype == dtype
    # Gradients of catalogue fields are sums of ten or so products of numbers of size 1, except
    # near creases, where a rounding decides the side: those few points may differ.
    error = np.abs(found - expected).max(axis=1)
    eps = np.finfo(dtype).eps
    assert np.mean(error > 100 * eps) < 0.01
    np.testing.assert_allclose(found_values, values, rtol=0, atol=200 * eps)


@pytest.mark.parametrize("oracles", [False, True])
def test_gradients_of_random_expressions_are_those_of_autograd(rng, oracles):
    agreeing = 0
    for _ in range(40):
        root = random_expression(rng, int(rng.integers(1, 30)), oracles=oracles, smooth=True)
        field = sdf.Field(root)
        points = rng.uniform(-2, 2, (50, 3))
        with sdf.back_end("torch"):
            expected = field.gradient(points)
        with sdf.back_end("numba"):
            found = field.gradient(points)
        # Ill-conditioned points are told apart by how much the gradient itself moves within
        # 1e-13: what rounding of the intermediate values can do as well.
        with sdf.back_end("torch"):
            moved = field.gradient(points + 1e-13)
        scale = 1 + np.abs(expected).max(axis=1)
        stable = np.isfinite(expected).all(axis=1) & (
            np.abs(moved - expected).max(axis=1) < 1e-9 * scale
        )
        error = np.abs(found - expected).max(axis=1)[stable] / scale[stable]
        assert (error < 1e-8).all()
        agreeing += stable.sum()
    assert agreeing > 40 * 50 / 2


@pytest.mark.parametrize(
    ("form", "point", "value", "gradient"),
    [
        (ex.length(X, Y, Z), (0, 0, 0), 0, (0, 0, 0)),
        (ex.sqrt(X), (-1, 0, 0), 0, (0, 0, 0)),
        (abs(X), (0, 1, 1), 0, (0, 0, 0)),
        (ex.floor(X), (1.5, 0, 0), 1, (0, 0, 0)),
        (ex.log(X), (-1, 0, 0), np.log(np.finfo(np.float64).tiny), (0, 0, 0)),
        (ex.power(X, Y), (-1, 2, 0), 0, (0, 0, 0)),
        (ex.power(X, Y), (2, 0, 0), 1, (0, np.log(2), 0)),
        (ex.atan2(Y, X), (0, 0, 0), 0, (0, 0, 0)),
        (ex.minimum(X, Y), (1, 1, 0), 1, (0.5, 0.5, 0)),
        (ex.maximum(X, Y), (1, 1, 0), 1, (0.5, 0.5, 0)),
        (ex.where_negative(Z, X, Y), (3, 4, 0), 4, (0, 1, 0)),
        (ex.where_negative(Z, X, Y), (3, 4, -1), 3, (1, 0, 0)),
    ],
)
def test_derivatives_where_none_exist_are_those_of_the_table(form, point, value, gradient):
    for name in ("torch", "numba"):
        with sdf.back_end(name):
            found = sdf.Field(form).value_and_gradient(np.array([point], dtype=float))
        assert found[0].item() == pytest.approx(value, rel=1e-15)
        np.testing.assert_allclose(found[1][0], gradient, rtol=1e-15)


# --- independence of everything but the point ---


@pytest.mark.parametrize("count", [0, 1, 7, 511, 513, 3 * 512])
def test_any_number_of_points(count, rng):
    field = sdf.sphere(1) & sdf.box(1.5)
    points = rng.uniform(-1, 1, (count, 3))
    torch_values, values = _both(field, points)
    assert values.shape == (count,)
    np.testing.assert_allclose(values, torch_values, rtol=0, atol=1e-15)
    with sdf.back_end("numba"):
        assert field.gradient(points).shape == (count, 3)


def test_a_value_depends_on_its_point_alone(rng, monkeypatch):
    field = sdf.Field(random_expression(rng, 40, oracles=True) + ex.sin(1e6 * X))
    points = rng.uniform(-2, 2, (40_000, 3)).astype(np.float32)
    order = rng.permutation(len(points))
    with sdf.back_end("numba"):
        values = field(points)
        slopes = field.gradient(points)
        np.testing.assert_array_equal(field(points[order]), values[order])
        np.testing.assert_array_equal(field(points[:5]), values[:5])
        monkeypatch.setattr("numba.get_num_threads", lambda: 3)
        np.testing.assert_array_equal(field(points), values)
        np.testing.assert_array_equal(field.gradient(points), slopes)
        monkeypatch.setattr("fields.evaluators.compiled.CHUNK", 1_000)
        np.testing.assert_array_equal(field(points), values)
        np.testing.assert_array_equal(field.gradient(points), slopes)


def test_points_of_any_layout(rng):
    field = sdf.torus(1, 0.3)
    base = torch.from_numpy(rng.uniform(-2, 2, (6, 4, 5, 3)))
    layouts = [base, base[::2, 1:, ::3], base.movedim(-1, 0).contiguous().movedim(0, -1)]
    layouts += [base[0, 0, 0], base[:0], base.expand(2, 6, 4, 5, 3)]
    for points in layouts:
        with sdf.back_end("torch"):
            expected = field(points)
        with sdf.back_end("numba"):
            assert field(points).shape == points.shape[:-1]
            torch.testing.assert_close(field(points), expected)
            assert field.gradient(points).shape == points.shape


def test_a_constant_field_and_a_coordinate():
    points = np.random.default_rng(0).normal(size=(5, 3))
    with sdf.back_end("numba"):
        assert sdf.Field(ex.constant(2.5))(points).tolist() == [2.5] * 5
        assert (sdf.Field(ex.constant(2.5)).gradient(points) == 0).all()
        np.testing.assert_array_equal(sdf.Field(Y)(points), points[:, 1])
        np.testing.assert_array_equal(sdf.Field(Y).gradient(points), [[0, 1, 0]] * 5)


# --- size ---


def test_tapes_of_ten_thousand_operations():
    united = nested = sdf.sphere(1)
    for i in range(2_000):
        united = united | sdf.sphere(0.5, (i * 1e-3, 0, 0))
        nested = (nested - sdf.below(-2)).offset(1e-5)
    deep = X
    for i in range(10_000):
        deep = ex.sin(deep * 1.25) if i % 2 else deep + 0.25
    points = np.random.default_rng(0).uniform(-2, 2, (20, 3))
    for field in (united, nested, sdf.Field(deep)):
        assert len(field.tape) >= 4_000
        torch_values, values = _both(field, points)
        np.testing.assert_allclose(values, torch_values, rtol=0, atol=1e-9)
        assert field.enclose(_point_boxes(points)).shape == (20, 2)
    del field, deep, nested, united
    gc.collect()


def test_registers_are_used_again():
    """A chain of unions needs a few registers however long it is, so blocks stay in the cache."""
    field = sdf.sphere(1)
    for i in range(500):
        field = field | sdf.sphere(0.5, (i, 0, 0))
    (machine,) = field.tape.compiled.machines
    assert machine.registers < 12


# --- oracles ---


def test_an_oracle_is_called_once_for_each_chunk(monkeypatch):
    calls = []

    def twice(points: torch.Tensor) -> torch.Tensor:
        calls.append(len(points))
        return 2 * points

    base = sdf.sphere(1) & sdf.box(1.5)
    warped = base.remap(twice, lipschitz=2)
    scene = (warped | warped.offset(0.1)).union(warped.translate((1, 0, 0)), smooth=0.1)
    points = np.random.default_rng(0).normal(size=(1_000, 3))
    with sdf.back_end("numba"):
        values = scene(points)
        assert calls == [1_000, 1_000]  # at two places
        calls.clear()
        monkeypatch.setattr("fields.evaluators.compiled.CHUNK", 600)
        np.testing.assert_array_equal(scene(points), values)
    assert calls == [600, 600, 400, 400]


def test_oracles_that_feed_oracles():
    shift = FunctionOracle(lambda p: p + torch.sin(p.roll(1, -1)), "shift", outputs=3)
    x, y, _ = ex.call(shift, (X, Y, Z))
    u, v, w = ex.call(shift, (x * y, 2.0, Z))
    (a, b, c) = ex.call(shift, (u, v + x, w * Y))
    field = sdf.Field(a * b - c + x * Z)
    points = np.random.default_rng(0).normal(size=(100, 3))
    np.testing.assert_allclose(*_both(field, points), rtol=1e-12)
    with sdf.back_end("torch"):
        expected = field.gradient(points)
    with sdf.back_end("numba"):
        np.testing.assert_allclose(field.gradient(points), expected, rtol=1e-9, atol=1e-12)


def test_an_oracle_of_the_wrong_shape_or_without_gradient_is_named():
    flat = sdf.sphere(1) | sdf.from_function(lambda p: p.sum(), name="learned")
    cut = sdf.sphere(1) | sdf.from_function(lambda p: p.detach().sum(dim=-1), name="cut")
    points = np.zeros((4, 3))
    with sdf.back_end("numba"):
        with pytest.raises(InputError, match="must return a tensor of shape"):
            flat(points)
        with pytest.raises(InputError, match="carry no gradient"):
            cut.gradient(points)


def test_an_oracle_with_parameters_keeps_its_graph():
    weight = torch.tensor(2.0, requires_grad=True)
    field = sdf.sphere(1) | sdf.from_function(lambda p: weight * p.sum(dim=-1), name="learned")
    points = torch.rand((WORTHWHILE, 3))
    assert field(points).requires_grad
    with torch.no_grad():
        assert not field(points).requires_grad


# --- choice ---


def test_many_points_are_compiled_and_few_are_not():
    tape = sdf.sphere(1).tape
    few, many = torch.rand((100, 3)), torch.rand((WORTHWHILE // len(tape) + 1, 3))
    assert not runs_compiled(tape, few, keep_graph=False)
    assert runs_compiled(tape, many, keep_graph=False)
    assert not runs_compiled(tape, many, keep_graph=True)
    assert not runs_compiled(tape, many.to(torch.bfloat16), keep_graph=False)
    assert not runs_compiled(tape, many.to("meta"), keep_graph=False)
    with sdf.back_end("torch"):
        assert not runs_compiled(tape, many, keep_graph=False)
    with sdf.back_end("numba"):
        assert runs_compiled(tape, few, keep_graph=False)


def test_points_that_require_a_gradient_get_one():
    points = torch.rand((WORTHWHILE // 8, 3), requires_grad=True)
    values = sdf.sphere(1)(points)
    values.sum().backward()
    assert points.grad is not None
    assert sdf.sphere(1).gradient(points).requires_grad
    with torch.no_grad():
        assert not sdf.sphere(1)(points).requires_grad


def test_transforms_of_torch_are_served_by_torch():
    field = sdf.sphere(1)
    points = torch.rand((1 << 18, 3), dtype=torch.float64) + 0.1
    unit = points / points.norm(dim=-1, keepdim=True)
    _, along = torch.func.jvp(field.evaluate, (points,), (unit,))
    torch.testing.assert_close(along, torch.ones_like(along))
    batched = torch.func.vmap(field.evaluate)(points.reshape(2, -1, 3))
    torch.testing.assert_close(batched.reshape(-1), field(points))


def test_a_back_end_that_cannot_serve_is_refused():
    field = sdf.sphere(1)
    with pytest.raises(InputError, match="no such back end"), sdf.back_end("cuda"):
        pass
    with sdf.back_end("numba"):
        with pytest.raises(InputError, match="without a graph"):
            field(torch.rand((4, 3), requires_grad=True))
        with pytest.raises(InputError, match="float32 and float64"):
            field.evaluate(torch.rand((4, 3)).to(torch.bfloat16))
        with sdf.back_end("auto"):
            assert field(torch.rand((4, 3), requires_grad=True)).requires_grad


def test_nan_and_infinite_points_are_computed_like_others():
    points = torch.tensor([[0.0, 0.0, np.nan], [np.inf, 0, 0], [0.0, 1.0, 0.0]])
    with sdf.back_end("numba"):
        values = sdf.sphere(1).evaluate(points)
        assert (sdf.torus(2, 1).union(sdf.box(1), smooth=0.1)).evaluate(points)[0].isnan()
    assert values[0].isnan()
    assert values[1:].tolist() == [np.inf, 0.0]


def test_chunks_hold_enough_points():
    """The parts that threads take are a small share of a chunk, and a chunk of memory is small."""
    assert CHUNK * 3 * 8 < 10e6
