"""Seeded pairs of one body in two poses, free of self-intersections, and kept on disk.

As in the paper's fitting experiment (supplement), source and target have the same shape and two
sampled poses; a body that intersects itself, by this project's own exact check, is drawn again.  No
injective map could reach such a target from a sound source.

Guarantee: pair i of a seed depends on the model's name, the seed and i only, so that a longer run
has the same first pairs, and a pair in the cache is the one that would be made.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import trimesh

from experiments.bodies.arrays import read_arrays
from implicit_warp.checking import check
from implicit_warp.errors import InputError
from implicit_warp.files import atomic_write

_TRIES = 2000


class BodyModel(Protocol):
    """A body that can be shaped and posed.

    Attributes:
        name: of the model, its version and settings; part of the cached files' names.
        faces: (F, 3) the faces of every mesh it makes.
    """

    name: str
    faces: np.ndarray

    def sample_shape(self, rng: np.random.Generator) -> np.ndarray:
        """Shape parameters drawn from the model's distribution."""

    def sample_pose(self, rng: np.random.Generator) -> np.ndarray:
        """Pose parameters drawn from the model's distribution."""

    def vertices(self, shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """(V, 3) the body's vertices."""

    def height(self, shape: np.ndarray) -> float:
        """The height of the body standing at rest."""


@dataclass(frozen=True)
class Pair:
    """One body in two poses.

    Attributes:
        name: unique among all pairs of all models and seeds.
        source, target: meshes of the same faces.
        height: of the body standing at rest, in the meshes' units: what counts as 1.4 in errors.
    """

    name: str
    source: trimesh.Trimesh
    target: trimesh.Trimesh
    height: float


def pairs(
    count: int,
    seed: int = 0,
    model: BodyModel | None = None,
    folder: str | Path | None = None,
) -> Iterator[Pair]:
    """The first pairs of a seed, from the cache or made and cached one by one.

    Args:
        count: how many.
        seed: of shapes and poses.
        model: whose bodies; `AnnyBody()` if None.
        folder: of the cache; by default ``$IMPLICIT_WARP_CACHE/pairs``, or
            ``~/.cache/implicit_warp/pairs``.

    Raises:
        MissingDependency: the default model without the extra ``human``.
        InputError: a model that makes no sound body in many tries.
    """
    if model is None:
        from experiments.bodies.anny_body import AnnyBody

        model = AnnyBody()
    home = os.environ.get("IMPLICIT_WARP_CACHE", Path.home() / ".cache" / "implicit_warp")
    folder = Path(home) / "pairs" if folder is None else Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for index in range(count):
        path = folder / f"{model.name}-{seed}-{index}.npz"
        if not path.exists():
            source, target, height = _sound_pair(model, np.random.default_rng([seed, index]))
            with atomic_write(path) as temporary:
                np.savez(temporary, source=source, target=target, faces=model.faces, height=height)
        stored = read_arrays(path, ("source", "target", "faces", "height"))
        source, target = (
            trimesh.Trimesh(stored[role], stored["faces"], process=False)
            for role in ("source", "target")
        )
        yield Pair(path.stem, source, target, float(stored["height"]))


def _sound_pair(model: BodyModel, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """Two sound poses of one body; of another body if the first finds none in a tenth of the tries,
    as very heavy ones do."""
    for _ in range(10):
        shape = model.sample_shape(rng)
        found = []
        for _ in range(_TRIES // 10):
            body = model.vertices(shape, model.sample_pose(rng))
            mesh = trimesh.Trimesh(body, model.faces, process=False)
            if check(mesh, referees=()).num_self_intersections == 0:
                found.append(body)
            if len(found) == 2:
                return *found, model.height(shape)
    raise InputError(
        "model", model.name, f"no sound body in {_TRIES} tries", "narrow its distributions"
    )
