"""The editor's page: one shape, one edit, one solver, and the panels that all tabs share.

viser keeps the controls of all tabs in step; every change goes through the session.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fields import Field
from implicit_warp.deformation import deform
from implicit_warp.elastic_solve import ElasticOptions
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.morph import Morph
from implicit_warp.viewer import markup
from implicit_warp.viewer.autosave import PERIOD, Autosave
from implicit_warp.viewer.drag_panel import DragPanel
from implicit_warp.viewer.export_panel import ExportPanel
from implicit_warp.viewer.guard import guarded, tell
from implicit_warp.viewer.handle_panel import HandlePanel
from implicit_warp.viewer.live_solver import LiveSolver, Update
from implicit_warp.viewer.regions import selected
from implicit_warp.viewer.select_panel import SelectPanel
from implicit_warp.viewer.session import (
    EditHandle,
    EditSession,
    EditState,
    load_edit,
    same_task,
    solve_handles,
)
from implicit_warp.viewer.shown import Shown
from implicit_warp.viewer.source import ShapeSource
from implicit_warp.viewer.stage import fit_camera, set_stage
from implicit_warp.viewer.view_panel import ViewPanel
from implicit_warp.warp import Warp

PATIENCE = 120.0
"""Seconds that an export waits for a solve."""

BRAND = (52, 96, 150)

PANEL_WIDTH = 372
"""Pixels."""


def import_viser() -> Any:
    """viser.

    Raises:
        MissingDependency: it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingDependency(
            "viser", "the editor", "Install it with `pip install 'implicit_warp[viewer]'`"
        ) from error
    return viser


class Editor:
    """The editor of one shape, served until it is closed.

    Attributes:
        session: the edit.
        solver: what follows it.
        shown: the mesh in the page.
        select, handles, drag, view, export: the panels.
        url: of the page.
        size: the diagonal of the shape's bounds.
        drags: seconds from a drag's event until its mesh was sent, newest last.
        last: what is shown; None at rest.
        final: the last result of a full solve.

    Args:
        shape: the file to edit.
        handles: a handle file to begin with.
        warp: a file with a map under which the shape is edited.
        host, port: where to listen.
        folder: where files are written.
        options: of the full solve.
    """

    def __init__(
        self,
        shape: str | Path,
        handles: str | Path | None = None,
        *,
        warp: str | Path | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        folder: str | Path = ".",
        options: ElasticOptions | None = None,
    ) -> None:
        viser = import_viser()
        self.folder = Path(folder).resolve()
        self.source = ShapeSource(shape, warp)
        self.inputs = (self.source.path, None if warp is None else Path(warp))
        state, solve = EditState(), {}
        if handles is not None:
            state, solve = load_edit(handles, self.rest)
        self.solver_options = options or ElasticOptions.from_mapping(solve)
        usual = asdict(ElasticOptions())
        self.solve_table = {
            k: v for k, v in asdict(self.solver_options).items() if v != usual[k]
        }  # fmt: skip
        self.session = EditSession(state)
        self.autosave = Autosave(self.session, self.source.path, self.folder, self.inputs[1])
        self.drags: deque[float] = deque(maxlen=1000)
        self.final: Update | None = None
        self.last: Update | None = None
        self._morph: tuple[Update, Morph] | None = None
        self._frames: deque[float] = deque(maxlen=20)
        self._closed = threading.Event()
        bounds = np.asarray(self.source.field.bounds)
        self.size = float(np.linalg.norm(bounds[1] - bounds[0]))

        with contextlib.redirect_stdout(None):  # it prints a banner
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.url = f"http://{host}:{self.server.get_port()}"
        fit_camera(self.server, bounds)
        set_stage(self.server, bounds)
        self.shown = Shown(self.server, self.source.preview)
        self._make_panels()
        self.solver = LiveSolver(
            self.source.field, self.rest, self._on_update, self.tell, self.solver_options
        )
        self.session.listen(self._on_change)
        self._on_change(self.session.state)
        self.say("at rest")
        if state.moves:
            self.solver.solve(solve_handles(state))
        threading.Thread(target=self._watch, name="watch", daemon=True).start()

    def _make_panels(self) -> None:
        gui = self.server.gui
        gui.configure_theme(
            control_width="medium", show_logo=False, show_share_button=False, brand_color=BRAND
        )
        gui.set_panel_label(self.source.path.name)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._status = gui.add_html("")
        if self.autosave.left_over:
            self._offer_recovery()
        self.select = SelectPanel(self)
        self.handles = HandlePanel(self)
        self.drag = DragPanel(self)
        self.view = ViewPanel(self)
        self.export = ExportPanel(self)

    # --- what the panels need ---

    @property
    def rest(self) -> NDArray[np.float64]:
        """(n, 3) the preview mesh's vertices at rest."""
        return np.asarray(self.source.preview.vertices)

    def short(self, value: float) -> float:
        """A number of about the shape's size, with three digits."""
        return float(f"{value:.3g}")

    def guarded(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """A callback whose errors are shown in the page."""
        return guarded(self.server, callback)

    def tell(self, error: BaseException, client: Any = None) -> None:
        """Show an error in one tab, or in all of them."""
        tell(client or self.server, error)

    def change_active(
        self, how: Callable[[EditHandle], EditHandle], merge: str | None = None
    ) -> EditState:
        """Change the handle that is chosen.

        Raises:
            InputError: none is.
        """

        def change(state: EditState) -> EditState:
            if not state.active:
                raise InputError("handle", "", "none is chosen", "hold or move a selection first")
            return state.with_handle(how(state.get(state.active)), state.active)

        return self.session.change(change, merge)

    def deformed_field(self) -> Field:
        """The shape's field as it is shown."""
        return self.source.field if self.last is None else deform(self.source.field, self.last.warp)

    def prepare(self, state: EditState) -> None:
        """Make ready for a drag."""
        self.solver.prepare(solve_handles(state))

    def solve_if_moved(self) -> None:
        """Solve in full if anything is moved, and show the rest shape otherwise."""
        state = self.session.state
        if state.moves:
            self.drag.set_share(1.0)
            self.solver.solve(solve_handles(state))
            return
        self.solver.rest()
        self.last = self.final = None
        self.shown.move(self.rest.astype(np.float32))
        self.view.repaint()
        self.view.refresh()
        self.say("at rest")

    def solved(self) -> Warp | None:
        """The map of a full solve for the handles as they are now; None if nothing moves.

        Raises:
            InputError: the solve did not end.
        """
        state = self.session.state
        if not state.moves:
            return None
        wanted = solve_handles(state)
        self.solver.wait(PATIENCE)
        if self.final is None or not same_task(self.final.handles, wanted):
            self.drag.set_share(1.0)
            self.solver.solve(wanted)
            self.solver.wait(PATIENCE)
        if self.final is None or not same_task(self.final.handles, wanted):
            raise InputError(
                "export", len(wanted), "the solve for these handles did not end",
                "see the message before this, or try again",
            )  # fmt: skip
        return self.final.warp

    def morph(self) -> Morph:
        """The way from rest to the last full solve's map."""
        final = self.final
        if final is None:
            raise InputError("amount", 0, "nothing is solved yet", "move a handle first")
        if self._morph is None or self._morph[0] is not final:
            held = [h.region for h in final.handles if h.is_held]
            inside = [selected(region, self.rest) for region in held]
            points = self.rest[np.any(inside, axis=0)] if inside else None
            self._morph = (final, Morph(final.warp, held=points))
        return self._morph[1]

    def show_share(self, share: float) -> None:
        """Show a share of the motions: on the way to the map of the full solve if there is one for
        these handles, else by following the handles."""
        state, final = self.session.state, self.final
        if not state.moves:
            return
        if final is None or self.solver.busy or not same_task(final.handles, solve_handles(state)):
            self.solver.follow(solve_handles(state, share))
            return
        if share >= 1.0:
            self._on_update(final)
            return
        warp = self.morph()(share)
        vertices = warp(self.rest).astype(np.float32)
        handles = tuple(solve_handles(state, share))
        text = f"{100 * share:.0f} % of the way"
        nan = float("nan")
        self._on_update(Update(vertices, warp, nan, False, True, nan, text, handles))

    # --- life ---

    def run(self) -> None:
        """Serve until interrupted."""
        try:
            self._closed.wait()
        except KeyboardInterrupt:
            pass
        finally:
            self.close()

    def close(self, *, crashed: bool = False) -> None:
        """End the editor; what is saved automatically is removed, unless it `crashed`."""
        self._closed.set()
        self.drag.stop_playing()
        self.solver.close()
        if not crashed:
            self.autosave.end()
        with contextlib.redirect_stdout(None):
            self.server.stop()

    def _watch(self) -> None:
        saved = time.monotonic()
        while not self._closed.wait(1.0):
            try:
                if self.source.changed():
                    self.reload()
                if time.monotonic() - saved > PERIOD:
                    saved = time.monotonic()
                    self.autosave.save_if_changed()
            except Exception as error:  # noqa: BLE001 - told, and the watch goes on
                self.tell(error)

    def reload(self) -> None:
        """Take the shape from its file again; if that is broken, its error is raised first."""
        self.source.reload()
        self.solver.set_shape(self.source.field, self.rest)
        self.shown.set_rest(self.source.preview)
        self.last = self.final = None
        self._on_change(self.session.state)
        self.view.show_rest()
        self.view.repaint()
        self.solve_if_moved()

    def recover(self) -> None:
        """Go on with the edit that was saved automatically; see `Autosave.read_left_over`."""
        state = self.autosave.read_left_over(self.rest)
        self.session.change(lambda _: state)
        self.autosave.save_if_changed()
        self.autosave.forget_left_over()
        self.solve_if_moved()

    def _offer_recovery(self) -> None:
        """Ask what is to become of an edit that a crash has left."""
        gui = self.server.gui
        folder = gui.add_folder("An edit was left unfinished")
        with folder:
            yes, no = gui.add_button("Go on with it"), gui.add_button("Discard it", color="gray")

        def choose(action: Callable[[], None]) -> Callable[[Any], None]:
            def act(event: Any) -> None:
                action()
                folder.remove()

            return self.guarded(act)

        yes.on_click(choose(self.recover))
        no.on_click(choose(self.autosave.forget_left_over))

    # --- the session's changes, and the solver's updates ---

    def _on_change(self, state: EditState) -> None:
        if self.view.plain:
            self.shown.show_handles(state)
        self.select.show(state)
        self.handles.show(state)
        self.drag.show(state)

    def _on_update(self, update: Update) -> None:
        self.last = update
        if update.final:
            self.final = update
        if np.isfinite(update.latency):
            self.drags.append(update.latency)
        self.view.follow(update)
        now = time.monotonic()
        if self._frames and now - self._frames[-1] > 1.0:
            self._frames.clear()
        self._frames.append(now)
        self.say(update.text, update)

    def say(self, text: str, update: Update | None = None) -> None:
        """The line at the top, and the figures of an update below it."""
        error = determinant = loss = rate = "\u2013"
        if update is not None:
            if np.isfinite(update.handle_error):
                error = f"{100 * update.handle_error / self.size:.2g} %"
            if update.final:
                report = update.warp.report
                determinant = f"{report.smallest_determinant:.2g}"
                loss = f"{report.loss['total']:.3g}"
            if update.running and len(self._frames) > 1:
                span = max(self._frames[-1] - self._frames[0], 1e-3)
                rate = f"{(len(self._frames) - 1) / span:.0f} / s"
        figures = (
            ("handle error", error), ("smallest det", determinant), ("loss", loss),
            ("updates", rate),
        )  # fmt: skip
        running = update is not None and update.running
        self._status.content = markup.status(text, running, figures)
