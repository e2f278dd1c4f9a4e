"""2 Handles: made from the selection, listed with their colours, shown, hidden and removed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from implicit_warp.errors import InputError
from implicit_warp.viewer import markup, regions
from implicit_warp.viewer.controls import assign
from implicit_warp.viewer.session import EditHandle, EditState
from implicit_warp.viewer.shown import handle_colour

if TYPE_CHECKING:
    from implicit_warp.viewer.page import Editor

HELD, MOVED = "held", "moved"

NONE = (0.0, 0.0, 0.0)

_NO_LABEL = "\u00a0"


class HandlePanel:
    """The handles' controls.

    Attributes:
        hold, move, name, weight, kind: the controls.
        about: the folder of what belongs to the handle that is chosen.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor = editor
        self._rows: list[tuple[Any, Any]] = []
        gui = editor.server.gui
        with gui.add_folder("2  Handles") as self._folder:
            self.hold = gui.add_button(
                "Hold what is picked", icon="lock", hint="It stays where it is"
            )
            self.move = gui.add_button(
                "Move what is picked", icon="arrows-move", hint="It gets a gizmo to drag"
            )
            # After the rows, which are made later.
            self.about = gui.add_folder(
                "This handle", expand_by_default=False, visible=False, order=1e9
            )
            with self.about:
                self.name = gui.add_text("Name", "")
                self.kind = gui.add_dropdown("It is", (HELD, MOVED))
                self.weight = gui.add_slider(
                    "Weight", min=0.1, max=10.0, step=0.1, initial_value=1.0
                )
        safe = editor.guarded
        self.hold.on_click(safe(lambda e: self._make(held=True)))
        self.move.on_click(safe(lambda e: self._make(held=False)))
        self.name.on_update(safe(self._rename))
        self.kind.on_update(safe(self._hold_or_move))
        self.weight.on_update(safe(self._weigh))

    def show(self, state: EditState) -> None:
        """One row a handle, and the active one's name, kind and weight."""
        self._match_rows(len(state.handles))
        for number, (handle, (text, buttons)) in enumerate(
            zip(state.handles, self._rows, strict=True)
        ):
            colour = handle_colour(number) if handle.visible else (206, 212, 218)
            active = handle.name == state.active
            row = markup.handle_row(
                handle.name, colour, handle.weight, held=handle.held, active=active
            )
            assign(text, "content", row)
            assign(buttons, "options", ("Edit", "Hide" if handle.visible else "Show", "Delete"))
        handle = state.chosen
        assign(self.about, "visible", handle is not None)
        if handle is not None:
            assign(self.name, "value", handle.name)
            assign(self.kind, "value", HELD if handle.held else MOVED)
            assign(self.weight, "value", handle.weight)

    def _match_rows(self, count: int) -> None:
        gui = self._editor.server.gui
        while len(self._rows) > count:
            for part in self._rows.pop():
                part.remove()
        with self._folder:
            while len(self._rows) < count:
                number = len(self._rows)
                text = gui.add_html("")
                buttons = gui.add_button_group(_NO_LABEL, ("Edit", "Hide", "Delete"))
                buttons.on_click(
                    self._editor.guarded(lambda e, n=number: self._act(n, e.target.value))
                )
                self._rows.append((text, buttons))

    # --- what the controls do ---

    def _make(self, *, held: bool) -> None:
        editor = self._editor

        def change(state: EditState) -> EditState:
            rest = editor.rest
            mask = regions.selected(state.selection, rest)
            if not mask.any():
                raise InputError(
                    "selection", 0, "nothing is picked",
                    "click on the shape with the brush, or hold Shift and draw a rectangle",
                )  # fmt: skip
            middle = np.round(rest[mask].mean(axis=0), 6)
            name = state.free_name(HELD if held else MOVED)
            handle = EditHandle(name, state.selection, tuple(map(float, middle)), held)
            return replace(state.with_handle(handle), selection=None)

        state = editor.session.change(change)
        if state.displaced:  # with one more handle, what is shown is not the result any more
            editor.solve_if_moved()
        else:
            editor.prepare(state)

    def _act(self, number: int, what: str) -> None:
        handles = self._editor.session.state.handles
        if number >= len(handles):  # another tab was faster
            return
        name, session = handles[number].name, self._editor.session
        if what == "Edit":
            session.change(lambda s: replace(s, active=name))
        elif what == "Delete":
            session.change(lambda s: s.without(name))
            self._editor.solve_if_moved()
        else:
            visible = what == "Show"
            session.change(lambda s: s.with_handle(replace(s.get(name), visible=visible)))

    def _rename(self, event: Any) -> None:
        name, active = event.target.value.strip(), self._editor.session.state.active
        if name and active and name != active:
            self._editor.change_active(lambda h: replace(h, name=name))

    def _hold_or_move(self, event: Any) -> None:
        held = event.target.value == HELD

        def change(handle: EditHandle) -> EditHandle:
            return replace(handle, held=True, rotvec=NONE, shift=NONE) if held else replace(
                handle, held=False
            )  # fmt: skip

        self._editor.change_active(change)
        self._editor.solve_if_moved()

    def _weigh(self, event: Any) -> None:
        weight = float(event.target.value)
        self._editor.change_active(lambda h: replace(h, weight=weight), "weight")
        self._editor.solve_if_moved()
