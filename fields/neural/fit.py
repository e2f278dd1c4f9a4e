"""Fitting a network to one shape."""

from __future__ import annotations

import hashlib
import time
from dataclasses import asdict, dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import torch

from fields.errors import FileFormatError, InputError
from fields.field import Field
from fields.mesh import TriangleMesh, mesh
from fields.neural import files
from fields.neural.architecture import Architecture, Siren, as_architecture, describe
from fields.neural.enclosure_gradient import lipschitz_bound
from fields.neural.leaf import NeuralOracle, neural_field
from fields.neural.losses import distance_loss, loss_terms
from fields.neural.measure import Accuracy, measure
from fields.neural.networks import Network
from fields.neural.options import NeuralOptions
from fields.neural.samples import Cube, Samples, bounded, draw
from fields.neural.training import Group, Progress, Terms, Training
from fields.whole_files import refuse_target

_REVIEWED = 4096
"""Points near the surface, and as many in the box, on which reviews measure the error."""


@dataclass(frozen=True, slots=True)
class NeuralReport:
    """What a fit reached.

    Attributes:
        status: "finished", "out of time" or "interrupted".
        steps: steps taken.
        seconds: of training.
        sampling_seconds: of drawing the samples before.
        parameters: how many numbers the network has.
        loss: the last terms, unweighted; see `NeuralOptions`.
        accuracy: measured on fresh points after the fit; see `Accuracy`.
        lipschitz: the proved bound on the gradient's norm, or None.
        history: (step, seconds, mean error over the diagonal) at each review.
        architecture, options: what was fitted, and how.
    """

    status: str
    steps: int
    seconds: float
    sampling_seconds: float
    parameters: int
    loss: dict[str, float]
    accuracy: Accuracy
    lipschitz: float | None
    history: list[tuple[int, float, float]] = field(repr=False)
    architecture: dict[str, Any] = field(repr=False)
    options: dict[str, Any] = field(repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        a = self.accuracy
        percent = [f"{100 * error:.4f} %" for error in (a.near_error, a.box_error, a.chamfer)]
        return (
            f"{self.status} after {self.steps} steps, {self.seconds:.1f} s and "
            f"{self.sampling_seconds:.1f} s of sampling; {self.parameters} numbers. Of the "
            f"diagonal: mean error {percent[0]} near the surface, {percent[1]} in the box, "
            f"surfaces {percent[2]} apart; normals off by {a.normal_error:.2f} degrees"
        )


def fit_neural(
    source: Field | TriangleMesh | str | PathLike[str],
    architecture: str | Architecture = "hash",
    *,
    options: NeuralOptions | None = None,
    checkpoint: str | PathLike[str] | None = None,
    resume: bool = False,
    progress: Progress | None = None,
    **changes: Any,
) -> tuple[Field, NeuralReport]:
    """Learn the signed distance of a shape.

    Args:
        source: a closed mesh (see `fields.mesh`), or any field with bounds. If it is not an exact
            distance, what is learned are its values as they are, without the eikonal term.
        architecture: "hash", "siren", or a `HashGrid` or `Siren` of chosen size.
        options: all options at once; single ones may be given by keyword instead or on top.
        checkpoint: a `.safetensors` file for the state of the fit, written every ten seconds and at
            the end.
        resume: go on from that file, with the same source and options (`steps` and `seconds` may
            differ); the result is that of a run that never stopped, bit for bit.
        progress: called with (steps done, steps in all, a short text) now and then.
        **changes: options by name, see `NeuralOptions`.

    Returns:
        The field, and a report on how good it is. The field is not exact; its bounds are the
        training box, outside of which it is positive whatever the network says there; its
        `lipschitz` is proved, or None. On Ctrl-C, the best so far, with the status "interrupted".

    Raises:
        InputError: a source that cannot be learned, an option out of range, a loss that became NaN,
            or nothing to resume from.
        FileFormatError: a checkpoint that is damaged.
        MissingDependency: Open3D is needed for a mesh, and is not installed.

    Non-guarantees: details thinner than the finest grid, or than the samples are apart, may be
    missing. Memory is about 100 bytes a sample and 20 bytes a parameter.
    """
    options = (options or NeuralOptions()).with_changes(changes)
    # Whatever mode the caller is in, a fit needs gradients.
    with torch.inference_mode(False), torch.enable_grad():
        return _fit(source, architecture, options, checkpoint, resume, progress or silent)


def _fit(
    source: Field | TriangleMesh | str | PathLike[str],
    architecture: str | Architecture,
    options: NeuralOptions,
    checkpoint: str | PathLike[str] | None,
    resume: bool,
    progress: Progress,
) -> tuple[Field, NeuralReport]:
    network = Network(as_architecture(architecture), torch.Generator().manual_seed(options.seed))
    if checkpoint is not None:
        refuse_target(checkpoint, (files.SUFFIX,))
    elif resume:
        raise InputError("resume", resume, "there is no checkpoint", "name its file in checkpoint")
    shape = source if isinstance(source, Field) else mesh(source)
    cube = Cube.around(bounded(shape), options.padding)
    start = time.perf_counter()
    if not shape.exact:
        options = options.with_changes({"eikonal_weight": 0.0})
    samples = draw(shape, cube, options).to(options.device)
    sampling_seconds = time.perf_counter() - start
    training = _training(network.to(options.device), samples, options, cube)
    state = _CheckpointFile(checkpoint, training, network, options, samples)
    if resume:
        state.read()
    status = training.run(progress, state.write)
    boxes = options.lipschitz_boxes
    slope = lipschitz_bound(network.cpu(), boxes) if boxes else None
    steepness = 1.0 if shape.exact else _steepness(samples, cube)
    learned = neural_field(NeuralOracle(network, cube.box, slope, steepness))
    record = training.record
    report = NeuralReport(
        status=status,
        steps=record.step,
        seconds=record.seconds,
        sampling_seconds=sampling_seconds,
        parameters=network.parameter_count,
        loss=record.loss,
        accuracy=measure(learned, shape, cube),
        lipschitz=learned.lipschitz,
        history=record.history,
        architecture=describe(network.architecture),
        options=options.to_dict(),
    )
    return learned, report


def parameter_groups(network: Network) -> list[Group]:
    """A network's parameters with their learning rates; see `NeuralOptions.learning_rate`."""
    dense = [*network.weights, *network.biases]
    if network.table is not None:
        return [([network.table], 1.0), (dense, 1 / 3)]
    return [(dense, 0.1 if isinstance(network.architecture, Siren) else 1 / 3)]


def _steepness(samples: Samples, cube: Cube) -> float:
    """Twice the most that values fall below 0 a unit of depth in the box; see `leaf`."""
    half = torch.from_numpy(np.ptp(cube.box, axis=0) / 2 / cube.unit)
    depth = (half - samples.box.cpu().abs()).amin(dim=1).clamp_min(1e-6)
    return max(1.0, 2 * float((-samples.box_distances.cpu() / depth).max()))


def silent(done: int, total: int, text: str) -> None:
    """A `Progress` that shows nothing."""


def _training(network: Network, samples: Samples, options: NeuralOptions, cube: Cube) -> Training:
    scale = cube.diagonal / cube.unit
    clamp = None if options.clamp is None else options.clamp * scale
    points = torch.cat([samples.near[:_REVIEWED], samples.box[:_REVIEWED]])
    distances = torch.cat([samples.near_distances[:_REVIEWED], samples.box_distances[:_REVIEWED]])

    def terms(generator: torch.Generator) -> Terms:
        values = loss_terms(network, samples, options, generator, clamp)
        return {name: (value, getattr(options, f"{name}_weight")) for name, value in values.items()}

    @torch.no_grad()
    def error() -> float:
        return float(distance_loss(network(points), distances, clamp)) / scale

    return Training(parameter_groups(network), options, terms, error)


class _CheckpointFile:
    """The state of a training on disk; nothing if there is no path."""

    def __init__(
        self,
        path: str | PathLike[str] | None,
        training: Training,
        network: Network,
        options: NeuralOptions,
        samples: Samples,
    ) -> None:
        self._path = None if path is None else Path(path)
        self._training = training
        self._of = {"architecture": describe(network.architecture), "options": options.to_dict()}
        digest = hashlib.sha256()
        for name in samples.__slots__:
            digest.update(getattr(samples, name).cpu().numpy().tobytes())
        self._of["samples"] = digest.hexdigest()

    def write(self) -> None:
        if self._path is not None:
            facts = {"of": self._of, "record": self._training.facts()}
            files.write(self._path, files.CHECKPOINT, self._training.tensors(), facts)

    def read(self) -> None:
        """Restore the training.

        Raises:
            InputError: the file is of another fit.
            FileFormatError: it is damaged.
        """
        tensors, facts = files.read(self._path, files.CHECKPOINT)
        self._refuse_another(facts["of"])
        try:
            self._training.restore(tensors, facts["record"])
        except (KeyError, TypeError, RuntimeError) as error:
            raise FileFormatError(f"{self._path}: the state is damaged ({error})") from error

    def _refuse_another(self, of: dict[str, Any]) -> None:
        own, other = _comparable(self._of), _comparable(of)
        for name in sorted(own.keys() | other.keys()):
            if own.get(name) != other.get(name):
                shown = "another shape" if name == "samples" else f"{name} = {other.get(name)}"
                raise InputError(
                    "checkpoint",
                    str(self._path),
                    f"it is of a fit of {shown}",
                    "resume with the same source, architecture and options, or start anew",
                )


def _comparable(of: dict[str, Any]) -> dict[str, Any]:
    """What must agree, one level deep; the limits of a run may differ."""
    flat = {"samples": of["samples"], **of["architecture"], **of["options"]}
    flat["near_scales"] = tuple(flat["near_scales"])
    return {name: value for name, value in flat.items() if name not in ("steps", "seconds")}
