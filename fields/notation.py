"""How a field was made, and the Python expression that makes it again.

A field keeps only a record of its last step and the fields it was made from; the text
is put together when someone asks for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from inspect import Parameter, signature
from os import PathLike, fspath
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from torch import Tensor

if TYPE_CHECKING:
    from fields.field import Field

LIMIT = 1_000_000
"""The longest text, in characters, that is written out. A graph that shares its parts
can stand for a text that is exponentially larger than itself."""

_OPERATORS = {
    "union": ("|", 1),
    "symmetric_difference": ("^", 2),
    "intersection": ("&", 3),
    "difference": ("-", 4),
}
_ATOM = 5

_LONGEST_CHAIN = 100
"""The most operands that are written with operators between them. Python's parser nests such a
chain, and gives up at a few thousand; the arguments of a call it only lists."""

Literal: TypeAlias = "float | bool | str | Opaque | tuple[Literal, ...]"


@dataclass(frozen=True, slots=True)
class Opaque:
    """Something that cannot be written in the vocabulary; shown in angle brackets."""

    text: str


@dataclass(frozen=True, slots=True)
class Call:
    """A function or method call that made a field.

    Attributes:
        name: the function; a method of the first operand if there are operands.
        operands: the fields it was applied to.
        arguments: its other positional arguments.
        keywords: its keyword arguments.
    """

    name: str
    operands: tuple[Field, ...] = ()
    arguments: tuple[Literal, ...] = ()
    keywords: tuple[tuple[str, Literal], ...] = ()


History: TypeAlias = "Call | Opaque"


def literal(value: object) -> Literal:
    """A value as it will be written: numbers as floats, arrays as tuples, flags as they are.

    Takes a copy, so that a later change of an array does not change the record.
    """
    if isinstance(value, np.ndarray | np.generic | Tensor):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(literal(item) for item in value)
    if isinstance(value, str | bool | Opaque):
        return value
    if isinstance(value, PathLike):
        return str(fspath(value))
    return float(value)  # type: ignore[arg-type]


def defaults(function: Callable[..., object]) -> dict[str, object]:
    """The parameters of a function that have default values, with these.

    And those that can be given by keyword only, with `Parameter.empty` if they have none.
    """
    return {
        name: parameter.default
        for name, parameter in signature(function).parameters.items()
        if parameter.default is not Parameter.empty or parameter.kind is Parameter.KEYWORD_ONLY
    }


def recorded(
    name: str,
    operands: tuple[Field, ...],
    arguments: Mapping[str, object],
    optional: Mapping[str, object],
) -> Call:
    """The record of a call.

    Args:
        name: of the function.
        operands: the fields it was applied to.
        arguments: the other arguments by the names of their parameters, in order.
        optional: the parameters that are written as keywords, with their default values, as
            `defaults` gives them. They are left out where the argument equals the default.
    """
    return Call(
        name,
        operands,
        tuple(literal(value) for key, value in arguments.items() if key not in optional),
        tuple(
            (key, literal(value))
            for key, value in arguments.items()
            if key in optional and not _is_default(value, optional[key])
        ),
    )


def _is_default(value: object, default: object) -> bool:
    if value is None or default is None or default is Parameter.empty:
        return value is default
    return literal(value) == literal(default)


def written(field: Field) -> str:
    """The Python expression that makes the field, in the vocabulary of `fields`.

    Parts that no expression makes, such as a mesh in memory or a function, appear in
    angle brackets. A text of more than `LIMIT` characters is given up and replaced by
    one in angle brackets that says so. Takes time proportional to the text's length.
    """
    pieces: list[str] = []
    size = 0
    # The stack holds what is still to be written, next item last: text as it is, and
    # fields with the precedence below which they need parentheses.
    pending: list[str | tuple[Field, int]] = [(field, 0)]
    while pending:
        item = pending.pop()
        if isinstance(item, str):
            pieces.append(item)
            size += len(item)
            if size > LIMIT:
                return f"<field whose expression is longer than {LIMIT} characters>"
        else:
            pending.extend(reversed(_spelled(*item)))
    return "".join(pieces)


def _spelled(field: Field, precedence: int) -> list[str | tuple[Field, int]]:
    """A field's last step as text, with its operands still to be written."""
    history = field.history
    if isinstance(history, Opaque):
        return [_literal_text(history)]
    plain = not history.arguments and not history.keywords
    if plain and history.name in _OPERATORS and len(history.operands) <= _LONGEST_CHAIN:
        symbol, own = _OPERATORS[history.name]
        # Operators group to the left, so only operands on the right need parentheses
        # around an operator of the same precedence.
        items: list[str | tuple[Field, int]] = [(history.operands[0], own)]
        for operand in history.operands[1:]:
            items += [f" {symbol} ", (operand, own + 1)]
        return ["(", *items, ")"] if own < precedence else items
    receiver, others = history.operands[:1], history.operands[1:]
    items = [(receiver[0], _ATOM), "."] if receiver else []
    items.append(f"{history.name}(")
    separator = ""
    for operand in others:
        items += [separator, (operand, 0)]
        separator = ", "
    for value in history.arguments:
        items.append(f"{separator}{_literal_text(value)}")
        separator = ", "
    for key, value in history.keywords:
        items.append(f"{separator}{key}={_literal_text(value)}")
        separator = ", "
    return [*items, ")"]


def _literal_text(value: Literal) -> str:
    if isinstance(value, Opaque):
        return f"<{value.text}>"
    if isinstance(value, tuple):
        inside = ", ".join(_literal_text(item) for item in value)
        return f"({inside},)" if len(value) == 1 else f"({inside})"
    return repr(value)
