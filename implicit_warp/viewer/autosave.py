"""What a crash would lose: handles and selection, kept beside the shape while they change.

The file is a handle file, whose table ``[editor]`` has the selection and the map that the shape was
edited under; without handles, it has that table only.  It goes when the editor ends as it should.
An editor that finds one at its start puts it aside and offers it, until it is taken up or refused.
"""

from __future__ import annotations

import os
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

import fields
from implicit_warp.errors import InputError
from implicit_warp.handles import region_text, save_handles
from implicit_warp.viewer.session import EditSession, EditState, load_edit

PERIOD = 60.0
"""Seconds between two looks at whether something has changed."""


class Autosave:
    """Keeps an edit in a file.

    Args:
        session: the edit.
        shape: the file that is edited.
        folder: where it is kept.
        warp: the file with the map under which the shape is edited.

    Attributes:
        path: the file.
        left_over: the file of an edit that did not end, if there is one: the newest.
    """

    def __init__(
        self, session: EditSession, shape: Path, folder: Path, warp: Path | None = None
    ) -> None:
        self.path = folder / f".{shape.stem}.autosave.toml"
        aside = folder / f".{shape.stem}.left-over.toml"
        if self.path.exists():
            os.replace(self.path, aside)
        self.left_over = aside if aside.exists() else None
        self._session, self._saved = session, session.revision
        self._warp = "" if warp is None else str(warp.resolve())

    def save_if_changed(self) -> bool:
        """Write the edit if anything has changed since the last time; returns whether.

        Raises:
            InputError: the folder cannot be written.
        """
        revision, state = self._session.revision, self._session.state
        if revision == self._saved:
            return False
        self._saved = revision  # also if it fails: that is told once a change
        if not state.handles and state.selection is None:
            self.path.unlink(missing_ok=True)
            return False
        editor = {"warp": self._warp}
        if state.selection is not None:
            editor["selection"] = region_text(state.selection, "the selection")
        save_handles(self.path, [h.handle() for h in state.handles], editor=editor)
        return True

    def read_left_over(self, vertices: np.ndarray) -> EditState:
        """The edit that did not end.

        Args:
            vertices: (n, 3) of the shape at rest, see `load_edit`.

        Raises:
            InputError: there is none; it was begun under another map; the file is damaged.
        """
        if self.left_over is None:
            raise InputError(
                "edit", None, "no unfinished edit is left", "look in the other tabs: one has it"
            )
        try:
            content = tomllib.loads(self.left_over.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:  # no TOML, no UTF-8
            raise InputError(
                "edit", str(self.left_over), f"it cannot be read ({error})", "discard it"
            ) from error
        editor = content.get("editor", {})
        warp = editor.get("warp", "")
        if warp != self._warp:
            raise InputError(
                "edit",
                warp,
                f"it was begun under the map {warp}" if warp else "it was begun under no map",
                "open the shape again with --warp and that file"
                if warp
                else "open it without --warp",
            )
        state = load_edit(self.left_over, vertices)[0] if "handle" in content else EditState()
        selection = editor.get("selection")
        return state if selection is None else replace(state, selection=fields.parse(selection))

    def forget_left_over(self) -> None:
        """Remove what an earlier edit left: it is taken up, or not wanted."""
        if self.left_over is not None:
            self.left_over.unlink(missing_ok=True)
            self.left_over = None

    def end(self) -> None:
        """Remove the file: the edit has ended as it should."""
        self.path.unlink(missing_ok=True)
