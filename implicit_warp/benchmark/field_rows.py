"""Measurements of fields: evaluation, and extraction of plain, twisted and warped ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import torch

import fields as sdf
from fields import Field
from implicit_warp.benchmark import workloads
from implicit_warp.benchmark.report import Row, number
from implicit_warp.benchmark.settings import Settings
from implicit_warp.benchmark.timing import Contender, race, wall
from implicit_warp.deformation import deform
from implicit_warp.evaluate import back_end
from implicit_warp.extraction import ExtractionReport, extract_mesh
from implicit_warp.extraction.lattice import lattice_for


def canonical_scene() -> Field:
    """A sphere and a box minus three cylinders, genus 5."""
    bar = sdf.cylinder(0.5)
    return (sdf.sphere(1.0) & sdf.box(1.5)) - (bar.orient("x") | bar.orient("y") | bar)


def twisted_plate() -> Field:
    """A plate 2 x 0.2 x 4, a full turn a unit of length: its gradient is up to 6.4 long."""
    return sdf.box((2.0, 0.2, 4.0)).twist(360.0)


def evaluation(settings: Settings) -> Iterable[Row]:
    """Values of the canonical scene, compiled and by torch."""
    scene = canonical_scene()
    points = 1.2 * workloads.cube_points(settings.points, settings.seed, torch.float32, "cpu")

    def slow() -> None:
        with torch.no_grad(), sdf.back_end("torch"):
            scene.evaluate(points)

    scene.evaluate(points)
    slow()
    timings = race(
        {
            "fast": Contender(wall(lambda: scene.evaluate(points), "cpu"), settings.rounds),
            "slow": Contender(wall(slow, "cpu"), settings.few_rounds),
        }
    )
    scale = 1e9 / settings.points
    yield Row(
        key="field_evaluation",
        what="canonical scene, float32, ns a point",
        unit="ns",
        value=scale * timings["fast"].median,
        best=scale * timings["fast"].best,
        more_is_better=False,
        goal=3.0,
        reference=scale * timings["slow"].median,
        note=f"a tape of {len(scene.tape)} instructions",
    )


def extractions(settings: Settings) -> Iterable[Row]:
    """Whole extractions, beside dense sampling by torch and scikit-image's marching cubes."""
    n, fine = settings.extraction_resolution, settings.fine_resolution
    warp = workloads.random_warp(settings.layers, settings.resolution, settings.seed, "cpu")
    canonical, plate = canonical_scene(), twisted_plate()
    warped = deform(canonical, warp)
    yield from _extraction("canonical scene", canonical, n, 0.6, settings)
    yield from _extraction("canonical scene, sharp", canonical, n, None, settings, sharp=True)
    yield from _extraction("twisted plate", plate, n, 1.0, settings)
    yield from _extraction("twisted plate, sharp", plate, n, 1.0, settings, sharp=True)
    yield from _extraction("warped canonical scene", warped, n, 1.5, settings)
    yield from _extraction("warped canonical scene, sharp", warped, n, 1.5, settings, sharp=True)
    yield from _extraction("warped canonical scene", warped, fine, 8.0, settings)


def _extraction(
    what: str,
    field: Field,
    resolution: int,
    goal: float | None,
    settings: Settings,
    sharp: bool = False,
) -> Iterable[Row]:
    reports: list[ExtractionReport] = []

    def fast() -> None:
        reports.append(extract_mesh(field, resolution, sharp=sharp, thin="ignore")[1])

    fast()
    slow, scale = _dense(field, resolution, settings)
    timings = race(
        {
            "fast": Contender(wall(fast, "cpu"), settings.few_rounds),
            "slow": Contender(wall(slow, "cpu"), 1),
        }
    )
    report = reports[-1]
    yield Row(
        key=f"extract_{what.replace(', ', '_').replace(' ', '_')}_{resolution}",
        what=f"{what}, {resolution} voxels",
        unit="s",
        value=timings["fast"].median,
        best=timings["fast"].best,
        more_is_better=False,
        goal=goal,
        reference=scale * timings["slow"].median,
        note=f"{number(100 * report.share_sampled)} % of the lattice sampled, {report.faces} "
        "faces; reference: all of it by torch, and scikit-image",
    )


def _dense(field: Field, resolution: int, settings: Settings) -> tuple[Callable[[], None], float]:
    """Dense extraction of a lattice as coarse as the time allows, and the factor to this one's."""
    from skimage.measure import marching_cubes

    carried = field.tape.calls_oracles
    coarse = min(resolution, settings.searched_resolution if carried else resolution // 2)
    lattice = lattice_for(field, coarse, None)
    axes = [np.arange(n) for n in lattice.shape]
    index = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = torch.from_numpy(lattice.origin + lattice.voxel * index).to(torch.float32)

    def run() -> None:
        with torch.no_grad(), sdf.back_end("torch"), back_end("torch"):
            values = field.evaluate(points.reshape(-1, 3)).reshape(lattice.shape)
        marching_cubes(values.numpy(), 0.0, method="lorensen")

    whole = np.prod([float(m) for m in lattice_for(field, resolution, None).shape])
    return run, whole / float(index[..., 0].size)
