"""A field's surface as a triangle mesh, by marching cubes on a lattice of cubic voxels.

What makes the mesh sound is how its vertices are found:

* A sample is inside where its value is below the level, else outside; there is no third
  case. Marching cubes (Lorensen and Cline, 1987) runs on these signs alone, so its topology
  does not depend on rounding, and every vertex names its lattice edge exactly.
* The vertex is then placed along that edge, in float64, but never nearer than `NEAREST` of a voxel
  to either end. This has the effect of pushing near-level samples off the level, yet needs no idea
  of the field's scale: the field may be scaled or warped, and no distance at all. Vertices of
  different edges keep apart.

Only cells near the surface are sampled. How they are found is chosen by `search`:

==============  ==================================================================================
``enclosures``  blocks are halved as long as bounds of the field's values on them leave their sign
                open (`enclosed`); for fields made of arithmetic, and all that enclose themselves
``distance``    blocks are halved as long as balls of |value| / Lipschitz bound do not cover them
                (`nearby`): the fewest samples, for fields whose evaluation is the cost
``guided``      for a field carried by a map: its surface is found at rest, carried forward, and
                followed (`guided`)
``auto``        guided if the field is carried by a map, distance if it calls a function and has a
                Lipschitz bound of at most `STEEPEST`, enclosures for everything else
==============  ==================================================================================

Guarantees: the mesh is watertight, edge- and vertex-manifold, and oriented outward, whatever
the samples are; its topology is that of the signs. Every search but the guided one finds every
sign; the guided one finds every part of the surface that a carried point falls on. Memory grows
with the surface, not with the volume.
Non-guarantees: parts thinner than a voxel may be missed or merged (see the option `thin`), edges
near corners may be off by part of a voxel (see `sharp`), and faces may be slivers. No sample
values are known to make the faces intersect, but that is proved for the triangles of one cell with
one loop only (`cube`): `check` decides it for the mesh at hand.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from fields import Field
from implicit_warp.errors import InputError, MissingDependency
from implicit_warp.extraction import enclosed, guided, nearby
from implicit_warp.extraction.attributes import Attribute, Colours, add_attributes
from implicit_warp.extraction.cells import Found, march, middles
from implicit_warp.extraction.lattice import lattice_for
from implicit_warp.extraction.placement import placed
from implicit_warp.extraction.refining import Looked, refined, warn_of_thin_parts
from implicit_warp.extraction.refusals import (
    Search,
    Thin,
    refuse_bad_options,
    refuse_empty,
    refuse_fine_voxels,
    refuse_open,
)
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.sharp import sharpened
from implicit_warp.extraction.thin import thin_cells

if TYPE_CHECKING:
    import trimesh

Progress = Callable[[int, int], None]


POLISHING = 8
"""Most rounds in which vertices are moved towards the field's own zero on their lattice edges."""

STEEPEST = 8.0
"""Largest Lipschitz bound with which balls about samples leave much out."""

_STAGES = 4

_COARSE = 48
"""Resolution at which a map's stretch on a surface is looked at."""


@dataclass(frozen=True)
class ExtractionReport:
    """How a mesh was extracted.

    Attributes:
        search: how the cells at the surface were found.
        resolution: voxels along the longest side of the box, after any refinement.
        voxel: side of a voxel.
        shape: lattice points along each axis.
        samples: points at which the field was evaluated, those for vertices included; of the
            lattice alone: `lattice_samples`.
        lattice_samples: the same without those on lattice edges.
        cells: cells that the surface crosses.
        vertices, faces: of the mesh.
        seconds: wall clock time.
        samples_at_rest: of a field at rest, from which the search was guided.
        thin_cells: cells that a part thinner than a voxel enters, unseen.
    """

    search: str
    resolution: int
    voxel: float
    shape: tuple[int, int, int]
    samples: int
    lattice_samples: int
    cells: int
    vertices: int
    faces: int
    seconds: float
    samples_at_rest: int
    thin_cells: int

    @property
    def share_sampled(self) -> float:
        """Lattice samples as a fraction of all lattice points."""
        return self.lattice_samples / float(np.prod(self.shape))

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "share_sampled": self.share_sampled}


def extract(field: Field, resolution: int = 128, **options: Any) -> trimesh.Trimesh:
    """The surface where a field equals a level, as a closed triangle mesh.

    `extract_mesh` lists the options, and returns a report as well.
    """
    return extract_mesh(field, resolution, **options)[0]


def extract_mesh(
    field: Field,
    resolution: int = 128,
    *,
    bounds: ArrayLike | None = None,
    at_wall: Literal["error", "close"] = "error",
    level: float = 0.0,
    search: Search = "auto",
    sharp: bool = True,
    thin: Thin = "warn",
    polishing: int = POLISHING,
    attributes: Sequence[Attribute] = (),
    colours: Colours | None = None,
    dtype: torch.dtype = torch.float32,
    block: int = 1 << 17,
    progress: Progress | None = None,
) -> tuple[trimesh.Trimesh, ExtractionReport]:
    """The surface where a field equals a level, as a closed triangle mesh, and how it was found.

    Guarantees and non-guarantees are in the module's docstring.

    Args:
        field: negative (below `level`) inside. Wrap a function by `fields.from_function`.
        resolution: voxels along the longest side of the box. The other sides are rounded up
            to whole voxels, half of the excess at each end.
        bounds: the box `(2, 3)`, minimum and maximum corner; by default the field's own bounds
            and two voxels more on every side.
        at_wall: what to do where the inside reaches the box's wall: "error" raises, "close"
            caps it there with a flat face (within `NEAREST` of a voxel of the wall).
        level: the value of the surface; other than 0 it may leave the field's own bounds.
        search: how the cells at the surface are found; see the module's docstring.
        sharp: put vertices on the edges and corners of the shape, as `sharp` explains; without,
            they are bevelled at the scale of a voxel.
        thin: what to do about parts, or gaps, that pass between the lattice points. "warn" (a
            `ThinParts` warning) of those that leave whole neighbourhoods of cells unseen, where
            looking costs little: not in fields that call functions without a Lipschitz bound.
            "refine" the lattice by twos, at most to `FINEST`, until there are none of these, and
            one twice as fine has the same number of pieces and the same Euler characteristic.
            "ignore" them.
        polishing: most rounds of root finding along the lattice edges, after the first guess by
            linear interpolation; smooth surfaces need one or two.
        attributes: what to note of each vertex in `mesh.vertex_attributes`: any of "rest_position",
            "normal" and "distance_error".
        colours: gives the vertices colours (n, 3), from 0 to 1, by their rest positions (n, 3).
        dtype: of the points and values, torch.float32 or torch.float64. Vertices are float64.
        block: points a call of the field; bounds the memory that the field uses.
        progress: called with the stages done and in all.

    Returns:
        The mesh, in the field's own units (vertices are shared, no two coincide), and a report.

    Raises:
        InputError: not a field; no bounds; no surface in the box; the inside reaches a wall;
            NaN or infinite values; voxels too small for `dtype`; a field that changes faster
            than its `lipschitz` says; a search that does not fit the field.
        MissingDependency: trimesh is not installed.
    """
    try:
        import trimesh  # before the work, not after
    except ImportError as error:
        raise MissingDependency(
            "trimesh", "extracting a mesh", "Install it with `pip install trimesh`"
        ) from error
    start = time.perf_counter()
    refuse_bad_options(field, at_wall, level, dtype, block, search, polishing, thin)
    level = float(torch.tensor(level, dtype=dtype))
    advance = _Stages(progress)
    chosen = _chosen(search, field, level)

    def look(factor: int) -> Looked:
        lattice = lattice_for(field, factor * resolution, bounds)
        refuse_fine_voxels(lattice, resolution, dtype)
        sampler = Sampler(field, lattice, level, dtype, block, walled=at_wall == "close")
        found, samples_at_rest = _find(chosen, sampler, doubts=thin != "ignore")
        missed = np.empty((0, 3), np.int64)
        if thin != "ignore":
            missed = thin_cells(sampler, found.cells.corners, found.doubtful, found.certain)
        return Looked(
            factor * resolution, sampler, found, march(found.cells), missed, samples_at_rest
        )

    looked = look(1)
    if thin == "refine":
        looked = refined(look, looked)
    advance()
    sampler, surface, cells = looked.sampler, looked.surface, looked.found.cells
    lattice, lattice_samples = sampler.lattice, sampler.count
    refuse_open(surface, sampler)
    if not len(surface.faces):
        refuse_empty(sampler, len(looked.missed))
    if len(looked.missed):
        warn_of_thin_parts(looked, thin)
    advance()
    vertices, faces = placed(surface, sampler, polishing), surface.faces
    if sharp:
        vertices, faces, _ = sharpened(surface, cells.corners, vertices, sampler)
    advance()
    mesh = trimesh.Trimesh(lattice.origin + lattice.voxel * vertices, faces, process=False)
    add_attributes(mesh, field, level, attributes, colours)
    report = ExtractionReport(
        search=chosen,
        resolution=looked.resolution,
        voxel=lattice.voxel,
        shape=lattice.shape,
        samples=sampler.count,
        lattice_samples=lattice_samples,
        samples_at_rest=looked.samples_at_rest,
        thin_cells=len(looked.missed),
        cells=len(cells.corners),
        vertices=len(vertices),
        faces=len(faces),
        seconds=time.perf_counter() - start,
    )
    advance()
    return mesh, report


class _Stages:
    """Tells of progress stage by stage."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._done = progress, 0

    def __call__(self) -> None:
        self._done += 1
        if self._progress is not None:
            self._progress(self._done, _STAGES)


def _chosen(search: Search, field: Field, level: float) -> str:
    """The search that "auto" means for a field; others are checked to fit it."""
    carried, bound = guided.carried(field), field.lipschitz
    bounded = bound is not None and np.isfinite(bound) and bound > 0
    flat = bounded and bound <= STEEPEST
    # A level above zero lies beyond the bounds of the field at rest.
    can_guide = carried is not None and carried.rest.bounds is not None and level <= 0
    if search == "auto":
        if can_guide:
            return "guided"
        return "distance" if flat and field.tape.calls_oracles else "enclosures"
    if search == "guided" and not can_guide:
        raise InputError(
            "search",
            search,
            "the field is not the image of a bounded field under a map, or the level is above zero",
            'Make it with implicit_warp.deform, or use search="auto"',
        )
    if search == "distance" and not bounded:
        raise InputError(
            "search",
            search,
            f"the field's Lipschitz bound is {bound}",
            'State one, or use search="auto"',
        )
    return search


def _find(search: str, sampler: Sampler, doubts: bool) -> tuple[Found, int]:
    """The cells that the surface crosses; and samples taken elsewhere, of a field at rest."""
    field = sampler.field
    if search == "enclosures":
        return enclosed.crossed_cells(sampler, doubts), 0
    if search == "distance":
        return nearby.crossed_cells(sampler, float(field.lipschitz), sampler.batch // 8), 0
    carried = guided.carried(field)
    coarse, taken = _surface_at_rest(carried.rest, _COARSE, sampler)
    resolution = guided.resolution_at_rest(carried, sampler.lattice.voxel, coarse)
    fine, taken_for_fine = _surface_at_rest(carried.rest, resolution, sampler)
    seeds = guided.seeds(carried, fine, sampler)
    return guided.follow(sampler, seeds, sampler.batch // 8), taken + taken_for_fine


def _surface_at_rest(
    rest: Field, resolution: int, sampler: Sampler
) -> tuple[NDArray[np.float64], int]:
    """Points (n, 3) near a field's surface, one in each crossed cell; and the samples taken."""
    lattice = lattice_for(rest, resolution, None)
    at_rest = replace(sampler, field=rest, lattice=lattice, walled=False)
    found, elsewhere = _find(_chosen("auto", rest, sampler.level), at_rest, doubts=False)
    points = lattice.origin + lattice.voxel * middles(found.cells)
    return points, at_rest.count + elsewhere
