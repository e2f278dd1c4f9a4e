"""Shader text run in numpy, line by line: what its words mean, written a second time."""

from __future__ import annotations

import re

import numpy as np

_LINE = re.compile(r"    (?:float (\w+)|let (\w+): f32) = (.*);")
_CHOICE = re.compile(r"\(([^?]*) \? ([^:]*) : (.*)\)$")
_LITERAL = re.compile(r"(?<![\w.])(\d+\.\d*(?:e[+-]?\d+)?|\d+e[+-]?\d+)")


def _select(otherwise, value, condition):
    return np.where(condition, value, otherwise)


_WORDS = {
    "abs": np.abs, "sqrt": np.sqrt, "sin": np.sin, "cos": np.cos, "floor": np.floor,
    "exp": np.exp, "log": np.log, "min": np.minimum, "max": np.maximum, "pow": np.power,
    "atan": np.arctan2, "atan2": np.arctan2, "select": _select, "f32": np.float32,
}  # fmt: skip


class _Point:
    def __init__(self, points: np.ndarray) -> None:
        self.x, self.y, self.z = points.T


def run_shader(text: str, points: np.ndarray) -> np.ndarray:
    """Values at float32 points `(n, 3)` of a function as `Field.to_glsl` writes it."""
    scope = dict(_WORDS, p=_Point(points))
    *lines, final, end, last = text.split("\n")
    assert (end, last) == ("}", "")
    with np.errstate(all="ignore"):
        for line in lines[1:]:
            first, second, expression = _LINE.fullmatch(line).groups()
            scope[first or second] = np.float32(1) * _value(expression, scope)
        result = _value(final.removeprefix("    return ").removesuffix(";"), scope)
    return np.broadcast_to(result, len(points)).astype(np.float32)


def _value(expression: str, scope: dict[str, object]) -> np.ndarray:
    if choice := _CHOICE.fullmatch(expression):
        condition, value, otherwise = (_value(part, scope) for part in choice.groups())
        return np.where(condition, value, otherwise)
    if " && " in expression and not expression.startswith("select"):
        left, right = (_value(part, scope) for part in expression.split(" && "))
        return left & right
    text = _LITERAL.sub(r"f32(\1)", expression)
    text = re.sub(r", ([^,]*) && ([^,]*)\)$", r", (\1) & (\2))", text)
    return eval(text, {"__builtins__": {}}, scope)
