"""The main job as one call: a shape and handles in, a checked mesh, a picture and a report out.

The command ``implicit-warp deform`` and the demo are this, and nothing more.  Files appear in the
order in which they are ready, each whole: the warp before the mesh is extracted, so that no later
failure loses the solve.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

import implicit_warp
from fields import Field
from implicit_warp.certificate import certify
from implicit_warp.deformation import deform
from implicit_warp.elastic_solve import ElasticOptions, elastic
from implicit_warp.errors import InputError
from implicit_warp.extraction.lattice import lattice_for
from implicit_warp.files import atomic_write, refuse_target, save
from implicit_warp.handles import Handle
from implicit_warp.layers import determinant_3x3
from implicit_warp.maps import Map
from implicit_warp.mesh_files import WRITABLE, write_mesh
from implicit_warp.warp import Warp

if TYPE_CHECKING:
    import trimesh

    from implicit_warp.checking import CheckReport

_DETERMINANTS = 1_000_000
"""Random points at which the report states the smallest det J."""

PALETTE = ((70, 130, 180), (220, 110, 60), (90, 150, 90), (160, 100, 170), (200, 160, 50))
"""Colours of the handles in pictures, in their order."""

_BODY = (205, 205, 200)


@dataclass(frozen=True)
class Outcome:
    """What `deform_to_files` made.

    Attributes:
        warp: the map that was solved for.
        mesh: the deformed surface; None if the solve was interrupted.
        verdict: the check of the file on disk; None if the solve was interrupted.
        report: everything in plain values, as written to the report file.
    """

    warp: Warp
    mesh: trimesh.Trimesh | None
    verdict: CheckReport | None
    report: dict[str, Any]


def deform_to_files(
    shape: Field,
    handles: Sequence[Handle],
    mesh_path: str | Path,
    *,
    under: Map | None = None,
    options: ElasticOptions | None = None,
    resolution: int = 192,
    sharp: bool = True,
    warp_path: str | Path | None = None,
    report_path: str | Path | None = None,
    picture_path: str | Path | None = None,
    referees: Sequence[str] = ("manifold3d",),
    progress: bool | None = None,
) -> Outcome:
    """Solve, pull the field back, extract, write, and check what was written.

    Args:
        shape: the rest shape.
        handles: what is held and moved.
        mesh_path: the deformed mesh, format by suffix.
        under: a map that deforms the shape before: the handles are on what it leaves, and the map
            that is saved is the solved one after this one.
        options: of the elastic solve.
        resolution: voxels along the longest side of the deformed shape's box.
        sharp: are edges and corners of the shape kept?
        warp_path: where to save the map (`.safetensors`).
        report_path: where to save the report (JSON).
        picture_path: where to save the picture before | after (PNG).
        referees: libraries whose verdict is asked for beside ours, see `check`.
        progress: as in `elastic`.

    Raises:
        InputError: see `elastic`, `extract` and `write_mesh`.
    """
    from implicit_warp.checking import check
    from implicit_warp.extraction import extract_mesh
    from implicit_warp.progress import progress_bar

    # Before the work: a path or a resolution that will be refused must not cost a solve.
    targets = [
        (mesh_path, WRITABLE),
        (warp_path, (".safetensors",)),
        (report_path, (".json",)),
        (picture_path, (".png",)),
    ]
    targets = [(str(path), suffixes) for path, suffixes in targets if path is not None]
    paths = [path for path, _ in targets]
    if len(set(paths)) < len(paths):
        raise InputError("path", paths, "two results would share a file", "name them apart")
    for path, suffixes in targets:
        refuse_target(path, suffixes)
    if under is not None:
        shape = deform(shape, under)
    lattice_for(shape, resolution, None)
    warp = elastic(shape, handles, options=options, progress=progress)
    if warp_path is not None:
        save(warp if under is None else warp @ under, warp_path)
    report: dict[str, Any] = {
        "implicit_warp": implicit_warp.__version__,
        "solve": warp.report.to_dict(),
        "map": describe_map(warp, shape.bounds),
    }
    if warp.report.status == "interrupted":
        if report_path is not None:
            write_json(report, report_path)
        return Outcome(warp, None, None, report)

    warped = deform(shape, warp)
    with progress_bar("extract", progress) as update:
        mesh, extraction = extract_mesh(warped, resolution, sharp=sharp, progress=update)
    write_mesh(mesh, mesh_path)
    extracted = time.perf_counter()
    verdict = check(mesh_path, referees=referees)
    report["extraction"] = extraction.to_dict()
    report["check"] = {**verdict.to_dict(), "seconds": time.perf_counter() - extracted}
    if picture_path is not None:
        start = time.perf_counter()
        save_picture(shape, handles, warp, mesh, picture_path)
        report["picture"] = {"seconds": time.perf_counter() - start}
    if report_path is not None:
        write_json(report, report_path)
    return Outcome(warp, mesh, verdict, report)


def describe_map(warp: Warp, bounds: np.ndarray | None) -> dict[str, Any]:
    """Facts about a map in plain values, with its certificate; det J over random points of a box,
    if one is given."""
    forward, backward = warp.lipschitz
    facts: dict[str, Any] = {
        "layers": warp.n_layers,
        "resolution": warp.resolution,
        "smallest_area": warp.smallest_area,
        "lipschitz_bound": forward,
        "lipschitz_bound_of_inverse": backward,
        "certificate": certify(warp).to_dict(),
    }
    if bounds is not None:
        facts["smallest_determinant"] = smallest_determinant(warp, bounds)
        facts["determinants_sampled"] = _DETERMINANTS
    return facts


@torch.no_grad()
def smallest_determinant(warp: Warp, bounds: np.ndarray, count: int = _DETERMINANTS) -> float:
    """Smallest det J over uniform random points of a box (fixed seed)."""
    low, high = torch.tensor(np.asarray(bounds))
    generator = torch.Generator().manual_seed(0)
    smallest = np.inf
    for size in [1 << 17] * (count // (1 << 17)) + [count % (1 << 17)]:
        points = low + torch.rand(size, 3, generator=generator, dtype=torch.float64) * (high - low)
        if size:
            smallest = min(smallest, float(determinant_3x3(warp.jacobian(points)).min()))
    return smallest


def save_picture(
    shape: Field,
    handles: Sequence[Handle],
    warp: Warp,
    deformed: trimesh.Trimesh,
    path: str | Path,
    *,
    resolution: int = 160,
) -> None:
    """The rest shape beside the deformed one, handles coloured alike on both."""
    from implicit_warp.extraction import extract
    from implicit_warp.render import Panel, render_row, save_png

    rest = extract(shape, resolution)

    at_rest = handle_colors(handles)

    def after(points: np.ndarray) -> np.ndarray:
        return at_rest(warp.inv(points))

    image = render_row([Panel(rest, at_rest, "rest"), Panel(deformed, after, "deformed")])
    save_png(path, image)


def handle_colors(handles: Sequence[Handle]) -> Callable[[np.ndarray], np.ndarray]:
    """A function from points at rest (n, 3) to sRGB (n, 3): each handle's region has its colour."""

    def colors(points: np.ndarray) -> np.ndarray:
        found = np.tile(np.array(_BODY, dtype=np.float64) / 255.0, (len(points), 1))
        for i, handle in enumerate(handles):
            inside = handle.region(points) <= 0
            found[inside] = np.array(PALETTE[i % len(PALETTE)]) / 255.0
        return found

    return colors


def write_json(values: Any, path: str | Path) -> None:
    """Write plain values as indented JSON, whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
