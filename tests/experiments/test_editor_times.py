"""The measurement of the editor, on a bar and a quick solve."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from experiments.editor import EditorTimes, measure
from tests.viewer.bar import BAR, BAR_HANDLES


def test_a_drag_and_a_solve_are_timed(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    shape, handles = tmp_path / "bar.py", tmp_path / "bar.toml"
    shape.write_text(BAR)
    handles.write_text(BAR_HANDLES)
    options = EditorTimes(seconds=0.5, rounds=2, port=8440)
    start = time.perf_counter()
    times = measure(shape, handles, tmp_path, options)
    took = time.perf_counter() - start
    assert times.vertices > 1000
    assert len(times.drag) == len(times.solve) == options.rounds
    # Parts of the whole.
    assert 0.0 < times.page + sum(times.solve) + options.rounds * options.seconds < took
    assert all(0.0 < drag < took for drag in times.drag)
