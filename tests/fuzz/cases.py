"""Random cases as plain JSON: what a failure prints, what shrinks, what the corpus stores.

A *case* is a dictionary with a `kind` (see `properties.PROPERTIES`) and a description of what to
build: a scene (an expression tree of primitives and booleans), a warp, a mesh.  The description is
all there is: the same JSON builds the same objects, bit for bit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

import fields as sdf
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

Description = dict[str, Any]

_BOOLEANS = {"union": sdf.Field.__or__, "cut": sdf.Field.__sub__, "common": sdf.Field.__and__}
_SATURATED = 40.0  # sigmoid(40) is 1 in float64, sigmoid(-40) is 4e-18: weights at their limits


def draw_scene(rng: np.random.Generator, depth: int = 3) -> Description:
    """A random tree of booleans over moved primitives, about the size of the unit cube."""
    if depth == 0 or rng.random() < 0.25:
        return _draw_primitive(rng)
    return {
        "op": str(rng.choice([*_BOOLEANS])),
        "smooth": _number(rng, 0.05, 0.2) if rng.random() < 0.3 else 0.0,
        "parts": [draw_scene(rng, depth - 1), draw_scene(rng, depth - 1)],
    }


def _draw_primitive(rng: np.random.Generator) -> Description:
    kind = str(rng.choice(["sphere", "box", "rounded_box", "cylinder", "capsule", "torus", "cone"]))
    return {
        "op": kind,
        "size": [_number(rng, 0.2, 0.6) for _ in range(3)],
        "axis": [_number(rng, -1.0, 1.0) for _ in range(3)] if rng.random() < 0.7 else None,
        "offset": [_number(rng, -0.4, 0.4) for _ in range(3)],
    }


def build_scene(scene: Description) -> sdf.Field:
    """The field that a scene describes."""
    if "parts" in scene:
        first, *others = (build_scene(part) for part in scene["parts"])
        if scene["smooth"]:
            join = {"union": sdf.union, "cut": sdf.difference, "common": sdf.intersection}
            return join[scene["op"]](first, *others, smooth=scene["smooth"])
        for other in others:
            first = _BOOLEANS[scene["op"]](first, other)
        return first
    a, b, c = scene["size"]
    build = {
        "sphere": lambda: sdf.sphere(a),
        "box": lambda: sdf.box([2 * a, 2 * b, 2 * c]),
        "rounded_box": lambda: sdf.rounded_box([2 * a, 2 * b, 2 * c], 0.4 * min(a, b, c)),
        "cylinder": lambda: sdf.cylinder(a, 2 * b),
        "capsule": lambda: sdf.capsule([0, 0, -a], [0, 0, a], 0.5 * b),
        "torus": lambda: sdf.torus(a, 0.5 * min(a, b)),
        "cone": lambda: sdf.cone(a, 2 * b),
    }
    field = build[scene["op"]]()
    if scene["axis"] is not None and np.any(scene["axis"]):
        field = field.orient(scene["axis"])
    return field.translate(scene["offset"])


def draw_warp(rng: np.random.Generator, max_layers: int = 64) -> Description:
    """A random warp: few or many layers, mild or with most weights at their limits."""
    return {
        "layers": int(np.exp(rng.uniform(0.0, np.log(max_layers + 0.999)))),
        "resolution": int(rng.choice([2, 3, 5, 11, 17])),
        "spread": float(rng.choice([0.3, 1.0, 3.0])),
        "saturated": float(rng.choice([0.0, 0.1, 1.0])),
        "frames": str(rng.choice(["random", "triplane", "cubic"])),
        "seed": int(rng.integers(2**31)),
    }


def build_warp(warp: Description) -> Warp:
    """The warp that a description stands for; its first layers do not depend on their number."""
    count, resolution = warp["layers"], warp["resolution"]
    frames = warp["frames"]
    if frames == "random":
        frames = Rotation.random(64, random_state=warp["seed"]).as_matrix()[:count]
    net = TutteNet(count, resolution, frames)
    with torch.no_grad():
        for layer in range(count):
            rng = np.random.default_rng([warp["seed"], layer])
            for parameter in (net.theta_weights, net.theta_boundary):
                theta = warp["spread"] * rng.standard_normal(parameter.shape[1])
                at_limit = rng.random(len(theta)) < warp["saturated"]
                theta[at_limit] = np.copysign(_SATURATED, theta[at_limit])
                parameter[layer] = torch.from_numpy(theta)
    return net.freeze()


def draw_mesh(rng: np.random.Generator) -> Description:
    """A random closed mesh without self-intersections, coarse enough to be bent badly."""
    shape = str(rng.choice(["sphere", "box", "torus", "cylinder", "scene"]))
    return {
        "shape": shape,
        "detail": int(rng.integers(0, 3)),
        "scene": draw_scene(rng, depth=2) if shape == "scene" else None,
        "turn": int(rng.integers(2**31)) if rng.random() < 0.7 else None,
        "size": [_number(rng, 0.3, 1.2) for _ in range(3)],
        "offset": [_number(rng, -0.3, 0.3) for _ in range(3)],
    }


def build_mesh(mesh: Description):
    """The mesh that a description stands for."""
    import trimesh

    detail, size = mesh["detail"], np.array(mesh["size"])
    if mesh["shape"] == "scene":
        from implicit_warp.extraction import extract

        result = extract(build_scene(mesh["scene"]), 8 * (detail + 1))
    elif mesh["shape"] == "sphere":
        result = trimesh.creation.icosphere(detail, 0.5)
    elif mesh["shape"] == "box":
        result = trimesh.creation.box()
        for _ in range(detail):
            result = result.subdivide()
    elif mesh["shape"] == "torus":
        result = trimesh.creation.torus(0.4, 0.15, 8 * (detail + 1), 5 * (detail + 1))
    else:
        result = trimesh.creation.cylinder(0.3, 1.0, sections=5 * (detail + 1))
    # One scale for all axes: unequal ones could flatten a scene's thin parts.
    vertices = np.asarray(result.vertices) * (size[0] if mesh["scene"] else size)
    if mesh["turn"] is not None:
        vertices = Rotation.random(random_state=mesh["turn"]).apply(vertices)
    return trimesh.Trimesh(vertices + mesh["offset"], result.faces, process=False)


def _number(rng: np.random.Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 3)
