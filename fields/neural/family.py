"""One network for a family of shapes, each a point of a latent space.

An auto-decoder (Park et al., "DeepSDF", CVPR 2019): a latent vector for each shape is learned along
with the network, and afterwards one for a new shape with the network held still. The network is a
SIREN whose every layer sees the latent,

    h_k+1 = sin(frequency (W_k h_k + b_k + V_k z)),

which is what writing z beside h_k comes to. So the network at one latent is a plain SIREN with
other biases, and everything that holds for learned fields holds for it.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from os import PathLike
from typing import Any, final

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor, nn

from fields import arguments
from fields.errors import FileFormatError, InputError
from fields.field import Field
from fields.mesh import TriangleMesh, mesh
from fields.neural import files
from fields.neural.architecture import Siren, describe
from fields.neural.fit import parameter_groups, silent
from fields.neural.leaf import NeuralOracle, neural_field
from fields.neural.losses import distance_loss
from fields.neural.measure import Accuracy, measure
from fields.neural.networks import Network
from fields.neural.options import NeuralOptions
from fields.neural.samples import Cube, bounded, draw
from fields.neural.storing import network_of, network_tensors
from fields.neural.training import Progress, Terms, Training
from fields.tags import hull

LATENT_WEIGHT = 1e-4
"""Of |z|^2 in the loss, as in the paper: keeps the latents near each other, so that what lies
between them is a shape too."""

LATENT_SPREAD = 0.01
"""Standard deviation of the latents at the start."""

ENCODE_STEPS = 300
"""Adam steps for the latent of a new shape."""

_REVIEWED = 2048
"""Points of each shape on which reviews measure the error."""


@dataclass(frozen=True, slots=True)
class FamilyReport:
    """What the fit of a family reached.

    Attributes:
        status, steps, seconds, parameters, history: as in `NeuralReport`.
        accuracies: one a shape, see `Accuracy`.
    """

    status: str
    steps: int
    seconds: float
    parameters: int
    accuracies: list[Accuracy]
    history: list[tuple[int, float, float]] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


@final
class Family:
    """Shapes that one network holds; made by `fields.fit_family` or `Family.load`.

    Attributes:
        latents: `(shapes, size)` float64, those of the shapes it was fitted to.
    """

    def __init__(
        self, network: Network, shifts: Sequence[Tensor], latents: Tensor, box: NDArray[np.float64]
    ) -> None:
        self._network = copy.deepcopy(network).requires_grad_(False)
        self._shifts = [shift.detach().clone() for shift in shifts]
        self._box = np.array(box, dtype=np.float64)
        self.latents = latents.detach().double().numpy().copy()

    def __len__(self) -> int:
        return len(self.latents)

    def __repr__(self) -> str:
        return f"<Family of {len(self)} shapes, latents of {self.latents.shape[1]} numbers>"

    @property
    def box(self) -> NDArray[np.float64]:
        """The box `(2, 3)` that all shapes were learned in, and where each `shape` ends."""
        return self._box.copy()

    def shape(self, index: int) -> Field:
        """The learned field of one of the shapes it was fitted to.

        Raises:
            InputError: there is no such shape.
        """
        return self.at(self.latents[arguments.whole("index", index, 0, len(self) - 1)])

    def at(self, latent: ArrayLike) -> Field:
        """The field at any latent vector, such as `(family.latents[0] + family.latents[1]) / 2`.

        Raises:
            InputError: not a vector of finite numbers of the family's latent size.
        """
        size = self.latents.shape[1]
        try:
            z = np.array(latent, dtype=np.float32)
        except (TypeError, ValueError):
            z = np.empty(0)
        if z.shape != (size,) or not np.isfinite(z).all():
            raise InputError(
                "latent", latent, f"a latent here is {size} finite numbers", "start from `latents`"
            )
        network = copy.deepcopy(self._network)
        for bias, shift in zip(network.biases, self._shifts, strict=True):
            bias += shift @ torch.from_numpy(z)
        return neural_field(NeuralOracle(network, self._box))

    def between(self, first: int, second: int, fraction: float) -> Field:
        """A shape on the straight way from one to another in latent space.

        Args:
            first, second: indices of shapes.
            fraction: 0 is the first, 1 the second.
        """
        ends = [
            self.latents[arguments.whole(name, index, 0, len(self) - 1)]
            for name, index in (("first", first), ("second", second))
        ]
        t = arguments.number("fraction", fraction)
        return self.at((1 - t) * ends[0] + t * ends[1])

    def encode(
        self, source: Field | TriangleMesh | str | PathLike[str], *, seed: int = 0
    ) -> NDArray[np.float64]:
        """The latent `(size,)` whose shape is nearest to a new one, by optimisation.

        Args:
            source: a closed mesh or a field with bounds within the family's `box`.
            seed: of the samples.

        Raises:
            InputError: it cannot be learned, or reaches beyond the family's box.

        Non-guarantee: shapes unlike all of the family are met badly; compare `at(latent)` with
        the source.
        """
        shape = source if isinstance(source, Field) else mesh(source)
        bounds = bounded(shape)
        if (bounds[0] < self._box[0]).any() or (bounds[1] > self._box[1]).any():
            raise InputError(
                "source",
                bounds.tolist(),
                f"its bounds reach beyond those of the family, {self._box.tolist()}",
                "move or scale it like the shapes that were learned",
            )
        options = NeuralOptions(
            steps=ENCODE_STEPS, batch=2048, gradient_batch=1, near_samples=20_000,
            box_samples=20_000, learning_rate=0.05, decay=0.1, seed=seed,
        )  # fmt: skip
        latent = nn.Parameter(torch.zeros(1, self.latents.shape[1]))
        with torch.inference_mode(False), torch.enable_grad():
            pool = _Pool([shape], Cube(self._box, _diagonal(bounds)), options)
            decoder = _Decoder(self._network, self._shifts, latent)
            training = pool.training([([latent], 1.0)], decoder, options)
            training.run(silent, lambda: None)
        return latent.detach()[0].double().numpy()

    def save(self, path: str | PathLike[str]) -> None:
        """Write to a `.safetensors` file, whole or not at all."""
        tensors = {f"network.{k}": v for k, v in network_tensors(self._network).items()}
        tensors |= {f"shift.{k}": shift for k, shift in enumerate(self._shifts)}
        tensors["latents"] = torch.from_numpy(self.latents)
        facts = {"architecture": describe(self._network.architecture), "box": self._box.tolist()}
        files.write(path, files.FAMILY, tensors, facts)

    @staticmethod
    def load(path: str | PathLike[str]) -> Family:
        """Read what `save` wrote.

        Raises:
            InputError: there is no such file.
            FileFormatError: it is damaged, altered, of another version, or holds something else.
        """
        tensors, facts = files.read(path, files.FAMILY)
        try:
            prefix = "network."
            own = {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
            network = network_of(own, facts["architecture"])
            shifts = [tensors[f"shift.{k}"] for k in range(len(network.biases))]
            return Family(network, shifts, tensors["latents"], np.array(facts["box"]))
        except files.DAMAGE as error:
            raise FileFormatError(
                f"{path}: the family's description is damaged ({error})"
            ) from error


def fit_family(
    sources: Sequence[Field | TriangleMesh | str | PathLike[str]],
    latent: int = 16,
    architecture: Siren | None = None,
    *,
    options: NeuralOptions | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> tuple[Family, FamilyReport]:
    """Learn several shapes with one network, each with a latent vector of its own.

    Args:
        sources: closed meshes or fields with bounds, at the same place and scale.
        latent: numbers of a latent vector.
        architecture: a `Siren`; by default one of 128 x 3 and frequency 10, which moves between
            shapes more smoothly than a higher one.
        options: as for `fit_neural`; of the weights only `distance_weight` and `clamp` play a part.
            Samples are drawn for each shape; a step's batch is spread over all of them. On the CPU.
        progress: called with (steps done, steps in all, a short text) now and then.
        **changes: options by name.

    Returns:
        The family, and a report. On Ctrl-C, the best so far, with the status "interrupted".

    Raises:
        InputError: fewer than two shapes, one that cannot be learned, or an option out of range.
        MissingDependency: Open3D is needed for meshes, and is not installed.
    """
    options = (options or NeuralOptions(near_samples=50_000, box_samples=50_000)).with_changes(
        changes
    )
    size = arguments.whole("latent", latent, 1, 4096)
    if isinstance(sources, str | Field) or len(sources) < 2:
        raise InputError("sources", sources, "a family is two shapes or more", "pass a list")
    architecture = architecture or Siren(frequency=10.0)
    if not isinstance(architecture, Siren):
        raise InputError(
            "architecture", architecture, "families are learned by SIRENs", "pass a fields.Siren"
        )
    shapes = [source if isinstance(source, Field) else mesh(source) for source in sources]
    bounds = bounded(shapes[0])
    for shape in shapes[1:]:
        bounds = hull(bounds, bounded(shape))
    cube = Cube.around(bounds, options.padding)
    generator = torch.Generator().manual_seed(options.seed)
    network = Network(architecture, generator)
    shifts = [
        # Weighted like the columns of the layer beside them.
        nn.Parameter(torch.empty(len(bias), size).uniform_(-1, 1, generator=generator) * spread)
        for bias, spread in zip(network.biases, _shift_spreads(network), strict=True)
    ]
    latents = nn.Parameter(LATENT_SPREAD * torch.randn(len(shapes), size, generator=generator))
    with torch.inference_mode(False), torch.enable_grad():
        pool = _Pool(shapes, cube, options)
        groups = [*parameter_groups(network), (shifts, 0.1), ([latents], 0.1)]
        training = pool.training(groups, _Decoder(network, shifts, latents), options)
        status = training.run(progress or silent, lambda: None)
        family = Family(network, shifts, latents, cube.box)
        accuracies = [
            measure(family.shape(index), shape, Cube(cube.box, _diagonal(shape.bounds)))
            for index, shape in enumerate(shapes)
        ]
    record = training.record
    size = sum(parameter.numel() for parameter in training.parameters)
    report = FamilyReport(status, record.step, record.seconds, size, accuracies, record.history)
    return family, report


def _diagonal(bounds: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.ptp(bounds, axis=0)))


def _shift_spreads(network: Network) -> list[float]:
    frequency = network.architecture.frequency
    return [math.sqrt(6 / weight.shape[1]) / frequency for weight in network.weights]


@dataclass(frozen=True, slots=True)
class _Decoder:
    """The network at the latents of several shapes."""

    network: Network
    shifts: Sequence[Tensor]
    latents: Tensor

    def __call__(self, points: Tensor) -> Tensor:
        """Values `(shapes, n)` at points `(shapes, n, 3)`."""
        biases = [
            bias + (self.latents @ shift.T).unsqueeze(1)
            for bias, shift in zip(self.network.biases, self.shifts, strict=True)
        ]
        return self.network.through_layers(points, biases)


class _Pool:
    """Samples of several shapes in one cube."""

    def __init__(self, shapes: Sequence[Field], cube: Cube, options: NeuralOptions) -> None:
        drawn = [draw(shape, cube, options) for shape in shapes]
        self.near = torch.stack([samples.near for samples in drawn])
        self.near_distances = torch.stack([samples.near_distances for samples in drawn])
        self.box = torch.stack([samples.box for samples in drawn])
        self.box_distances = torch.stack([samples.box_distances for samples in drawn])
        self._scale = cube.diagonal / cube.unit

    def training(self, groups: list[Any], decoder: _Decoder, options: NeuralOptions) -> Training:
        """The auto-decoder's loss: distances, and |z|^2."""
        clamp = None if options.clamp is None else options.clamp * self._scale
        each = max(1, options.batch // len(self.near))
        near = math.ceil(each * options.near_fraction)

        def terms(generator: torch.Generator) -> Terms:
            points, distances = self._batch(near, each - near, generator)
            return {
                "distance": (
                    distance_loss(decoder(points), distances, clamp),
                    options.distance_weight,
                ),
                "latent": (decoder.latents.square().sum(dim=-1).mean(), LATENT_WEIGHT),
            }

        points = torch.cat([self.near[:, :_REVIEWED], self.box[:, :_REVIEWED]], dim=1)
        distances = torch.cat(
            [self.near_distances[:, :_REVIEWED], self.box_distances[:, :_REVIEWED]], dim=1
        )

        @torch.no_grad()
        def error() -> float:
            return float(distance_loss(decoder(points), distances, clamp)) / self._scale

        return Training(groups, options, terms, error)

    def _batch(self, near: int, box: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        i = torch.randint(self.near.shape[1], (near,), generator=generator)
        j = torch.randint(self.box.shape[1], (box,), generator=generator)
        points = torch.cat([self.near[:, i], self.box[:, j]], dim=1)
        return points, torch.cat([self.near_distances[:, i], self.box_distances[:, j]], dim=1)
