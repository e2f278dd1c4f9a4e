"""What a fit minimises: checked input in a unit domain, the loss and the errors reported."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from implicit_warp.alignment import apply_affine, best_affine_map
from implicit_warp.errors import InputError
from implicit_warp.fitting.options import FitOptions
from implicit_warp.layers import compose_affine, invert_affine
from implicit_warp.mesh_gradient import MeshGradient

PAPER_HEIGHT = 1.4
"""Height of a body in the scale in which the paper states its errors."""

_LARGEST_RATIO = 50.0
"""Source and target whose sizes differ by more than this are taken to be in different units."""

_FARTHEST = 10.0
"""Landmarks farther from the mesh than so many of its diagonals are taken for mistakes."""


@dataclass(frozen=True)
class Correspondence:
    """Points of the source and where they belong, float64 on the CPU, in the user's units.

    Attributes:
        source, target: (n, 3) the vertices first, then the landmarks.
        n_vertices: how many of them are vertices.
        weights: (n_vertices,) weights of the vertices, of mean 1.
        faces: (F, 3) of the source mesh; None for points.
    """

    source: Tensor
    target: Tensor
    n_vertices: int
    weights: Tensor
    faces: np.ndarray | None


def correspondence(source: Any, target: Any, landmarks: Any, vertex_weights: Any) -> Correspondence:
    """Check what `fit` was given, and put it together.

    Raises:
        InputError: see `fit`.
    """
    if (source is None) != (target is None):
        missing = "source" if source is None else "target"
        raise InputError(missing, None, "the other one is given", "pass both, or landmarks alone")
    if source is None and landmarks is None:
        raise InputError("source", None, "there is nothing to fit", "pass source and target")
    empty = np.empty((0, 3))
    points, goals, faces = empty, empty, None
    if source is not None:
        points, faces = _points("source", source), _faces("source", source)
        goals, goal_faces = _points("target", target), _faces("target", target)
        if len(points) != len(goals):
            raise InputError(
                "target",
                f"{len(goals)} points",
                f"the source has {len(points)}, and vertex i of one belongs to vertex i of the "
                "other",
                "pass meshes of the same connectivity; give landmarks for others",
            )
        if faces is not None and goal_faces is not None and not np.array_equal(faces, goal_faces):
            differ = "their numbers differ" if len(faces) != len(goal_faces) else "their vertices"
            raise InputError(
                "target",
                f"{len(goal_faces)} faces",
                f"its faces are not those of the source ({differ})",
                "pass meshes of the same connectivity, or points to ignore faces",
            )
    marks, mark_goals = (empty, empty) if landmarks is None else _landmarks(landmarks)
    if source is not None:
        _refuse_far_away("landmarks[0]", marks, points)
        _refuse_far_away("landmarks[1]", mark_goals, goals)
    weights = _weights(vertex_weights, len(points))
    both = [torch.from_numpy(np.concatenate(p)) for p in ((points, marks), (goals, mark_goals))]
    _refuse_other_units(*both)
    return Correspondence(*both, len(points), torch.from_numpy(weights), faces)


def _points(argument: str, shape: Any) -> np.ndarray:
    if isinstance(shape, Tensor):
        shape = shape.detach().cpu().numpy()
    try:
        points = np.array(getattr(shape, "vertices", shape), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(
            argument, type(shape).__name__, "neither a mesh nor points", "pass e.g. (n, 3) numbers"
        ) from error
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise InputError(
            argument, points.shape, "the shape should be (n, 3), n > 0", "pass a mesh or points"
        )
    bad = np.flatnonzero(~np.isfinite(points).all(1))
    if len(bad):
        raise InputError(
            argument, f"{len(bad)} points", f"NaN or infinite, the first is {bad[0]}", "remove them"
        )
    return points


def _faces(argument: str, shape: Any) -> np.ndarray | None:
    faces = getattr(shape, "faces", None)
    if faces is None:
        return None
    if not len(faces):
        raise InputError(argument, shape, "a mesh without faces", "pass its vertices as points")
    return np.array(faces, dtype=np.int64)


def _landmarks(landmarks: Any) -> tuple[np.ndarray, np.ndarray]:
    try:
        marks, goals = landmarks
    except (TypeError, ValueError) as error:
        raise InputError(
            "landmarks", type(landmarks).__name__, "not a pair", "pass (source points, targets)"
        ) from error
    marks, goals = _points("landmarks[0]", marks), _points("landmarks[1]", goals)
    if len(marks) != len(goals):
        raise InputError(
            "landmarks",
            f"{len(marks)} points, {len(goals)} targets",
            "every landmark needs its target",
            "pass two arrays of the same length",
        )
    return marks, goals


def _refuse_far_away(argument: str, marks: np.ndarray, points: np.ndarray) -> None:
    """Landmarks far from the shape would shrink it to a spot in the net's domain."""
    centre, size = points.mean(0), np.linalg.norm(np.ptp(points, axis=0))
    far = np.flatnonzero(np.linalg.norm(marks - centre, axis=1) > _FARTHEST * size)
    if len(far):
        raise InputError(
            argument,
            marks[far[0]].tolist(),
            f"landmark {far[0]} is out of range, more than {_FARTHEST:g} sizes of the shape away",
            "give landmarks in the units of the meshes",
        )


def _weights(weights: Any, count: int) -> np.ndarray:
    if weights is None:
        return np.ones(count)
    weights = np.array(weights, dtype=np.float64)
    if weights.shape != (count,):
        raise InputError(
            "vertex_weights", weights.shape, f"the shape should be ({count},)", "one a vertex"
        )
    if not np.isfinite(weights).all() or (weights < 0).any() or not weights.sum() > 0:
        raise InputError(
            "vertex_weights",
            f"{weights.min()} to {weights.max()}",
            "weights are finite, not negative, and not all zero",
            "mend them, or leave them out",
        )
    return weights / weights.mean()


def _refuse_other_units(source: Tensor, target: Tensor) -> None:
    sizes = [float((p.amax(0) - p.amin(0)).norm()) for p in (source, target)]
    for argument, size in zip(("source", "target"), sizes, strict=True):
        if size == 0.0:
            raise InputError(argument, size, "all of its points coincide", "give it a size")
    ratio = sizes[1] / sizes[0]
    if not 1.0 / _LARGEST_RATIO <= ratio <= _LARGEST_RATIO:
        raise InputError(
            "target",
            f"size {sizes[1]:.3g}",
            f"the source has size {sizes[0]:.3g}, so their units seem to differ",
            "scale one of them",
        )


class FitProblem:
    """Source and target in the unit domain, on the device, and the loss between them.

    The net acts in the middle: `after` o net o `before` is the map in the user's units, and
    `target` is the goal pulled back through `after`.

    Attributes:
        source, target: (n, 3) in the unit domain.
        before, after: (3, 4) float64.
        height: length in the user's units that counts as 1.4.
    """

    def __init__(self, given: Correspondence, options: FitOptions) -> None:
        self.options = options
        dtype, device = getattr(torch, options.precision), options.device
        self.before, self.after = _domain(given, options)
        back = invert_affine(self.after)
        self.source = apply_affine(self.before, given.source).to(device, dtype)
        self.target = apply_affine(back, given.target).to(device, dtype)
        box = given.source.amax(0) - given.source.amin(0)
        self.height = float(box.max()) if options.height is None else float(options.height)
        # Errors are measured in the user's space, where `after` may be any affine map.
        self._metric = (self.after[:, :3] * (PAPER_HEIGHT / self.height)).to(device, dtype)
        self.n_vertices = given.n_vertices
        # Of each entry's square in the mean over vertices and coordinates.
        self._weights = (given.weights / (3 * max(given.n_vertices, 1)))[:, None].to(device, dtype)
        self._gradient = None
        if given.faces is not None:
            scaled = given.source[: given.n_vertices] * (PAPER_HEIGHT / self.height)
            self._gradient = MeshGradient(scaled, given.faces, weighting="uniform")

    def errors(self, image: Tensor) -> tuple[dict[str, float], Tensor]:
        """The errors, times 1000, their weighted "total" first, and the total's derivative by the
        image of the source, (n, 3).

        Each error is a mean over all entries in the paper's scale, and a quadratic form d . Q d of
        the differences d: one product gives its value and its derivative, 2 Q d.
        """
        n, options = self.n_vertices, self.options
        # (a - b) M^T for the affine `after`: the same numbers as comparing in the user's space.
        difference = (image - self.target) @ self._metric.T
        vertices, landmarks = difference[:n], difference[n:]
        # Of each term: its differences d, and Q d.
        terms: dict[str, tuple[Tensor, Tensor]] = {}
        if n:
            terms["vertex"] = vertices, self._weights * vertices
            if self._gradient is not None:
                terms["gradient"] = vertices, self._gradient.laplacian(vertices) / 9.0
        if len(landmarks):
            terms["landmark"] = landmarks, landmarks / landmarks.numel()
        weights = {
            "vertex": 1.0,
            "gradient": options.gradient_weight,
            "landmark": options.landmark_weight,
        }
        errors, total, slope = {}, 0.0, torch.zeros_like(difference)
        for name, (d, q) in terms.items():
            errors[name] = 1000.0 * float((d * q).sum())
            total += weights[name] * errors[name]
            part = slice(n, None) if name == "landmark" else slice(n)
            slope[part] += 2000.0 * weights[name] * q
        return {"total": total, **errors}, slope @ self._metric


def _domain(given: Correspondence, options: FitOptions) -> tuple[Tensor, Tensor]:
    """The affine maps into the unit domain and out of it."""
    marks = given.weights.new_ones(len(given.source) - given.n_vertices)
    weights = torch.cat([given.weights, marks])
    motion = best_affine_map(given.source, given.target, options.align, weights)
    # The domain has to hold the source and the target, seen from the source's side.
    points = torch.cat([given.source, apply_affine(invert_affine(motion), given.target)])
    centre = 0.5 * (points.amin(0) + points.amax(0))
    unit = options.radius / float((points - centre).norm(dim=-1).max())
    before = torch.cat([unit * torch.eye(3).double(), -unit * centre[:, None]], -1)
    return before, compose_affine(motion, invert_affine(before))
