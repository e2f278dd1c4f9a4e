"""Text to field, without evaluating anything else.

The language is the part of Python that fields are written in (what `repr(field)`
gives), read through `ast` and computed by the walker below. Nothing is ever passed to
`eval`; a name means a constructor of this package or nothing.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from inspect import signature
from typing import NoReturn

from fields.errors import InputError
from fields.field import Field
from fields.grid_files import load_grid
from fields.mesh import mesh
from fields.neural.storing import load_neural
from fields.notation import LIMIT
from fields.operations import RULES
from fields.primitives import PRIMITIVES
from fields.profiles.drawing import svg
from fields.profiles.lettering import text as lettering
from fields.profiles.picture import image

_OPERATORS: dict[type[ast.operator], Callable[[Field, Field], Field]] = {
    ast.BitOr: Field.__or__,
    ast.BitXor: Field.__xor__,
    ast.BitAnd: Field.__and__,
    ast.Sub: Field.__sub__,
}

_METHODS: dict[str, Callable[..., Field]] = {name: getattr(Field, name) for name in RULES}


def parse(text: str, *, allow_files: bool = False) -> Field:
    """The field that an expression such as `"sphere(1) & box(1.5)"` describes.

    Safe on text from anywhere: it can only call the constructors and operations of this
    package. `parse(repr(field))` has the same `expression`, the same object even, as
    `field`, if its `repr` has no angle brackets.

    Allowed are the primitives (`sphere`, `below`, ...), the operations as functions and
    as methods (`union(a, b)`, `a.translate((0, 0, 1))`), the operators `|`, `^`, `&` and
    `-` between fields and `~` before one, numbers with a sign, strings, tuples, lists,
    and keyword arguments.

    Args:
        text: one expression of at most 1,000,000 characters (as many as `repr` writes),
            with at most 200 parentheses open at once (a limit of Python's own parser) and
            chains of at most some hundreds of steps. Lists may be long: of the arguments
            of a union, say.
        allow_files: also allow `mesh`, `load_grid`, `load_neural`, `text`, `svg` and `image`,
            which read files (of a text, the font).

    Raises:
        InputError: the text is not such an expression; the message names the column
            (counted from 1) and what is allowed there. Or an argument in it is bad.
    """
    if not isinstance(text, str):
        raise InputError("text", text, "it is not a string", "pass the expression as text")
    if len(text) > LIMIT:
        raise InputError(
            "text", text, f"it has {len(text)} characters, more than {LIMIT}", "shorten it"
        )
    reader = _Reader(text, allow_files)
    too_deep = InputError("text", text, "it is nested too deeply", "split it into smaller fields")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except SyntaxError as error:
        column = None if error.offset is None else error.offset + reader.indent
        reader.refuse(column, f"it is not an expression ({error.msg})")
    except ValueError:  # before Python 3.12: a null character
        reader.refuse(None, "it holds a null character")
    except (RecursionError, MemoryError):
        raise too_deep from None
    try:
        value = reader.value(tree.body)
    except RecursionError:
        raise too_deep from None
    if not isinstance(value, Field):
        reader.refuse(1, "it is not a field but a plain value")
    return value


_FILE_READERS: dict[str, Callable[..., Field]] = {
    "load_grid": load_grid,
    "load_neural": load_neural,
    "mesh": mesh,
    "text": lettering,
    "svg": svg,
    "image": image,
}


class _Reader:
    """Computes the value of a syntax tree, and says where it cannot."""

    def __init__(self, text: str, allow_files: bool) -> None:
        self.text = text
        self.indent = len(text) - len(text.lstrip())
        self.constructors: dict[str, Callable[..., Field]] = {**PRIMITIVES, **_METHODS}
        if allow_files:
            self.constructors.update(_FILE_READERS)

    def refuse(self, column: int | None, cause: str, remedy: str | None = None) -> NoReturn:
        where = "" if column is None else f"column {column}: "
        raise InputError(
            "text",
            self.text,
            where + cause,
            remedy
            or "allowed are constructors and operations of fields, the operators | ^ & - between "
            "fields, ~ before one, signed numbers, strings, tuples and lists",
        ) from None

    def column(self, node: ast.expr, at_end: bool = False) -> int:
        """The column where a node starts (or just past its end), from 1, in its own line."""
        number, offset = node.lineno, node.col_offset
        if at_end:
            number, offset = node.end_lineno or number, node.end_col_offset or offset
        # The syntax tree counts UTF-8 bytes, people count characters.
        before = self.text.strip().split("\n")[number - 1].encode()[:offset]
        return len(before.decode(errors="replace")) + 1 + (self.indent if number == 1 else 0)

    def value(self, node: ast.expr) -> object:
        """The value of a node.

        Chains of operators and of methods lean to the left, and are walked in a loop, so
        that only true nesting uses Python's stack.
        """
        steps: list[ast.BinOp | ast.Call] = []
        while True:
            if isinstance(node, ast.BinOp):
                steps.append(node)
                node = node.left
            elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                steps.append(node)
                node = node.func.value
            else:
                break
        result = self._operand(node)
        for step in reversed(steps):
            if isinstance(step, ast.BinOp):
                result = self._combined(step, result)
            else:
                result = self._method_called(step, result)
        return result

    def _operand(self, node: ast.expr) -> object:
        match node:
            case ast.Constant(value=int() | float() | str() as value):
                return value
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
                number = self.value(operand)
                if isinstance(number, bool) or not isinstance(number, int | float):
                    self.refuse(
                        self.column(node),
                        "only numbers take a sign",
                        "for the complement of a field use ~ or .negate()",
                    )
                return -number if isinstance(node.op, ast.USub) else number
            case ast.UnaryOp(op=ast.Invert(), operand=operand):
                field = self.value(operand)
                if not isinstance(field, Field):
                    self.refuse(self.column(node), "only fields have a complement")
                return ~field
            case ast.Tuple(elts=items) | ast.List(elts=items):
                return tuple(self.value(item) for item in items)
            case ast.Call(func=ast.Name(id=name)):
                if name not in self.constructors:
                    self._refuse_name(node, name)
                return self._called(node, name, self.constructors[name])
            case ast.Name(id=name):
                if name in self.constructors:
                    self.refuse(self.column(node), f"{name} needs its arguments in parentheses")
                self._refuse_name(node, name)
            case ast.Attribute(attr=name):
                self.refuse(
                    self.column(node, at_end=True) - len(name),
                    f"the attribute {name!r} cannot be read; methods need parentheses",
                )
        kind = type(node).__name__
        self.refuse(self.column(node), f"this kind of expression ({kind}) is not allowed")

    def _refuse_name(self, node: ast.expr, name: str) -> NoReturn:
        if name in _FILE_READERS:
            self.refuse(
                self.column(node),
                "reading files is not permitted here",
                "call parse(text, allow_files=True) if the text can be trusted",
            )
        known = ", ".join(sorted(self.constructors))
        self.refuse(
            self.column(node), f"the name {name!r} is not known", f"the known names are {known}"
        )

    def _combined(self, node: ast.BinOp, left: object) -> Field:
        right, at = self.value(node.right), self.column(node.right)
        operator = _OPERATORS.get(type(node.op))
        if operator is None:
            self.refuse(at, f"the operator {type(node.op).__name__} is not allowed before this")
        if not isinstance(left, Field) or not isinstance(right, Field):
            self.refuse(at, "operators combine fields only, not plain values")
        return operator(left, right)

    def _method_called(self, node: ast.Call, receiver: object) -> Field:
        name = node.func.attr
        column = self.column(node.func, at_end=True) - len(name)
        if not isinstance(receiver, Field):
            self.refuse(column, "only fields have methods")
        if name not in _METHODS:
            known = ", ".join(sorted(_METHODS))
            self.refuse(
                column,
                f"the method {name!r} is not known",
                f"the known methods are {known}",
            )
        return self._called(node, name, _METHODS[name], receiver)

    def _called(
        self, node: ast.Call, name: str, function: Callable[..., Field], *receiver: Field
    ) -> Field:
        values = [*receiver, *(self.value(argument) for argument in node.args)]
        keywords: dict[str, object] = {}
        for keyword in node.keywords:
            if keyword.arg is None:
                self.refuse(self.column(node), "** is not allowed")
            keywords[keyword.arg] = self.value(keyword.value)
        expected = signature(function)
        try:
            expected.bind(*values, **keywords)
        except TypeError as error:
            self.refuse(
                self.column(node),
                f"{name} cannot be called like this ({error})",
                f"its parameters are {', '.join(expected.parameters)}",
            )
        try:
            return function(*values, **keywords)
        except InputError as error:
            raise InputError(
                error.argument,
                error.value,
                f"{error.cause} (column {self.column(node)} of the text)",
                error.remedy,
            ) from error
