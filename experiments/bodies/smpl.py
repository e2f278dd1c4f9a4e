"""SMPL bodies from the model file of those who have its licence (Loper et al. 2015).

    body = T + shapedirs . betas + posedirs . (R(pose) - I),   skinned by the file's weights about
    the joints that the file regresses from the shaped body.

`smplx`, the usual reader, is itself for non-commercial use and needs pickles to be trusted, so the
formula is written here; a test compares the two where `smplx` is installed.  A ``.npz`` is read
without pickle.  The official SMPL files are pickles: they are read by an unpickler that makes
arrays, sparse matrices and nothing else.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from experiments.bodies.arrays import UNREADABLE, read_arrays
from experiments.bodies.skinning import joint_transforms, skin
from implicit_warp.errors import FileFormatError, InputError

SHAPE_SPREAD = 2.0
BETAS = 10

_KEYS = ("v_template", "shapedirs", "posedirs", "J_regressor", "weights", "kintree_table", "f")


class SmplBody:
    """SMPL, or SMPL+H in ``.npz``, as a `BodyModel`.

    Args:
        path: ``SMPL_NEUTRAL.pkl``, ``.npz`` or the like.
        sample_pose: draws rotation vectors of the first joints, as `AmassPoses.frame` and
            `AmassPoses.gaussian` do; the other joints stay at rest.
        poses: a name for where they come from; part of the cached pairs' names.

    Raises:
        InputError: no such file, or a suffix that is neither.
        FileFormatError: a damaged file, or one without the model's arrays.
    """

    def __init__(
        self,
        path: str | Path,
        sample_pose: Callable[[np.random.Generator], np.ndarray],
        poses: str = "amass",
    ) -> None:
        arrays = _load(Path(path))
        self.name = f"smpl-{Path(path).stem}-{poses}-1"
        self.faces = arrays["f"].astype(np.int64)
        self._template, self._weights = arrays["v_template"], arrays["weights"]
        self._shape_directions = arrays["shapedirs"][:, :, :BETAS]
        self._pose_directions, self._regressor = arrays["posedirs"], arrays["J_regressor"]
        parents = arrays["kintree_table"][0].astype(np.int64)
        self._parents = np.where(np.arange(len(parents)) == 0, -1, parents)
        self._sample_pose = sample_pose

    def sample_shape(self, rng: np.random.Generator) -> np.ndarray:
        """(10,) betas, which have unit spread in the population; twice as wide here."""
        return SHAPE_SPREAD * rng.standard_normal(self._shape_directions.shape[2])

    def sample_pose(self, rng: np.random.Generator) -> np.ndarray:
        """(joints, 3) rotation vectors, in radians."""
        pose = np.zeros((len(self._parents), 3))
        given = self._sample_pose(rng)[: len(pose)]
        pose[: len(given)] = given
        return pose

    def vertices(self, shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """(V, 3) the body's vertices, in metres, y up."""
        shaped = self._template + self._shape_directions @ shape
        joints = self._regressor @ shaped
        bend = Rotation.from_rotvec(pose[1:]).as_matrix() - np.eye(3)
        posed = shaped + self._pose_directions @ bend.ravel()
        return skin(posed, self._weights, joint_transforms(self._parents, joints, pose))

    def height(self, shape: np.ndarray) -> float:
        """The height at rest, in metres."""
        return float(np.ptp((self._template + self._shape_directions @ shape)[:, 1]))


def _load(path: Path) -> dict[str, np.ndarray]:
    if not path.is_file():
        raise InputError("path", str(path), "there is no such file", "check the path")
    if path.suffix not in (".npz", ".pkl"):
        raise InputError("path", str(path), "neither .npz nor .pkl", "pass a model file of SMPL")
    try:
        if path.suffix == ".npz":
            found = read_arrays(path, _KEYS)
        else:
            with path.open("rb") as file:
                found = _ArraysOnly(file, encoding="latin1").load()
        return {key: _array(found[key]) for key in _KEYS}
    except (*UNREADABLE, TypeError, pickle.UnpicklingError) as error:
        raise FileFormatError(f"{path}: not a readable SMPL model ({error!r})") from error


def _array(value: Any) -> np.ndarray:
    if isinstance(value, _Chumpy):
        value = value.state["x"]
    dense = value.toarray() if hasattr(value, "toarray") else value
    return np.asarray(dense, dtype=np.float64)


class _Chumpy:
    """Stands for `chumpy.ch.Ch`, the array type of the original files; keeps its state."""

    def __init__(self, *_: Any) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.state = state


class _ArraysOnly(pickle.Unpickler):
    """Refuses everything but what the model files are made of, so that no code can hide there."""

    _NUMPY = ("numpy.core.multiarray", "numpy._core.multiarray", "numpy")
    _SPARSE = ("scipy.sparse.csc", "scipy.sparse._csc")

    def find_class(self, module: str, name: str) -> Any:
        """The class or function of that name, if it is one of the harmless."""
        if module in self._NUMPY and name in ("_reconstruct", "ndarray", "dtype", "scalar"):
            # Old pickles name modules that numpy has moved since.
            return super().find_class("numpy._core.multiarray" if "multiarray" in module else
                                      "numpy", name)  # fmt: skip
        if module in self._SPARSE and name == "csc_matrix":
            return super().find_class("scipy.sparse", name)
        if module.startswith("chumpy"):
            return _Chumpy
        if (module, name) in (("_codecs", "encode"), ("copy_reg", "_reconstructor")):
            return super().find_class(module.replace("copy_reg", "copyreg"), name)
        if (module, name) in (("builtins", "object"), ("__builtin__", "object")):
            return object
        raise pickle.UnpicklingError(f"it holds {module}.{name}, which is no array")
