"""Linear blend skinning: a tree of joints, and vertices that follow several of them."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def joint_transforms(
    parents: np.ndarray, joints: np.ndarray, rotation_vectors: np.ndarray
) -> np.ndarray:
    """(J, 3, 4) where each joint's rotation takes what is rigidly attached to it at rest.

    Args:
        parents: (J,) index of each joint's parent, which comes before it; -1 for the root.
        joints: (J, 3) positions at rest.
        rotation_vectors: (J, 3) of each joint, in the rest pose's axes, relative to its parent.
    """
    rotations = Rotation.from_rotvec(rotation_vectors).as_matrix()
    transforms = np.empty((len(parents), 3, 4))
    for j, parent in enumerate(parents):
        # About its own place, x -> R (x - joint) + joint; then as the parent moves.
        linear, offset = rotations[j], joints[j] - rotations[j] @ joints[j]
        if parent >= 0:
            above = transforms[parent]
            offset = above[:, :3] @ offset + above[:, 3]
            linear = above[:, :3] @ linear
        transforms[j] = np.column_stack([linear, offset])
    return transforms


def skin(vertices: np.ndarray, weights: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """(V, 3) the vertices moved by the mean of the transforms (J, 3, 4), weighted (V, J)."""
    blended = np.tensordot(weights, transforms, 1)
    return np.einsum("vij,vj->vi", blended[:, :, :3], vertices) + blended[:, :, 3]
