"""What networks there are, and their sizes: plain values, checked where they are made.

`HashGrid` learns fastest on a CPU and is what `fit_neural` takes by default. `Siren` is smooth (it
has derivatives of every order), twenty times smaller on disk, and slower to learn.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TypeAlias

import numpy as np

from fields import arguments
from fields.errors import InputError


@dataclass(frozen=True, slots=True)
class Siren:
    """A perceptron of sines, x -> sin(frequency (W x + b)), ended by a linear layer.

    Source: Sitzmann et al., "Implicit Neural Representations with Periodic Activation
    Functions", NeurIPS 2020.

    Attributes:
        width: of each hidden layer.
        layers: hidden layers.
        frequency: the factor inside the sines (the paper's omega_0, which takes 30 for all
            layers); higher values resolve finer detail, and ripple where samples are few.
    """

    width: int = 128
    layers: int = 3
    frequency: float = 30.0

    def __post_init__(self) -> None:
        _make_whole(self, {"width": 4096, "layers": 32})
        arguments.positive("frequency", self.frequency)


@dataclass(frozen=True, slots=True)
class HashGrid:
    """Grids of several resolutions, each with two numbers a vertex, and a small perceptron.

    Source: Mueller et al., "Instant Neural Graphics Primitives with a Multiresolution Hash
    Encoding", ACM ToG 2022. The features of a point are interpolated in its cell of each grid; with
    the point itself they go through a perceptron of ReLUs. A grid with more vertices than
    `2**log2_table` shares its entries by a hash of the vertex, as in the paper.

    Attributes:
        levels: how many grids.
        coarsest: cells along an edge of the coarsest.
        finest: of the finest; the sizes in between grow by one factor.
        log2_table: base-2 logarithm of the most entries of a grid.
        width: of each hidden layer of the perceptron.
        layers: its hidden layers.
    """

    levels: int = 8
    coarsest: int = 8
    finest: int = 64
    log2_table: int = 15
    width: int = 64
    layers: int = 2

    def __post_init__(self) -> None:
        sizes = {"levels": 32, "coarsest": 4096, "finest": 4096, "log2_table": 24}
        _make_whole(self, {**sizes, "width": 4096, "layers": 32})
        if self.finest < self.coarsest:
            raise InputError(
                "finest",
                self.finest,
                f"the finest grid is coarser than the coarsest, {self.coarsest}",
                "pass coarsest <= finest",
            )

    @property
    def resolutions(self) -> np.ndarray:
        """Cells along an edge of each grid, `(levels,)`, from coarse to fine."""
        return np.rint(np.geomspace(self.coarsest, self.finest, self.levels)).astype(np.int64)


def _make_whole(sizes: Siren | HashGrid, most: dict[str, int]) -> None:
    """Check whole numbers from 1 to what is given by name; 3.0 becomes 3."""
    for name, limit in most.items():
        value = arguments.whole(name, getattr(sizes, name), 1, limit)
        object.__setattr__(sizes, name, value)


Architecture: TypeAlias = "Siren | HashGrid"

_KINDS: dict[str, type[Siren] | type[HashGrid]] = {"siren": Siren, "hash": HashGrid}


def as_architecture(value: object) -> Architecture:
    """An architecture as it is; one by name, "siren" or "hash", in its default size."""
    if isinstance(value, Siren | HashGrid):
        return value
    if isinstance(value, str) and value in _KINDS:
        return _KINDS[value]()
    raise InputError(
        "architecture",
        value,
        "there is no such network",
        f"pass {', '.join(map(repr, _KINDS))}, or fields.Siren(...) or fields.HashGrid(...)",
    )


def describe(architecture: Architecture) -> dict[str, object]:
    """Plain values for JSON."""
    kind = next(name for name, cls in _KINDS.items() if type(architecture) is cls)
    return {"kind": kind, **asdict(architecture)}


def from_description(values: Mapping[str, object]) -> Architecture:
    """The inverse of `describe`; raises KeyError, TypeError or InputError on other values."""
    sizes = dict(values)
    return _KINDS[str(sizes.pop("kind"))](**sizes)  # type: ignore[arg-type]
