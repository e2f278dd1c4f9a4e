"""4 See: colours, the shape at rest, sections, layers, self-intersections."""

from __future__ import annotations

import io
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from implicit_warp.affine import Affine
from implicit_warp.color_scales import ColorScale, color_scale
from implicit_warp.distortion import handle_distance, measure_distortion
from implicit_warp.errors import InputError
from implicit_warp.handles import Handle
from implicit_warp.maps import Map
from implicit_warp.viewer import markup
from implicit_warp.viewer.live_solver import Update

if TYPE_CHECKING:
    from implicit_warp.viewer.page import Editor

PLAIN = "Handles"

QUANTITY = {
    "Stretch": "stretch",
    "Squeeze": "squeeze",
    "Volume (det J)": "det",
    "Elastic energy": "energy",
    "Handle error": "error",
}
"""The quantities by their names in the page."""

NO_SECTION, FILLED, LINES = SECTIONS = ("None", "Filled", "Lines")

LINE_COLOURS = ((70, 110, 170), (20, 20, 20), (190, 120, 70))
"""Of lines inside, on the surface, and outside."""

CONTACT = (224, 49, 49)


class ViewPanel:
    """What is shown beside the handles.

    Attributes:
        colour, ghost, section, axis, at, layer, layers, contacts: the controls.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor, self._lock = editor, threading.RLock()
        gui = editor.server.gui
        with gui.add_folder("4  See", expand_by_default=False):
            self.colour = gui.add_dropdown("Colours", (PLAIN, *QUANTITY))
            self._legend = gui.add_html("", visible=False)
            self.ghost = gui.add_checkbox("Rest shape", False)
            self.section = gui.add_dropdown(
                "Section", SECTIONS, hint="The deformed field in a plane"
            )
            self.axis = gui.add_dropdown(
                "Across", ("x", "y", "z"), initial_value="y", visible=False
            )
            self.at = gui.add_slider(
                "At", min=0.0, max=1.0, step=0.01, initial_value=0.5, visible=False
            )
            self.layer = gui.add_slider(
                "Layer", min=0, max=max(editor.solver_options.layers, 1), step=1, initial_value=0,
                hint="The 2D mesh of one layer of the map, in its plane; 0 for none",
            )  # fmt: skip
            self.layers = gui.add_button("All layers", icon="layout-grid")
            self.contacts = gui.add_button("Find self-intersections", icon="search")
            self._found = gui.add_html("", visible=False)
        safe = editor.guarded
        self.colour.on_update(safe(lambda e: self.repaint()))
        self.ghost.on_update(safe(lambda e: self.show_rest()))
        for control in (self.section, self.axis, self.at):
            control.on_update(safe(lambda e: self.show_section()))
        self.layer.on_update(safe(lambda e: self.show_layer()))
        self.layers.on_click(safe(lambda e: self._show_all_layers(e.client)))
        self.contacts.on_click(safe(lambda e: self._show_contacts()))

    @property
    def plain(self) -> bool:
        """Is the mesh in its handles' colours?"""
        return self.colour.value == PLAIN

    # --- the mesh ---

    def repaint(self) -> None:
        """Colour the mesh as the control says, where it is."""
        editor = self._editor
        if self.plain:
            self._legend.visible = False
            editor.shown.show_handles(editor.session.state)
        else:
            update = editor.last
            self._paint(
                editor.shown.vertices,
                Affine() if update is None else update.warp,
                () if update is None else update.handles,
            )

    def follow(self, update: Update) -> None:
        """Show where an update has carried the mesh; what is drawn in the shape follows later."""
        if self.plain:
            self._editor.shown.move(update.vertices)
        else:
            self._paint(update.vertices, update.warp, update.handles)
        self._forget_contacts()
        if not update.running:
            self.refresh()

    def refresh(self) -> None:
        """Draw section and layer anew."""
        self.show_section()
        self.show_layer()

    def _paint(self, vertices: Any, map_: Map, handles: tuple[Handle, ...]) -> None:
        scale, colours = coloured(QUANTITY[self.colour.value], map_, handles, self._editor.rest)
        self._editor.shown.show_colours(vertices, colours)
        self._legend.content, self._legend.visible = markup.legend(scale), True

    def show_rest(self) -> None:
        """The shape at rest as a veil, or not."""
        scene, rest = self._editor.server.scene, self._editor.source.preview
        scene.remove_by_name("/rest")
        if self.ghost.value:
            scene.add_mesh_simple(
                "/rest", np.asarray(rest.vertices), np.asarray(rest.faces), color=(90, 125, 175),
                opacity=0.22, cast_shadow=False, receive_shadow=False,
            )  # fmt: skip

    # --- in the shape ---

    def show_section(self) -> None:
        """The deformed field in a plane, painted or as lines of equal value."""
        kind, editor = self.section.value, self._editor
        with self._lock:
            self.axis.visible = self.at.visible = kind != NO_SECTION
            scene = editor.server.scene
            if kind == NO_SECTION:
                scene.remove_by_name("/section")
                return
            low, high = editor.shown.vertices.min(axis=0), editor.shown.vertices.max(axis=0)
            axis = self.axis.value
            number = "xyz".index(axis)
            at = float(low[number] + self.at.value * (high[number] - low[number]))
            margin = 0.08 * editor.size
            below = margin * np.array([1.0, 1.0, 0.25])  # a shape at rest stands on the floor
            box = np.stack([low - below, high + margin]).astype(np.float64)
            draw = _fill if kind == FILLED else _lines
            draw(scene, editor.deformed_field(), (axis, at), box)

    def show_layer(self) -> None:
        """The 2D mesh of one layer of the map, in its plane."""
        from implicit_warp.layer_pictures import layer_segments

        scene, update = self._editor.server.scene, self._editor.last
        number = int(self.layer.value)
        if number == 0 or update is None:
            scene.remove_by_name("/layer")
            return
        number = min(number, update.warp.n_layers)
        scene.add_line_segments(
            "/layer", layer_segments(update.warp, number).astype(np.float32),
            np.array((52, 96, 150)), line_width=1.5,
        )  # fmt: skip

    def _show_all_layers(self, client: Any) -> None:
        """A window with the 2D meshes of all layers, for the tab that asked."""
        from PIL import Image

        from implicit_warp.layer_pictures import layer_picture

        update = self._editor.last
        if update is None:
            raise InputError("layers", 0, "nothing is moved yet", "move a handle first")
        stream = io.BytesIO()
        layer_picture(update.warp).savefig(stream, dpi=110, format="png")
        window = client.gui.add_modal(f"The {update.warp.n_layers} layers of the map")
        with window:
            client.gui.add_image(np.asarray(Image.open(stream).convert("RGB")), format="png")
            client.gui.add_button("Close").on_click(lambda event: window.close())

    def _show_contacts(self) -> None:
        """Where the preview mesh, as shown, intersects itself."""
        from implicit_warp.checking import check
        from implicit_warp.highlights import self_intersection_highlights

        editor = self._editor
        found = self_intersection_highlights(check(editor.shown.mesh))
        self._forget_contacts()
        if found:
            for name, lines, width in (("faces", found.edges, 1.5), ("lines", found.contacts, 4.0)):
                if len(lines):
                    editor.server.scene.add_line_segments(
                        f"/contacts/{name}", lines.astype(np.float32), np.array(CONTACT),
                        line_width=width,
                    )  # fmt: skip
        pairs = sum(found.kinds.values())
        text = f"{pairs} pairs of faces intersect" if found else "No two faces intersect."
        self._found.content = markup.report(f"Preview mesh: {text}", not found)
        self._found.visible = True

    def _forget_contacts(self) -> None:
        if self._found.visible:
            self._found.visible = False
            self._editor.server.scene.remove_by_name("/contacts")


def coloured(
    quantity: str, map_: Map, handles: tuple[Handle, ...], points: np.ndarray
) -> tuple[ColorScale, np.ndarray]:
    """A scale for what a map does at points (n, 3) at rest, and their colours (n, 4) in it."""
    if quantity == "error":
        if not handles:
            raise InputError("colours", quantity, "there are no handles", "hold or move something")
        values = handle_distance(map_, handles, points)[0]
    else:
        values = measure_distortion(map_, points).quantity(quantity)
    scale = color_scale(quantity, values)
    return scale, scale(values)


def _fill(scene: Any, field: Any, plane: tuple[str, float], box: np.ndarray) -> None:
    from implicit_warp.cross_sections import section_picture

    picture = section_picture(field, plane, 320, bounds=box, opacity=0.7)
    scene.remove_by_name("/section")
    scene.add_image(
        "/section/picture", picture.image, picture.width, picture.height, format="png",
        wxyz=picture.wxyz, position=picture.center, cast_shadow=False, receive_shadow=False,
    )  # fmt: skip


def _lines(scene: Any, field: Any, plane: tuple[str, float], box: np.ndarray) -> None:
    from implicit_warp.cross_sections import as_segments, iso_lines

    step = 0.03 * float(np.linalg.norm(box[1] - box[0]))
    levels = {k * step: k for k in range(-2, 5)}
    found = iso_lines(field, plane, tuple(levels), 96, bounds=box)
    scene.remove_by_name("/section")
    for level, lines in found.items():
        k = levels[level]
        if lines:
            scene.add_line_segments(
                f"/section/{k + 2}", as_segments(lines).astype(np.float32),
                np.array(LINE_COLOURS[int(np.sign(k)) + 1]), line_width=4.0 if k == 0 else 1.5,
            )  # fmt: skip
