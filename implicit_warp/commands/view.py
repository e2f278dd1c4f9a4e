"""The command ``implicit-warp view``."""

from __future__ import annotations

import webbrowser
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from implicit_warp.commands.common import GOOD, Common, say
from implicit_warp.errors import InputError


@dataclass(frozen=True, kw_only=True)
class View(Common):
    """Open the handle editor in the browser: pick, drag, watch the shape follow, export.

    SHAPE is anything that `deform` takes. Files that the page writes go to the working folder. The
    handle file it saves is the one that `deform --handles` reads, with the same result.

    Example: implicit-warp view part.py --handles part.toml
    """

    shape: Positional[Path]
    """Field script (.py), learned field (.safetensors), volume or mesh file."""
    handles: Path | None = None
    """Handle file (.toml) to begin with."""
    warp: Path | None = None
    """Saved map (.safetensors) under which the shape is edited; the handle file that is saved then
    belongs to the deformed shape: `deform --under`."""
    host: str = "127.0.0.1"
    """Address to listen on; others than this one let other machines in, without a password."""
    port: int = 8080
    """Port to listen on; the next free one if it is taken."""
    browser: bool = True
    """Open the browser."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.viewer.page import Editor

        if not 0 < self.port < 65536:
            raise InputError("port", self.port, "not a port", "pass 1024 to 65535")
        editor = Editor(self.shape, self.handles, warp=self.warp, host=self.host, port=self.port)
        say(f"the editor is at {editor.url} (Ctrl-C ends it)")
        if self.browser:
            webbrowser.open(editor.url)
        editor.run()
        return GOOD
