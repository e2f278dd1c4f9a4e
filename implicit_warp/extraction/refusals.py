"""What `extract` refuses, and how it says so."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import torch

from fields import Field
from implicit_warp.errors import InputError
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.lattice import Lattice
from implicit_warp.extraction.samples import Sampler
from implicit_warp.extraction.walls import refuse_inside_at_walls

Search = Literal["auto", "enclosures", "distance", "guided"]
Thin = Literal["warn", "refine", "ignore"]


def refuse_open(surface: Surface, sampler: Sampler) -> None:
    """Every edge is met in four cells, or the mesh would have a hole there."""
    refuse_inside_at_walls(surface, sampler)
    missing = int((surface.uses != 4).sum())
    if missing:
        raise InputError(
            "field.lipschitz",
            sampler.field.lipschitz,
            f"the field changes sign on {missing} lattice edges beside cells that its Lipschitz "
            "bound, or what encloses its values, rules out",
            "State the true bound, or none (lipschitz=None)",
        )


def refuse_empty(sampler: Sampler, missed: int) -> None:
    """Raise for a field without surface, or with one that misses all lattice points."""
    if missed:
        raise InputError(
            "resolution",
            sampler.lattice.shape,
            f"the whole shape passes between the lattice points: it enters {missed} cells, and "
            "holds no corner of any",
            'Use thin="refine", or a higher resolution',
        )
    lattice = sampler.lattice
    axes = [np.linspace(0, n - 1, min(n, 17)).round().astype(np.int64) for n in lattice.shape]
    sampler.at(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3))
    raise InputError(
        "field",
        sampler.field,
        f"no surface: the values sampled in the box lie between {sampler.lowest:.6g} and "
        f"{sampler.highest:.6g}, and none is below the level {sampler.level:g}",
        "Check the sign convention (negative inside), the bounds, and that the shape is "
        f"thicker than a voxel ({lattice.voxel:.3g})",
    )


def refuse_bad_options(
    field: object,
    at_wall: object,
    level: object,
    dtype: object,
    block: object,
    search: object,
    polishing: object,
    thin: object,
) -> None:
    """Raise for an option that is none."""
    if not isinstance(field, Field):
        raise InputError("field", field, "not a field", "Wrap a function by fields.from_function")
    if at_wall not in ("error", "close"):
        raise InputError("at_wall", at_wall, "no such choice", 'Use "error" or "close"')
    if not isinstance(level, int | float) or not np.isfinite(level):
        raise InputError("level", level, "not a finite number", "Use 0 for the field's surface")
    if dtype not in (torch.float32, torch.float64):
        raise InputError("dtype", dtype, "not supported", "Use torch.float32 or torch.float64")
    if not isinstance(block, int) or block < 1:
        raise InputError("block", block, "not a positive whole number", "Leave it out")
    if search not in get_args(Search):
        raise InputError("search", search, "no such search", f"Use one of {get_args(Search)}")
    if not isinstance(polishing, int) or polishing < 0:
        raise InputError("polishing", polishing, "not a number of rounds", "Use 0 or more")
    if thin not in get_args(Thin):
        raise InputError("thin", thin, "no such choice", f"Use one of {get_args(Thin)}")


def refuse_fine_voxels(lattice: Lattice, resolution: int, dtype: torch.dtype) -> None:
    """Neighbouring samples must be distinct points after rounding to `dtype`."""
    farthest = float(np.abs([lattice.origin, lattice.far_corner]).max())
    if lattice.voxel < 8.0 * torch.finfo(dtype).eps * farthest:
        raise InputError(
            "resolution",
            resolution,
            f"a voxel of {lattice.voxel:.3g} is lost in the rounding of {dtype} coordinates of "
            f"size {farthest:.3g}",
            "Use dtype=torch.float64, move the shape to the origin, or lower the resolution",
        )
