"""A browser, and an editor of the demo's part."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.viewer.driver import FLAGS, browser_path

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="session")
def chromium():
    playwright = pytest.importorskip("playwright.sync_api")
    path = browser_path()
    if path is None:
        pytest.skip("no Chromium on this machine: install Debian's `chromium`")
    with playwright.sync_playwright() as p:
        instance = p.chromium.launch(executable_path=path, args=list(FLAGS))
        yield instance
        instance.close()


@pytest.fixture
def browser(chromium):
    """A window whose tabs are closed after the test: they would go on drawing, and reconnect."""
    window = chromium.new_context()
    yield window
    window.close()


@pytest.fixture
def editor(tmp_path):
    """Of the demo's part, with a short solve."""
    pytest.importorskip("viser")
    from implicit_warp.elastic_solve import ElasticOptions
    from implicit_warp.viewer.page import Editor

    options = ElasticOptions(steps=150, layers=12, resolution=9)
    made = Editor(EXAMPLES / "demo" / "part.py", port=8300, folder=tmp_path, options=options)
    yield made
    made.close()
