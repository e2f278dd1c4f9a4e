"""Carry things forward by a map: points, fields and meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, overload
from weakref import WeakKeyDictionary

import numpy as np
import torch
from torch import Tensor

from fields import Field
from fields.expression import Expression
from implicit_warp.errors import InputError
from implicit_warp.maps import Map

if TYPE_CHECKING:
    import trimesh

    from implicit_warp.push_forward.methods import Method, Precision, Progress

_LATTICE = 48
"""Samples a side of the lattice from which the bounds of a deformed field are estimated."""


@overload
def deform(thing: Field, map_: Map) -> Field: ...
@overload
def deform(
    thing: trimesh.Trimesh,
    map_: Map,
    *,
    method: Method = "vertices",
    tolerance: float | None = None,
    until_clean: bool = False,
    clean_for: Precision | None = None,
    progress: Progress | None = None,
) -> trimesh.Trimesh: ...
@overload
def deform(thing: Tensor, map_: Map) -> Tensor: ...


def deform(thing, map_: Map, *, method: Method = "vertices", **options):
    """Carry a field, a mesh or points forward by an injective map f.

    * Points (..., 3): their images f(x).
    * A field s: the field s o f^-1, whose surface is the image of the surface of s.  It is not a
      distance any more; its Lipschitz tag is that of s times that of f^-1 where both are known.
      For maps in closed form (`Affine`, `Twist`, `Taper`, `Shear`, `Bend` and compositions of
      these) it is the operation of the same name on fields: one expression, with proven bounds.
      For others bounds are estimated from a lattice of samples, with a margin for what lies between
      them; `extract` reports a surface that reaches the edge of its box all the same.
    * A mesh: `method` says how, and what is guaranteed.  By "vertices", the default, vertices are
      mapped and faces stay flat.  That is what the paper does, and it carries **no guarantee**: the
      map is injective on space, but a flat triangle is not the image of a triangle, so a coarse
      mesh can come out with self-intersections.  "adaptive" divides faces until their images are
      within a tolerance of flat, for any map.  "exact" cuts them along the creases of a warp, so
      that the result is the image itself, and as free of self-intersections as the mesh was.
      `deform_mesh` explains all three, their options, and returns a report as well.

    Raises:
        InputError: the first argument is none of these, the second is no map, or a method or option
            that does not fit them.
    """
    if not isinstance(map_, Map):
        raise InputError("map_", map_, "not a map", "pass a Warp, TutteNet, Affine, ...")
    if hasattr(thing, "vertices") and hasattr(thing, "faces"):
        if method == "vertices" and not options:
            moved = thing.copy()
            moved.vertices = map_(np.asarray(thing.vertices, dtype=np.float64))
            return moved
        from implicit_warp.push_forward import deform_mesh

        return deform_mesh(thing, map_, method, **options)[0]
    if method != "vertices" or options:
        raise InputError(
            "method", method, "methods and their options are for meshes only", "leave them out"
        )
    if isinstance(thing, Field):
        return _deform_field(thing, map_)
    if isinstance(thing, Tensor | np.ndarray | list | tuple):
        return map_(thing)
    raise InputError(
        "thing", thing, "neither a field, a mesh nor points", "pass a Field, Trimesh or (..., 3)"
    )


class Origin(NamedTuple):
    """A field that was carried forward by a map, the map, and whether the result is a formula of
    the field's (else it calls the map's inverse)."""

    rest: Field
    map: Map
    formula: bool


_origins: WeakKeyDictionary[Expression, Origin] = WeakKeyDictionary()


def origin(field: Field) -> Origin | None:
    """What `deform` made a field of; None for fields that it did not make."""
    return _origins.get(field.expression)


def _deform_field(field: Field, map_: Map) -> Field:
    carried = map_._pull_back(field)
    formula = carried is not None
    if not formula:
        carried = _through_an_oracle(field, map_)
    _origins[carried.expression] = Origin(field, map_, formula)
    return carried


def _through_an_oracle(field: Field, map_: Map) -> Field:
    forward, backward = map_.lipschitz
    known = field.lipschitz is not None and backward is not None

    return field.remap(
        PullBack(map_),
        lipschitz=field.lipschitz * backward if known else None,
        bounds=None if field.bounds is None else _image_bounds(field, map_),
        growth=forward if field.exact else None,
    )


class PullBack:
    """The inverse of a map as a leaf of fields' expressions.

    Attributes:
        map: the map itself, which carries fields forward.
        name: its kind, for `repr`.
        outputs: 3, the coordinates before the map.
    """

    outputs = 3

    def __init__(self, map_: Map) -> None:
        self.map = map_
        self.name = type(map_).__name__.lower()

    def __call__(self, points: Tensor) -> Tensor:
        """Where points `(..., 3)` come from."""
        return self.map._inverse(points.reshape(-1, 3)).reshape(points.shape)

    def value_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Where points (n, 3) come from, and the Jacobians of the map's inverse there."""
        return self.map._inverse_and_jacobian(points)

    def enclose(self, boxes: np.ndarray) -> np.ndarray | None:
        """Boxes `(n, 3, 2)` around where boxes `(n, 2, 3)` come from; None for maps that know none.

        A millionth of their size wider than the map's own bounds: those are for float64.
        """
        try:
            places = self.map.inv.enclose_image(boxes)
        except InputError:  # the kind of map has no bounds, or not on such boxes
            return None
        slack = 1e-6 * np.abs(places).max(axis=(1, 2), initial=0.0)[:, None]
        return np.stack([places[:, 0] - slack, places[:, 1] + slack], axis=-1)


@torch.no_grad()
def _image_bounds(field: Field, map_: Map) -> np.ndarray:
    """A box around the image of the field's inside.

    Every point inside lies within half a lattice diagonal of a sample that is kept, and its image
    within that times the local stretch, taken as the largest norm of J at any kept sample.
    """
    low, high = torch.tensor(field.bounds)
    step = (high - low) / (_LATTICE - 1)
    axes = [low[i] + step[i] * torch.arange(_LATTICE, dtype=torch.float64) for i in range(3)]
    lattice = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    reach = 0.5 * float(step.norm())
    if field.lipschitz is not None:
        lattice = lattice[field.evaluate(lattice) <= reach * field.lipschitz]
    if not len(lattice):  # nothing is inside; any box will do, so that of the corners' images
        images = map_(torch.cartesian_prod(*torch.stack([low, high], 1)))
        return torch.stack([images.amin(0), images.amax(0)]).numpy()
    images, jacobians = map_.call_and_jacobian(lattice)
    # The Frobenius norm bounds the spectral norm, and needs no decomposition.
    margin = reach * float(torch.linalg.matrix_norm(jacobians).max())
    return torch.stack([images.amin(0) - margin, images.amax(0) + margin]).numpy()
