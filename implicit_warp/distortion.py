"""How a map distorts: quantities at points, and colours that show them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from implicit_warp.energy import elastic_energy
from implicit_warp.errors import InputError
from implicit_warp.maps import Map

Quantity = Literal["stretch", "volume", "energy"]

QUANTITIES: tuple[Quantity, ...] = ("stretch", "volume", "energy")

_BLOCK = 1 << 16

# A calm blue, nearly white, a warm red: dark at both ends, equally light steps in between.
_DIVERGING = np.array(
    [[44, 84, 142], [106, 150, 196], [190, 211, 228], [245, 244, 240], [240, 200, 178],
     [214, 120, 92], [158, 42, 43]],
    np.float64,
)  # fmt: skip


def distortion(map: Map, points: ArrayLike, quantity: Quantity) -> NDArray[np.float64]:
    """(n,) what a map does at points (n, 3).

    Args:
        map: any map.
        points: at rest.
        quantity: "stretch", the singular value of the Jacobian that is farthest from 1, by its
            logarithm; "volume", det J; or "energy", |J^T J - 1|^2 as the elastic solve has it.

    Raises:
        InputError: no such quantity; points that the map refuses.
    """
    if quantity not in QUANTITIES:
        raise InputError("quantity", quantity, "no such one", f"use one of {', '.join(QUANTITIES)}")
    array = np.asarray(points, np.float64)
    found = [np.empty(0)]
    for start in range(0, len(array), _BLOCK):
        jacobian = torch.from_numpy(map.jacobian(array[start : start + _BLOCK]))
        if quantity == "volume":
            found.append(torch.linalg.det(jacobian).numpy())
        elif quantity == "energy":
            found.append(elastic_energy(jacobian).numpy())
        else:
            values = torch.linalg.svdvals(jacobian).numpy()
            row = np.arange(len(values))
            found.append(values[row, np.abs(np.log(values)).argmax(axis=1)])
    return np.concatenate(found)


class Coloured(NamedTuple):
    """Values as colours.

    Attributes:
        colours: (n, 3) uint8.
        low, high: the values of the two ends of the scale.
    """

    colours: NDArray[np.uint8]
    low: float
    high: float


def coloured(values: ArrayLike, quantity: Quantity | Literal["distance"]) -> Coloured:
    """Colours of values: ratios are blue below 1 and red above, on a logarithmic scale as wide on
    both sides; energies and distances go from white to red.

    The scale ends at the farthest of 99 % of the values: single ones do not bleach the rest.
    """
    array = np.asarray(values, np.float64)
    if quantity in ("energy", "distance"):
        high = max(float(np.quantile(array, 0.99, method="higher")) if len(array) else 0.0, 1e-12)
        share = 0.5 + 0.5 * np.clip(array / high, 0.0, 1.0)
        return Coloured(_ramp(share), 0.0, high)
    logs = np.log(np.maximum(array, 1e-12))
    reach = float(np.quantile(np.abs(logs), 0.99, method="higher")) if len(logs) else 0.0
    reach = max(reach, np.log(1.05))  # hardly any distortion looks like hardly any
    share = 0.5 + 0.5 * np.clip(logs / reach, -1.0, 1.0)
    return Coloured(_ramp(share), float(np.exp(-reach)), float(np.exp(reach)))


def _ramp(share: NDArray[np.float64]) -> NDArray[np.uint8]:
    place = share * (len(_DIVERGING) - 1)
    channels = [
        np.interp(place, np.arange(len(_DIVERGING)), _DIVERGING[:, channel]) for channel in range(3)
    ]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)
