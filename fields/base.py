"""What all methods of fields stand on: a formula with its tags, and how one is derived.

`fields.field.Field` is the only class made of this. Its methods are spread over the modules of
`fields.methods`, by topic; each method calls `derived` with a rule of `fields.operations.RULES`.
"""

from __future__ import annotations

from functools import cache
from typing import TypeVar

from fields import notation
from fields.errors import InputError
from fields.notation import Call, History
from fields.operations import Body, Rule
from fields.tape import Tape


class FieldBase:
    """The parts of a field: its body, its tape once it is made, and its history."""

    __slots__ = ("_body", "_tape", "history")

    _body: Body
    _tape: Tape | None
    history: History
    """How the field was made; what `repr` writes."""

    @property
    def tape(self) -> Tape:
        """The instructions that compute the field; made on first use and kept."""
        if self._tape is None:
            self._tape = Tape(self._body.expression)
        return self._tape


F = TypeVar("F", bound=FieldBase)

_defaults = cache(notation.defaults)


def made(kind: type[F], body: Body, history: History) -> F:
    """A field from a body and a record of how it was made."""
    field = object.__new__(kind)
    field._body = body
    field._tape = None
    field.history = history
    return field


def derived(rule: Rule, operands: tuple[F, ...], **given: object) -> F:
    """The field that a rule makes of others; `given` are its other arguments, in order.

    Raises:
        InputError: an operand is no field, or what the rule says.
    """
    for operand in operands:
        if not isinstance(operand, FieldBase):
            raise InputError(
                "field",
                operand,
                f"{rule.__name__} takes fields",
                "pass fields made by this package",
            )
    body = rule(*(operand._body for operand in operands), **given)
    if body is operands[0]._body:  # nothing to do, such as the union of one field
        return operands[0]
    record: Call = notation.recorded(rule.__name__, operands, given, _defaults(rule))
    return made(type(operands[0]), body, record)
