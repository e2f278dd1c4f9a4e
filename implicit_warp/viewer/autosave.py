"""What a crash would lose: the handles, kept beside the shape while they change.

The file is a handle file like any other.  It goes when the editor ends as it should, and is offered
again when the editor finds one at its start.
"""

from __future__ import annotations

from pathlib import Path

from implicit_warp.errors import InputError
from implicit_warp.viewer.session import EditSession, save_edit

PERIOD = 60.0
"""Seconds between two looks at whether something has changed."""


class Autosave:
    """Keeps an edit in a file.

    Attributes:
        path: the file.
        left_over: was there one when this began, from an edit that did not end?
    """

    def __init__(self, session: EditSession, shape: Path, folder: Path) -> None:
        self.path = folder / f".{shape.stem}.autosave.toml"
        self.left_over = self.path.exists()
        self._session, self._saved = session, session.revision

    def save_if_changed(self) -> bool:
        """Write the handles if anything has changed since the last time; returns whether."""
        revision, state = self._session.revision, self._session.state
        if revision == self._saved or not state.handles:
            return False
        try:
            save_edit(state, self.path)
        except InputError:  # a region that no text can name: nothing can keep it
            return False
        self._saved = revision
        return True

    def forget(self) -> None:
        """Remove the file: the edit has ended, or is not wanted any more."""
        self.path.unlink(missing_ok=True)
        self.left_over = False
