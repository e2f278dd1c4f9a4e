"""5 Export: the mesh, extracted and checked; handles, map, picture and films."""

from __future__ import annotations

import shlex
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from implicit_warp.errors import InputError
from implicit_warp.files import save
from implicit_warp.viewer import markup
from implicit_warp.viewer.export import MESHES, export_mesh, inside
from implicit_warp.viewer.session import save_edit

if TYPE_CHECKING:
    from collections.abc import Iterator

    from implicit_warp.viewer.page import Editor

SUFFIX = {"Handles": ".toml", "Warp": ".safetensors", "Picture": ".png"}

FILM_FORMATS = ("MP4", "GIF")


class ExportPanel:
    """The files' controls.

    Attributes:
        file, resolution, export, save, film, film_format: the controls.
    """

    def __init__(self, editor: Editor) -> None:
        self._editor, self._busy = editor, threading.Lock()
        gui = editor.server.gui
        with gui.add_folder("5  Export"):
            self.file = gui.add_text(
                "File", f"{editor.source.path.stem}-deformed.stl",
                hint=f"In the working folder; {', '.join(MESHES)}",
            )  # fmt: skip
            self.resolution = gui.add_number(
                "Voxels", 192, min=16, max=1024, step=1, hint="Along the longest side"
            )
            self.export = gui.add_button("Export the mesh", color=(47, 133, 90), icon="download")
            self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
            self._said = gui.add_html("", visible=False)
            with gui.add_folder("Other files", expand_by_default=False):
                self.save = gui.add_button_group("Save", tuple(SUFFIX))
                self.film = gui.add_button_group("Film", ("Turntable", "Animation"))
                self.film_format = gui.add_dropdown("Films are", FILM_FORMATS)
        safe = editor.guarded
        self.export.on_click(safe(self._export))
        self.save.on_click(safe(lambda e: self._save(e.target.value, e.client)))
        self.film.on_click(safe(lambda e: self._film(e.target.value, e.client)))

    def _path(self, suffix: str, more: str = "") -> Path:
        """Beside the mesh, named like it."""
        path = Path(self.file.value.strip() or "edit")
        name = str(path.with_name(f"{path.stem}{more}{suffix}"))
        return inside(self._editor.folder, name, (suffix,), keep=self._editor.inputs)

    @contextmanager
    def _working(self, path: Path) -> Iterator[None]:
        """One export at a time; its bar goes whatever becomes of it."""
        if not self._busy.acquire(blocking=False):
            raise InputError("export", str(path), "another export is running", "wait for it to end")
        try:
            self._said.visible = False
            self._bar.value, self._bar.visible = 0.0, True
            yield
        finally:
            self._bar.visible = False
            self._busy.release()

    def _progress(self, done: int, total: int, text: str = "") -> None:
        share = round(100.0 * done / total)
        if share != self._bar.value:
            self._bar.value = share

    def _done(
        self, client: Any, path: Path, text: str, good: bool | None = None, command: str = ""
    ) -> None:
        self._said.content, self._said.visible = markup.report(text, good, command), True
        client.send_file_download(path.name, path.read_bytes())

    def _export(self, event: Any) -> None:
        editor = self._editor
        path = inside(editor.folder, self.file.value, MESHES, keep=editor.inputs)
        with self._working(path):
            warp = editor.solved()
            report = export_mesh(
                editor.source.field, warp, path, int(self.resolution.value), self._progress
            )
        self._done(event.client, path, str(report).replace(str(path), path.name, 1), report.ok)

    def _save(self, what: str, client: Any) -> None:
        editor, path = self._editor, self._path(SUFFIX[what])
        with self._working(path):
            if what == "Handles":
                save_edit(editor.session.state, path, editor.solve_table)
            elif what == "Warp":
                warp, before = editor.solved(), editor.source.map
                if warp is None:
                    raise InputError("warp", 0, "nothing is moved yet", "move a handle first")
                save(warp if before is None else warp @ before, path)
            else:
                self._picture(path)
        command = self._replay(path) if what == "Handles" else ""
        self._done(client, path, f"Wrote {path.name}.", command=command)

    def _replay(self, handles: Path) -> str:
        """The command that makes the mesh from a handle file, to be run in the working folder."""
        editor = self._editor

        def named(path: Path) -> str:
            path = path.resolve()
            inner = path.is_relative_to(editor.folder)
            return str(path.relative_to(editor.folder) if inner else path)

        shape, under = editor.inputs
        mesh = handles.with_name(f"{handles.stem}-again{self._mesh_suffix()}")
        return shlex.join([
            "implicit-warp", "deform", named(shape),
            *(() if under is None else ("--under", named(under))),
            "--handles", named(handles), "-o", named(mesh),
            "--resolution", str(int(self.resolution.value)),
        ])  # fmt: skip

    def _mesh_suffix(self) -> str:
        suffix = Path(self.file.value.strip()).suffix
        return suffix if suffix.lower() in MESHES else MESHES[0]

    def _film(self, what: str, client: Any) -> None:
        """A turn around the shape as it is shown, or its way from rest and back."""
        from implicit_warp.film_files import write_film
        from implicit_warp.films import animation, turntable

        editor = self._editor
        path = self._path(f".{self.film_format.value.lower()}", f"-{what.lower()}")
        with self._working(path):
            if what == "Turntable":
                film = turntable(self._editor.shown.mesh)
            else:
                if editor.solved() is None:
                    raise InputError("film", what, "nothing is moved yet", "move a handle first")
                film = animation(editor.source.preview, editor.morph())
            write_film(film, path, self._progress)
        self._done(client, path, f"Wrote {path.name}.")

    def _picture(self, path: Path) -> None:
        """Rest and deformed side by side, by the project's own renderer."""
        from implicit_warp.render import Panel, render_row, save_png

        rest = Panel(self._editor.source.preview, None, "rest")
        save_png(path, render_row([rest, Panel(self._editor.shown.mesh, None, "deformed")]))
