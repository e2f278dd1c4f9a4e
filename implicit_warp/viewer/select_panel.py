"""1 Select: brush, rectangle, box and ball, and what can be done to what is picked."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from fields import Field
from implicit_warp.errors import InputError
from implicit_warp.viewer import markup, regions
from implicit_warp.viewer.session import EditState
from implicit_warp.viewer.shown import PICKED

if TYPE_CHECKING:
    from implicit_warp.viewer.page import Editor

BRUSH, RECTANGLE, BOX, BALL = TOOLS = ("Brush", "Rectangle", "Box", "Ball")

ADVICE = {
    BRUSH: "Click on the shape.",
    RECTANGLE: "Draw a rectangle around what you want.",
    BOX: "Place the box, then <i>Pick what is inside</i>.",
    BALL: "Place the ball, then <i>Pick what is inside</i>.",
}

STEP = 0.015
"""What Grow and Shrink add and take, of the shape's size."""


class SelectPanel:
    """The selection's controls.

    Attributes:
        tool, picks, radius, box_size, pick, through, edit: the controls.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor, self._volume = editor, None
        gui, size, short = editor.server.gui, editor.size, editor.short
        with gui.add_folder("1  Select"):
            self.tool = gui.add_dropdown(
                "Tool", TOOLS, hint="With every tool, Shift and a drag draw a rectangle"
            )
            self.picks = gui.add_dropdown(
                "A pick is", ("New", "Add", "Subtract"),
                hint="It replaces the selection, is added to it, or taken from it",
            )  # fmt: skip
            self.radius = gui.add_slider(
                "Radius", min=short(0.01 * size), max=short(0.4 * size), step=short(0.002 * size),
                initial_value=short(0.12 * size),
            )  # fmt: skip
            self.box_size = gui.add_vector3(
                "Box size", (short(0.25 * size),) * 3, min=(1e-6 * size,) * 3, visible=False
            )
            self.pick = gui.add_button("Pick what is inside", visible=False)
            self.through = gui.add_checkbox(
                "Through", False, hint="Rectangles also pick what is hidden", visible=False
            )
            self.edit = gui.add_button_group(
                "Selection", ("Grow", "Shrink", "Invert", "Part", "Clear"),
                hint="Part: all that hangs together with what is picked",
            )  # fmt: skip
            self._advice = gui.add_html("")
        scene, safe = editor.server.scene, editor.guarded
        scene.on_click()(safe(self._clicked))
        scene.on_rect_select(modifier="shift")(safe(self._rectangle))
        self._plain = safe(self._rectangle)
        self._drawing = False
        self.tool.on_update(safe(lambda e: self.show_tool()))
        self.box_size.on_update(safe(lambda e: self._show_volume()))
        self.radius.on_update(safe(lambda e: self._show_volume()))
        self.pick.on_click(safe(lambda e: self._pick_volume()))
        self.edit.on_click(safe(lambda e: self.change(e.target.value)))

    def show(self, state: EditState) -> None:
        """What is picked of the surface, or how to pick."""
        if state.selection is None:
            self._say(ADVICE[self.tool.value])
        else:
            share = 100 * float(regions.selected(state.selection, self._editor.rest).mean())
            self._say(f"<b>{share:.1f} %</b> of the surface is picked. Now hold or move it.")

    def _say(self, text: str) -> None:
        content = markup.hint(text)
        if self._advice.content != content:
            self._advice.content = content

    def show_tool(self) -> None:
        """The controls, the advice and the volume of the tool that is chosen."""
        tool, scene = self.tool.value, self._editor.server.scene
        self.radius.visible = tool in (BRUSH, BALL)
        self.box_size.visible = tool == BOX
        self.pick.visible = tool in (BOX, BALL)
        self.through.visible = tool == RECTANGLE
        if (tool == RECTANGLE) != self._drawing:
            self._drawing = tool == RECTANGLE
            if self._drawing:
                scene.on_rect_select()(self._plain)
            else:
                scene.remove_rect_select_callback(self._plain)
        self._show_volume()
        self.show(self._editor.session.state)

    # --- picks ---

    def _clicked(self, event: Any) -> None:
        if self.tool.value != BRUSH:
            return
        editor = self._editor
        point = regions.picked_point(
            editor.source.preview, editor.shown.vertices, event.ray_origin, event.ray_direction
        )
        if point is not None:
            self._take(regions.ball(point, self.radius.value))

    def _rectangle(self, event: Any) -> None:
        camera, editor = event.client.camera, self._editor
        view = regions.Camera(camera.position, camera.wxyz, camera.fov, camera.aspect)
        mask = regions.in_rectangle(
            editor.shown.vertices.astype(np.float64), np.asarray(editor.source.preview.faces), view,
            event.screen_min, event.screen_max, through=self.through.value,
        )  # fmt: skip
        self._take(regions.covering(editor.rest, mask))

    def _take(self, region: Field) -> None:
        how = self.picks.value.lower()
        self._editor.session.change(
            lambda s: replace(s, selection=regions.combined(s.selection, region, how))
        )

    def _pick_volume(self) -> None:
        if self._volume is None:
            raise InputError(
                "Pick", self.tool.value, "this tool has no volume", "choose Box or Ball first"
            )
        place, turn = self._volume.position, self._volume.wxyz
        if self.tool.value == BOX:
            self._take(regions.block(place, turn, self.box_size.value))
        else:
            self._take(regions.ball(place, self.radius.value))

    def change(self, what: str) -> None:
        """Grow, Shrink, Invert, Part or Clear."""
        editor = self._editor

        def changed(state: EditState) -> EditState:
            old, rest = state.selection, editor.rest
            if what == "Clear":
                return state if old is None else replace(state, selection=None)
            if what == "Invert":
                return replace(
                    state, selection=regions.inverted(old, editor.source.field.bounds)
                )  # fmt: skip
            if old is None:
                raise InputError("selection", 0, "nothing is picked", "click on the shape first")
            if what == "Part":
                faces = np.asarray(editor.source.preview.faces)
                mask = regions.part_of(faces, regions.selected(old, rest))
                return replace(state, selection=regions.covering(rest, mask))
            step = STEP * editor.size * (1 if what == "Grow" else -1)
            return replace(state, selection=regions.grown(old, step, rest))

        editor.session.change(changed)

    # --- box and ball ---

    def _show_volume(self) -> None:
        """The box or ball that is picked with, with its gizmo."""
        kind, editor = self.tool.value, self._editor
        scene, old = editor.server.scene, self._volume
        place = np.asarray(editor.source.field.bounds).mean(axis=0)
        turn: Any = (1.0, 0.0, 0.0, 0.0)
        if old is not None:
            place, turn, self._volume = old.position, old.wxyz, None
            old.remove()
        if kind not in (BOX, BALL):
            return
        self._volume = scene.add_transform_controls(
            "/tool", scale=0.14 * editor.size, depth_test=False, position=place, wxyz=turn,
            disable_rotations=kind == BALL,
        )  # fmt: skip
        look = {"color": PICKED, "opacity": 0.3, "cast_shadow": False}
        if kind == BOX:
            scene.add_box("/tool/volume", dimensions=tuple(self.box_size.value), **look)
        else:
            scene.add_icosphere("/tool/volume", radius=self.radius.value, **look)
