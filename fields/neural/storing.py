"""Learned fields on disk."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fields.errors import FileFormatError, InputError
from fields.field import Field
from fields.neural import files
from fields.neural.architecture import describe, from_description
from fields.neural.fit import NeuralReport
from fields.neural.leaf import NeuralOracle, neural_field, neural_leaf
from fields.neural.networks import Network
from fields.notation import Call, literal


def save_neural(
    field: Field, path: str | PathLike[str], report: NeuralReport | None = None
) -> None:
    """Write a learned field to a `.safetensors` file, whole or not at all.

    Args:
        field: what `fit_neural`, `Family.shape` or `Family.at` gave, as it came: save before moving
            or combining.
        path: where to.
        report: of the fit, kept beside it.

    Raises:
        InputError: the field is no network, or has been worked on since; or the path cannot be
            written.
    """
    leaf = neural_leaf(field) if isinstance(field, Field) else None
    if leaf is None:
        raise InputError(
            "field",
            field,
            "it is not just a network",
            "save what fit_neural returned; motions and combinations go into a script",
        )
    facts = {
        "architecture": describe(leaf.network.architecture),
        "box": leaf.box.tolist(),
        "lipschitz": leaf.lipschitz,
        "steepness": leaf.steepness,
        "report": None if report is None else report.to_dict(),
    }
    files.write(path, files.NEURAL, network_tensors(leaf.network), facts)


def load_neural(path: str | PathLike[str]) -> Field:
    """The learned field that `save_neural` or `implicit-warp learn-sdf` wrote.

    Raises:
        InputError: there is no such file.
        FileFormatError: it is damaged, altered, of another version, or holds something else.
    """
    tensors, facts = files.read(path, files.NEURAL)
    try:
        network = network_of(tensors, facts["architecture"])
        box = np.array(facts["box"])
        oracle = NeuralOracle(network, box, facts["lipschitz"], facts["steepness"])
    except files.DAMAGE as error:
        raise FileFormatError(f"{path}: the network's description is damaged ({error})") from error
    return neural_field(oracle, Call("load_neural", (), (literal(Path(path)),)))


def facts_of(path: str | PathLike[str]) -> dict[str, Any]:
    """What a file of a learned field says beside its numbers; for people to read."""
    return files.read(path, files.NEURAL)[1]


def network_tensors(network: Network) -> dict[str, Tensor]:
    """All numbers of a network by name."""
    return dict(network.state_dict())


def network_of(tensors: dict[str, Tensor], architecture: dict[str, Any]) -> Network:
    """The inverse of `network_tensors`; raises one of `files.DAMAGE` if they do not fit."""
    network = Network(from_description(architecture))
    network.load_state_dict(tensors)
    if not all(bool(torch.isfinite(tensor).all()) for tensor in tensors.values()):
        raise InputError("tensors", len(tensors), "NaN or infinite values", "fit anew")
    return network
