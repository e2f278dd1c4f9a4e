"""The open body model `anny` (Apache-2.0, data CC0): shapes and poses from seeded distributions.

AMASS's statistics cannot be shipped, so the distributions here are our own: every phenotype and
every large joint has a mean and a spread of everyday variety, chosen by hand, and joints have
limits.  As in the paper's supplement, shapes are drawn twice as wide as the population and poses
one and a half times.

The mesh is the model's largest component, the skin: 13,348 vertices, 26,692 faces, watertight,
genus 0.  Eyeballs and tongue are components of their own that cross the skin, and the last toes
cross each other at rest; the toes are spread by up to 20 degrees, which makes the body sound.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from implicit_warp.errors import MissingDependency

SHAPE_SPREAD, POSE_SPREAD = 2.0, 1.5

# Mean and spread in the population, of parameters that the model keeps in [0, 1]; an age of 2/3 is
# a young adult, 1/3 a child.
_PHENOTYPES = {
    "gender": (0.5, 0.25),
    "age": (0.67, 0.06),
    "muscle": (0.5, 0.12),
    "weight": (0.5, 0.1),
    "height": (0.38, 0.085),
    "proportions": (0.5, 0.15),
}

# Bone, axis (x to the body's left, -y forward, z up), and mean, spread and limits of the angle in
# degrees. Bones of both sides are given for the left one.
_JOINTS = (
    ("spine05", "x", 4, 6, -20, 40),
    ("spine05", "y", 0, 4, -15, 15),
    ("spine05", "z", 0, 5, -20, 20),
    ("spine03", "x", 4, 6, -20, 40),
    ("spine03", "y", 0, 4, -15, 15),
    ("spine03", "z", 0, 5, -20, 20),
    ("spine01", "x", 2, 5, -20, 30),
    ("spine01", "z", 0, 5, -20, 20),
    ("neck01", "x", 4, 7, -25, 35),
    ("neck01", "y", 0, 5, -20, 20),
    ("neck01", "z", 0, 8, -35, 35),
    ("head", "x", 2, 6, -20, 25),
    ("head", "z", 0, 6, -25, 25),
    ("clavicle.L", "y", 0, 4, -12, 12),
    ("clavicle.L", "z", 0, 4, -12, 12),
    ("upperarm01.L", "x", 0, 15, -60, 60),
    ("upperarm01.L", "y", 25, 20, -60, 40),
    ("upperarm01.L", "z", -10, 20, -80, 30),
    ("lowerarm01.L", "x", 0, 12, -40, 40),
    ("lowerarm01.L", "z", -25, 18, -110, 0),
    ("wrist.L", "x", 0, 10, -40, 40),
    ("wrist.L", "y", 0, 12, -40, 40),
    ("upperleg01.L", "x", -12, 18, -90, 30),
    ("upperleg01.L", "y", -4, 7, -35, 10),
    ("upperleg01.L", "z", 0, 6, -25, 25),
    ("lowerleg01.L", "x", 18, 18, 0, 110),
    ("foot.L", "x", 0, 8, -30, 30),
    ("foot.L", "y", 0, 4, -15, 15),
)

_TOES = {"toe2-1": 5.0, "toe3-1": 10.0, "toe4-1": 15.0, "toe5-1": 20.0}


class AnnyBody:
    """`anny`'s body as a `BodyModel`; the first one made takes a minute, later ones seconds.

    Raises:
        MissingDependency: without the extra ``human``.
    """

    def __init__(self) -> None:
        try:
            import anny
        except ImportError as error:
            remedy = "Install it with: pip install 'implicit_warp[human]'"
            raise MissingDependency("anny", "AnnyBody", remedy) from error
        self.name = f"anny-{anny.__version__}-1"
        self._model = anny.Anny(skinning_method="lbs")
        self._bones = list(self._model.bone_labels)
        faces = self._model.get_triangular_faces().numpy()
        self._skin, self.faces = _largest_component(faces, len(self._model.template_vertices))

    def sample_shape(self, rng: np.random.Generator) -> np.ndarray:
        """(6,) the phenotypes."""
        mean, spread = np.array(list(_PHENOTYPES.values())).T
        return np.clip(mean + SHAPE_SPREAD * spread * rng.standard_normal(len(mean)), 0.0, 1.0)

    def sample_pose(self, rng: np.random.Generator) -> np.ndarray:
        """(bones, 3) rotation vectors in the body's axes, in radians."""
        pose = np.zeros((len(self._bones), 3))
        for bone, axis, *angles in _JOINTS:
            for name, sign in _sides(bone, axis):
                mean, spread, low, high = angles
                degrees = np.clip(mean + POSE_SPREAD * spread * rng.standard_normal(), low, high)
                pose[self._bones.index(name), "xyz".index(axis)] = np.radians(sign * degrees)
        for toe, degrees in _TOES.items():
            for name, sign in _sides(f"{toe}.L", "z"):
                pose[self._bones.index(name), 2] = np.radians(sign * degrees)
        return pose

    def vertices(self, shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
        """(13348, 3) the skin, in metres, z up."""
        import torch
        from scipy.spatial.transform import Rotation

        matrices = np.tile(np.eye(4), (len(pose), 1, 1))
        matrices[:, :3, :3] = Rotation.from_rotvec(pose).as_matrix()
        phenotypes = {
            name: torch.tensor([value])
            for name, value in zip(_PHENOTYPES, shape.tolist(), strict=True)
        }
        with torch.no_grad():
            posed = self._model(
                pose_parameters=torch.from_numpy(matrices)[None], phenotype_kwargs=phenotypes
            )
        return posed["vertices"][0].numpy()[self._skin]

    def height(self, shape: np.ndarray) -> float:
        """The height at rest, in metres."""
        rest = self.vertices(shape, np.zeros((len(self._bones), 3)))
        return float(np.ptp(rest[:, 2]))


def _sides(bone: str, axis: str) -> Sequence[tuple[str, float]]:
    """The bones meant by a row, with the sign of the angle: the right side mirrors the left."""
    if not bone.endswith(".L"):
        return ((bone, 1.0),)
    return ((bone, 1.0), (bone[:-1] + "R", 1.0 if axis == "x" else -1.0))


def _largest_component(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices of the largest connected component, and its faces in their numbering."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    links = coo_array((np.ones(len(edges)), edges.T), (count, count))
    _, label = connected_components(links, directed=False)
    inside = label == np.bincount(label).argmax()
    number = np.cumsum(inside) - 1
    return np.flatnonzero(inside), number[faces[inside[faces[:, 0]]]]
