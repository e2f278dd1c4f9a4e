"""Extraction beside other libraries, in one run: time, and whether the meshes are sound.

    python -m experiments.peers -o out/

Peers take part if they are installed: fogleman/sdf (`pip install sdf-fork`), scikit-image and
Open3D, the last two on samples by our fast evaluator.  Each makes both scenes at the same voxel
size, three times, in turns; the median of the times counts, and the mesh of the last is checked.
"""

from __future__ import annotations

import json
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import torch
import trimesh
import tyro
from tyro.conf import arg

from fields import Field
from implicit_warp.benchmark.field_rows import canonical_scene, twisted_plate
from implicit_warp.checking import check
from implicit_warp.checking.exact import IntersectionKind
from implicit_warp.extraction import extract
from implicit_warp.extraction.lattice import lattice_for
from implicit_warp.files import atomic_write

Mesher = Callable[[], trimesh.Trimesh]


@dataclass(frozen=True)
class Scene:
    """A shape with what is known of it.

    Attributes:
        name: in the table.
        field: ours.
        genus: of its one component.
        volume: None where there is no closed form.
    """

    name: str
    field: Field
    genus: int
    volume: float | None


SCENES = (
    Scene("canonical", canonical_scene(), 5, None),
    Scene("twisted plate", twisted_plate(), 0, 1.6),
)


def meshers(scene: Scene, resolution: int) -> dict[str, Mesher]:
    """Everything that can mesh a scene here, by name."""
    found: dict[str, Mesher] = {
        "implicit_warp": lambda: extract(scene.field, resolution, thin="ignore"),
        "implicit_warp, sharp=False": lambda: extract(
            scene.field, resolution, sharp=False, thin="ignore"
        ),
        "scikit-image, all sampled": lambda: _scikit_image(scene.field, resolution),
        "Open3D, all sampled": lambda: _open3d(scene.field, resolution),
    }
    if find_spec("sdf") is not None:
        found["fogleman/sdf"] = lambda: _fogleman(scene, resolution)
    return found


def _volume(field: Field, resolution: int) -> tuple[np.ndarray, Any]:
    """All samples of a lattice, by the fast evaluator, float32."""
    lattice = lattice_for(field, resolution, None)
    axes = [
        o + lattice.voxel * np.arange(n) for o, n in zip(lattice.origin, lattice.shape, strict=True)
    ]
    values = np.empty(lattice.shape, np.float32)
    for i, x in enumerate(axes[0]):
        plane = np.stack(np.meshgrid([x], axes[1], axes[2], indexing="ij"), -1).reshape(-1, 3)
        with torch.no_grad():
            found = field.evaluate(torch.from_numpy(plane.astype(np.float32)))
        values[i] = found.numpy().reshape(lattice.shape[1:])
    return values, lattice


def _scikit_image(field: Field, resolution: int) -> trimesh.Trimesh:
    from skimage.measure import marching_cubes

    values, lattice = _volume(field, resolution)
    vertices, faces, _, _ = marching_cubes(values, 0.0, spacing=(lattice.voxel,) * 3)
    return trimesh.Trimesh(vertices + lattice.origin, faces, process=False)


def _open3d(field: Field, resolution: int) -> trimesh.Trimesh:
    import open3d as o3d

    values, lattice = _volume(field, resolution)
    tensor = o3d.core.Tensor(values.transpose(2, 1, 0).copy())
    mesh = o3d.t.geometry.TriangleMesh.create_isosurfaces(tensor, [0.0])
    vertices = mesh.vertex.positions.numpy() * lattice.voxel + lattice.origin
    faces = mesh.triangle.indices.numpy()
    return trimesh.Trimesh(vertices, faces, process=False)


def _fogleman(scene: Scene, resolution: int) -> trimesh.Trimesh:
    import sdf

    lattice = lattice_for(scene.field, resolution, None)
    if scene.name == "canonical":
        bar = sdf.cylinder(0.5)
        shape = sdf.sphere(1) & sdf.box(1.5)
        shape -= bar.orient(sdf.X) | bar.orient(sdf.Y) | bar.orient(sdf.Z)
    else:
        shape = sdf.box((2.0, 0.2, 4.0)).twist(2.0 * np.pi)
    points = shape.generate(
        step=lattice.voxel,
        bounds=(tuple(lattice.origin), tuple(lattice.far_corner)),
        workers=os.cpu_count(),
        verbose=False,
    )
    corners = np.array(points).reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    mesh.merge_vertices(digits_vertex=6)  # it gives triangles, not a mesh
    return mesh


def measure(scene: Scene, resolution: int, rounds: int) -> list[dict[str, Any]]:
    """One row a mesher: seconds, faces, and what the checker says."""
    contenders = meshers(scene, resolution)
    times: dict[str, list[float]] = {name: [] for name in contenders}
    meshes: dict[str, trimesh.Trimesh] = {}
    for turn in range(rounds + 1):
        for name, mesher in contenders.items():
            start = time.perf_counter()
            meshes[name] = mesher()
            if turn:  # the first one warms up
                times[name].append(time.perf_counter() - start)
    rows = []
    for name, mesh in meshes.items():
        report = check(mesh)
        kinds = report.self_intersections.kinds if report.self_intersections else np.empty(0)
        rows.append(
            {
                "scene": scene.name,
                "mesher": name,
                "seconds": statistics.median(times[name]),
                "faces": len(mesh.faces),
                "watertight": bool(report.topology.watertight),
                "open_edges": len(report.topology.open_edges),
                "genus": [None if g is None else int(g) for g in report.topology.genus],
                "crossings": int((kinds == IntersectionKind.CROSSING).sum()),
                "zero_area_faces": int((mesh.area_faces == 0).sum()),
                "volume_error": None
                if scene.volume is None or not report.topology.watertight
                else float(mesh.volume / scene.volume - 1.0),
            }
        )
    return rows


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as a Markdown table; times also as multiples of ours."""
    lines = [
        "| scene | mesher | s | times ours | faces | watertight | open edges | genus | strict "
        "crossings | zero-area | volume error |",
        "|---|---|---:|---:|---:|---|---:|---|---:|---:|---:|",
    ]
    ours = {r["scene"]: r["seconds"] for r in rows if r["mesher"] == "implicit_warp"}
    for r in rows:
        error = "" if r["volume_error"] is None else f"{100 * r['volume_error']:.2f} %"
        genus = ", ".join("?" if g is None else str(g) for g in r["genus"][:4])
        lines.append(
            f"| {r['scene']} | {r['mesher']} | {r['seconds']:.2f} | "
            f"{r['seconds'] / ours[r['scene']]:.1f} | {r['faces']} | "
            f"{'yes' if r['watertight'] else 'NO'} | {r['open_edges']} | {genus} | "
            f"{r['crossings']} | {r['zero_area_faces']} | {error} |"
        )
    return "\n".join(lines)


@dataclass(frozen=True)
class Options:
    """Compare extraction with other libraries."""

    out: Annotated[Path, arg(aliases=["-o"])]
    """Folder for peers.json and peers.md."""
    resolution: int = 256
    """Voxels along the longest side."""
    rounds: int = 3
    """Measurements of each, of which the median counts."""


def run(options: Options) -> list[dict[str, Any]]:
    """Measure all scenes and write the results; returns the rows."""
    rows = [row for scene in SCENES for row in measure(scene, options.resolution, options.rounds)]
    options.out.mkdir(parents=True, exist_ok=True)
    with atomic_write(options.out / "peers.json") as path:
        path.write_text(json.dumps({"load": os.getloadavg()[0], "rows": rows}, indent=2) + "\n")
    with atomic_write(options.out / "peers.md") as path:
        path.write_text(table(rows) + "\n")
    return rows


if __name__ == "__main__":
    print(table(run(tyro.cli(Options))))
