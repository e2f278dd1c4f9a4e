"""Poses of the AMASS archive, from the ``.npz`` files of those who have its licence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from experiments.bodies.arrays import read_arrays
from implicit_warp.errors import FileFormatError, InputError

BODY = 66
"""Numbers of a frame that pose the body: 22 joints' rotation vectors, the root's first. What
follows in the files poses hands, and is left out."""

POSE_SPREAD = 1.5


class AmassPoses:
    """Frames of all sequences in a folder.

    Args:
        folder: with ``*_poses.npz`` or other ``.npz`` files of AMASS, at any depth.
        every: keep one frame of so many; neighbours hardly differ.

    Raises:
        InputError: no folder, or none with sequences.
        FileFormatError: a file without finite poses of at least 66 numbers a frame.

    Attributes:
        frames: (n, 66) rotation vectors, in radians, in the order of the files' names.
    """

    def __init__(self, folder: str | Path, every: int = 10) -> None:
        folder = Path(folder)
        # shape.npz and the like lie beside the sequences, without poses.
        sequences = [
            poses[::every] for path in sorted(folder.rglob("*.npz"))
            if (poses := _poses(path)) is not None
        ]  # fmt: skip
        if not sequences:
            raise InputError(
                "folder", str(folder), "it holds no .npz file with poses", "unpack AMASS there"
            )
        self.frames = np.concatenate(sequences)

    def frame(self, rng: np.random.Generator) -> np.ndarray:
        """(22, 3) one frame, as it was captured: the paper's fitting experiment."""
        return self.frames[rng.integers(len(self.frames))].reshape(-1, 3)

    def gaussian(self, rng: np.random.Generator) -> np.ndarray:
        """(22, 3) drawn from a normal distribution with the frames' mean and 1.5 times their
        standard deviation: the paper's learning experiment."""
        mean, spread = self.frames.mean(0), self.frames.std(0)
        return (mean + POSE_SPREAD * spread * rng.standard_normal(BODY)).reshape(-1, 3)


def _poses(path: Path) -> np.ndarray | None:
    poses = read_arrays(path, ["poses"]).get("poses")
    if poses is None:
        return None
    if poses.ndim != 2 or poses.shape[1] < BODY or not np.isfinite(poses[:, :BODY]).all():
        raise FileFormatError(f"{path}: its poses, of shape {poses.shape}, are not AMASS's")
    return poses[:, :BODY].astype(np.float64)
