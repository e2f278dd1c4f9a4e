"""Samples of a shape's interior and of the handles' regions, by rejection on the fields."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fields import Field
from implicit_warp.errors import InputError
from implicit_warp.handles import Handle

_BATCH = 1 << 17
_MOST_CANDIDATES = 1 << 24
_PATIENCE = 1 << 21
"""Candidates after which a region is content with fewer points than asked for."""


@dataclass(frozen=True)
class Samples:
    """Points of the rest shape, float64, in the user's units.

    Attributes:
        interior: (P, 3) uniform in the shape's inside.
        regions: one (H, 3) a handle, uniform in the part of the shape that its region selects.
    """

    interior: Tensor
    regions: list[Tensor]


def sample_shape(
    shape: Field, handles: Sequence[Handle], interior: int, per_region: int, seed: int
) -> Samples:
    """Draw points of the shape's inside, and of each handle's part of it.

    Args:
        shape: a field with finite bounds.
        handles: their regions need no bounds.
        interior: how many points of the inside.
        per_region: how many points of each region; small regions may get fewer, never none.
        seed: of the random numbers.

    Raises:
        InputError: the shape is unbounded or empty, a handle selects nothing, or two handles
            want to move the same points to different places.
    """
    if shape.bounds is None:
        raise InputError(
            "shape",
            shape,
            "its bounds are unknown or infinite, so it cannot be sampled",
            "intersect it with a box that holds the part to deform",
        )
    low, high = torch.tensor(shape.bounds)
    generator = torch.Generator().manual_seed(seed)
    inside: list[Tensor] = []
    chosen: list[list[Tensor]] = [[] for _ in handles]
    counts = [0] * len(handles)
    found = tried = 0
    while tried < _MOST_CANDIDATES and (found < interior or min(counts, default=1) < per_region):
        candidates = torch.rand(_BATCH, 3, generator=generator, dtype=torch.float64)
        candidates = low + candidates * (high - low)
        if found >= interior:
            # Only regions are still short of points; they are cheap to evaluate, the shape may
            # not be.
            if min(counts, default=1) > 0 and tried > _PATIENCE:
                break
            short = [h for h, n in zip(handles, counts, strict=True) if n < per_region]
            wanted = [handle.region.evaluate(candidates) <= 0 for handle in short]
            candidates = candidates[torch.stack(wanted).any(0)] if short else candidates[:0]
        tried += _BATCH
        candidates = candidates[shape.evaluate(candidates) <= 0]
        if found < interior:
            found += len(candidates)
            inside.append(candidates)
        for i, handle in enumerate(handles):
            if counts[i] < per_region:
                selected = candidates[handle.region.evaluate(candidates) <= 0]
                chosen[i].append(selected)
                counts[i] += len(selected)
        if found == 0 and tried >= 2 * _PATIENCE:
            break
    if found == 0:
        raise InputError(
            "shape",
            shape,
            f"none of {tried} random points of its bounds lies inside",
            "check its signs (negative inside) and that its parts overlap",
        )
    for handle, count in zip(handles, counts, strict=True):
        if count == 0:
            raise InputError(
                "handles",
                handle.name,
                f"this handle selects nothing: of {tried} random points of the shape's bounds, "
                f"{shape.bounds.round(4).tolist()}, none lies both in the shape and in its region",
                "move or enlarge the region so that it meets the shape",
            )
    regions = [torch.cat(points)[:per_region] for points in chosen]
    refuse_contradictions(handles, regions, shape.bounds)
    return Samples(torch.cat(inside)[:interior], regions)


def refuse_contradictions(
    handles: Sequence[Handle], regions: Sequence[Tensor], bounds: np.ndarray
) -> None:
    """Raise `InputError` if two handles send points in both of their regions to two places.

    Args:
        handles: in any motion.
        regions: points (n, 3) in each of them.
        bounds: (2, 3) of the shape.
    """
    diagonal = float(np.linalg.norm(np.diff(bounds, axis=0)))
    for i, first in enumerate(handles):
        for j, second in enumerate(handles[i + 1 :], i + 1):
            # A large region's samples may all miss a small one: each is asked about the other's.
            both = torch.cat([regions[i], regions[j]])
            in_both = (first.region.evaluate(both) <= 0) & (second.region.evaluate(both) <= 0)
            shared = both[in_both]
            gap = (first.motion(shared) - second.motion(shared)).norm(dim=-1)
            # Motions that agree to 1e-6 of the shape's size are the same for every purpose.
            torn = gap > 1e-6 * diagonal
            if bool(torn.any()):
                raise InputError(
                    "handles",
                    [first.name, second.name],
                    f"these two contradict each other: {int(torn.sum())} of {len(both)} "
                    f"points of theirs lie in both regions, and are sent to places up to "
                    f"{float(gap.max()):.3g} apart",
                    "make the regions disjoint, or give both the same motion",
                )
