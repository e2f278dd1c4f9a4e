"""Make a failing case smaller while it still fails.

Greedy: of all cases one step simpler, take the first that fails in the same way, until none does
or the time is over.  A step replaces a scene by one of its parts, drops a part, or moves one number
or word towards its simplest value.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator
from typing import Any

_SIMPLEST = {"layers": 1, "resolution": 2, "detail": 0, "size": 0.5, "seed": 0, "turn": None}
_WORDS = {"frames": "triplane", "shape": "box", "op": "sphere"}


def shrink(case: dict[str, Any], fails: Callable[[dict[str, Any]], bool], seconds: float) -> dict:
    """A case that still fails, no larger than the given one.

    Args:
        case: one that fails.
        fails: does a case fail in the way that is being looked into?
        seconds: no further step is tried after so long.
    """
    end = time.monotonic() + seconds
    smaller = True
    while smaller:
        smaller = False
        for candidate in simpler(case):
            if time.monotonic() > end:
                return case
            if fails(candidate):
                case, smaller = candidate, True
                break
    return case


def simpler(case: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """All cases one step simpler, the largest steps first."""
    for path, value in sorted(_walk(case), key=lambda item: len(item[0])):
        for better in _steps(path, value):
            candidate = copy.deepcopy(case)
            target = candidate
            for key in path[:-1]:
                target = target[key]
            target[path[-1]] = better
            yield candidate


def _walk(value: Any, path: tuple = ()) -> Iterator[tuple[tuple, Any]]:
    if path:
        yield path, value
    items = value.items() if isinstance(value, dict) else ()
    items = enumerate(value) if isinstance(value, list) else items
    for key, entry in items:
        yield from _walk(entry, (*path, key))


def _steps(path: tuple, value: Any) -> Iterator[Any]:
    name = next((key for key in reversed(path) if isinstance(key, str)), "")
    if name == "kind":
        return
    if isinstance(value, dict):
        yield from value.get("parts", ())
    elif isinstance(value, str):
        if name in _WORDS and value != _WORDS[name] and path[-1] == name:
            yield _WORDS[name]
    elif isinstance(value, int | float) and not isinstance(value, bool):
        goal = _SIMPLEST.get(name, 0)
        if value == goal:
            return
        yield goal
        if goal is None:
            return
        if isinstance(value, int):
            middle = goal + (value - goal) // 2
            yield from dict.fromkeys(v for v in (middle, value - 1) if goal < v < value)
        else:
            yield from dict.fromkeys(v for v in (round(value, 1), round(value, 2)) if v != value)
