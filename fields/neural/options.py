"""How to fit a network to a shape: numbers with names, checked where they are made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from dataclasses import fields as options_of
from typing import Any

import torch

from fields import arguments
from fields.errors import InputError

_WHOLE = {
    "steps": (1, 1 << 31),
    "batch": (1, 1 << 31),
    "gradient_batch": (1, 1 << 31),
    "near_samples": (1, 1 << 31),
    "box_samples": (1, 1 << 31),
    "lipschitz_boxes": (0, 1 << 31),
    "seed": (0, 1 << 53),
}
"""Options that are whole numbers, and their ranges."""


@dataclass(frozen=True, slots=True)
class NeuralOptions:
    """Options of `fields.fit_neural` and `fields.fit_family`.

    With d the true distance, n its gradient (on the surface, the normal), f the network, and
    lengths in units of half the longest side of the training box, what is minimised is the sum of

        distance_weight     mean | clamp(f) - clamp(d) |      near the surface and in the box
        surface_weight      mean | f |                        on the surface
        normal_weight       mean | grad f - n |^2             on the surface
        eikonal_weight      mean ( | grad f | - 1 )^2         in the box
        off_surface_weight  mean exp(-sharpness | f |)        in the box

    The first alone gives the least distance error for the time; normals make surfaces smoother to
    look at; the last is for surfaces without distances (Sitzmann et al. 2020), and is off.

    Attributes:
        steps: Adam steps, along which the learning rate falls.
        seconds: stop after so much time all the same, and let the learning rate fall along it. Such
            a run cannot be repeated bit for bit. None for no limit.
        batch: points of the distance term a step.
        gradient_batch: points of each of the terms on the surface, and of those with gradients in
            the box, a step.
        near_samples: points drawn near the surface, in advance, and as many on it.
        box_samples: points drawn uniformly in the training box, in advance.
        near_fraction: of each batch that is drawn from the first kind.
        near_scales: standard deviations of the distance from the surface at which points are drawn,
            in equal parts, as fractions of the diagonal of the bounds.
        padding: width that the training box adds to the bounds on every side, a fraction of their
            diagonal.
        clamp: distances beyond this fraction of the diagonal count as this; None for all as they
            are.
        distance_weight, surface_weight, normal_weight, eikonal_weight, off_surface_weight: above.
        sharpness: above, per unit.
        learning_rate: at the start, of the tables of a `HashGrid`; dense layers take a third of it
            beside tables, and a tenth in a `Siren`.
        decay: the learning rate at the end, as a fraction of that at the start.
        lipschitz_boxes: boxes to look at for a proved bound on the gradient (see
            `fields.neural.enclosure_gradient`), some 0.1 to 0.5 ms each; 0 leaves `lipschitz` None.
            It pays for small networks only: for the defaults the bound stays in the hundreds.
        seed: of every random choice.
        device: where to compute.
    """

    steps: int = 3000
    seconds: float | None = None
    batch: int = 4096
    gradient_batch: int = 512
    near_samples: int = 300_000
    box_samples: int = 100_000
    near_fraction: float = 0.75
    near_scales: tuple[float, ...] = (0.002, 0.01, 0.03)
    padding: float = 0.05
    clamp: float | None = None
    distance_weight: float = 1.0
    surface_weight: float = 0.1
    normal_weight: float = 0.01
    eikonal_weight: float = 0.001
    off_surface_weight: float = 0.0
    sharpness: float = 100.0
    learning_rate: float = 0.01
    decay: float = 0.01
    lipschitz_boxes: int = 0
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        for name, (least, most) in _WHOLE.items():
            whole = arguments.whole(name, getattr(self, name), least, most)
            object.__setattr__(self, name, whole)  # 3.0 becomes 3
        for name in ("seconds", "clamp"):
            if getattr(self, name) is not None:
                arguments.positive(name, getattr(self, name))
        for name in ("padding", "sharpness", "learning_rate", "decay"):
            arguments.positive(name, getattr(self, name))
        weights = [option.name for option in options_of(self) if option.name.endswith("_weight")]
        if not sum(arguments.not_negative(name, getattr(self, name)) for name in weights):
            raise InputError("distance_weight", 0.0, "all weights are zero", "raise at least one")
        if not 0 <= arguments.number("near_fraction", self.near_fraction) <= 1:
            raise InputError(
                "near_fraction", self.near_fraction, "it is no fraction", "pass 0 to 1"
            )
        self._refuse_bad_scales()
        self._refuse_few_samples()
        try:
            torch.empty(0, device=self.device)
        except (RuntimeError, AssertionError, TypeError) as error:
            cause = str(error).splitlines()[0]
            raise InputError(
                "device", self.device, f"torch cannot use it ({cause})", 'use "cpu"'
            ) from error

    def _refuse_bad_scales(self) -> None:
        if not isinstance(self.near_scales, tuple | list) or not self.near_scales:
            raise InputError(
                "near_scales", self.near_scales, "no scale is given", "pass e.g. (0.002, 0.01)"
            )
        scales = tuple(arguments.not_negative("near_scales", scale) for scale in self.near_scales)
        object.__setattr__(self, "near_scales", scales)  # a list, as JSON has it, becomes a tuple

    def _refuse_few_samples(self) -> None:
        """A batch larger than what it is drawn from would only repeat points."""
        near = math.ceil(self.batch * self.near_fraction)
        for name, has, needs in (
            ("near_samples", self.near_samples, max(near, self.gradient_batch)),
            ("box_samples", self.box_samples, max(self.batch - near, self.gradient_batch)),
        ):
            if has < needs:
                raise InputError(
                    name,
                    has,
                    f"too few: one step alone uses {needs} of them",
                    "draw many more, such as 100,000, or lower batch and gradient_batch",
                )

    def with_changes(self, values: Mapping[str, Any]) -> NeuralOptions:
        """A copy with some options replaced; unknown names are refused."""
        known = [option.name for option in options_of(self)]
        for name in values:
            if name not in known:
                raise InputError(
                    name, values[name], "no such option of the fit", f"use {', '.join(known)}"
                )
        return replace(self, **values)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)
