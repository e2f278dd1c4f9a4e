"""A mesh becomes a network, and the network is deformed: learn, measure, twist, extract, check.

python examples/learned/run.py --out out/learned
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

import fields as sdf
import implicit_warp as iw
from implicit_warp.files import atomic_write
from implicit_warp.mesh_files import write_mesh
from implicit_warp.render import Panel, render_row, save_png

SHAPE = (
    sdf.torus(1.0, 0.3)
    .rotate(90, "x")
    .union(sdf.box((0.5, 0.5, 3.2)), sdf.capsule((-1.5, 0, 0), (1.5, 0, 0), 0.18), smooth=0.15)
    .union(
        sdf.sphere(0.45, (0, 0, 1.6)), sdf.rounded_box((1.3, 1.3, 0.4), 0.1).translate((0, 0, -1.6))
    )
)
LARGEST_SHOWN = 0.001
"""Errors from 0, white, to this fraction of the diagonal, red, in the picture."""


def run(out: Path, *, resolution: int = 192, steps: int = 1500) -> int:
    """Write rest.ply, sdf.safetensors, report.json, twisted.stl and learned.png; 0 if clean."""
    out.mkdir(parents=True, exist_ok=True)
    rest = iw.extract(SHAPE, resolution)
    write_mesh(rest, out / "rest.ply")
    exact = sdf.mesh(rest)

    learned, report = sdf.fit_neural(exact, steps=steps)
    sdf.save_neural(learned, out / "sdf.safetensors", report)
    with atomic_write(out / "report.json") as temporary:
        temporary.write_text(json.dumps(report.to_dict(), indent=2))

    bounds = exact.bounds + 0.05 * np.array([[-1.0], [1.0]])
    mesh = iw.extract(learned, resolution, bounds=bounds)
    twist = iw.Twist(70, between=(-1.0, 1.2))
    twisted = iw.extract(iw.deform(learned, twist), resolution)
    write_mesh(twisted, out / "twisted.stl")
    verdict = iw.check(out / "twisted.stl")

    diagonal = np.linalg.norm(np.ptp(exact.bounds, axis=0))

    def error(points: np.ndarray) -> np.ndarray:
        """White to red by the distance from the true surface."""
        share = np.clip(np.abs(exact(points)) / diagonal / LARGEST_SHOWN, 0, 1)[:, None]
        return np.array([0.92, 0.92, 0.9]) * (1 - share) + np.array([0.8, 0.1, 0.1]) * share

    panels = [
        Panel(rest, label=f"a mesh of {len(rest.faces):,} faces"),
        Panel(mesh, error, label=f"learned; red where {100 * LARGEST_SHOWN:g} % off"),
        Panel(twisted, label="twisted"),
    ]
    save_png(out / "learned.png", render_row(panels))
    print(report)
    print(verdict)
    return 0 if verdict.ok else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/learned"))
    parser.add_argument("--resolution", type=int, default=192)
    parser.add_argument("--steps", type=int, default=1500)
    given = parser.parse_args()
    sys.exit(run(given.out, resolution=given.resolution, steps=given.steps))
