"""Random (clean mesh, random warp) pairs, and what must hold of the exact image of each.

A fuzzer calls `failures(seed)` for as many seeds as it likes; `size` scales the work.
"""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

import fields as sdf
import implicit_warp as iw
from implicit_warp.checking import analyse, self_intersections
from tests.implicit_warp.registered_maps import random_affine, random_net

SPREADS = (0.0, 0.3, 1.0, 3.0, 30.0)
"""Of the normally distributed parameters: from the identity to weights at their limits."""


def random_mesh(rng: np.random.Generator, size: float = 1.0) -> trimesh.Trimesh:
    """A closed mesh free of self-intersections: smooth or with flat sides, turned or aligned."""
    fine = int(size >= 4.0)
    kind = rng.integers(6)
    if kind == 0:
        mesh = trimesh.creation.icosphere(int(rng.integers(0, 3 + fine)), 0.5)
    elif kind == 1:
        mesh = trimesh.creation.box(rng.uniform(0.2, 1.0, 3))
        for _ in range(rng.integers(0, 3 + fine)):
            mesh = mesh.subdivide()
    elif kind == 2:
        mesh = trimesh.creation.torus(0.4, rng.uniform(0.05, 0.2), int(rng.integers(5, 16)), 7)
    elif kind == 3:
        outer, inner = trimesh.creation.icosphere(1, 0.5), trimesh.creation.icosphere(1, 0.3)
        inner.invert()
        mesh = trimesh.util.concatenate([outer, inner])
    elif kind == 4:
        mesh = trimesh.creation.annulus(0.2, 0.5, rng.uniform(0.05, 0.6), sections=7)
    else:
        box, hole = sdf.box(rng.uniform(0.5, 0.9, 3)), sdf.cylinder(rng.uniform(0.05, 0.12))
        mesh = iw.extract((box & sdf.sphere(0.45)) - hole, int(14 * size**0.5))
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    if rng.random() < 0.5:
        turn = np.eye(4)
        turn[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
        mesh.apply_transform(turn)
    if rng.random() < 0.5:
        mesh.apply_scale(rng.choice([0.1, 0.5, 2.0, 5.0]))
        mesh.apply_translation(rng.uniform(-1.0, 1.0, 3))
    return mesh


def arrays(mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces."""
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def split_ball() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """A ball, and the same where every face of the upper part has vertices of its own."""
    ball = trimesh.creation.icosphere(2, 0.6)
    upper = ball.triangles_center[:, 0] > 0.05
    vertices = np.concatenate([ball.vertices, ball.vertices[ball.faces[upper]].reshape(-1, 3)])
    faces = ball.faces.copy()
    faces[upper] = len(ball.vertices) + np.arange(3 * upper.sum()).reshape(-1, 3)
    return ball, trimesh.Trimesh(vertices, faces, process=False)


def random_pair(seed: int, size: float = 1.0) -> tuple[trimesh.Trimesh, iw.Warp]:
    """A mesh and a warp of 1 to 24 layers, such that the image has some thousand faces."""
    rng = np.random.default_rng(seed)
    mesh = random_mesh(rng, size)
    layers = int(rng.integers(1, 25))
    budget = 24.0 * size / np.clip(np.ptp(mesh.bounds, axis=0).max(), 0.2, 10.0)
    resolution = int(np.clip(rng.integers(2, 13), 2, max(2, budget / layers)))
    layers = int(np.clip(layers, 1, max(1, budget / resolution)))
    frames = [None, "triplane", "cubic"][rng.integers(3)]
    spread = float(rng.choice(SPREADS))
    net = random_net(seed, layers=layers, resolution=resolution, spread=spread, frames=frames)
    if rng.random() < 0.5:
        return mesh, net.freeze()
    with torch.no_grad():
        before, after = random_affine(seed).matrix, random_affine(seed + 1).matrix
        return mesh, iw.Warp(net.embeddings(), net.frames(), before, after)


def failures(seed: int, size: float = 1.0) -> list[str]:
    """What is wrong with the exact image of one pair; nothing, one hopes."""
    mesh, warp = random_pair(seed, size)
    image, report = iw.deform_mesh(mesh, warp, "exact")
    return compare(mesh, image) + ([f"{report.uncut} pieces uncut"] if report.uncut else [])


def compare(mesh: trimesh.Trimesh, image: trimesh.Trimesh) -> list[str]:
    """How the image's topology differs from the mesh's, and its self-intersections."""
    before = analyse(np.asarray(mesh.vertices), mesh.faces)
    after = analyse(np.asarray(image.vertices), image.faces)
    found = []
    for name in ("watertight", "edge_manifold", "vertex_manifold", "oriented", "num_components"):
        if getattr(before, name) != getattr(after, name):
            found.append(f"{name}: {getattr(before, name)} -> {getattr(after, name)}")
    if sorted(map(str, before.genus)) != sorted(map(str, after.genus)):
        found.append(f"genus: {before.genus} -> {after.genus}")
    volumes = np.sign(before.component_volumes), np.sign(after.component_volumes)
    if not np.array_equal(*(np.sort(v) for v in volumes)):
        found.append("a component was turned inside out")
    if len(after.zero_area_faces):
        found.append(f"{len(after.zero_area_faces)} faces of zero area")
    contacts = self_intersections(np.asarray(image.vertices), image.faces)
    if len(contacts):
        found.append(f"self-intersections: {contacts.count_by_kind()}")
    return found
