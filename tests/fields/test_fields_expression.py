"""The expression graph, its tapes, and their evaluation in torch."""

from __future__ import annotations

import copy
import gc
import pickle
import time
import weakref

import numpy as np
import pytest
import torch

import fields as sdf
from fields import InputError
from fields import expression as ex
from fields.expression import OPERATIONS, X, Y, Z
from fields.oracle import FunctionOracle
from fields.tape import Tape

POINTS = torch.tensor([[0.3, -0.7, 1.1], [-2.0, 0.5, 0.25]], dtype=torch.float64)

MEANING = {
    "negative": lambda a: -a,
    "absolute": np.abs,
    "square": lambda a: a * a,
    "sqrt": lambda a: np.sqrt(np.maximum(a, 0)),
    "sin": np.sin,
    "cos": np.cos,
    "floor": np.floor,
    "exp": np.exp,
    "log": lambda a: np.log(np.maximum(a, np.finfo(np.float64).tiny)),
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "minimum": np.minimum,
    "maximum": np.maximum,
    "atan2": np.arctan2,
    "power": lambda a, b: np.where(a > 0, np.abs(a) ** b, 0),
    "where_negative": lambda c, a, b: np.where(c < 0, a, b),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_means_what_it_is_called(name, rng):
    arguments = rng.normal(size=(OPERATIONS[name].arity, 50))
    points = torch.zeros((50, 3), dtype=torch.float64)
    points[:, : len(arguments)] = torch.from_numpy(arguments.T)
    value = Tape(ex.apply(name, *(X, Y, Z)[: len(arguments)])).evaluate(points)
    np.testing.assert_allclose(value, MEANING[name](*arguments), rtol=1e-15)
    # and the same when the arguments are constants, folded in advance
    folded = ex.apply(name, *(float(a) for a in arguments[:, 0]))
    assert folded.kind == "constant"
    assert folded.payload == pytest.approx(MEANING[name](*arguments[:, 0]), rel=1e-15)


def test_equal_formulas_are_one_object():
    assert (X + 1.0) * Y is (X + 1) * Y
    assert ex.constant(0.0) is ex.constant(-0.0)
    assert X + Y is not Y + X
    assert copy.deepcopy(X * Y) is X * Y


def test_nodes_are_forgotten_when_unused():
    gc.collect()
    before = len(ex._interned)
    node = ex.sin(X * 123.456)
    assert len(ex._interned) == before + 3
    del node
    assert len(ex._interned) == before


def test_expressions_are_immutable_and_not_pickled():
    with pytest.raises(AttributeError, match="immutable"):
        X.kind = "constant"
    with pytest.raises(TypeError, match=r"repr\(field\)"):
        pickle.dumps(X)
    with pytest.raises(TypeError, match="made by the functions"):
        ex.Expression()


@pytest.mark.parametrize(
    ("simplified", "expected"),
    [
        (X + 0, X), (0 + X, X), (X - 0, X), (X * 1, X), (1 * X, X), (X / 1, X),
        (X * 0, ex.constant(0)), (0 * X, ex.constant(0)), (0 - X, -X), (-(-X), X),  # noqa: B002
        (ex.minimum(X, X), X), (ex.maximum(X, X), X), (ex.constant(2) * 3 + 1, ex.constant(7)),
    ],
)  # fmt: skip
def test_trivial_arithmetic_disappears(simplified, expected):
    assert simplified is expected


def test_constants_must_be_finite():
    with pytest.raises(InputError, match="must be finite"):
        ex.constant(float("inf"))
    with pytest.raises(InputError, match="division by zero"):
        ex.constant(1.0) / 0.0
    with pytest.raises(InputError, match="minimum takes 2, not 1"):
        ex.apply("minimum", X)


# --- evaluation ---


def test_a_common_subexpression_is_one_instruction():
    assert len(Tape(ex.sin(X * Y) + ex.cos(X * Y) * (X * Y))) == 2 + 1 + 2 + 2


def test_a_constant_field_has_the_points_shape_and_dtype():
    field = sdf.Field(ex.constant(2.5))
    assert field(np.zeros((4, 2, 3), dtype=np.float32)).tolist() == [[2.5, 2.5]] * 4
    assert field(torch.zeros(3)).dtype == torch.float32
    np.testing.assert_array_equal(field.gradient(np.zeros((5, 3))), np.zeros((5, 3)))


def test_an_intermediate_is_freed_after_its_last_use():
    results: list[weakref.ref[torch.Tensor]] = []
    alive: list[int] = []

    def total(points: torch.Tensor) -> torch.Tensor:
        alive.append(sum(result() is not None for result in results))
        value = points.sum(dim=-1, keepdim=True)
        results.append(weakref.ref(value))
        return value

    root = X
    for _ in range(30):
        (root,) = ex.call(FunctionOracle(total, "total"), (root, root, root))
    Tape(root).evaluate(POINTS)
    assert alive == [0, *[1] * 29]


def test_nan_points_give_nan_values_unchecked():
    points = torch.tensor([[0.0, 0.0, float("nan")]])
    for field in (sdf.sphere(1), sdf.torus(2, 1), sdf.below(0)):
        assert field.evaluate(points).isnan().all()


def test_sqrt_at_zero_has_value_and_derivatives_zero():
    x = torch.zeros((1, 3), dtype=torch.float64, requires_grad=True)
    value = Tape(ex.length(X, Y, Z)).evaluate(x)
    (first,) = torch.autograd.grad(value, x, create_graph=True)
    (second,) = torch.autograd.grad(first.sum(), x)
    assert value.item() == 0
    assert (first == 0).all()
    assert (second == 0).all()
    assert Tape(ex.sqrt(X)).evaluate(torch.tensor([[-1.0, 0, 0]])).item() == 0


def test_gradients_pass_gradcheck():
    shape = sdf.torus(1, 0.3).union(sdf.cone(1, 2).rotate(20, "x"), smooth=0.3)
    points = POINTS.clone().requires_grad_()
    assert torch.autograd.gradcheck(shape.evaluate, points)
    assert torch.autograd.gradgradcheck(shape.evaluate, points)


def test_gradients_can_be_differentiated_if_the_points_ask_for_it():
    points = POINTS.clone().requires_grad_()
    assert sdf.sphere(1).gradient(points).requires_grad
    assert not sdf.sphere(1).gradient(POINTS).requires_grad
    with torch.no_grad():
        assert not sdf.sphere(1).gradient(points).requires_grad


@pytest.mark.gpu
def test_values_stay_on_their_device(example):
    points = POINTS.cuda()
    assert example(points).device == points.device
    torch.testing.assert_close(example(points).cpu(), example(POINTS))


# --- substitution ---


def test_substitution_is_simultaneous():
    swapped = ex.remap(X - 2 * Y, (Y, X, Z))
    assert Tape(swapped).evaluate(POINTS).tolist() == (POINTS[:, 1] - 2 * POINTS[:, 0]).tolist()


def test_nested_substitutions_apply_from_the_outside_in():
    inner = ex.remap(ex.sin(X), (X * Y, Y, Z))  # sin(x y)
    outer = ex.remap(inner, (X + 1, Y * Z, Z))  # sin((x + 1) y z)
    x, y, z = POINTS.unbind(-1)
    torch.testing.assert_close(Tape(outer).evaluate(POINTS), torch.sin((x + 1) * y * z))
    assert Tape(outer).instructions == Tape(ex.sin((X + 1) * (Y * Z))).instructions


def test_a_part_seen_twice_from_one_place_is_computed_once():
    ball = sdf.sphere(1).translate((0.1, 0.2, 0.3))
    assert len((ball | ball.offset(0.5)).tape) == len(ball.tape) + 3  # 0.5, -, min


# --- oracles ---


class Counting:
    """An oracle that counts its calls and points."""

    name = "counting"
    outputs = 3

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, points: torch.Tensor) -> torch.Tensor:
        self.calls += 1
        return 2 * points


def test_an_oracle_used_many_times_is_called_once():
    oracle = Counting()
    base = sdf.sphere(1) & sdf.box(1.5) | sdf.torus(1, 0.2)
    warped = base.remap(oracle, lipschitz=2)
    both = (warped | warped.offset(0.1)).union(warped.shell(0.2), smooth=0.1)
    values = both(POINTS)
    assert oracle.calls == 1
    torch.testing.assert_close(warped(POINTS), base(2 * POINTS))
    assert values.shape == (2,)
    elsewhere = warped | warped.translate((1, 0, 0))
    oracle.calls = 0
    elsewhere(POINTS)
    assert oracle.calls == 2  # at two places, two calls


def test_the_same_function_twice_is_two_oracles():
    first, second = sdf.from_function(torch.sum), sdf.from_function(torch.sum)
    assert first.expression is not second.expression


def test_values_of_a_function_may_have_a_last_axis_of_one():
    flat = sdf.from_function(lambda p: p.norm(dim=-1) - 1)
    column = sdf.from_function(lambda p: p.norm(dim=-1, keepdim=True) - 1)
    torch.testing.assert_close(flat(POINTS), column(POINTS))


@pytest.mark.parametrize(
    ("function", "cause"),
    [
        (lambda p: p.sum(), r"must return a tensor of shape \(2, 1\)"),
        (lambda p: p, r"must return a tensor of shape \(2, 1\)"),
        (lambda p: 3.0, r"must return a tensor of shape \(2, 1\)"),
    ],
)
def test_an_oracle_of_the_wrong_shape_is_named(function, cause):
    with pytest.raises(InputError, match=cause) as caught:
        sdf.from_function(function, name="learned")(POINTS)
    assert caught.value.argument == "learned"


def test_an_oracle_without_gradient_is_refused_where_one_is_asked_for():
    cut = sdf.sphere(1) | sdf.from_function(lambda p: p.detach().sum(dim=-1), name="cut")
    assert cut(POINTS).shape == (2,)
    with pytest.raises(InputError, match="carry no gradient"):
        cut.gradient(POINTS)


# --- length ---


def _chains(n: int) -> dict[str, sdf.Field]:
    """Three fields of n operations each."""
    moved = united = nested = sdf.sphere(1)
    for _ in range(n // 2):
        moved = moved.translate((1e-4, 0, 0)).rotate(90)
        nested = (nested - sdf.below(-2)).offset(1e-5)
    for i in range(n):
        united = united | sdf.sphere(0.5, (i * 1e-3, 0, 0))
    return {"moved": moved, "united": united, "nested": nested}


def test_chains_of_ten_thousand_operations_work():
    """Building, evaluating, differentiating, writing and forgetting: no recursion."""
    points = POINTS.clone().requires_grad_()
    for name, field in _chains(10_000).items():
        assert field(points).isfinite().all(), name
        assert field.gradient(points).isfinite().all(), name
        assert repr(field).count("(") >= 10_000
    del field
    gc.collect()


def test_the_value_of_a_long_chain_is_right():
    field = _chains(1_600)["moved"]
    # Four quarter turns with a step between each come back to where they began.
    torch.testing.assert_close(field(POINTS), sdf.sphere(1)(POINTS), atol=1e-9, rtol=0)


def test_long_chains_take_linear_time():
    def seconds(n: int) -> float:
        start = time.process_time()
        for field in _chains(n).values():
            field(POINTS)
            repr(field)
        return time.process_time() - start

    seconds(100)
    # Eight times as long: linear takes 8 times the time, quadratic 64.
    assert min(seconds(2_400) / seconds(300) for _ in range(3)) < 25


def test_a_text_that_would_be_exponential_is_given_up():
    field = sdf.sphere(1)
    for _ in range(60):
        field = field | field
    assert repr(field) == "<field whose expression is longer than 1000000 characters>"
    assert field((2, 0, 0)) == 1
