"""Every kind of map, built at random, for tests that hold for all of them.

A new subclass of `Map` must be added here: `test_map_laws` fails if one is missing.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from implicit_warp.affine import Affine, rigid_motion
from implicit_warp.axial import AxialMap, Taper, Twist
from implicit_warp.bend import Bend
from implicit_warp.maps import Composition, Inverse, Map
from implicit_warp.shear import Shear
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp


def random_net(
    seed: int, *, layers: int = 5, resolution: int = 7, spread: float = 1.0, frames=None
) -> TutteNet:
    """A net with normally distributed parameters; random rotations unless frames are given."""
    if frames is None:
        frames = Rotation.random(layers, random_state=seed).as_matrix()
    net = TutteNet(layers, resolution, frames)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in net.parameters():
            noise = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
            parameter.copy_(spread * noise)
    return net


def random_affine(seed: int) -> Affine:
    """An affine map with singular values between 1/2 and 2."""
    rng = np.random.default_rng(seed)
    left, right = Rotation.random(2, random_state=seed).as_matrix()
    stretch = np.diag(rng.uniform(0.5, 2.0, 3))
    return Affine(left @ stretch @ right, rng.uniform(-1.0, 1.0, 3))


def random_warp(seed: int, **options) -> Warp:
    """A warp between two affine maps, as a solve returns it."""
    net = random_net(seed, **options)
    with torch.no_grad():
        return Warp(
            net.embeddings(),
            net.frames(),
            random_affine(seed).matrix,
            random_affine(seed + 1).matrix,
        )


def random_axis(seed: int) -> dict:
    """A random axis and origin."""
    rng = np.random.default_rng(seed)
    return {"axis": rng.normal(size=3), "origin": rng.uniform(-0.5, 0.5, 3)}


def random_bend(seed: int) -> Bend:
    """A bend by 60 degrees whose domain holds the ball of radius 3.5 about the origin."""
    towards = np.random.default_rng(seed + 1).normal(size=3)
    return Bend(60.0, **random_axis(seed), between=(-2.0, 2.5), towards=towards)


def within(m: Map, points: torch.Tensor) -> torch.Tensor:
    """Those of the points (n, 3) at which a map is defined: all, but for bends."""
    if isinstance(m, Bend):
        return points[torch.from_numpy(m.contains(points))]
    if isinstance(m, Inverse) and isinstance(m.inv, Bend):
        return points[torch.from_numpy(m.inv.image_contains(points))]
    return points


BUILDERS: dict[str, Callable[[int], Map]] = {
    "affine": random_affine,
    "rigid": lambda seed: rigid_motion(((1.0, 2.0, seed % 7), 50.0), (0.1, 0.2, 0.3)),
    "net triplane": lambda seed: random_net(seed, frames="triplane"),
    "net cubic": lambda seed: random_net(seed, layers=8, frames="cubic"),
    "net free": lambda seed: random_net(seed, frames="free"),
    "net random frames": random_net,
    "net coarsest": lambda seed: random_net(seed, resolution=2),
    "net single layer": lambda seed: random_net(seed, layers=1, resolution=3),
    "warp": random_warp,
    "inverse": lambda seed: random_warp(seed).inv,
    "composition": lambda seed: random_warp(seed) @ random_affine(seed) @ random_warp(seed + 1).inv,
    "twist": lambda seed: Twist(20.0, **random_axis(seed)),
    "twist on a range": lambda seed: Twist(-90.0, "y", between=(-0.5, 0.7)),
    "taper": lambda seed: Taper((1.2, 0.4), **random_axis(seed), between=(-1.0, 1.5)),
    "shear": lambda seed: Shear(0.7, **random_axis(seed)),
    "shear on a range": lambda seed: Shear(-0.4, "y", "z", between=(-0.5, 0.7)),
    "bend": random_bend,
    "axial composition": lambda seed: Twist(30.0) @ Taper((0.5, 0.8)) @ random_affine(seed),
}

COVERED = (Affine, TutteNet, Warp, Inverse, Composition, AxialMap, Twist, Taper, Shear, Bend)
