"""Arrays in ``.npz`` files: read without pickle, and refused in words when they are damaged."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from implicit_warp.errors import FileFormatError

UNREADABLE = (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile)
"""What numpy raises on damaged or missing arrays."""


def read_arrays(path: Path, names: Sequence[str]) -> dict[str, np.ndarray]:
    """The named arrays of a file; those that it does not have are left out.

    Raises:
        FileFormatError: the file is damaged, or an array needs pickle.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names if name in file}
    except UNREADABLE as error:
        raise FileFormatError(f"{path}: not a readable .npz file ({error})") from error
