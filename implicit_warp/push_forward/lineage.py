"""Where the vertices of a subdivided mesh come from, and what they inherit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fields.jit import kernel


@dataclass(frozen=True, eq=False)
class Lineage:
    """The first vertices of a mesh were given; every other was made on an edge of earlier ones.

    Attributes:
        n_given: number of given vertices.
        parents: (n, 2) the ends of the edge that each further vertex was made on.
        fractions: (n,) where on it: first + fraction (second - first).
    """

    n_given: int
    parents: NDArray[np.integer]
    fractions: NDArray[np.float64]

    def interpolate(self, given: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (n_given + n, c) at all vertices from values (n_given, c) at the given ones.

        Linear along every edge that was divided, hence linear on every given triangle.
        """
        values = np.empty((self.n_given + len(self.parents), given.shape[1]))
        values[: self.n_given] = given
        _interpolate(values, self.parents, self.fractions, self.n_given)
        return values

    def nearest_given(self) -> NDArray[np.int64]:
        """(n_given + n,) a given vertex for each, found by going to the nearer parent."""
        nearest = np.arange(self.n_given + len(self.parents))
        _follow_nearer(nearest, self.parents, self.fractions, self.n_given)
        return nearest


@kernel
def _interpolate(values, parents, fractions, n_given):
    # In order of creation: parents come first.
    for i in range(len(parents)):
        a, b, t = parents[i, 0], parents[i, 1], fractions[i]
        for c in range(values.shape[1]):
            values[n_given + i, c] = values[a, c] + t * (values[b, c] - values[a, c])


@kernel
def _follow_nearer(nearest, parents, fractions, n_given):
    for i in range(len(parents)):
        nearest[n_given + i] = nearest[parents[i, 0 if fractions[i] < 0.5 else 1]]
