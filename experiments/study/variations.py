"""What the ablations vary: one thing at a time around the defaults of `fit`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Variation:
    """One row of a table.

    Attributes:
        name: in the table.
        options: that differ from the base.
        method: a key of `fitters.FITTERS`.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    method: str = "tuttenet"


BASE = Variation("24 layers")

PAPER_RECIPE = {
    "frames": "triplane",
    "init": "paper",
    "learning_rate": 0.02,
    "schedule": "constant",
    "memory": 0.999,
    "boundary_rate": 1.0,
    "relapse": None,
    "align": "none",
    "radius": 0.9,
}
"""The paper's way, as far as it says: random start, tri-planes, Adam at a constant 0.02."""


def _steps(count: int) -> Variation:
    return Variation(f"{count} steps", {"steps": count})


STUDIES: dict[str, tuple[Variation, ...]] = {
    "layers": (
        Variation("6 layers", {"layers": 6}),
        Variation("12 layers", {"layers": 12}),
        BASE,
        Variation("36 layers", {"layers": 36}),
        Variation("36 layers, learning rate 0.1", {"layers": 36, "learning_rate": 0.1}),
    ),
    "resolution": (
        Variation("resolution 7", {"resolution": 7}),
        Variation("resolution 11"),
        Variation("resolution 17", {"resolution": 17}),
        Variation("resolution 25", {"resolution": 25}),
        Variation("resolution 25, learning rate 0.1", {"resolution": 25, "learning_rate": 0.1}),
    ),
    "orientation": (
        Variation("cubic"),
        Variation("tri-plane", {"frames": "triplane"}),
        Variation("free, learned from tri-plane", {"frames": "free"}),
        Variation("cubic, radius 0.9", {"radius": 0.9}),
        Variation("tri-plane, radius 0.9", {"frames": "triplane", "radius": 0.9}),
    ),
    "initialisation": (
        Variation("identity"),
        Variation("paper's, random", {"init": "paper"}),
    ),
    "ideas": (
        Variation("as `fit` does it"),
        Variation("the paper's way, emulated", PAPER_RECIPE),
        Variation("learning rate constant 0.15", {"schedule": "constant"}),
        Variation("learning rate constant 0.02", {"schedule": "constant", "learning_rate": 0.02}),
        Variation("learning rate 0.2 at its highest", {"learning_rate": 0.2}),
        Variation("learning rate 0.1 at its highest", {"learning_rate": 0.1}),
        Variation("learning rate 0.05 at its highest", {"learning_rate": 0.05}),
        Variation("squares remembered longer, 0.999", {"memory": 0.999}),
        Variation("boundary at the full rate", {"boundary_rate": 1.0}),
        Variation("boundary held fixed", {"boundary": "fixed"}),
        Variation("back from relapses at 20 times the best loss", {"relapse": 20.0}),
        Variation("no return from relapses", {"relapse": None}),
        Variation("no alignment", {"align": "none"}),
        Variation("affine alignment", {"align": "affine"}),
        Variation("radius 0.9", {"radius": 0.9}),
        Variation("radius 1.5", {"radius": 1.5}),
        Variation("learned frames", {"frames": "free"}),
        Variation("float64 points", {"precision": "float64"}),
        Variation("coarse to fine, 6 then 11", method="coarse_to_fine"),
        Variation("L-BFGS in place of Adam", method="lbfgs"),
    ),
    "steps": (
        _steps(250),
        _steps(500),
        Variation("1000 steps"),
        _steps(2000),
    ),
}
"""Each study's rows; a row without options is its base, and is fitted once for all studies."""


def base_of(study: str) -> Variation:
    """The row that the others of a study differ from.

    Raises:
        StopIteration: the study has none, which the tests forbid.
    """
    return next(v for v in STUDIES[study] if not v.options and v.method == "tuttenet")
