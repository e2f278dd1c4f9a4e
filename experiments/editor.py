"""How fast the handle editor is: from the command to the page, a drag to its mesh, and the solve.

    python -m experiments.editor

Prints a table for the demo's part and, with the extra ``human``, for a body. A drag is thirty
events a second for some seconds, as a hand makes them; what is timed is from an event to the moment
when its mesh has been handed to the page. No browser is connected, so what one does with the same
cores comes on top. The tests of the page drag with a mouse in Chromium, and print the same figure.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from implicit_warp.benchmark.report import cpu_name, load_average
from implicit_warp.viewer.page import PATIENCE, Editor
from implicit_warp.viewer.session import EditState, solve_handles

DEMO = Path(__file__).parents[1] / "examples" / "demo"

EVENTS = 30.0
"""A second."""


@dataclass(frozen=True, kw_only=True)
class EditorTimes:
    """Measure the editor."""

    seconds: float = 4.0
    """How long the drag takes."""
    rounds: int = 5
    """Drags and full solves of each shape; medians count."""
    body: bool = True
    """Measure a body, too."""
    port: int = 8400
    """Where the editor listens."""


@dataclass(frozen=True)
class Times:
    """Of one shape, in seconds.

    Attributes:
        vertices: of the preview mesh.
        page: from starting the command to the first byte of the page.
        drag: from an event to its mesh, median of each round.
        solve: the full solve, each round.
    """

    vertices: int
    page: float
    drag: list[float]
    solve: list[float]


def body_files(folder: Path) -> tuple[Path, Path]:
    """A body's mesh, and a handle file that holds its feet and leans its head to the side."""
    from experiments.bodies import pairs

    mesh = next(iter(pairs(1, seed=2026))).source
    up = int(np.argmax(np.ptp(mesh.vertices, axis=0)))
    matrix = np.eye(4)
    matrix[:3, :3] = np.roll(np.eye(3), 2 - up, axis=0)  # the long axis becomes z
    low, high = mesh.apply_transform(matrix).bounds
    height = high[2] - low[2]
    mesh.export(folder / "body.ply")
    (folder / "body.toml").write_text(
        f"[[handle]]\nregion = 'below({low[2] + 0.1 * height})'\nhold = true\n\n"
        f"[[handle]]\nregion = 'above({high[2] - 0.12 * height})'\n"
        f"translate = [{0.12 * height}, 0, {-0.02 * height}]\n"
    )
    return folder / "body.ply", folder / "body.toml"


def page_ready(shape: Path, port: int) -> float:
    """Seconds from starting `implicit-warp view` to the first byte of its page."""
    command = [
        sys.executable, "-m", "implicit_warp.cli", "view", str(shape), "--no-browser",
        "--port", str(port),
    ]  # fmt: skip
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    try:
        while time.perf_counter() - start < PATIENCE:
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=1.0):
                    return time.perf_counter() - start
            except (OSError, TimeoutError):
                time.sleep(0.02)
        raise TimeoutError(f"no page after {PATIENCE} s")
    finally:
        process.terminate()
        process.wait()


def follow(editor: Editor, target: EditState, seconds: float) -> float:
    """Drag from rest towards the target's motions; the median latency."""
    editor.solver.wait(PATIENCE)
    editor.drags.clear()
    count = int(seconds * EVENTS)
    start = time.perf_counter()
    for i in range(count):
        editor.solver.follow(solve_handles(target, (i + 1) / count))
        time.sleep(max(0.0, start + (i + 1) / EVENTS - time.perf_counter()))
    return statistics.median(editor.drags)


def measure(shape: Path, handles: Path, folder: Path, options: EditorTimes) -> Times:
    """All of one shape."""
    page = page_ready(shape, options.port)
    editor = Editor(shape, handles, port=options.port + 1, folder=folder)
    try:
        target = editor.session.state
        editor.solver.wait(PATIENCE)  # kernels are loaded
        drag, solve = [], []
        for _ in range(options.rounds):
            editor.solver.rest()
            editor.prepare(target)
            drag.append(follow(editor, target, options.seconds))
            editor.final = None
            start = time.perf_counter()
            editor.solver.solve(solve_handles(target))
            editor.solved()
            solve.append(time.perf_counter() - start)
        return Times(len(editor.rest), page, drag, solve)
    finally:
        editor.close()


def main() -> None:
    """The command."""
    options = tyro.cli(EditorTimes)
    before = load_average()
    rows = [
        "| shape | vertices | page, s | drag to mesh, ms | solve, s |",
        "|---|---:|---:|---:|---:|",
    ]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shapes = {"demo part": (DEMO / "part.py", DEMO / "handles.toml")}
        if options.body:
            shapes["body"] = body_files(folder)
        for title, (shape, handles) in shapes.items():
            times = measure(shape, handles, folder, options)
            drag, solve = (
                f"{scale * statistics.median(v):.3g} ({scale * min(v):.3g} to {scale * max(v):.3g})"
                for v, scale in ((times.drag, 1e3), (times.solve, 1.0))
            )
            rows.append(f"| {title} | {times.vertices:,} | {times.page:.1f} | {drag} | {solve} |")
    print("\n".join(rows))
    print(f"\n{cpu_name()}, load average {before:.1f} before and {load_average():.1f} after")


if __name__ == "__main__":
    main()
