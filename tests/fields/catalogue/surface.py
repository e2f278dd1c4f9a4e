"""A primitive described a second time, and ways to draw points of surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fields import Field

REACH = 4.0
"""Half the edge of the cube in which laws are sampled; the catalogue fits inside it."""


@dataclass(frozen=True)
class Surface:
    """A primitive described a second time, without distances.

    Attributes:
        field: the primitive.
        sample: `sample(rng, n)` gives points `(n, 3)` all over its surface (the part
            within `REACH` if it is unbounded).
        inside: whether points `(n, 3)` are in the open solid.
    """

    field: Field
    sample: Callable[[np.random.Generator, int], np.ndarray]
    inside: Callable[[np.ndarray], np.ndarray]
