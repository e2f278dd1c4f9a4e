"""Where the inside of a field reaches the walls of its lattice."""

from __future__ import annotations

import numpy as np

from implicit_warp.errors import InputError
from implicit_warp.extraction.cells import Surface
from implicit_warp.extraction.cube import CORNERS
from implicit_warp.extraction.samples import Sampler

_WALLS = (("x min", "x max"), ("y min", "y max"), ("z min", "z max"))


def refuse_inside_at_walls(surface: Surface, sampler: Sampler) -> None:
    """Raise if the surface would be open at a wall.

    A wall that the inside reaches either has crossed edges in its plane, or is inside all over:
    then its corners are.

    Raises:
        InputError: the inside reaches one or more walls; all of them are named.
    """
    if sampler.walled:
        return
    lattice = sampler.lattice
    last = np.array(lattice.shape) - 1
    inside = sampler.at(CORNERS * last) < 0
    reached = []
    for axis in range(3):
        in_plane = surface.axes != axis
        for side, name in enumerate(_WALLS[axis]):
            crossed = in_plane & (surface.low_ends[:, axis] == side * last[axis])
            if crossed.any() or inside[CORNERS[:, axis] == side].any():
                reached.append(name)
    if reached:
        raise InputError(
            "bounds",
            [lattice.origin.tolist(), lattice.far_corner.tolist()],
            f"the inside of the field reaches the wall of this box at {', '.join(reached)}, "
            "so the surface would be open there",
            'Pass larger bounds, or at_wall="close" to cap the shape at the wall',
        )
