"""A path of injective maps from the identity to a given map, for animations.

Blending a map with the identity point by point does not do: halfway between two injective maps
there may be folds.  Each kind of map is therefore turned back in what it is made of:

* A layer of a warp is the Tutte embedding of *some* positive weights: the mean-value coordinates
  of each inner vertex in its image's star (Floater 2003), which are positive because the star's
  triangles are.  Between these and those of the square at rest, every convex combination is
  positive, and so is every mixture of the boundary's angle increments; so every amount gives
  weights and a convex boundary whose embedding is injective by Tutte's and Floater's theorem
  (Floater and Gotsman 1999, "How to morph tilings injectively").  Nothing but the warp itself is
  needed: not the parameters that it was solved with.
* The affine part turns back along its axis and its stretches by their logarithms, about the
  middle of the warp's domain.
* A twist, bend, shear or taper has less of its angle, slope or factors; a composition has all of
  its parts at the same amount.

Guarantee: amount 0 is the identity to rounding, amount 1 the map itself.  A warp on the path is a
`Warp` like any other, so it is proved injective when it is made, by exact signs, or raises
`NotInjective`; but for rounding that cannot happen to warps that TutteNets make, whose boundaries
lie on the square.  Non-guarantee: the path is smooth, but it is not the elastic solution for part
of the handles' motion: handles' regions are near paths of their own choice.  Points that ought to
stay can be named; a rigid motion then brings them back at every amount.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from fields import arguments
from implicit_warp.affine import Affine
from implicit_warp.alignment import best_affine_map
from implicit_warp.axial import Taper, Twist
from implicit_warp.bend import Bend
from implicit_warp.embedding import embed
from implicit_warp.errors import InputError
from implicit_warp.layers import compose_affine, invert_affine
from implicit_warp.maps import Composition, Inverse, Map, flatten_points
from implicit_warp.shear import Shear
from implicit_warp.square_mesh import SquareMesh
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

Array = NDArray[np.float64]

_RING = [0, 4, 1, 5, 2, 6, 3, 7]
"""The order of `SquareMesh.inner_neighbours` that goes around the vertex."""


class Morph:
    """All amounts of one map.

    Args:
        map_: a `Warp`, `TutteNet` (as it is now), `Affine`, `Twist`, `Taper`, `Shear`, `Bend`, or a
            composition or inverse of these.
        center: (3,) the point that an `Affine` turns about on its way; the origin by default.  A
            warp turns about the middle of its own domain.
        held: (n, 3) points that the map holds; on the way they stay as well as rigid motions of
            everything can keep them.  None leaves the path as it is.

    Raises:
        InputError: a map of another kind.
    """

    def __init__(
        self,
        map_: Map,
        center: ArrayLike = (0.0, 0.0, 0.0),
        held: ArrayLike | None = None,
    ) -> None:
        center = np.array(arguments.vector("center", center))
        self.map = map_.freeze() if isinstance(map_, TutteNet) else map_
        self._at = _path(self.map, center)
        self._held = None
        if held is not None and len(points := flatten_points(held)[0]) >= 3:
            points = points.double()
            self._held = points, self.map(points)

    def __call__(self, amount: float) -> Map:
        """The map at an amount from 0, the identity, to 1.

        Raises:
            InputError: an amount beyond these.
            NotInjective: see the module.
        """
        amount = arguments.number("amount", amount)
        if not 0.0 <= amount <= 1.0:
            raise InputError("amount", amount, "not in 0 to 1", "0 is at rest, 1 the whole map")
        if amount == 1.0:
            return self.map
        found = self._at(amount)
        if self._held is None:
            return found
        points, ends = self._held
        correction = best_affine_map(found(points), points + amount * (ends - points), "rigid")
        if isinstance(found, Warp):
            after = compose_affine(correction, found.after)
            return Warp(found.embeddings, found.frames, found.before, after)
        return Affine.from_matrix(correction.numpy()) @ found


def _path(map_: Map, center: Array) -> Callable[[float], Map]:
    if isinstance(map_, Warp):
        return _WarpPath(map_)
    if isinstance(map_, Affine):
        path = _AffinePath(map_.matrix.numpy(), center)
        return lambda amount: Affine.from_matrix(path(amount))
    if isinstance(map_, Composition):
        parts = []
        for part in map_.maps:
            parts.append(_path(part, center))
            center = np.asarray(part(center))
        return lambda amount: Composition(part(amount) for part in parts)
    if isinstance(map_, Inverse):
        inner = _path(map_.inv, np.asarray(map_(center)))
        return lambda amount: inner(amount).inv
    return _closed_form(map_)


def _closed_form(map_: Map) -> Callable[[float], Map]:
    if not isinstance(map_, Twist | Taper | Shear | Bend):
        raise InputError(
            "map_",
            map_,
            "no path to the identity is known for maps of this kind",
            "use a Warp, TutteNet, Affine, Twist, Taper, Shear or Bend, or a composition of these",
        )
    placed = map_._placed()
    if isinstance(map_, Twist):
        return lambda amount: Twist(amount * map_.degrees, **placed)
    if isinstance(map_, Taper):
        return lambda amount: Taper([1 + amount * (f - 1) for f in map_.factors], **placed)
    towards = map_.frame[:, 0].tolist()
    if isinstance(map_, Shear):
        return lambda amount: Shear(amount * map_.slope, towards=towards, **placed)
    # A bend's frame leans to where the far end goes, whatever the angle's sign.
    degrees = abs(map_.degrees)
    return lambda a: Bend(a * degrees, towards=towards, **placed) if a > 0 else Affine()


class _AffinePath:
    """Affine maps (3, 4) between the identity and one with positive determinant."""

    def __init__(self, matrix: Array, center: Array) -> None:
        left, stretches, right = np.linalg.svd(matrix[:, :3])
        self._turn = Rotation.from_matrix(left @ right).as_rotvec()
        self._axes, self._stretches = right.T, stretches
        self._center = center
        self._shift = matrix[:, :3] @ center + matrix[:, 3] - center

    def __call__(self, amount: float) -> Array:
        turn = Rotation.from_rotvec(amount * self._turn).as_matrix()
        linear = turn @ (self._axes * self._stretches**amount) @ self._axes.T
        offset = self._center + amount * self._shift - linear @ self._center
        return np.concatenate([linear, offset[:, None]], axis=1)


class _WarpPath:
    def __init__(self, warp: Warp) -> None:
        self._warp = warp
        self._before = warp.before.cpu()
        self._frames = warp.frames.cpu()
        middle = invert_affine(self._before)[:, 3].numpy()
        self._affine = _AffinePath(compose_affine(warp.after.cpu(), self._before).numpy(), middle)

    @cached_property
    def _ends(self) -> tuple[tuple[Array, ...], tuple[Array, ...]]:
        """What describes the layers at rest and the warp's; made on first use."""
        mesh, images = self._warp.mesh, self._warp.embeddings.cpu().numpy()
        return _description(mesh.vertices[None], mesh), _description(images, mesh)

    def __call__(self, amount: float) -> Warp:
        mesh = self._warp.mesh
        weights, angles, radii = (
            (1 - amount) * rest + amount * image for rest, image in zip(*self._ends, strict=True)
        )
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        outline = directions / np.abs(directions).max(axis=-1, keepdims=True)
        boundary = outline * np.exp(radii)[..., None]
        embeddings = embed(torch.from_numpy(weights), torch.from_numpy(boundary), mesh)
        common = torch.from_numpy(self._affine(amount))
        after = compose_affine(common, invert_affine(self._before))
        return Warp(embeddings, self._frames, self._before, after)


def _description(images: Array, mesh: SquareMesh) -> tuple[Array, Array, Array]:
    """What embeddings (K, V, 2) are the embeddings of.

    Returns:
        (K, E) positive weights that sum to one at every inner vertex, in the order of `mesh.edges`;
        (K, M) angles of the boundary's vertices, increasing; and (K, M) the logarithms of their
        distances from the middle in the maximum norm, 0 on the square.
    """
    n = mesh.resolution
    centres = np.arange(n * n, len(mesh.vertices))
    of_centres = _mean_value_weights(images, centres, mesh.centre_corners)
    around = _mean_value_weights(images, mesh.inner, mesh.inner_neighbours[:, _RING])
    of_inner = np.empty_like(around)
    of_inner[..., _RING] = around
    weights = [part.reshape(len(images), -1) for part in (of_centres, of_inner)]
    x, y = np.moveaxis(images[:, mesh.boundary], -1, 0)
    angles = np.unwrap(np.arctan2(y, x), axis=-1)
    turns = np.rint((angles[:, :1] - mesh.boundary_angles[0]) / (2 * np.pi))
    radii = np.log(np.maximum(np.abs(x), np.abs(y)))
    return np.concatenate(weights, axis=1), angles - 2 * np.pi * turns, radii


def _mean_value_weights(
    images: Array, vertices: NDArray[np.int64], ring: NDArray[np.int64]
) -> Array:
    """(K, n, m) mean-value coordinates of vertices (n,) in rings (n, m) that go around them."""
    spokes = images[:, ring] - images[:, vertices, None]
    lengths = np.linalg.norm(spokes, axis=-1)
    ahead = np.roll(spokes, -1, axis=2)
    cross = spokes[..., 0] * ahead[..., 1] - spokes[..., 1] * ahead[..., 0]
    dot = np.sum(spokes * ahead, axis=-1)
    # The tangent of half the angle between a spoke and the next; positive, as triangles are.
    half = cross / (lengths * np.roll(lengths, -1, axis=2) + dot)
    weights = (half + np.roll(half, 1, axis=2)) / lengths
    return weights / weights.sum(axis=2, keepdims=True)
