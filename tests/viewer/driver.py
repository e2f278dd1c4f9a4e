"""The editor's page, driven as a user does: clicks, keys and drags in headless Chromium."""

from __future__ import annotations

import runpy
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from implicit_warp.viewer import regions
from implicit_warp.viewer.page import Editor

_SCRIPT = Path(__file__).parents[2] / "scripts" / "system_libraries.py"
BROWSERS: tuple[str, ...] = runpy.run_path(str(_SCRIPT), run_name="system_libraries")["BROWSERS"]
"""Commands of browsers: those that the script looks for, which installs one."""

FLAGS = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
)
"""Rendering without a GPU, also as root."""

PATIENCE = 60.0
"""Seconds after which something that should happen has not: shared machines are slow at random."""


WINDOW = (1040, 660)
"""Pixels; a small one, because they are rendered by software."""


def browser_path() -> str | None:
    """A browser of the system, if it has one."""
    return next((path for name in BROWSERS if (path := shutil.which(name))), None)


def until(condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
    """Wait until something is so, and return it."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"not within {patience:g} s: {what}")


class Tab:
    """One tab with the page of an editor.

    Attributes:
        page: playwright's.
        editor: what is on the other side.
    """

    def __init__(self, browser: Any, editor: Editor, size: tuple[int, int] = WINDOW) -> None:
        known = set(editor.server.get_clients())
        self.editor, self.size = editor, np.array(size, np.float64)
        self.page = browser.new_page()
        self.page.set_viewport_size({"width": size[0], "height": size[1]})
        self.page.goto(editor.url)
        self._client = until(
            lambda: next(
                (c for k, c in editor.server.get_clients().items() if k not in known), None
            ),
            "the page connects",
        )
        self.page.wait_for_selector("text=1 Select", timeout=1000 * PATIENCE)
        until(lambda: self._aspect() > 0, "the camera is known")
        self.settle()

    def _aspect(self) -> float:
        try:
            return self._client.camera.aspect
        except AssertionError:  # viser: nothing has been heard of the camera yet
            return 0.0

    def settle(self, seconds: float = 0.7) -> None:
        """Give the page time to draw."""
        self.page.wait_for_timeout(1000 * seconds)

    def on_screen(self, point: Any) -> np.ndarray:
        """(2,) the pixel where a point (3,) is seen."""
        camera = self._client.camera
        view = regions.Camera(camera.position, camera.wxyz, camera.fov, camera.aspect)
        canvas = self.page.locator("canvas").first.bounding_box()  # the panel is beside it
        place = view.on_screen(np.asarray(point, np.float64)[None])[0][0]
        return place * (canvas["width"], canvas["height"]) + (canvas["x"], canvas["y"])

    def click_shape(self, point: Any) -> None:
        """Click where a point of the shape is seen."""
        self.page.mouse.click(*self.on_screen(point))

    def press(self, text: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=text, exact=True).first.click()

    def open(self, folder: str) -> None:
        """Open a folder of the panel, or close it."""
        self.page.get_by_text(folder, exact=True).first.click()
        self.settle(0.4)

    def choose(self, label: str, option: str) -> None:
        """Choose from a list."""
        self.page.get_by_label(label, exact=True).first.click()
        self.page.get_by_role("option", name=option, exact=True).first.click()

    def drag(self, start: Any, way: Any, steps: int = 12, pause: float = 0.05) -> None:
        """Drag from a pixel by so many pixels; the button stays down until `drop`."""
        start, way = np.asarray(start, np.float64), np.asarray(way, np.float64)
        self.page.mouse.move(*start)
        self.settle(0.5)  # what is under the pointer is known a frame later
        self.page.mouse.down()
        for k in range(1, steps + 1):
            self.page.mouse.move(*(start + way * k / steps))
            self.page.wait_for_timeout(1000 * pause)

    def drag_arrow(self, way: Any, axis: int = 2) -> None:
        """Drag the gizmo's arrow along an axis; the button stays down until `drop`.

        A page that is rendered slowly can miss the grip, and turns its camera then: once more.
        """
        for _ in range(4):
            self.settle(1.0)
            before = self.editor.session.revision
            self.drag(self.arrow(axis), way)
            if self._changed_since(before):
                return
            self.drop()
        raise AssertionError("the gizmo does not follow the mouse")

    def _changed_since(self, revision: int) -> bool:
        for _ in range(20):
            if self.editor.session.revision != revision:
                return True
            self.page.wait_for_timeout(100)
        return False

    def drop(self) -> None:
        """Release the button."""
        self.page.mouse.up()

    def drop_and_solve(self) -> None:
        """Release the button, and wait for the solve that follows."""
        self.editor.solver.wait()
        self.editor.final = None
        self.drop()
        until(lambda: self.editor.final is not None, "the solve after the drag ends")

    def arrow(self, axis: int = 2) -> np.ndarray:
        """(2,) a pixel on the gizmo's arrow along an axis."""
        state = self.editor.session.state
        position, _ = state.get(state.active).pose()
        offset = np.zeros(3)
        offset[axis] = 0.75 * 0.16 * self.editor.size
        return self.on_screen(position + offset)

    def notice(self, text: str) -> None:
        """Wait until a text is on the page."""
        self.page.wait_for_selector(f"text={text}", timeout=1000 * PATIENCE)

    def dismiss(self) -> None:
        """Close all notices: they may lie over the shape."""
        close = self.page.locator(".mantine-Notification-closeButton")
        while close.count():
            close.first.click()
            self.settle(0.5)

    def steady(self, path: Path) -> None:
        """A screenshot of what the page has come to: two that are far apart are the same."""
        last, now = b"", self.picture()
        while now != last:
            self.settle(6.0)  # sections are sent late, and drawn slowly without a GPU
            last, now = now, self.picture()
        path.write_bytes(now)

    def picture(self, path: Path | None = None) -> bytes:
        """A screenshot."""
        return self.page.screenshot(path=path)

    def drawn(self) -> bytes:
        """A screenshot of the shape, without the panel beside it."""
        return self.page.screenshot(clip=self.page.locator("canvas").first.bounding_box())


def seen_vertex(editor: Editor, x: float, y: float, reach: float = 0.12) -> np.ndarray:
    """(3,) the highest vertex of the preview near a place: it is seen from above."""
    vertices = np.asarray(editor.source.preview.vertices)
    near = np.flatnonzero(np.hypot(vertices[:, 0] - x, vertices[:, 1] - y) < reach)
    return vertices[near[vertices[near, 2].argmax()]]
