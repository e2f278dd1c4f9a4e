"""Every way of fitting a pair, by name: the methods of the comparison, and what ablations add."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from experiments.baselines import METHODS, Fitted
from experiments.bodies import Pair
from experiments.study.other_solvers import SOLVERS
from implicit_warp.errors import InputError

FITTERS = {**METHODS, **SOLVERS}
"""Every method by the name that records and options use."""

NAMES = {
    "tuttenet": "TutteNet",
    "realnvp": "RealNVP",
    "realnvp_64": "RealNVP, width 64",
    "i_resnet": "i-ResNet",
    "neural_ode": "NeuralODE",
    "cage": "cage (mean value)",
    "arap": "as rigid as possible",
}
"""What tables and pictures call the methods of the comparison."""


def fit(
    method: str, pair: Pair, seconds: float | None, seed: int, options: Mapping[str, Any]
) -> Fitted:
    """Fit one pair.

    Args:
        method: a key of `FITTERS`.
        pair: source and target.
        seconds: of CPU time, for methods that are stopped by time.
        seed: of everything random.
        options: further ones, that the method knows.

    Raises:
        InputError: no such method.
    """
    if method not in FITTERS:
        raise InputError("method", method, "no such method", f"use one of {', '.join(FITTERS)}")
    source, target = (np.array(mesh.vertices, np.float64) for mesh in (pair.source, pair.target))
    faces = np.array(pair.source.faces, np.int64)
    return FITTERS[method](
        source, target, faces, height=pair.height, seconds=seconds, seed=seed, **options
    )
