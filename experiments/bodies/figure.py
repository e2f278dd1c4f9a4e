"""A procedural articulated figure: a union of capsules, extracted once, skinned by distances.

It needs no data and no extra: for tests, and for a first look.  Each bone is a capsule field; the
surface is the union's, and a vertex follows the bones in proportion to
``exp(-(d_b - d_min) / softness)``, where d_b is its distance from bone b.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

import fields
from experiments.bodies.skinning import joint_transforms, skin
from implicit_warp.extraction import extract

# Joint, parent, position at rest, end of its bone, radius; metres, z up, x to the figure's left.
_BONES = (
    ("pelvis", None, (0.0, 0.0, 0.95), (0.0, 0.0, 1.05), 0.13),
    ("chest", "pelvis", (0.0, 0.0, 1.15), (0.0, 0.0, 1.35), 0.13),
    ("head", "chest", (0.0, 0.0, 1.50), (0.0, 0.0, 1.66), 0.10),
    ("upperarm.L", "chest", (0.20, 0.0, 1.40), (0.42, 0.0, 1.40), 0.055),
    ("forearm.L", "upperarm.L", (0.45, 0.0, 1.40), (0.70, 0.0, 1.40), 0.045),
    ("upperarm.R", "chest", (-0.20, 0.0, 1.40), (-0.42, 0.0, 1.40), 0.055),
    ("forearm.R", "upperarm.R", (-0.45, 0.0, 1.40), (-0.70, 0.0, 1.40), 0.045),
    ("thigh.L", "pelvis", (0.11, 0.0, 0.90), (0.13, 0.0, 0.55), 0.08),
    ("shin.L", "thigh.L", (0.13, 0.0, 0.50), (0.14, 0.0, 0.10), 0.06),
    ("thigh.R", "pelvis", (-0.11, 0.0, 0.90), (-0.13, 0.0, 0.55), 0.08),
    ("shin.R", "thigh.R", (-0.13, 0.0, 0.50), (-0.14, 0.0, 0.10), 0.06),
)

_SOFTNESS = 0.03
_NECKS = (((0.0, 0.0, 1.35), (0.0, 0.0, 1.5), 0.06), ((0.14, 0.0, 1.38), (0.2, 0.0, 1.4), 0.06),
          ((-0.14, 0.0, 1.38), (-0.2, 0.0, 1.4), 0.06))  # fmt: skip


class FigureBody:
    """The figure as a `BodyModel`.

    Args:
        resolution: voxels along its height.
        spread: standard deviation of every joint's rotation, in degrees.
    """

    def __init__(self, resolution: int = 64, spread: float = 15.0) -> None:
        self.name = f"figure-{resolution}-{spread:g}-1"
        self._resolution, self._spread = resolution, np.radians(spread)
        self._names = [name for name, *_ in _BONES]
        self._parents = np.array(
            [-1 if parent is None else self._names.index(parent) for _, parent, *_ in _BONES]
        )
        self._joints = np.array([at for _, _, at, *_ in _BONES])

    @cached_property
    def _rest(self):
        bones = [fields.capsule(a, b, radius) for *_, a, b, radius in _BONES]
        necks = [fields.capsule(*neck) for neck in _NECKS]
        whole = fields.union(*bones, *necks)
        mesh = extract(whole, self._resolution)
        distances = np.stack([bone(mesh.vertices) for bone in bones], -1)
        weights = np.exp((distances.min(-1, keepdims=True) - distances) / _SOFTNESS)
        return mesh, weights / weights.sum(-1, keepdims=True)

    @property
    def faces(self) -> np.ndarray:
        """(F, 3) the faces of every mesh it makes."""
        return np.array(self._rest[0].faces)

    def sample_shape(self, rng: np.random.Generator) -> np.ndarray:
        """(3,) how much wider, deeper and taller the figure is."""
        return rng.uniform(0.85, 1.15, 3)

    def sample_pose(self, rng: np.random.Generator) -> np.ndarray:
        """(11, 3) rotation vectors, in radians; the pelvis stays."""
        pose = self._spread * rng.standard_normal((len(_BONES), 3))
        pose[0] = 0.0
        return pose

    def vertices(self, shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """(V, 3) the figure's vertices, in metres."""
        mesh, weights = self._rest
        transforms = joint_transforms(self._parents, shape * self._joints, pose)
        return skin(shape * mesh.vertices, weights, transforms)

    def height(self, shape: np.ndarray) -> float:
        """The height at rest, in metres."""
        return float(np.ptp(self._rest[0].vertices[:, 2]) * shape[2])
