"""The editor's page: what its controls do, and what the solver's updates change in it.

All tabs share one set of controls, which viser keeps in step, and one session.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from implicit_warp.elastic_solve import ElasticOptions
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.files import save
from implicit_warp.viewer import regions
from implicit_warp.viewer.autosave import PERIOD, Autosave
from implicit_warp.viewer.export import MESHES, export_mesh, inside
from implicit_warp.viewer.guard import guarded, tell
from implicit_warp.viewer.live_solver import LiveSolver, Update
from implicit_warp.viewer.panel import Panel
from implicit_warp.viewer.scene import PLAIN, Shown, fit_camera, set_stage
from implicit_warp.viewer.session import (
    EditHandle,
    EditSession,
    EditState,
    load_edit,
    same_task,
    save_edit,
    solve_handles,
)
from implicit_warp.viewer.source import ShapeSource
from implicit_warp.warp import Warp


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
        url: of the page.
        drags: (seconds from a drag's event until its mesh was sent), newest last.
        final: the last result of a full solve.

    Args:
        shape: the file to edit.
        handles: a handle file to begin with.
        warp: a saved map, under which the shape is edited.
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
        self._sources = (self.source.path, None if warp is None else Path(warp))
        state, solve = EditState(), {}
        if handles is not None:
            state, solve = load_edit(handles, np.asarray(self.source.preview.vertices))
        options = options or ElasticOptions.from_mapping(solve)
        usual = asdict(ElasticOptions())
        self._solve_table = {k: v for k, v in asdict(options).items() if v != usual[k]}
        self.session = EditSession(state)
        self.autosave = Autosave(self.session, self.source.path, self.folder)
        self.drags: deque[float] = deque(maxlen=1000)
        self.final: Update | None = None
        self.last: Update | None = None
        self._amount, self._playing = 1.0, threading.Event()
        self._exporting = threading.Lock()
        self._frames: deque[float] = deque(maxlen=20)
        self._closed = threading.Event()

        with contextlib.redirect_stdout(None):  # it prints a banner
            self.server = viser.ViserServer(host=host, port=port, verbose=False)
        self.url = f"http://{host}:{self.server.get_port()}"
        bounds = np.asarray(self.source.field.bounds)
        self.size = float(np.linalg.norm(bounds[1] - bounds[0]))
        fit_camera(self.server, bounds)
        set_stage(self.server, bounds)
        self.shown = Shown(self.server, self.source.preview)
        self._gizmo: Any = None
        self._tool: Any = None
        self.panel = Panel(self.server, self.size, self.source.path.stem)
        self.solver = LiveSolver(
            self.source.field, np.asarray(self.source.preview.vertices), self._on_update,
            lambda error: tell(self.server, error), options,
        )  # fmt: skip
        self._connect()
        self.session.listen(self._on_change)
        self._on_change(self.session.state)
        if state.moves:
            self.solver.solve(solve_handles(state))
        if self.autosave.left_over:
            self.panel.offer_recovery(self.recover, self.autosave.forget_left_over, self.server)
        threading.Thread(target=self._watch, name="watch", daemon=True).start()

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
        self._playing.clear()
        self.solver.close()
        if not crashed:
            self.autosave.end()
        with contextlib.redirect_stdout(None):
            self.server.stop()

    def _watch(self) -> None:
        saved = time.monotonic()
        while not self._closed.wait(1.0):
            if self.source.changed():
                self.reload()
            if time.monotonic() - saved > PERIOD:
                saved = time.monotonic()
                try:
                    self.autosave.save_if_changed()
                except Exception as error:  # noqa: BLE001 - told, and the watch goes on
                    tell(self.server, error)

    def reload(self) -> None:
        """Take the shape from its file again; a broken file leaves it, and is told of."""
        try:
            self.source.reload()
        except Exception as error:  # noqa: BLE001 - a script may raise anything
            tell(self.server, error)
            return
        self.solver.set_shape(self.source.field, np.asarray(self.source.preview.vertices))
        self.shown.set_rest(self.source.preview)
        self.last = self.final = None
        self._on_change(self.session.state)
        self.solve_if_moved()

    def recover(self) -> None:
        """Go on with the edit that was saved automatically."""
        if self.autosave.left_over is None:
            return
        state, _ = load_edit(self.autosave.left_over, np.asarray(self.source.preview.vertices))
        self.session.change(lambda _: state)
        self.autosave.save_if_changed()
        self.autosave.forget_left_over()
        self.solve_if_moved()

    # --- the session's changes ---

    def _on_change(self, state: EditState) -> None:
        if self.panel.colours == PLAIN:
            self.shown.paint(state)
        rest = np.asarray(self.source.preview.vertices)
        picked = float(regions.selected(state.selection, rest).mean())
        self.panel.show_state(state, picked)
        self._show_gizmo(state)

    def _show_gizmo(self, state: EditState) -> None:
        handle = next((h for h in state.handles if h.name == state.active and not h.held), None)
        if handle is None:
            if self._gizmo is not None:
                self._gizmo.remove()
                self._gizmo = None
            return
        position, wxyz = handle.pose()
        if self._gizmo is None:
            self._gizmo = self.server.scene.add_transform_controls(
                "/gizmo", scale=0.16 * self.size, depth_test=False, line_width=3.0,
                position=position, wxyz=wxyz,
            )  # fmt: skip
            self._gizmo.on_update(self._on_gizmo)
        elif not np.allclose(
            self._gizmo.position, position, atol=1e-7 * self.size
        ) or not np.allclose(self._gizmo.wxyz, wxyz, atol=1e-7):
            self._gizmo.position, self._gizmo.wxyz = position, wxyz
        self._gizmo.disable_axes = self._gizmo.disable_sliders = not self.panel.translates
        self._gizmo.disable_rotations = not self.panel.rotates

    async def _on_gizmo(self, event: Any) -> None:
        # On the event loop, so that phases arrive in order; nothing here takes long.
        if event.client is None:
            return
        try:
            name = self.session.state.active
            if not name:
                return
            position, wxyz = event.target.position, event.target.wxyz
            # From the handle as it is within the change: another tab may edit it meanwhile.
            state = self.session.change(
                lambda s: s.with_handle(s.get(name).posed(position, wxyz)), merge=f"drag {name}"
            )
            if event.phase == "end":
                self.session.end_merging()
                self.solver.solve(solve_handles(state, self._amount))
            else:
                self.solver.follow(solve_handles(state, self._amount))
        except Exception as error:  # noqa: BLE001 - shown in the page
            tell(event.client, error)

    def solve_if_moved(self) -> None:
        """Solve in full if anything is moved, and show the rest shape otherwise."""
        state = self.session.state
        if state.moves:
            self.solver.solve(solve_handles(state, self._amount))
        else:
            self.solver.rest()
            self.last = self.final = None
            self.shown.move(np.asarray(self.source.preview.vertices, np.float32))
            self.panel.show_numbers("at rest")

    # --- the solver's updates ---

    def _on_update(self, update: Update) -> None:
        self.last = update
        if update.final:
            self.final = update
        self.shown.move(update.vertices)
        if np.isfinite(update.latency):
            self.drags.append(update.latency)
        now = time.monotonic()
        self._frames.append(now)
        if self.panel.colours != PLAIN and not update.running:
            self._paint_distortion()
        rate = (len(self._frames) - 1) / max(now - self._frames[0], 1e-3)
        parts = [update.text]
        if np.isfinite(update.handle_error):
            parts.append(f"handle error {100 * update.handle_error / self.size:.2g} % of the size")
        if update.final:
            parts.append(f"smallest det J {update.warp.report.smallest_determinant:.2g}")
        elif update.running:
            parts.append(f"{rate:.0f} updates a second")
        self.panel.show_numbers(", ".join(parts), update.running)

    def _paint_distortion(self) -> None:
        warp = None if self.last is None else self.last.warp
        handles = [h.handle(self._amount) for h in self.session.state.handles]
        low, high = self.shown.paint_distortion(warp, self.panel.colours, handles)
        self.panel.show_scale(low, high)

    # --- controls ---

    def _connect(self) -> None:
        p, safe = self.panel, lambda f: guarded(self.server, f)
        self.server.scene.on_click()(safe(self._clicked))
        self.server.scene.on_rect_select(modifier="shift")(safe(self._rectangle))
        p.tool.on_update(safe(lambda e: self._show_tool()))
        p.box_size.on_update(safe(lambda e: self._show_tool()))
        p.radius.on_update(safe(lambda e: self._show_tool()))
        p.pick.on_click(safe(lambda e: self._pick_volume()))
        p.edit.on_click(safe(lambda e: self._edit_selection(e.target.value)))
        p.hold.on_click(safe(lambda e: self._make_handle(held=True)))
        p.move.on_click(safe(lambda e: self._make_handle(held=False)))
        p.handle.on_update(safe(self._activate))
        p.name.on_update(safe(self._rename))
        p.weight.on_update(safe(self._weigh))
        p.visible.on_update(safe(self._show_or_hide))
        p.kind.on_click(safe(lambda e: self._handle_action(e.target.value)))
        for control in (p.translate, p.rotate):
            control.on_update(safe(lambda e: self._show_gizmo(self.session.state)))
        for control in (p.shift, p.turn, p.pivot):
            control.on_update(safe(self._typed))
        p.steps.on_click(safe(lambda e: self._step(e.target.value)))
        p.amount.on_update(safe(self._set_amount))
        p.play.on_click(safe(lambda e: self._play()))
        p.colour.on_update(safe(lambda e: self._recolour()))
        p.ghost.on_update(safe(lambda e: self._show_ghost()))
        p.contacts.on_click(safe(lambda e: self._show_contacts()))
        p.section.on_update(safe(lambda e: self._show_section()))
        p.section_at.on_update(safe(lambda e: self._show_section()))
        p.layer.on_update(safe(lambda e: self._show_layer()))
        p.film.on_click(safe(lambda e: self._film(e.target.value, e.client)))
        p.export.on_click(safe(self._export))
        p.save.on_click(safe(lambda e: self._save(e.target.value, e.client)))

    def _clicked(self, event: Any) -> None:
        if self.panel.tool.value != "Brush":
            return
        point = regions.picked_point(
            self.source.preview, self.shown.vertices, event.ray_origin, event.ray_direction
        )
        if point is not None:
            self._select(regions.ball(point, self.panel.radius.value))

    def _rectangle(self, event: Any) -> None:
        camera = event.client.camera
        view = regions.Camera(camera.position, camera.wxyz, camera.fov, camera.aspect)
        mask = regions.in_rectangle(
            self.shown.vertices.astype(np.float64), np.asarray(self.source.preview.faces), view,
            event.screen_min, event.screen_max, through=self.panel.through.value,
        )  # fmt: skip
        self._select(regions.covering(np.asarray(self.source.preview.vertices), mask))

    def _select(self, region: Any) -> None:
        how = self.panel.picks.value.lower()
        self.session.change(
            lambda s: _replace(s, selection=regions.combined(s.selection, region, how))
        )

    def _show_tool(self) -> None:
        """The box or ball that is picked with, with its gizmo."""
        kind = self.panel.tool.value
        pose = None if self._tool is None else (self._tool.position, self._tool.wxyz)
        if self._tool is not None:
            self._tool.remove()
            self._tool = None
        if kind not in ("Box", "Ball"):
            return
        centre = np.asarray(self.source.field.bounds).mean(axis=0)
        position, wxyz = pose or (centre, (1.0, 0.0, 0.0, 0.0))
        self._tool = self.server.scene.add_transform_controls(
            "/tool", scale=0.14 * self.size, depth_test=False, position=position, wxyz=wxyz,
            disable_rotations=kind == "Ball",
        )  # fmt: skip
        if kind == "Box":
            self.server.scene.add_box(
                "/tool/volume", dimensions=tuple(self.panel.box_size.value), color=(252, 196, 60),
                opacity=0.3, cast_shadow=False,
            )  # fmt: skip
        else:
            self.server.scene.add_icosphere(
                "/tool/volume", radius=self.panel.radius.value, color=(252, 196, 60), opacity=0.3,
                cast_shadow=False,
            )  # fmt: skip

    def _pick_volume(self) -> None:
        if self._tool is None:
            raise InputError(
                "Pick", self.panel.tool.value, "this tool has no volume", "choose Box or Ball first"
            )
        if self.panel.tool.value == "Box":
            size = self.panel.box_size.value
            self._select(regions.block(self._tool.position, self._tool.wxyz, size))
        else:
            self._select(regions.ball(self._tool.position, self.panel.radius.value))

    def _edit_selection(self, what: str) -> None:
        def change(state: EditState) -> EditState:
            old, rest = state.selection, np.asarray(self.source.preview.vertices)
            if what == "Clear":
                return _replace(state, selection=None)
            if what == "Invert":
                bounds = self.source.field.bounds
                return _replace(state, selection=regions.inverted(old, bounds))
            if old is None:
                raise InputError("selection", 0, "nothing is picked", "click on the shape first")
            if what == "Part":
                mask = regions.part_of(
                    np.asarray(self.source.preview.faces), regions.selected(old, rest)
                )
                return _replace(state, selection=regions.covering(rest, mask))
            step = 0.015 * self.size * (1 if what == "Grow" else -1)
            return _replace(state, selection=regions.grown(old, step, rest))

        self.session.change(change)

    def _make_handle(self, *, held: bool) -> None:
        def change(state: EditState) -> EditState:
            rest = np.asarray(self.source.preview.vertices)
            mask = regions.selected(state.selection, rest)
            if not mask.any():
                raise InputError(
                    "selection", 0, "nothing is picked",
                    "click on the shape with the brush, or hold Shift and draw a rectangle",
                )  # fmt: skip
            middle = np.round(rest[mask].mean(axis=0), 6)
            name = state.free_name("held" if held else "moved")
            handle = EditHandle(name, state.selection, tuple(map(float, middle)), held)
            return _replace(state.with_handle(handle), selection=None)

        state = self.session.change(change)
        if state.displaced:  # with one more handle, what is shown is not the result any more
            self.solver.solve(solve_handles(state, self._amount))
        else:
            self.solver.prepare(solve_handles(state))

    def _activate(self, event: Any) -> None:
        name = event.target.value
        if any(h.name == name for h in self.session.state.handles):
            self.session.change(lambda s: _replace(s, active=name))

    def _with_active(self, how: Any, merge: str | None = None) -> EditState:
        def change(state: EditState) -> EditState:
            if not state.active:
                raise InputError("handle", "", "none is chosen", "hold or move a selection first")
            return state.with_handle(how(state.get(state.active)), state.active)

        return self.session.change(change, merge)

    def _rename(self, event: Any) -> None:
        name = event.target.value.strip()
        if name and name != self.session.state.active and self.session.state.active:
            self._with_active(lambda h: _replace(h, name=name))

    def _weigh(self, event: Any) -> None:
        self._with_active(lambda h: _replace(h, weight=float(event.target.value)), "weight")
        self.solve_if_moved()

    def _show_or_hide(self, event: Any) -> None:
        self._with_active(lambda h: _replace(h, visible=bool(event.target.value)))

    def _handle_action(self, what: str) -> None:
        if what == "Delete":
            self.session.change(lambda s: s.without(s.active))
        elif what == "Hold":
            none = (0.0, 0.0, 0.0)
            self._with_active(lambda h: _replace(h, held=True, rotvec=none, shift=none))
        else:
            self._with_active(lambda h: _replace(h, held=False))
        self.solve_if_moved()

    def _typed(self, event: Any) -> None:
        p = self.panel
        shift, turn, pivot = (tuple(map(float, c.value)) for c in (p.shift, p.turn, p.pivot))
        self._with_active(
            lambda h: _replace(h, shift=shift, rotvec=turn, pivot=pivot, held=False), "typed"
        )
        self.solve_if_moved()

    def _step(self, what: str) -> None:
        if what == "Stop":
            self._playing.clear()
            self.solver.stop()
            self.panel.show_numbers("stopped")
            return
        {"Undo": self.session.undo, "Redo": self.session.redo, "Reset": self.session.reset}[what]()
        self.solve_if_moved()

    def _set_amount(self, event: Any) -> None:
        self._amount = float(event.target.value)
        if self.session.state.moves:
            self.solver.follow(solve_handles(self.session.state, self._amount))

    def _play(self) -> None:
        """From rest to the deformed shape and back, each frame a map of its own."""
        if not self.session.state.moves or self._playing.is_set():
            return
        self._playing.set()
        count = 60
        for frame in range(2 * count + 1):
            if not self._playing.is_set():
                break
            share = 1.0 - abs(frame - count) / count
            self._amount = 0.5 - 0.5 * np.cos(np.pi * share)
            self.panel.amount.value = round(self._amount, 2)
            self.solver.follow(solve_handles(self.session.state, self._amount))
            time.sleep(1 / 20)
        self._playing.clear()
        self._amount = self.panel.amount.value = 1.0
        self.solve_if_moved()

    def _recolour(self) -> None:
        if self.panel.colours == PLAIN:
            self.panel.show_scale(None, None)
            self.shown.repaint(self.session.state)
        else:
            self._paint_distortion()

    def _show_layer(self) -> None:
        """The 2D mesh of one layer of the map, in its plane."""
        from implicit_warp.layer_pictures import layer_segments

        self.server.scene.remove_by_name("/layer")
        number = int(self.panel.layer.value)
        if number == 0 or self.last is None:
            return
        number = min(number, self.last.warp.n_layers)
        self.server.scene.add_line_segments(
            "/layer", layer_segments(self.last.warp, number).astype(np.float32),
            np.array((52, 96, 150)), line_width=1.5,
        )  # fmt: skip

    def _show_ghost(self) -> None:
        rest = self.source.preview
        if self.panel.ghost.value:
            self.server.scene.add_mesh_simple(
                "/ghost", np.asarray(rest.vertices), np.asarray(rest.faces), color=(120, 150, 190),
                opacity=0.18, cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
        else:
            self.server.scene.remove_by_name("/ghost")

    def _show_contacts(self) -> None:
        """Where the preview mesh, as shown, meets itself: the faces' edges in red."""
        from implicit_warp.checking.self_intersection import self_intersections

        faces = np.asarray(self.source.preview.faces)
        vertices = self.shown.vertices.astype(np.float64)
        pairs = self_intersections(vertices, faces).pairs
        self.server.scene.remove_by_name("/contacts")
        bad = np.unique(pairs)
        if len(bad):
            ends = faces[bad][:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
            self.server.scene.add_line_segments(
                "/contacts", vertices[ends].astype(np.float32), np.array((220, 30, 30)),
                line_width=3.0,
            )  # fmt: skip
        text = "no two faces intersect" if not len(pairs) else f"{len(pairs)} pairs intersect"
        self.panel.show_numbers(f"preview mesh: {text}")

    def _show_section(self) -> None:
        """Iso-lines of the warped field in a plane."""
        from implicit_warp.cross_sections import as_segments, iso_lines
        from implicit_warp.deformation import deform

        self.server.scene.remove_by_name("/section")
        axis = self.panel.section.value
        if axis == "None":
            return
        field = self.source.field
        if self.last is not None:
            field = deform(field, self.last.warp)
        low, high = np.asarray(field.bounds)
        number = "xyz".index(axis)
        at = low[number] + self.panel.section_at.value * (high[number] - low[number])
        step = 0.04 * self.size
        levels = {k * step: k for k in range(-2, 5)}
        for level, lines in iso_lines(field, (axis, float(at)), tuple(levels), 96).items():
            k = levels[level]
            colour = (20, 20, 20) if k == 0 else (70, 110, 170) if k < 0 else (190, 120, 70)
            if lines:
                self.server.scene.add_line_segments(
                    f"/section/{k + 2}", as_segments(lines).astype(np.float32), np.array(colour),
                    line_width=4.0 if k == 0 else 1.5,
                )  # fmt: skip

    # --- files ---

    def _export(self, event: Any) -> None:
        path = inside(self.folder, self.panel.file.value, MESHES, keep=self._sources)
        if not self._exporting.acquire(blocking=False):
            raise InputError("export", str(path), "another export is running", "wait for it to end")
        try:
            warp = self._solved()
            self.panel.show_export(0.0)
            report = export_mesh(
                self.source.field, warp, path, int(self.panel.resolution.value),
                lambda done, total: self.panel.show_export(done / total),
            )  # fmt: skip
            self.panel.show_export(1.0, str(report))
            event.client.send_file_download(path.name, path.read_bytes())
        finally:
            self._exporting.release()

    def _solved(self) -> Warp | None:
        """The map of a full solve for the handles as they are now; None if nothing moves."""
        state = self.session.state
        if not state.moves:
            return None
        wanted = solve_handles(state)
        self.solver.wait(120)
        if self.final is None or not same_task(self.final.handles, wanted):
            self._amount = self.panel.amount.value = 1.0
            self.solver.solve(wanted)
            self.solver.wait(120)
        if self.final is None or not same_task(self.final.handles, wanted):
            raise InputError(
                "export", len(wanted), "the solve for these handles did not end",
                "see the message before this, or try again",
            )  # fmt: skip
        return self.final.warp

    def _save(self, what: str, client: Any) -> None:
        stem = Path(self.panel.file.value.strip() or "edit").stem
        suffix = {"Handles": ".toml", "Warp": ".safetensors"}.get(what, ".png")
        path = inside(self.folder, f"{stem}{suffix}", (suffix,), keep=self._sources)
        if what == "Handles":
            save_edit(self.session.state, path, self._solve_table)
        elif what == "Warp":
            warp = self._solved()
            if warp is None:
                raise InputError("warp", 0, "nothing is moved yet", "move a handle first")
            save(warp, path)
        else:
            self._picture(path)
        self.panel.show_export(1.0, f"wrote {path.name}")
        client.send_file_download(path.name, path.read_bytes())

    def _film(self, what: str, client: Any) -> None:
        """A turn around the shape as it is shown, or its way from rest and back."""
        import trimesh

        from implicit_warp.film_files import write_film
        from implicit_warp.films import animation, turntable
        from implicit_warp.morph import Morph

        stem = Path(self.panel.file.value.strip() or "edit").stem
        path = inside(self.folder, f"{stem}-{what.lower()}.mp4", (".mp4",))
        rest = self.source.preview
        if what == "Turntable":
            now = trimesh.Trimesh(self.shown.vertices, np.asarray(rest.faces), process=False)
            film = turntable(now)
        elif self.last is None:
            raise InputError("film", what, "nothing is moved yet", "move a handle first")
        else:
            self.solver.wait(120)
            film = animation(rest, Morph((self.final or self.last).warp))
        self.panel.show_export(0.0)
        write_film(film, path, lambda done, total, text: self.panel.show_export(done / total))
        self.panel.show_export(1.0, f"wrote {path.name}")
        client.send_file_download(path.name, path.read_bytes())

    def _picture(self, path: Path) -> None:
        """Rest and deformed side by side, by the project's own renderer."""
        import trimesh

        from implicit_warp.render import Panel as Picture
        from implicit_warp.render import render_row, save_png

        faces = np.asarray(self.source.preview.faces)
        now = trimesh.Trimesh(self.shown.vertices, faces, process=False)
        save_png(path, render_row([Picture(self.source.preview, None, "rest"),
                                   Picture(now, None, "deformed")]))  # fmt: skip


def _replace(item: Any, **changes: Any) -> Any:
    from dataclasses import replace

    return replace(item, **changes)
