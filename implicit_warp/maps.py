"""The `Map` protocol: injective maps of R^3 with an inverse and Jacobians.

A map implements four hooks on checked tensors of shape (n, 3); everything that users call is
derived from them here, once, so that all maps (layers, affine maps, compositions, baselines)
behave alike.  Laws, which the tests hold every registered map to:

    m.inv(m(x)) = x = m(m.inv(x)),    m.inv.inv is m,    (a @ b)(x) = a(b(x)),
    m.inv.jacobian(m(x)) @ m.jacobian(x) = I,    det m.jacobian(x) > 0.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from implicit_warp.certificate import Certificate, certify_in_turn, no_certificate
from implicit_warp.errors import InputError

if TYPE_CHECKING:
    from fields import Field
    from implicit_warp.local_bounds import LocalBounds


class Map(ABC):
    """An orientation-preserving injective map of R^3 onto R^3.

    Points are tensors of shape (..., 3), or anything numpy can make an array of; numpy in, numpy
    out.  Jacobians are (..., 3, 3), with entry [i, j] = d y_i / d x_j.
    """

    @abstractmethod
    def _forward(self, points: Tensor) -> Tensor:
        """f(points) for a floating tensor (n, 3)."""

    @abstractmethod
    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """f(points) and the Jacobians (n, 3, 3)."""

    @abstractmethod
    def _inverse(self, points: Tensor) -> Tensor:
        """f^-1(points) for a floating tensor (n, 3)."""

    @abstractmethod
    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """f^-1(points) and the Jacobians of f^-1 (n, 3, 3)."""

    def __call__(self, points):
        """The images (..., 3) of points (..., 3).

        Raises:
            InputError: the points have another shape, or are not finite.
        """
        tensor, restore = flatten_points(points)
        return restore(self._forward(tensor))

    def call_and_jacobian(self, points):
        """Images (..., 3) and Jacobians (..., 3, 3) from one traversal, since they share it."""
        tensor, restore = flatten_points(points)
        image, jacobian = self._forward_and_jacobian(tensor)
        return restore(image), restore(jacobian)

    def jacobian(self, points):
        """Jacobians (..., 3, 3) at points (..., 3)."""
        return self.call_and_jacobian(points)[1]

    @property
    def lipschitz(self) -> tuple[float | None, float | None]:
        """Lipschitz constants of the map and of its inverse on all of R^3; None if unknown."""
        return None, None

    def lipschitz_on(self, boxes) -> np.ndarray:
        """(n,) Lipschitz constants of the map on each box (n, 2, 3); see `local_bounds`."""
        return self.local_bounds(boxes).lipschitz

    def enclose_image(self, boxes) -> np.ndarray:
        """(n, 2, 3) boxes that hold the images of boxes (n, 2, 3); see `local_bounds`."""
        return self.local_bounds(boxes).boxes

    def local_bounds(self, boxes) -> LocalBounds:
        """What the map does to each of n boxes: its largest stretch there, and where they go.

        The bounds are rigorous, rounding included, unless a kind of map says otherwise.  Those of
        the inverse are ``map.inv.local_bounds(boxes)``.

        Args:
            boxes: (n, 2, 3) low and high corners.

        Raises:
            InputError: malformed boxes; a box leaves the map's domain; or nothing is known of the
                map's Lipschitz constant.
        """
        from implicit_warp.local_bounds import checked_boxes

        return self._local_bounds(checked_boxes(boxes))

    @cached_property
    def inv(self) -> Map:
        """The inverse, itself a map; ``m.inv.inv is m``."""
        return Inverse(self)

    def _pull_back(self, field: Field) -> Field | None:
        """The field s o f^-1 as one expression, with bounds of its own; None if that is unknown.

        It may differ from s o f^-1 away from the surface, where it has the same sign.
        """
        return None

    def _certify(self, box: np.ndarray | None) -> Certificate:
        """What is proved of this map on a box (2, 3), or on all of space; see `certify`."""
        return no_certificate(self, "nothing is known that proves maps of this kind", box)

    def _certify_inverse(self, box: np.ndarray | None) -> Certificate:
        """The same for the inverse.  What holds on all of space holds for the inverse as well."""
        return self._certify(None).inverted(repr(self.inv), box)

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        """`local_bounds` of checked boxes; here by the global constant."""
        return _global_bounds(self, boxes)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return _global_bounds(self.inv, boxes)

    def __matmul__(self, other: Map) -> Map:
        """The composition self after other."""
        if not isinstance(other, Map):
            return NotImplemented
        return Composition((other, self))


class Inverse(Map):
    """The inverse of another map; made by `Map.inv`."""

    def __init__(self, original: Map) -> None:
        self._original = original

    @cached_property
    def inv(self) -> Map:
        """The map that this one inverts."""
        return self._original

    @property
    def lipschitz(self) -> tuple[float | None, float | None]:
        """Lipschitz constants of this map and of the one that it inverts."""
        return self._original.lipschitz[::-1]

    def __repr__(self) -> str:
        return f"{self._original!r}.inv"

    def _certify(self, box: np.ndarray | None) -> Certificate:
        return self._original._certify_inverse(box)

    def _certify_inverse(self, box: np.ndarray | None) -> Certificate:
        return self._original._certify(box)

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        return self._original._local_bounds_of_inverse(boxes)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return self._original._local_bounds(boxes)

    def _forward(self, points: Tensor) -> Tensor:
        return self._original._inverse(points)

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return self._original._inverse_and_jacobian(points)

    def _inverse(self, points: Tensor) -> Tensor:
        return self._original._forward(points)

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return self._original._forward_and_jacobian(points)


class Composition(Map):
    """Maps applied one after the other; made by ``b @ a``.

    Args:
        maps: in the order of application, at least one.

    Raises:
        InputError: there are none, or one is no map.
    """

    def __init__(self, maps: Iterable[Map]) -> None:
        flat: list[Map] = []
        for m in maps:
            if not isinstance(m, Map):
                raise InputError("maps", m, "not a map", "pass Warp, TutteNet, Affine, ...")
            flat.extend(m.maps if isinstance(m, Composition) else [m])
        if not flat:
            raise InputError("maps", maps, "there are none", "Affine() is the identity")
        self.maps = tuple(flat)

    @property
    def lipschitz(self) -> tuple[float | None, float | None]:
        """Products of the parts' constants; None where one is unknown."""
        known = zip(*(m.lipschitz for m in self.maps), strict=True)
        return tuple(None if None in part else math.prod(part) for part in known)

    def __repr__(self) -> str:
        return " @ ".join(repr(m) for m in reversed(self.maps))

    def _pull_back(self, field: Field) -> Field | None:
        for m in self.maps:
            pulled = m._pull_back(field)
            if pulled is None:
                return None
            field = pulled
        return field

    def _certify(self, box: np.ndarray | None) -> Certificate:
        return certify_in_turn(self, self.maps, box)

    def _certify_inverse(self, box: np.ndarray | None) -> Certificate:
        return certify_in_turn(self.inv, [m.inv for m in reversed(self.maps)], box)

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        return _bounds_in_turn(self.maps, boxes)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return _bounds_in_turn([m.inv for m in reversed(self.maps)], boxes)

    def _forward(self, points: Tensor) -> Tensor:
        for m in self.maps:
            points = m._forward(points)
        return points

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return _chain(points, (m._forward_and_jacobian for m in self.maps))

    def _inverse(self, points: Tensor) -> Tensor:
        for m in reversed(self.maps):
            points = m._inverse(points)
        return points

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return _chain(points, (m._inverse_and_jacobian for m in reversed(self.maps)))


def _chain(points: Tensor, steps) -> tuple[Tensor, Tensor]:
    jacobian = torch.eye(3, dtype=points.dtype, device=points.device).expand(len(points), 3, 3)
    for step in steps:
        points, local = step(points)
        jacobian = local @ jacobian
    return points, jacobian


def _global_bounds(map_: Map, boxes: np.ndarray) -> LocalBounds:
    """By the map's global Lipschitz constant. The centres' images are rounded as the map rounds:
    1e-12 of their size is allowed for that, which no unknown map can promise."""
    from implicit_warp.local_bounds import ball_bounds, middle_and_half

    constant = map_.lipschitz[0]
    if constant is None:
        raise InputError(
            "map",
            repr(map_),
            "it knows no Lipschitz constant, so nothing bounds what it does to a box",
            "use a kind of map that does",
        )
    centres, halves = middle_and_half(boxes)
    images = map_(centres)
    radii = constant * np.linalg.norm(halves, axis=1) + 1e-12 * np.linalg.norm(images, axis=1)
    return ball_bounds(np.full(len(boxes), constant), images, radii * (1.0 + 1e-14))


def _bounds_in_turn(maps: Iterable[Map], boxes: np.ndarray) -> LocalBounds:
    """Products of the parts' constants, each on a box around the image under those before it."""
    product = np.ones(len(boxes))
    for m in maps:
        bounds = m._local_bounds(boxes)
        product = product * bounds.lipschitz * (1.0 + 2.0**-52)
        boxes = bounds.boxes
    return replace(bounds, lipschitz=product)


def flatten_points(points):
    """Check points and bring them to a floating tensor (n, 3).

    Returns:
        The tensor, and a function that gives a result (n, ...) the leading shape of the input,
        and turns it into numpy if the input was no tensor.

    Raises:
        InputError: not numeric, the last axis is not of length 3, or NaN or infinite values.
    """
    if isinstance(points, Tensor):
        tensor, to_numpy = points, False
    else:
        try:
            array = np.asarray(points)
            # Torch takes neither foreign byte orders nor negative strides.
            native = array.astype(array.dtype.newbyteorder("="), order="C", copy=True)
            tensor, to_numpy = torch.from_numpy(native), True
        except (TypeError, ValueError) as error:
            raise InputError(
                "points",
                points,
                f"not an array of numbers ({error})",
                "pass a tensor or an array of shape (..., 3)",
            ) from error
    if tensor.shape[-1:] != (3,):
        raise InputError(
            "points",
            tuple(tensor.shape),
            "this is the shape, and its last axis must be of length 3",
            "pass points as (..., 3)",
        )
    if not tensor.is_floating_point():
        if tensor.dtype == torch.bool or tensor.is_complex():
            raise InputError(
                "points", tensor.dtype, "not real numbers", "convert them to float64 first"
            )
        tensor = tensor.to(torch.float64)
    shape = tensor.shape[:-1]
    flat = tensor.reshape(-1, 3)
    check_finite("points", flat)

    def restore(result: Tensor):
        result = result.reshape(shape + result.shape[1:])
        return result.detach().cpu().numpy() if to_numpy else result

    return flat, restore


def check_finite(argument: str, values: Tensor) -> None:
    """Raise `InputError` when values (n, ...) hold NaN or infinity, naming the first row."""
    # A sum is finite only if every term is; it costs one pass and no temporary.
    if bool(torch.isfinite(values.detach().sum())):
        return
    bad = (~torch.isfinite(values.detach())).flatten(1).any(-1).nonzero().squeeze(-1)
    if len(bad):
        raise InputError(
            argument,
            values[bad[0]].tolist(),
            f"{len(bad)} of {len(values)} rows are NaN or infinite, the first is row {int(bad[0])}",
            "drop them, or look for a division by zero where they were made",
        )
