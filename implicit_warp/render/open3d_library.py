"""Open3D, imported on use."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from implicit_warp.errors import MissingDependency


def import_open3d(needed_for: str) -> ModuleType:
    """Open3D, or an error that says what needs it and how to get it."""
    try:
        return import_module("open3d")
    except (ImportError, OSError) as error:
        raise MissingDependency(
            "open3d",
            needed_for,
            "Install it with `pip install open3d`; on Debian it also needs the packages "
            f"libusb-1.0-0 libegl1 libgl1 (the import said: {error})",
        ) from error
