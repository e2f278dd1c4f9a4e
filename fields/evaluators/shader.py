"""A field as the text of a shader function, in GLSL or WGSL.

The text needs nothing else: each instruction of the tape is one line, named by its slot, and the
conventions of `fields.expression` (the square root below 0, the angle at the origin, the power of
a base <= 0) are written out where the languages leave them open. Constants are written with as
many digits as float32 needs to read the same number back.

Non-guarantees: shaders compute in float32 and may fuse, reorder and approximate, each by the rules
of its language; NaN and infinity need not survive.
"""

from __future__ import annotations

import re

import numpy as np

from fields.errors import InputError
from fields.tape import Tape

_COMMON: dict[str, str] = {
    "negative": "-{0}",
    "absolute": "abs({0})",
    "square": "{0} * {0}",
    "sqrt": "sqrt(max({0}, 0.0))",
    "sin": "sin({0})",
    "cos": "cos({0})",
    "floor": "floor({0})",
    "exp": "exp({0})",
    "log": "log(max({0}, 1.1754944e-38))",
    "add": "{0} + {1}",
    "subtract": "{0} - {1}",
    "multiply": "{0} * {1}",
    "divide": "{0} / {1}",
    "minimum": "min({0}, {1})",
    "maximum": "max({0}, {1})",
}

SPELLINGS: dict[str, dict[str, str]] = {
    "glsl": _COMMON
    | {
        "atan2": "({1} == 0.0 && {0} == 0.0 ? 0.0 : atan({0}, {1}))",
        "power": "({0} > 0.0 ? pow({0}, {1}) : 0.0)",
        "where_negative": "({0} < 0.0 ? {1} : {2})",
    },
    "wgsl": _COMMON
    | {
        "atan2": "select(atan2({0}, {1}), 0.0, {1} == 0.0 && {0} == 0.0)",
        "power": "select(0.0, pow({0}, {1}), {0} > 0.0)",
        "where_negative": "select({2}, {1}, {0} < 0.0)",
    },
}
"""How each language writes the rows of `OPERATIONS`."""

_FRAMES = {
    "glsl": ("float {0}(vec3 p) {{", "    float {0} = {1};"),
    "wgsl": ("fn {0}(p: vec3<f32>) -> f32 {{", "    let {0}: f32 = {1};"),
}

_NAME = re.compile(r"(?!gl_)(?!.*__)[A-Za-z][A-Za-z0-9_]*")


def shader_text(tape: Tape, name: str, dialect: str) -> str:
    """The function; see `Field.to_glsl`."""
    if dialect not in SPELLINGS:
        raise InputError(
            "dialect", dialect, "no such language", f"use one of {', '.join(SPELLINGS)}"
        )
    if not isinstance(name, str) or not _NAME.fullmatch(name) or name == "p":
        raise InputError(
            "name",
            name,
            "it cannot be the name of a function in a shader",
            "use letters, digits and single underscores, and a letter first",
        )
    head, line = _FRAMES[dialect]
    words: list[str] = []
    lines = [head.format(name)]
    for slot, instruction in enumerate(tape.instructions):
        if instruction.kind == "constant":
            words.append(_number(float(instruction.payload)))  # type: ignore[arg-type]
        elif instruction.kind == "coordinate":
            words.append("p." + "xyz"[int(instruction.payload)])  # type: ignore[arg-type]
        elif instruction.kind in ("call", "component"):
            oracle = getattr(instruction.payload, "name", "")
            raise InputError(
                "field",
                oracle,
                f"it calls the function {oracle!r}, of which the formula is not known",
                "leave that part out, or sample it on a grid for the viewer",
            )
        else:
            given = [words[index] for index in instruction.arguments]
            words.append(f"v{slot}")
            lines.append(
                line.format(words[-1], SPELLINGS[dialect][instruction.kind].format(*given))
            )
    return "\n".join([*lines, f"    return {words[-1]};", "}", ""])


def _number(value: float) -> str:
    """The shortest decimal that float32 reads as this number; in parentheses if negative."""
    with np.errstate(over="ignore"):
        rounded = np.float32(value)
    if not np.isfinite(rounded):
        raise InputError(
            "field",
            value,
            "a constant of its formula is too large for float32",
            "scale the field down",
        )
    text = np.format_float_scientific(rounded, trim="0", exp_digits=1)
    if 1e-4 <= abs(rounded) < 1e7 or rounded == 0:
        text = np.format_float_positional(rounded, trim="0")
    return f"({text})" if rounded < 0 else text
