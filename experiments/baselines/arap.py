"""As-rigid-as-possible surface deformation (Sorkine and Alexa, 2007), by Open3D.

A user of it moves handles; here a fiftieth of the vertices, drawn at random, is put where it
belongs.  Nothing keeps the surface from passing through itself.
"""

from __future__ import annotations

import time

import numpy as np

from experiments.baselines.method import Fitted
from experiments.baselines.training import errors_of, problem_for

SHARE = 0.02
ITERATIONS = 300


def fit_arap(source, target, faces, *, height, seconds, seed=0) -> Fitted:
    """See `Method`; the time is that of `ITERATIONS` iterations."""
    import open3d as o3d

    start = time.process_time()
    count = max(4, round(SHARE * len(source)))
    handles = np.sort(np.random.default_rng(seed).choice(len(source), count, replace=False))
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(source), o3d.utility.Vector3iVector(faces)
    )
    moved = mesh.deform_as_rigid_as_possible(
        o3d.utility.IntVector(handles.tolist()),
        o3d.utility.Vector3dVector(target[handles]),
        max_iter=ITERATIONS,
    )
    vertices = np.asarray(moved.vertices).copy()
    seconds_taken = time.process_time() - start
    found = errors_of(problem_for(source, target, faces, height), vertices)
    return Fitted(vertices, None, 3 * count, ITERATIONS, [(seconds_taken, *found)])
