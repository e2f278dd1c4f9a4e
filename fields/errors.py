"""Errors that say what was wrong, why that is likely, and what to do.

One class serves both packages (`implicit_warp.errors` re-exports it), so that a
caller can catch every rejected argument with one name, and the command line can
turn it into exit code 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """An argument that cannot be used.

    The message always has the same four parts: which argument, which value, the
    likely cause, and the remedy. They are also attributes, so that a user interface
    can lay them out.

    Args:
        argument: name of the argument as the caller wrote it.
        value: the offending value; long ones are abbreviated in the message.
        cause: what is wrong with it, as a clause without a final full stop.
        remedy: what to do instead, as a clause without a final full stop.
    """

    def __init__(self, argument: str, value: object, cause: str, remedy: str) -> None:
        self.argument = argument
        self.value = value
        self.cause = cause
        self.remedy = remedy
        super().__init__(f"{argument} = {_short(value)}: {cause}. {remedy}.")


class FileFormatError(ValueError):
    """A file is unreadable, truncated, or of a version this library does not know."""


class MissingDependency(ImportError):  # noqa: N818 (named for what is the matter)
    """An optional library that a feature needs is not installed or does not load."""

    def __init__(self, library: str, needed_for: str, remedy: str) -> None:
        self.library = library
        super().__init__(f"{needed_for} needs {library}, which could not be imported. {remedy}.")


@contextmanager
def needing(library: str, needed_for: str) -> Iterator[None]:
    """Around an import: if it fails, say what needs the library and how to get it."""
    try:
        yield
    except ImportError as error:
        raise MissingDependency(
            library,
            needed_for,
            f"Install it with `pip install {library}` (the import said: {error})",
        ) from error


def _short(value: object, limit: int = 120) -> str:
    text = repr(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."
