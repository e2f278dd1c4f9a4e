"""The state of a fit on disk, from which it goes on bit for bit."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.files import atomic_write, read_tensors, refuse_target
from implicit_warp.fitting.options import FitOptions
from implicit_warp.fitting.problem import Correspondence

if TYPE_CHECKING:
    from implicit_warp.fitting.solve import _Fit

FORMAT = "implicit_warp.fit"
FORMAT_VERSION = "1"


class Checkpoint:
    """A `.safetensors` file with the net, the optimiser and the history of one fit.

    Args:
        path: where it is, or will be.
        given: what is fitted; its fingerprint goes into the file.
        options: the same.

    Raises:
        InputError: a file cannot be written there.
    """

    def __init__(self, path: str | Path, given: Correspondence, options: FitOptions) -> None:
        self.path = Path(path)
        refuse_target(self.path, (".safetensors",))
        self._fingerprint = _fingerprint(given, options)

    def restore(self, fit: _Fit) -> None:
        """Bring a fit to the state in the file, if there is one.

        Raises:
            InputError: the file belongs to another fit.
            FileFormatError: the file is damaged, or no checkpoint.
        """
        if not self.path.exists():
            return
        tensors, metadata = read_tensors(self.path)
        if (metadata.get("format"), metadata.get("format_version")) != (FORMAT, FORMAT_VERSION):
            raise FileFormatError(
                f"{self.path}: holds no fit that this version can go on with. Choose another file"
            )
        if metadata["fingerprint"] != self._fingerprint:
            raise InputError(
                "checkpoint",
                str(self.path),
                "it was written by a fit of other points or with other options",
                "choose another file, or remove this one",
            )
        state = json.loads(metadata["state"])
        fit.step, fit.seconds = state["step"], state["seconds"]
        fit.relapses = state["relapses"]
        fit.history = [tuple(row) for row in state["history"]]
        fit.net.load_state_dict(_under("net.", tensors))
        fit.best = (state["best"], _under("best.", tensors))
        optimiser = fit.optimiser.state_dict()
        optimiser["state"] = {
            int(index): _under(f"optimiser.{index}.", tensors) for index in state["parameters"]
        }
        fit.optimiser.load_state_dict(optimiser)

    def write(self, fit: _Fit) -> None:
        """Write the state of a fit, whole or not at all."""
        from safetensors.torch import save_file

        tensors = _named("net.", fit.net.state_dict())
        tensors |= _named("best.", fit.best[1])
        states = fit.optimiser.state_dict()["state"]
        for index, values in states.items():
            tensors |= _named(f"optimiser.{index}.", values)
        state = {
            "step": fit.step,
            "seconds": fit.seconds,
            "history": fit.history,
            "relapses": fit.relapses,
            "best": fit.best[0],
            "parameters": list(states),
        }
        metadata = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "fingerprint": self._fingerprint,
            "state": json.dumps(state),
        }
        with atomic_write(self.path) as temporary:
            save_file(tensors, temporary, metadata=metadata)


def _named(prefix: str, tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {prefix + name: value.detach().cpu().clone() for name, value in tensors.items()}


def _under(prefix: str, tensors: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    return {n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)}


def _fingerprint(given: Correspondence, options: FitOptions) -> str:
    """Changes with everything that the course of a fit depends on."""
    digest = hashlib.sha256(json.dumps(asdict(options)).encode())
    for tensor in (given.source, given.target, given.weights):
        digest.update(str(tuple(tensor.shape)).encode() + tensor.numpy().tobytes())
    if given.faces is not None:
        digest.update(given.faces.tobytes())
    return digest.hexdigest()
