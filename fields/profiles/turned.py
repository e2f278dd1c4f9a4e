"""A solid of revolution from half of its outline."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fields.errors import InputError
from fields.expression import X, Y, Z, length, remap
from fields.operations import Body
from fields.primitives import primitive
from fields.profiles.edges import open_edges
from fields.profiles.outline import outline_distance
from fields.profiles.simple import plane_points, simple_polygon
from fields.tags import Tags


@primitive
def lathe(points: ArrayLike) -> Body:
    """The solid that turns about the z axis have in common with a half outline; exact.

    The outline is a chain of straight lines in the half-plane (r, z), r >= 0, completed by straight
    lines to the axis where its ends are not on it. What is between it and the axis is solid.
    `revolve` turns any profile, but measures to a side on the axis as well, where no surface is.

    Args:
        points: `(n, 2)`, two or more pairs (r, z), in either direction. Only the first and the last
            may be on the axis.

    Raises:
        InputError: the outline touches or crosses itself or the axis.
    """
    outline = plane_points("points", points, least=2)
    if (outline[:, 0] < 0).any() or (outline[1:-1, 0] == 0).any():
        raise InputError(
            "points",
            points,
            "the outline crosses the axis, or touches it between its ends",
            "keep r > 0 between the ends, and unite several solids",
        )
    on_axis = outline * (0.0, 1.0)
    below = [on_axis[:1]] if outline[0, 0] > 0 else []
    above = [on_axis[-1:]] if outline[-1, 0] > 0 else []
    # Closed along the axis it is a polygon, whose last edge then is left out.
    chain = simple_polygon("points", np.concatenate([*below, outline, *above]))
    reach, (low, high) = float(chain[:, 0].max()), (chain[:, 1].min(), chain[:, 1].max())
    extent = np.array([(-reach, -reach, low), (reach, reach, high)])
    distance = remap(outline_distance(open_edges(chain)), (length(X, Y), Z, Z))
    return Body(distance, Tags.of_distance(extent))
