"""Handles: regions of the rest shape, and the rigid motions they must follow.

A handle file is TOML, with one table a handle and the same words as the Python API:

    [[handle]]
    name = "foot"
    region = "below(-0.6)"          # any expression of the fields vocabulary
    hold = true

    [[handle]]
    name = "head"
    region = "above(0.6)"
    rotate = ["z", 60]              # degrees, right-handed
    translate = [0, 0, 0.1]
    pivot = [0, 0, 0]

    [solve]                         # optional: options of the elastic solve
    steps = 300

A table ``[editor]`` is the browser editor's own, and is passed over here.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import fields
from fields import Field
from implicit_warp.affine import Affine, rigid_motion
from implicit_warp.errors import InputError

_MOTION_WORDS = ("rotate", "translate", "pivot", "matrix")
_WORDS = {"name", "region", "hold", "weight", *_MOTION_WORDS}


@dataclass(frozen=True)
class Handle:
    """A region of the rest shape and its target. Made by `hold` and `move`.

    Attributes:
        region: a field whose inside selects points of the rest shape.
        motion: the rigid motion that those points must follow, in the user's units.
        name: shown in reports and errors.
        weight: factor on this handle's terms of the loss.
        words: the motion as it was written (empty for a held region), for files.
    """

    region: Field
    motion: Affine
    name: str
    weight: float = 1.0
    words: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_held(self) -> bool:
        """Does the region stay where it is?"""
        return not self.words


def hold(region: Field, *, name: str = "", weight: float = 1.0) -> Handle:
    """A region that stays in place.

    Args:
        region: a field; its inside (within the shape) is held.
        name: defaults to the region's expression.
        weight: factor on the handle's terms of the loss.
    """
    return _handle(region, {}, name, weight)


def move(
    region: Field,
    *,
    rotate=None,
    translate=None,
    pivot=None,
    matrix=None,
    name: str = "",
    weight: float = 1.0,
) -> Handle:
    """A region that follows a rigid motion: turn about an axis through the pivot, then shift.

    Args:
        region: a field; its inside (within the shape) is moved.
        rotate: (axis, degrees), the axis "x", "y", "z" or a vector.
        translate: (3,) in the shape's units.
        pivot: (3,) the rotation's fixed point; the origin by default.
        matrix: a rigid (3, 4) or (4, 4) matrix instead of all of these.
        name: defaults to the region's expression.
        weight: factor on the handle's terms of the loss.

    Raises:
        InputError: no motion is given, or it is malformed or not rigid.
    """
    given = {"rotate": rotate, "translate": translate, "pivot": pivot, "matrix": matrix}
    words = {key: value for key, value in given.items() if value is not None}
    if not words.keys() - {"pivot"}:
        raise InputError(
            "move",
            words,
            "there is no motion",
            "pass rotate, translate or matrix, or use hold(region) to keep the region in place",
        )
    return _handle(region, words, name, weight)


def _handle(region: Field, words: Mapping[str, Any], name: str, weight: float) -> Handle:
    if not isinstance(region, Field):
        raise InputError(
            "region",
            region,
            "not a field",
            "pass e.g. fields.above(0.6), or a box or sphere around the part to grab",
        )
    if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0 < weight < np.inf:
        raise InputError("weight", weight, "not a positive number", "pass e.g. 1.0")
    return Handle(region, rigid_motion(**words), name or repr(region), float(weight), words)


def refuse_equal_names(handles: Sequence[Handle]) -> None:
    """Raise `InputError` if two handles have one name: reports and editors go by it."""
    names = [handle.name for handle in handles]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError("handles", twice, "two handles have this name", "name them apart")


def load_handles(path: str | Path) -> tuple[list[Handle], dict[str, Any]]:
    """Read a handle file.

    Returns:
        The handles, and the options of its ``[solve]`` table.

    Raises:
        InputError: the file is missing, is no TOML, or holds words that are not known.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            "handles", str(path), f"the file cannot be read ({error.strerror})", "check the path"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(
            "handles", str(path), f"not a TOML file: {error}", "mend the line it names"
        ) from error
    unknown = sorted(content.keys() - {"handle", "solve", "editor"})
    if unknown:
        raise InputError(
            "handles",
            str(path),
            f"unknown table {unknown[0]!r}",
            "write handles as [[handle]] and options as [solve]",
        )
    tables = content.get("handle", [])
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables) or not tables:
        raise InputError(
            "handles", str(path), "no [[handle]] table", "add one a region to hold or move"
        )
    handles = [_from_table(table, f"{path.name}, handle {i + 1}") for i, table in enumerate(tables)]
    solve = content.get("solve", {})
    if not isinstance(solve, dict):
        raise InputError("solve", solve, f"{path.name}: not a table", "write options under [solve]")
    return handles, dict(solve)


def save_handles(
    path: str | Path,
    handles: Iterable[Handle],
    solve: Mapping[str, Any] | None = None,
    editor: Mapping[str, Any] | None = None,
) -> None:
    """Write a handle file that `load_handles` reads back.

    Args:
        path: where to.
        handles: what is held and moved.
        solve: options of the elastic solve.
        editor: what the browser editor keeps there.

    Raises:
        InputError: a region was made by a function that no text can name.
    """
    from implicit_warp.files import atomic_write

    blocks = []
    for handle in handles:
        text = region_text(handle.region, handle.name)
        lines = ["[[handle]]", f"name = {_toml(handle.name)}", f"region = {_toml(text)}"]
        if handle.is_held:
            lines.append("hold = true")
        lines.extend(f"{key} = {_toml(value)}" for key, value in handle.words.items())
        if handle.weight != 1.0:
            lines.append(f"weight = {_toml(handle.weight)}")
        blocks.append("\n".join(lines))
    for name, table in (("solve", solve), ("editor", editor)):
        if table:
            blocks.append(
                "\n".join([f"[{name}]", *(f"{k} = {_toml(v)}" for k, v in table.items())])
            )
    with atomic_write(path) as temporary:
        temporary.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")


def region_text(region: Field, name: str) -> str:
    """A region as the text that `fields.parse` reads.

    Args:
        region: the region.
        name: what it is called in errors.

    Raises:
        InputError: it was made by a function that no text can name.
    """
    text = repr(region)
    try:
        fields.parse(text)
    except InputError as error:
        raise InputError(
            "handles",
            text,
            f"the region of {name!r} cannot be written as text",
            "build it from the fields vocabulary",
        ) from error
    return text


def _from_table(table: Mapping[str, Any], where: str) -> Handle:
    unknown = sorted(table.keys() - _WORDS)
    if unknown:
        raise InputError(
            unknown[0],
            table[unknown[0]],
            f"{where} does not know this word",
            f"use {', '.join(sorted(_WORDS))}",
        )
    if not isinstance(table.get("region"), str):
        raise InputError(
            "region",
            table.get("region"),
            f"{where} needs a region, written as text",
            'write e.g. region = "above(0.6)"',
        )
    try:
        region = fields.parse(table["region"])
    except InputError as error:
        raise InputError(
            "region", table["region"], f"{where}: {error.cause}", error.remedy
        ) from error
    motion = {key: table[key] for key in _MOTION_WORDS if key in table}
    name, weight = table.get("name", ""), table.get("weight", 1.0)
    if not isinstance(name, str):
        raise InputError("name", name, f"{where}: not a text", 'write e.g. name = "foot"')
    if not isinstance(table.get("hold", False), bool):
        raise InputError("hold", table["hold"], f"{where}: neither true nor false", "no quotes")
    if table.get("hold", False):
        if motion:
            raise InputError(
                "hold",
                True,
                f"{where} is held and moved at once",
                f"remove hold or {', '.join(motion)}",
            )
        return hold(region, name=name, weight=weight)
    if not motion:
        raise InputError(
            "hold",
            table.get("hold"),
            f"{where} says neither that it is held nor how it moves",
            "write hold = true, or a rotate, translate or matrix",
        )
    return move(region, **motion, name=name, weight=weight)


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # TOML's escapes are JSON's; only "delete" has to be escaped here and not there.
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, Sequence):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, int | np.integer):
        return str(int(value))
    return repr(float(value))
