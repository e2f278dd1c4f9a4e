"""Samples on a grid and where they are, as files hold them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Samples:
    """Values on a grid that may be turned, and not yet checked.

    Attributes:
        values: `(nx, ny, nz)`, if all is well.
        origin: `(3,)`, place of the first sample.
        axes: `(3, 3)`, row i the step from a sample to the next along axis i; NaN if unknown.
    """

    values: NDArray[np.generic]
    origin: NDArray[np.float64]
    axes: NDArray[np.float64]


class DamagedFile(ValueError):  # noqa: N818 (named for what is the matter)
    """A file's content is not what its format says; the message says why, as a clause."""
