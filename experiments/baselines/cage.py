"""A cage: the body in mean-value coordinates (Ju et al., 2005) of a coarse surface around it.

The cage is the body's own surface, grown and coarsely extracted; its vertices are placed by least
squares, so that the loss of `fit` is as small as this cage allows.  Mean-value coordinates may be
negative, and the map of space that they give need not be injective.
"""

from __future__ import annotations

import time

import numpy as np
import torch
import trimesh
from numpy.typing import NDArray
from torch import nn

import fields
from experiments.baselines.method import Fitted
from experiments.baselines.training import GRADIENT_WEIGHT, errors_of, problem_for
from implicit_warp.alignment import apply_affine
from implicit_warp.extraction import extract
from implicit_warp.fitting.problem import PAPER_HEIGHT
from implicit_warp.layers import compose_affine
from implicit_warp.mesh_gradient import MeshGradient

GROWTH, RESOLUTION = 0.05, 28
"""How far from the body the cage is, of its height; and voxels along it."""

_STIFFNESS = 1e-7
"""Weight of staying at rest, where the body says nothing of a cage's vertex."""

_BLOCK = 512


def mean_value_coordinates(
    points: NDArray[np.float64], cage: trimesh.Trimesh
) -> NDArray[np.float64]:
    """(n, c) weights of the cage's vertices at points (n, 3) strictly inside it; they sum to 1.

    For each face of the cage, the integral of the unit vectors towards it over its image on the
    unit sphere about the point, as a combination of its corners.
    """
    corners, faces = np.asarray(cage.vertices), np.asarray(cage.faces)
    weights = np.zeros((len(points), len(corners)))
    for start in range(0, len(points), _BLOCK):
        block = weights[start : start + _BLOCK]
        apart = corners[None] - points[start : start + _BLOCK, None]
        distance = np.linalg.norm(apart, axis=2)
        unit = apart / distance[..., None]
        u = unit[:, faces]  # (b, f, 3 corners, 3)
        chord = np.linalg.norm(np.roll(u, -1, 2) - np.roll(u, -2, 2), axis=3)
        angle = 2.0 * np.arcsin(np.clip(0.5 * chord, 0.0, 1.0))
        half = 0.5 * angle.sum(axis=2, keepdims=True)
        sine = np.sin(angle)
        after, before = np.roll(sine, -1, 2), np.roll(sine, -2, 2)
        c = np.clip(2.0 * np.sin(half) * np.sin(half - angle) / (after * before) - 1.0, -1.0, 1.0)
        turn = np.sign(np.einsum("bfi,bfi->bf", np.cross(u[:, :, 0], u[:, :, 1]), u[:, :, 2]))
        s = turn[..., None] * np.sqrt(1.0 - c**2)
        numerator = (
            angle
            - np.roll(c, -1, 2) * np.roll(angle, -2, 2)
            - np.roll(c, -2, 2) * np.roll(angle, -1, 2)
        )
        denominator = distance[:, faces] * after * np.roll(s, -2, 2)
        # In the plane of a face, and outside of it, the face counts nothing.
        flat = (np.abs(s) < 1e-9).any(axis=2, keepdims=True)
        part = np.where(flat, 0.0, numerator / np.where(flat, 1.0, denominator))
        for corner in range(3):
            np.add.at(block, (slice(None), faces[:, corner]), part[:, :, corner])
        block /= block.sum(axis=1, keepdims=True)
    return weights


def cage_around(vertices, faces, height: float) -> trimesh.Trimesh:
    """A coarse closed surface around a body, a twentieth of its height away."""
    body = fields.mesh(trimesh.Trimesh(vertices, faces, process=False))
    return extract(body.offset(GROWTH * height), RESOLUTION, sharp=False, thin="ignore")


def fit_cage(source, target, faces, *, height, seconds, seed=0) -> Fitted:
    """See `Method`; one linear solve."""
    start = time.process_time()
    problem = problem_for(source, target, faces, height)
    cage = cage_around(source, faces, height)
    weights = mean_value_coordinates(source, cage)
    scale = PAPER_HEIGHT / height
    gradient = MeshGradient(source * scale, faces, weighting="uniform")
    columns = torch.from_numpy(weights)
    # Of the quadratic form of the loss, in the paper's scale.
    weighted = columns / (3 * len(source)) + GRADIENT_WEIGHT * _laplacian(gradient, columns) / 9.0
    # The cage at rest is carried along by the rigid motion, and moves from there.
    motion = compose_affine(problem.after, problem.before).double()
    at_rest = apply_affine(motion, torch.from_numpy(np.asarray(cage.vertices)))
    missing = torch.from_numpy(target) - columns @ at_rest
    matrix = columns.T @ weighted + _STIFFNESS * torch.eye(weights.shape[1]) / weights.shape[1]
    moved = at_rest + torch.linalg.solve(matrix, weighted.T @ missing)
    vertices = (columns @ moved).numpy()
    taken = time.process_time() - start
    trace = [(taken, *errors_of(problem, vertices))]
    return Fitted(vertices, None, moved.numel(), 1, trace)


def _laplacian(gradient: MeshGradient, columns: torch.Tensor) -> torch.Tensor:
    """L times (V, c), as if every three columns were positions."""
    padded = nn.functional.pad(columns, (0, -columns.shape[1] % 3))
    positions = padded.view(len(columns), -1, 3).movedim(1, 0)
    return gradient.laplacian(positions).movedim(0, 1).reshape(padded.shape)[:, : columns.shape[1]]
