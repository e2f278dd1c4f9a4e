"""Take the pictures of the editor that docs/editor.md and the README show.

    python docs/make_editor_pictures.py

Drives the page in the system's Chromium, as the tests do, on the demo's part.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "pictures"
sys.path.insert(0, str(ROOT))

from playwright.sync_api import sync_playwright  # noqa: E402

from implicit_warp.viewer.page import Editor  # noqa: E402
from tests.viewer.driver import FLAGS, Tab, browser_path, seen_vertex, until  # noqa: E402


def take(size: tuple[int, int], suffix: str) -> None:
    """The pictures of one size of the window."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        part = ROOT / "examples" / "demo" / "part.py"
        handles = ROOT / "examples" / "demo" / "handles.toml"
        editor = Editor(part, handles, port=8400, folder=folder)
        browser = playwright.chromium.launch(executable_path=browser_path(), args=list(FLAGS))
        tab = Tab(browser, editor, size)
        # Chromium renders by software here, and the page says so: not a part of the picture.
        tab.page.add_style_tag(content=".mantine-Notifications-root { display: none !important; }")
        until(lambda: editor.final is not None, "the handle file's solve ends")
        tab.settle(4.0)
        tab.picture(PICTURES / f"editor{suffix}.png")
        if suffix:
            browser.close()
            editor.close()
            return
        editor.panel.colour.value = "Stretch"
        editor._recolour()
        editor.panel.section.value = "y"
        editor._show_section()
        tab.settle(4.0)
        tab.picture(PICTURES / "editor-distortion.png")
        editor.server.scene.remove_by_name("/section")
        editor.panel.colour.value = "Handles"
        editor._recolour()
        editor.panel.steps.value = "Reset"
        editor._step("Reset")
        tab.settle(2.0)
        tab.click_shape(seen_vertex(editor, 0.0, -0.2))
        until(lambda: editor.session.state.selection is not None, "the brush picks")
        tab.settle(2.0)
        tab.picture(PICTURES / "editor-select.png")
        browser.close()
        editor.close()


def main() -> None:
    """Write docs/pictures/editor*.png."""
    take((1280, 800), "")
    take((1920, 1080), "-wide")


if __name__ == "__main__":
    main()
