"""What a crash would lose: the handles, kept beside the shape while they change.

The file is a handle file like any other.  It goes when the editor ends as it should.  An editor
that finds one at its start puts it aside and offers it, until it is taken up or refused.
"""

from __future__ import annotations

import os
from pathlib import Path

from implicit_warp.viewer.session import EditSession, save_edit

PERIOD = 60.0
"""Seconds between two looks at whether something has changed."""


class Autosave:
    """Keeps an edit in a file.

    Attributes:
        path: the file.
        left_over: the file of an edit that did not end, if there is one: the newest.
    """

    def __init__(self, session: EditSession, shape: Path, folder: Path) -> None:
        self.path = folder / f".{shape.stem}.autosave.toml"
        aside = folder / f".{shape.stem}.left-over.toml"
        if self.path.exists():
            os.replace(self.path, aside)
        self.left_over = aside if aside.exists() else None
        self._session, self._saved = session, session.revision

    def save_if_changed(self) -> bool:
        """Write the handles if anything has changed since the last time; returns whether.

        Raises:
            InputError: the folder cannot be written.
        """
        revision, state = self._session.revision, self._session.state
        if revision == self._saved:
            return False
        self._saved = revision  # also if it fails: that is told once a change
        if not state.handles:
            self.path.unlink(missing_ok=True)
            return False
        save_edit(state, self.path)
        return True

    def forget_left_over(self) -> None:
        """Remove what an earlier edit left: it is taken up, or not wanted."""
        if self.left_over is not None:
            self.left_over.unlink(missing_ok=True)
            self.left_over = None

    def end(self) -> None:
        """Remove the file: the edit has ended as it should."""
        self.path.unlink(missing_ok=True)
