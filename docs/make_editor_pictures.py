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
        tab.steady(PICTURES / f"editor{suffix}.png")
        if not suffix:
            tab.open("1 Select")
            tab.open("2 Handles")
            tab.open("4 See")
            tab.choose("Colours", "Stretch")
            tab.choose("Section", "Filled")
            tab.steady(PICTURES / "editor-distortion.png")
            tab.choose("Section", "None")
            tab.choose("Colours", "Handles")
            tab.open("4 See")
            tab.open("2 Handles")
            tab.open("1 Select")
            tab.press("Reset")
            editor.solver.wait()
            tab.click_shape(seen_vertex(editor, 0.0, -0.2))
            until(lambda: editor.session.state.selection is not None, "the brush picks")
            tab.steady(PICTURES / "editor-select.png")
        browser.close()
        editor.close()


def main() -> None:
    """Write docs/pictures/editor*.png."""
    take((1280, 800), "")
    take((1920, 1080), "-wide")


if __name__ == "__main__":
    main()
