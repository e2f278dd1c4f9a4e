"""3 Drag: the gizmo, the motion in numbers, undo and redo, and the way from rest."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from implicit_warp.viewer.controls import assign
from implicit_warp.viewer.regions import selected
from implicit_warp.viewer.session import EditState, solve_handles

if TYPE_CHECKING:
    from implicit_warp.viewer.page import Editor

BOTH, ARROWS, RINGS = GIZMOS = ("Arrows and rings", "Arrows", "Rings")

PIVOTS = ("Middle of handle", "Middle of shape", "Origin", "By numbers")

PLAY_SECONDS, PLAY_RATE = 4.0, 20.0
"""How long the way from rest and back takes, and its pictures a second."""


class DragPanel:
    """The motion's controls, and the gizmo.

    Attributes:
        gizmo, shift, turn, pivot, place, steps, amount, play: the controls.
        share: of the handles' motions that is shown.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor, self._controls = editor, None
        self._playing, self.share = threading.Event(), 1.0
        gui, size, short = editor.server.gui, editor.size, editor.short
        with gui.add_folder("3  Drag"):
            self.gizmo = gui.add_dropdown("Gizmo", GIZMOS)
            self.steps = gui.add_button_group("Edit", ("Undo", "Redo", "Reset", "Stop"))
            self.amount = gui.add_slider(
                "Amount", min=0.0, max=1.0, step=0.01, initial_value=1.0,
                hint="Of the handles' motions: 0 at rest, 1 in full",
            )  # fmt: skip
            self.play = gui.add_button("Play from rest", icon="player-play")
        with editor.handles.about:
            self.shift = gui.add_vector3("Shift", (0.0, 0.0, 0.0), step=short(0.001 * size))
            self.turn = gui.add_vector3(
                "Turn", (0.0, 0.0, 0.0), step=0.1, hint="Rotation vector, in degrees"
            )
            self.place = gui.add_dropdown("Pivot", PIVOTS, hint="What it turns about")
            self.pivot = gui.add_vector3("at", (0.0, 0.0, 0.0), step=short(0.001 * size))
        safe = editor.guarded
        self.gizmo.on_update(safe(lambda e: self.show(editor.session.state)))
        self.shift.on_update(safe(self._typed))
        self.turn.on_update(safe(self._typed))
        self.place.on_update(safe(self._choose_pivot))
        self.pivot.on_update(safe(self._type_pivot))
        self.steps.on_click(safe(lambda e: self.step(e.target.value)))
        self.amount.on_update(safe(self._set_amount))
        self.play.on_click(safe(lambda e: self._play()))
        for what, key, modifier in (
            ("Undo", "Z", "cmd/ctrl"), ("Redo", "Z", "cmd/ctrl+shift"), ("Redo", "Y", "cmd/ctrl"),
        ):  # fmt: skip
            command = gui.add_command(what, hotkey=key, modifier=modifier)
            command.on_trigger(safe(lambda e, w=what: self.step(w)))

    def show(self, state: EditState) -> None:
        """The active handle's gizmo and numbers."""
        handle = state.chosen
        if handle is not None:
            assign(self.shift, "value", handle.shift)
            assign(self.turn, "value", handle.rotvec)
            assign(self.pivot, "value", handle.pivot)
        if handle is None or handle.held:
            if self._controls is not None:
                self._controls.remove()
                self._controls = None
            return
        size = self._editor.size
        position, wxyz = handle.pose()
        if self._controls is None:
            self._controls = self._editor.server.scene.add_transform_controls(
                "/gizmo", scale=0.16 * size, depth_test=False, line_width=3.0,
                position=position, wxyz=wxyz,
            )  # fmt: skip
            self._controls.on_update(self._dragged)
        gizmo = self._controls
        if not (
            np.allclose(gizmo.position, position, atol=1e-7 * size)
            and np.allclose(gizmo.wxyz, wxyz, atol=1e-7)
        ):
            gizmo.position, gizmo.wxyz = position, wxyz
        assign(gizmo, "disable_axes", self.gizmo.value == RINGS)
        assign(gizmo, "disable_sliders", self.gizmo.value == RINGS)
        assign(gizmo, "disable_rotations", self.gizmo.value == ARROWS)

    def set_share(self, share: float) -> None:
        """Show so much of the motions from now on."""
        self.share = share
        assign(self.amount, "value", round(share, 2))

    def stop_playing(self) -> None:
        """End the animation, if it plays."""
        self._playing.clear()

    async def _dragged(self, event: Any) -> None:
        # On the event loop, so that phases arrive in order; nothing here takes long.
        editor = self._editor
        if event.client is None:
            return
        try:
            name = editor.session.state.active
            if not name:
                return
            self.stop_playing()
            if self.share != 1.0:  # the gizmo stands where the whole motion leads
                self.set_share(1.0)
            position, wxyz = event.target.position, event.target.wxyz
            # From the handle as it is within the change: another tab may edit it meanwhile.
            state = editor.session.change(
                lambda s: s.with_handle(s.get(name).posed(position, wxyz)), merge=f"drag {name}"
            )
            if event.phase == "end":
                editor.session.end_merging()
                editor.solver.solve(solve_handles(state))
            else:
                editor.solver.follow(solve_handles(state))
        except Exception as error:  # noqa: BLE001 - shown in the page
            editor.tell(error, event.client)

    def _typed(self, event: Any) -> None:
        shift, turn = (tuple(map(float, c.value)) for c in (self.shift, self.turn))
        self._editor.change_active(
            lambda h: replace(h, shift=shift, rotvec=turn, held=False), "typed"
        )
        self._editor.solve_if_moved()

    def _choose_pivot(self, event: Any) -> None:
        choice, editor = event.target.value, self._editor
        if choice == "Middle of handle":
            region = editor.session.state.get(editor.session.state.active).region
            place = editor.rest[selected(region, editor.rest)].mean(axis=0)
        elif choice == "Middle of shape":
            place = np.asarray(editor.source.field.bounds).mean(axis=0)
        elif choice == "Origin":
            place = np.zeros(3)
        else:
            return
        editor.change_active(lambda h: h.about(np.round(place, 6)))

    def _type_pivot(self, event: Any) -> None:
        place = np.array(event.target.value, np.float64)
        self._editor.change_active(lambda h: h.about(place), "typed pivot")
        self.place.value = "By numbers"

    def step(self, what: str) -> None:
        """Undo, Redo, Reset or Stop."""
        editor = self._editor
        self.stop_playing()
        if what == "Stop":
            editor.solver.stop()
            editor.say("stopped")
            return
        session = editor.session
        {"Undo": session.undo, "Redo": session.redo, "Reset": session.reset}[what]()
        editor.solve_if_moved()

    def _set_amount(self, event: Any) -> None:
        self.stop_playing()
        self.share = float(event.target.value)
        self._editor.show_share(self.share)

    def _play(self) -> None:
        """From rest to the deformed shape and back; a second press ends it."""
        if self._playing.is_set():
            self.stop_playing()
            return
        if not self._editor.session.state.moves:
            return
        self._playing.set()
        self.play.label = "Stop playing"
        start = time.monotonic()
        try:
            while self._playing.is_set():
                at = (time.monotonic() - start) / PLAY_SECONDS
                if at >= 1.0:
                    break
                self.set_share(0.5 - 0.5 * np.cos(2.0 * np.pi * at))
                self._editor.show_share(self.share)
                time.sleep(1.0 / PLAY_RATE)
        finally:
            self._playing.clear()
            self.play.label = "Play from rest"
            self.set_share(1.0)
            self._editor.show_share(1.0)
