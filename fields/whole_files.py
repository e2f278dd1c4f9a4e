"""Writing files that are whole or not there: never half of one, also after a crash."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from fields.errors import InputError


@contextlib.contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside the target; rename it on success, remove it on failure.

    The suffix is kept, so that writers which choose a format by suffix work.  A crash leaves the
    old file as it was.

    Raises:
        InputError: the folder does not exist, or the target is a folder.
    """
    path = Path(os.path.realpath(path))  # a link stays a link
    refuse_target(path)
    try:
        # mkstemp makes private files; the result keeps the old file's permissions, or gets those
        # that any new file has.
        handle, name = tempfile.mkstemp(path.suffix, f".{path.stem}.", path.parent)
        os.close(handle)
        mode = path.stat().st_mode & 0o777 if path.exists() else 0o666 & ~_umask()
    except OSError as error:
        raise InputError(
            "path", str(path), f"cannot be written ({error.strerror})", "choose another folder"
        ) from error
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(mode)
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _umask() -> int:
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def refuse_target(path: str | Path, suffixes: Sequence[str] = ()) -> None:
    """Raise `InputError` if a file cannot be written there, before the work that it would hold.

    Args:
        path: where a file is to be written.
        suffixes: the suffixes it may have; any if empty.
    """
    path = Path(path)
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(
            "path", str(path), f"cannot write {path.suffix!r} here", f"use {', '.join(suffixes)}"
        )
    if not path.parent.is_dir():
        raise InputError(
            "path", str(path), "its folder does not exist", f"create {path.parent} first"
        )
    if path.is_dir():
        raise InputError("path", str(path), "this is a folder", "name a file")
    if not os.access(path.parent, os.W_OK):
        raise InputError(
            "path", str(path), "its folder is not writable", "change its permissions or the path"
        )
