"""The page's controls, in the order in which a user needs them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from implicit_warp.viewer.guard import guarded
from implicit_warp.viewer.scene import COLOURS, PLAIN
from implicit_warp.viewer.session import EditState

if TYPE_CHECKING:
    import viser

NO_HANDLE = "none yet"


class Panel:
    """Makes the controls, and shows values in them; what they do is connected elsewhere."""

    def __init__(self, server: viser.ViserServer, size: float, stem: str) -> None:
        gui = server.gui
        gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False,
            brand_color=(52, 96, 150),
        )  # fmt: skip
        gui.set_panel_label(f"implicit_warp: {stem}")
        short = _digits(size)
        self._numbers = gui.add_markdown("*at rest*")
        with gui.add_folder("1  Select"):
            self.tool = gui.add_dropdown(
                "Tool", ("Brush", "Box", "Ball"),
                hint="Brush: click on the shape. Box, Ball: place them, then Pick. "
                "With every tool: hold Shift and draw a rectangle.",
            )  # fmt: skip
            self.picks = gui.add_dropdown("A pick is", ("New", "Add", "Subtract"))
            self.radius = gui.add_slider(
                "Radius", min=short(0.01 * size), max=short(0.4 * size), step=short(0.002 * size),
                initial_value=short(0.12 * size),
            )  # fmt: skip
            self.box_size = gui.add_vector3(
                "Box size", (short(0.25 * size),) * 3, min=(1e-6 * size,) * 3, visible=False
            )
            self.pick = gui.add_button("Pick what is inside", visible=False)
            self.through = gui.add_checkbox(
                "Through", False, hint="Rectangles also pick what is hidden"
            )
            self.edit = gui.add_button_group(
                "Change", ("Grow", "Shrink", "Invert", "Part", "Clear")
            )
            self._picked = gui.add_markdown("Click on the shape.")
        with gui.add_folder("2  Handles"):
            self.hold = gui.add_button("Hold what is picked", hint="It stays where it is")
            self.move = gui.add_button("Move what is picked", hint="It gets a gizmo to drag")
            self.handle = gui.add_dropdown("Handle", (NO_HANDLE,))
            self._about = gui.add_folder(
                "About this handle", expand_by_default=False, visible=False
            )
            with self._about:
                self.name = gui.add_text("Name", "")
                self.weight = gui.add_slider(
                    "Weight", min=0.1, max=10.0, step=0.1, initial_value=1.0
                )
                self.visible = gui.add_checkbox("Coloured", True)
            self.kind = gui.add_button_group("Make it", ("Hold", "Move", "Delete"), visible=False)
        with gui.add_folder("3  Drag"):
            self.translate = gui.add_checkbox("Arrows", True)
            self.rotate = gui.add_checkbox("Rings", True)
            with gui.add_folder("By numbers", expand_by_default=False):
                self.shift = gui.add_vector3("Shift", (0.0, 0.0, 0.0), step=short(0.001 * size))
                self.turn = gui.add_vector3(
                    "Turn", (0.0, 0.0, 0.0), step=0.1, hint="Rotation vector, in degrees"
                )
                self.pivot = gui.add_vector3("Pivot", (0.0, 0.0, 0.0), step=short(0.001 * size))
            self.steps = gui.add_button_group("Edit", ("Undo", "Redo", "Reset", "Stop"))
            self.amount = gui.add_slider("Amount", min=0.0, max=1.0, step=0.01, initial_value=1.0)
            self.play = gui.add_button("Play from rest")
        with gui.add_folder("4  See", expand_by_default=False):
            self.colour = gui.add_dropdown("Colours", COLOURS)
            self._scale = gui.add_markdown("", visible=False)
            self.ghost = gui.add_checkbox("Rest shape", False)
            self.section = gui.add_dropdown("Section", ("None", "x", "y", "z"))
            self.section_at = gui.add_slider("At", min=0.0, max=1.0, step=0.01, initial_value=0.5)
            self.layer = gui.add_slider(
                "Layer", min=0, max=64, step=1, initial_value=0,
                hint="The 2D mesh of one layer of the map; 0 for none",
            )  # fmt: skip
            self.contacts = gui.add_button("Find self-intersections")
        with gui.add_folder("5  Export"):
            self.file = gui.add_text("File", f"{stem}-deformed.stl")
            self.resolution = gui.add_number("Voxels", 192, min=16, max=1024, step=1)
            self.export = gui.add_button("Export the mesh", color=(52, 96, 150))
            self.save = gui.add_button_group("Or save", ("Handles", "Warp", "Picture"))
            self.film = gui.add_button_group("Film", ("Turntable", "Animation"))
            self._bar = gui.add_progress_bar(0.0, visible=False)
            self._said = gui.add_markdown("", visible=False)

    @property
    def colours(self) -> str:
        """What the mesh is coloured by."""
        return self.colour.value

    @property
    def translates(self) -> bool:
        """Does the gizmo have arrows?"""
        return self.translate.value

    @property
    def rotates(self) -> bool:
        """Does the gizmo have rings?"""
        return self.rotate.value

    def show_state(self, state: EditState, picked: float) -> None:
        """The handles and the selection.

        Args:
            state: of the edit.
            picked: share of the surface that is selected.
        """
        kind = self.tool.value
        self.box_size.visible = kind == "Box"
        self.pick.visible = kind in ("Box", "Ball")
        if state.selection is None:
            self._picked.content = "Click on the shape, or hold Shift and draw a rectangle."
        else:
            self._picked.content = f"**{100 * picked:.1f} %** of the surface is picked."
        names = tuple(h.name for h in state.handles) or (NO_HANDLE,)
        if tuple(self.handle.options) != names:
            self.handle.options = names
        active = next((h for h in state.handles if h.name == state.active), None)
        for control in (self._about, self.kind):
            control.visible = active is not None
        if active is None:
            return
        _set(self.handle, active.name)
        _set(self.name, active.name)
        _set(self.weight, active.weight)
        _set(self.visible, active.visible)
        _set(self.shift, active.shift)
        _set(self.turn, active.rotvec)
        _set(self.pivot, active.pivot)

    def show_numbers(self, text: str, running: bool = False) -> None:
        """The line of figures at the top."""
        self._numbers.content = f"**{text} ...**" if running else f"*{text}*"

    def show_scale(self, low: float | None, high: float | None) -> None:
        """What the ends of the colour scale mean; None for no scale."""
        self._scale.visible = low is not None and self.colours != PLAIN
        if low is not None and high is not None:
            self._scale.content = f"blue {low:.3g}, white the rest, red {high:.3g}"

    def show_export(self, share: float, text: str = "") -> None:
        """How far an export is, and what became of it."""
        self._bar.visible = share < 1.0
        self._bar.value = 100.0 * share
        self._said.visible = bool(text)
        if text:
            self._said.content = "\n".join(f"    {line}" for line in text.splitlines())

    def offer_recovery(
        self, recover: Callable[[], None], forget: Callable[[], None], server: Any
    ) -> None:
        """Ask what is to become of an edit that a crash has left."""
        folder = server.gui.add_folder("An edit was left unfinished", order=-1.0)
        with folder:
            yes, no = server.gui.add_button("Go on with it"), server.gui.add_button("Discard it")

        def chosen(action: Callable[[], None]) -> Callable[[Any], None]:
            def act(event: Any) -> None:
                action()
                folder.remove()

            return guarded(server, act)

        yes.on_click(chosen(recover))
        no.on_click(chosen(forget))


def _set(control: Any, value: Any) -> None:
    """Show a value, unless it is shown already: setting one sends a message to every tab."""
    if control.value != value:
        control.value = value


def _digits(size: float) -> Callable[[float], float]:
    """Numbers of about the shape's size, with three digits."""
    return lambda value: float(f"{value:.3g}")
