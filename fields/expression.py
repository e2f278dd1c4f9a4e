"""The expression graph that every field is written in.

A field is one scalar `Expression` in the coordinates x, y and z. Expressions are
immutable and interned: building the same expression twice gives the same object, so
common subexpressions are shared from the start, `is` means "same formula", and nodes
can be used as dictionary keys.

All arithmetic is listed once, in `OPERATIONS`. An evaluator (torch here; compiled
loops, intervals or shader code elsewhere) adds its own column to that table and runs
the instructions of a `fields.tape.Tape`; no evaluator walks this graph itself.

Guarantees: no function here recurses, so chains of any length work; gradients by
autograd are finite wherever the values are, given that no divisor is zero.

Non-guarantees: algebraic identities that rounding allows (x + 0, 1 * x, 0 * x, constant
folding in float64) are applied, so 0 * x is 0 even where x would be infinite.

Derivatives where none exists are chosen as follows, and are always finite:

==================  ==========================================================
sqrt at 0           0 (hence the gradient of a distance is 0 at its own centre)
sqrt below 0        value 0, derivative 0 (such values come from rounding only)
absolute at 0       0
floor               0 everywhere
log at or below 0   value: the logarithm of the least positive normal number of the
                    dtype; derivative 0
power, base <= 0    value 0, derivative 0
atan2 at (0, 0)     value 0, derivative 0
minimum, maximum    the mean of both sides at a tie
where_negative      the derivative of the branch that is taken
==================  ==========================================================
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final
from weakref import WeakValueDictionary

import torch
from torch import Tensor

from fields.errors import InputError
from fields.oracle import Oracle

Operand: TypeAlias = "Expression | float"
Coordinates: TypeAlias = "tuple[Expression, Expression, Expression]"


@final
class Expression:
    """One node of the graph: a scalar function of x, y and z.

    Made by the functions and operators of this module, never directly. Arithmetic
    operators accept other expressions and real numbers.

    Attributes:
        kind: the name of a row of `OPERATIONS`, or one of "constant" (payload: the
            number), "coordinate" (payload: 0, 1 or 2), "call" (payload: an oracle;
            arguments: where it is called; internal, has several outputs), "component"
            (payload: which output; argument: a "call") and "remap" (arguments: a body
            and the three expressions that stand for its x, y and z).
        payload: see `kind`; None for operations.
        arguments: the nodes it is a function of.
    """

    __slots__ = ("__weakref__", "arguments", "kind", "payload")

    kind: str
    payload: float | int | Oracle | None
    arguments: tuple[Expression, ...]

    def __init__(self) -> None:
        raise TypeError("expressions are made by the functions of fields.expression")

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"expressions are immutable: cannot set {name}")

    def __repr__(self) -> str:
        detail = "" if self.payload is None else f" {getattr(self.payload, 'name', self.payload)}"
        return f"<Expression {self.kind}{detail}>"

    def __copy__(self) -> Expression:
        return self

    def __deepcopy__(self, memo: object) -> Expression:
        return self

    def __reduce__(self) -> str:
        raise TypeError("expressions are not pickled; send repr(field) and fields.parse it")

    def __neg__(self) -> Expression:
        return apply("negative", self)

    def __abs__(self) -> Expression:
        return apply("absolute", self)

    def __add__(self, other: Operand) -> Expression:
        return apply("add", self, other)

    def __radd__(self, other: Operand) -> Expression:
        return apply("add", other, self)

    def __sub__(self, other: Operand) -> Expression:
        return apply("subtract", self, other)

    def __rsub__(self, other: Operand) -> Expression:
        return apply("subtract", other, self)

    def __mul__(self, other: Operand) -> Expression:
        return apply("multiply", self, other)

    def __rmul__(self, other: Operand) -> Expression:
        return apply("multiply", other, self)

    def __truediv__(self, other: Operand) -> Expression:
        return apply("divide", self, other)

    def __rtruediv__(self, other: Operand) -> Expression:
        return apply("divide", other, self)


# --- the table of operations ----------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Operation:
    """One row of the table: a name, its number of arguments, and its meaning in torch."""

    name: str
    arity: int
    torch: Callable[..., Tensor]


def _sqrt(value: Tensor) -> Tensor:
    # The inner `where` keeps the infinite derivative at 0 out of the backward pass:
    # masking only the result would multiply 0 by infinity there. NaN passes through.
    flat = value <= 0
    return torch.where(flat, 0, torch.sqrt(torch.where(flat, 1, value)))


def _log(value: Tensor) -> Tensor:
    least = torch.finfo(value.dtype).tiny
    return torch.log(torch.where(value < least, least, value))


def _power(base: Tensor, exponent: Tensor) -> Tensor:
    flat = base <= 0
    return torch.where(flat, 0, torch.pow(torch.where(flat, 1, base), exponent))


def _atan2(y: Tensor, x: Tensor) -> Tensor:
    # The derivative at the origin is 0 / 0; there x is replaced by a constant.
    nowhere = (x == 0) & (y == 0)
    return torch.atan2(torch.where(nowhere, 0, y), torch.where(nowhere, 1, x))


def _where_negative(condition: Tensor, negative: Tensor, otherwise: Tensor) -> Tensor:
    return torch.where(condition < 0, negative, otherwise)


OPERATIONS: dict[str, Operation] = {
    operation.name: operation
    for operation in (
        Operation("negative", 1, torch.neg),
        Operation("absolute", 1, torch.abs),
        Operation("square", 1, torch.square),
        Operation("sqrt", 1, _sqrt),
        Operation("sin", 1, torch.sin),
        Operation("cos", 1, torch.cos),
        Operation("floor", 1, torch.floor),
        Operation("exp", 1, torch.exp),
        Operation("log", 1, _log),
        Operation("add", 2, torch.add),
        Operation("subtract", 2, torch.sub),
        Operation("multiply", 2, torch.mul),
        Operation("divide", 2, torch.div),
        Operation("minimum", 2, torch.minimum),
        Operation("maximum", 2, torch.maximum),
        Operation("atan2", 2, _atan2),
        Operation("power", 2, _power),
        Operation("where_negative", 3, _where_negative),
    )
}


# --- making nodes ---------------------------------------------------------------------

_interned: WeakValueDictionary[tuple[object, ...], Expression] = WeakValueDictionary()


def intern_node(
    kind: str, payload: float | int | Oracle | None, arguments: tuple[Expression, ...]
) -> Expression:
    """The one node with this kind, payload and arguments, as it stands (no simplification).

    Part of the machinery of graph transformations; formulas are written with `apply`.
    """
    # An oracle is keyed by identity, so that it need be neither hashable nor comparable;
    # the node keeps it alive, so the id cannot be reused while the entry exists.
    identity = payload if payload is None or isinstance(payload, float | int) else id(payload)
    key = (kind, identity, arguments)
    node = _interned.get(key)
    if node is None:
        node = object.__new__(Expression)
        object.__setattr__(node, "kind", kind)
        object.__setattr__(node, "payload", payload)
        object.__setattr__(node, "arguments", arguments)
        node = _interned.setdefault(key, node)
    return node


def constant(value: float) -> Expression:
    """The expression with the same finite value everywhere.

    Raises:
        InputError: the value is infinite or not a number (a division by zero in a
            formula ends here).
    """
    number = float(value) + 0.0  # -0.0 and 0.0 become one node
    if not math.isfinite(number):
        raise InputError(
            "value",
            value,
            "constants in an expression must be finite",
            "look for a division by zero or an overflow among the parameters",
        )
    return intern_node("constant", number, ())


X = intern_node("coordinate", 0, ())
Y = intern_node("coordinate", 1, ())
Z = intern_node("coordinate", 2, ())

_ZERO = constant(0.0)
_ONE = constant(1.0)


def as_expression(value: Operand) -> Expression:
    """An expression as it is; a real number as a constant."""
    return value if isinstance(value, Expression) else constant(value)


def apply(name: str, *arguments: Operand) -> Expression:
    """The row `name` of `OPERATIONS` applied to expressions or numbers, simplified.

    Raises:
        InputError: the number of arguments is not the operation's arity, or a constant
            result is not finite.
    """
    operation = OPERATIONS[name]
    if len(arguments) != operation.arity:
        raise InputError(
            "arguments",
            arguments,
            f"{name} takes {operation.arity}, not {len(arguments)}",
            "pass one expression or number per argument",
        )
    nodes = tuple(as_expression(argument) for argument in arguments)
    if all(node.kind == "constant" for node in nodes):
        numbers = [torch.tensor(node.payload, dtype=torch.float64) for node in nodes]
        return constant(float(operation.torch(*numbers)))
    simpler = _simplified(name, nodes)
    return simpler if simpler is not None else intern_node(name, None, nodes)


def _simplified(name: str, nodes: tuple[Expression, ...]) -> Expression | None:
    first, last = nodes[0], nodes[-1]
    match name:
        case "add" if first is _ZERO:
            return last
        case "add" | "subtract" if last is _ZERO:
            return first
        case "subtract" if first is _ZERO:
            return apply("negative", last)
        case "multiply" if first is _ZERO or last is _ZERO:
            return _ZERO
        case "multiply" if first is _ONE:
            return last
        case "multiply" | "divide" if last is _ONE:
            return first
        case "negative" if first.kind == "negative":
            return first.arguments[0]
        case "absolute" | "square" if first.kind == "negative":
            return apply(name, first.arguments[0])
        case "minimum" | "maximum" if first is last:
            return first
    return None


def call(oracle: Oracle, coordinates: Coordinates = (X, Y, Z)) -> tuple[Expression, ...]:
    """The outputs of an oracle at the given coordinates, one expression each."""
    node = intern_node("call", oracle, tuple(as_expression(axis) for axis in coordinates))
    return tuple(intern_node("component", index, (node,)) for index in range(oracle.outputs))


def remap(body: Expression, coordinates: Coordinates) -> Expression:
    """`body` with its x, y and z replaced by three expressions, all at once.

    Costs the same however large `body` is: the substitution is carried out when a tape
    is made, from the outside in, so a chain of n remaps takes time proportional to n.
    """
    if body.kind == "constant" or coordinates == (X, Y, Z):
        return body
    if body.kind == "coordinate":
        return coordinates[int(body.payload)]  # type: ignore[arg-type]
    return intern_node("remap", None, (body, *coordinates))


# --- the operations as functions ------------------------------------------------------


def square(value: Operand) -> Expression:
    """value**2."""
    return apply("square", value)


def sqrt(value: Operand) -> Expression:
    """The square root; 0 with derivative 0 wherever value <= 0."""
    return apply("sqrt", value)


def sin(value: Operand) -> Expression:
    """The sine of an angle in radians."""
    return apply("sin", value)


def cos(value: Operand) -> Expression:
    """The cosine of an angle in radians."""
    return apply("cos", value)


def floor(value: Operand) -> Expression:
    """The largest whole number that is not above value; derivative 0."""
    return apply("floor", value)


def exp(value: Operand) -> Expression:
    """e**value."""
    return apply("exp", value)


def log(value: Operand) -> Expression:
    """The natural logarithm; see the module's table for values at or below 0."""
    return apply("log", value)


def atan2(y: Operand, x: Operand) -> Expression:
    """The angle of the vector (x, y), in radians from -pi to pi; 0 at the origin."""
    return apply("atan2", y, x)


def power(base: Operand, exponent: Operand) -> Expression:
    """base**exponent for a base that is not negative; 0 with derivative 0 at a base <= 0."""
    return apply("power", base, exponent)


def modulo(value: Operand, period: float) -> Expression:
    """value - period * floor(value / period), in [0, period) for a positive period."""
    return value - period * floor(value / period)


def minimum(first: Operand, *others: Operand) -> Expression:
    """The smallest of one or more expressions."""
    result = as_expression(first)
    for other in others:
        result = apply("minimum", result, other)
    return result


def maximum(first: Operand, *others: Operand) -> Expression:
    """The largest of one or more expressions."""
    result = as_expression(first)
    for other in others:
        result = apply("maximum", result, other)
    return result


def clamp(value: Operand, low: float, high: float) -> Expression:
    """The nearest number to value in [low, high]."""
    return minimum(maximum(value, low), high)


def where_negative(condition: Operand, negative: Operand, otherwise: Operand) -> Expression:
    """`negative` where condition < 0, else `otherwise`.

    The branch that is not taken may be any finite number, but must not be infinite or
    NaN where gradients are wanted.
    """
    return apply("where_negative", condition, negative, otherwise)


def length(*components: Operand) -> Expression:
    """The Euclidean norm sqrt(a**2 + b**2 + ...); derivative 0 at the origin."""
    total = square(components[0])
    for component in components[1:]:
        total = total + square(component)
    return sqrt(total)
