"""Learned fields: tiny networks with fixed weights, in boxes of uneven sides."""

from __future__ import annotations

import numpy as np
import torch

from fields import Field
from fields.neural.architecture import Architecture, HashGrid, Siren
from fields.neural.enclosure_gradient import lipschitz_bound
from fields.neural.leaf import NeuralOracle, neural_field
from fields.neural.networks import Network
from tests.fields.catalogue.surface import Surface

BOX = np.array([[-1.0, -1.2, -0.5], [1.0, 1.4, 0.9]])


def tiny_network(architecture: Architecture, seed: int = 5) -> Network:
    """Random weights, features that matter, and values of both signs."""
    network = Network(architecture, torch.Generator().manual_seed(seed))
    with torch.no_grad():
        if network.table is not None:
            network.table *= 3_000.0
        network.biases[-1] -= 0.1
    return network


def _field(architecture: Architecture) -> Field:
    network = tiny_network(architecture)
    return neural_field(NeuralOracle(network, BOX, lipschitz_bound(network, 1 << 11)))


EXAMPLES: dict[str, Field] = {
    "neural, siren": _field(Siren(8, 2, 3.0)),
    "neural, hash grid": _field(HashGrid(2, 2, 5, 6, 8, 1)),
}

SURFACES: dict[str, Surface] = {}
