"""What is measured of a fit: the same for all methods, in float64, apart from their own losses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import trimesh

import implicit_warp as iw
from experiments.baselines import Fitted
from experiments.bodies import Pair
from implicit_warp.fitting.problem import PAPER_HEIGHT
from implicit_warp.maps import Map
from implicit_warp.mesh_gradient import MeshGradient

if TYPE_CHECKING:
    from experiments.study.jobs import Job

POINTS_IN_BOX = 10_000


def errors(pair: Pair, vertices: np.ndarray) -> dict[str, float]:
    """The paper's two errors, times 1000, of deformed vertices (V, 3).

    Vertex: mean over vertices and coordinates of the squared difference to the target.  Gradient:
    mean over faces and the nine entries of the squared difference of the deformation gradients,
    taken with the source mesh's operator.  Both with the body's height scaled to 1.4.
    """
    scale = PAPER_HEIGHT / pair.height
    source, target, image = (
        torch.from_numpy(scale * np.array(points, np.float64))
        for points in (pair.source.vertices, pair.target.vertices, vertices)
    )
    gradient = MeshGradient(source, pair.source.faces, weighting="uniform")
    return {
        "vertex_error": 1000.0 * float((image - target).square().mean()),
        "gradient_error": 1000.0 * float(gradient.squared_distance(image, target)) / 9.0,
    }


def quality(pair: Pair, fitted: Fitted, job: Job) -> dict[str, Any]:
    """All measurements of a fit; None for what a method does not have.

    * ``round_trip``: largest distance of f^-1(f(x)) from x, of the body's height, over the vertices
      and `POINTS_IN_BOX` random points of the body's box.
    * ``det_vertices``, ``det_box``: smallest det J of the map at the same points.
    * ``contacts``: self-intersecting pairs of faces of the mesh with its vertices moved.
    * ``exact_contacts``, ``exact_faces``: the same of the map's exact image of the mesh, where the
      map is piecewise linear, and its number of faces.
    """
    faces = pair.source.faces
    moved = trimesh.Trimesh(fitted.vertices, faces, process=False)
    found: dict[str, Any] = errors(pair, fitted.vertices)
    found |= dict.fromkeys(
        ("round_trip", "det_vertices", "det_box", "exact_contacts", "exact_faces")
    )
    found["contacts"] = iw.check(moved, referees=()).num_self_intersections
    if fitted.map is not None:
        found |= map_quality(pair, fitted.map, job.seed)
        if isinstance(fitted.map, iw.Warp):
            image, report = iw.deform_mesh(pair.source, fitted.map, "exact")
            found["exact_contacts"] = iw.check(image, referees=()).num_self_intersections
            found["exact_faces"] = report.faces_out
    return found


def map_quality(pair: Pair, map_: Map, seed: int) -> dict[str, float]:
    """Round trip and smallest determinants, see `quality`."""
    rng = np.random.default_rng([seed, 1])
    low, high = pair.source.bounds
    vertices = torch.from_numpy(np.array(pair.source.vertices, np.float64))
    box = torch.from_numpy(rng.uniform(low, high, (POINTS_IN_BOX, 3)))
    found, worst = {}, 0.0
    for name, points in (("det_vertices", vertices), ("det_box", box)):
        smallest = np.inf
        for part in points.split(2048):  # networks keep all activations of a call
            image, jacobian = map_.call_and_jacobian(part)
            smallest = min(smallest, float(torch.linalg.det(jacobian).min()))
            worst = max(worst, float((map_.inv(image) - part).norm(dim=-1).max()))
        found[name] = smallest
    return {"round_trip": worst / pair.height, **found}
