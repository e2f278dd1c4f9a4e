"""What the benchmark measures, and how much of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numba
import torch

from implicit_warp.errors import InputError


@dataclass(frozen=True)
class Settings:
    """Sizes of all measurements; the defaults are those that the goals are stated for.

    Attributes:
        device: "cpu" or a CUDA device of torch.
        threads: of torch and of the Numba kernels; as they are now if None.
        seed: of the random map and points.
        layers, resolution: of the measured map.
        points: a call of the map, of its inverse, or with Jacobians.
        reference_points: the same for the torch reference, whose rate is what counts.
        searched_points: the same for the reference's inverse, which tests every cell.
        vertices: of the mesh of the fit step.
        samples: interior points an elastic step.
        elastic_steps, reference_elastic_steps: over which one step is averaged.
        extraction_resolution, fine_resolution: voxels of the extractions.
        searched_resolution: voxels of the reference's extraction of a warped field, scaled.
        solve_resolutions: of the embedding solves.
        largest_reference_solve: the dense reference solve runs up to this resolution.
        memory_points, reference_memory_points: of the call whose memory is measured.
        large_points: of the one large map on a GPU.
        rounds: measurements of each quantity, of which the median counts.
        few_rounds: the same for what takes long: the reference, whole solves and processes.
    """

    device: str = "cpu"
    threads: int | None = None
    seed: int = 0
    layers: int = 24
    resolution: int = 11
    points: int = 1_000_000
    reference_points: int = 100_000
    searched_points: int = 4_000
    vertices: int = 6890
    samples: int = 20_000
    elastic_steps: int = 25
    reference_elastic_steps: int = 25
    extraction_resolution: int = 256
    fine_resolution: int = 512
    searched_resolution: int = 32
    solve_resolutions: tuple[int, ...] = (11, 25, 65)
    largest_reference_solve: int = 65
    memory_points: int = 10_000_000
    reference_memory_points: int = 1_000_000
    large_points: int = 100_000_000
    rounds: int = 7
    few_rounds: int = 3

    def __post_init__(self) -> None:
        names = ("cpu", "cuda")
        if self.device.partition(":")[0] not in names:
            raise InputError(
                "device", self.device, "no such device", f"use one of {', '.join(names)}"
            )
        if self.device != "cpu" and not torch.cuda.is_available():
            raise InputError("device", self.device, "torch sees no CUDA device", 'use "cpu"')
        for name, value in vars(self).items():
            values = value if isinstance(value, tuple) else (value,)
            if name in ("device", "seed") or value is None:
                continue
            if not all(isinstance(v, int) and v > 0 for v in values):
                raise InputError(name, value, "not a positive whole number", "see Settings")
        if self.vertices < 4:
            raise InputError("vertices", self.vertices, "no closed mesh is so small", "pass >= 4")

    @classmethod
    def quick(cls, **changes: Any) -> Settings:
        """Smaller calls and fewer rounds: about a tenth of the time, and noisier."""
        values = {
            "points": 200_000,
            "reference_points": 20_000,
            "searched_points": 2_000,
            "reference_elastic_steps": 2,
            "extraction_resolution": 64,
            "fine_resolution": 96,
            "searched_resolution": 16,
            "largest_reference_solve": 25,
            "reference_memory_points": 200_000,
            "rounds": 3,
            "few_rounds": 1,
        }
        return replace(cls(), **{**values, **changes})

    def thread_count(self) -> int:
        """The threads that the kernels run on."""
        return numba.get_num_threads() if self.threads is None else self.threads
