"""Certificates: what is proved of a map, and how.

A certificate speaks about the exact map that stored float64 numbers define, not about the numbers
that evaluation in floating point returns.  It is either a proof of injectivity (see `orientation`
for the theorem behind layered maps) or says "no certificate" and why; that something is injective
is never said without proof, and the lack of a proof never means that a map is not injective.

What each kind of map can prove of itself, it says in `Map._certify`: a kind of map defined
elsewhere, such as a baseline, may override that one method, and otherwise has no certificate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from implicit_warp.errors import InputError

if TYPE_CHECKING:
    from implicit_warp.maps import Map

Box = tuple[tuple[float, float, float], tuple[float, float, float]]

_AGREE = 1e-6
"""Relative difference up to which two certificates of one map agree: the extremes of a net's
layers depend on the last digits of its solve, which may differ between processors."""


@dataclass(frozen=True)
class Certificate:
    """What is proved of a map.

    Attributes:
        map: which map, in words.
        proved: is the exact map injective (a homeomorphism onto its image, keeping orientation)?
        reason: why not, if there is no proof.
        region: the box that everything here is about; None means all of R^3.
        by_filter: orientations decided in float64 with a proven error bound.
        exactly: orientations decided in exact integer arithmetic.
        smallest_area: twice the smallest oriented area of any triangle or cone of any layer, the
            exact value rounded once; None without layers.
        smallest_area_sign: its exact sign, which rounding cannot take to zero; 0 without layers.
        singular_values: for each layer, a lower bound of the smallest and an upper bound of the
            largest singular value of its Jacobian on all of R^3; an affine map is one layer.
        lipschitz: upper bounds of the Lipschitz constants of the map and of its inverse; None
            where none is known. On a box they hold on it, and on a box around its image.
    """

    map: str
    proved: bool
    reason: str = ""
    region: Box | None = None
    by_filter: int = 0
    exactly: int = 0
    smallest_area: float | None = None
    smallest_area_sign: int = 0
    singular_values: tuple[tuple[float, float], ...] = ()
    lipschitz: tuple[float | None, float | None] = (None, None)

    def __str__(self) -> str:
        if not self.proved:
            return f"no certificate: {self.reason}"
        where = "all of R^3" if self.region is None else f"the box {_shown(self.region)}"
        lines = [f"proved injective on {where}"]
        if self.by_filter + self.exactly:
            lines.append(
                f"orientations: {self.by_filter} decided in float64 with a proven error bound, "
                f"{self.exactly} in exact arithmetic"
            )
        if self.smallest_area is not None:
            sign = {-1: "negative", 0: "zero", 1: "positive"}[self.smallest_area_sign]
            lines.append(f"smallest oriented area (twice): {self.smallest_area:.6g}, {sign}")
        if self.singular_values:
            low = min(pair[0] for pair in self.singular_values)
            high = max(pair[1] for pair in self.singular_values)
            count = len(self.singular_values)
            lines.append(f"singular values of any of {count} layers: {low:.6g} to {high:.6g}")
        shown = ["unknown" if x is None else f"{x:.6g}" for x in self.lipschitz]
        lines.append(f"Lipschitz bounds: {shown[0]} forward, {shown[1]} back")
        return "\n  ".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """The same in plain values, as JSON has them; None for an infinite singular value."""
        values = asdict(self)
        values["region"] = None if self.region is None else [list(corner) for corner in self.region]
        values["singular_values"] = [[_finite(s) for s in pair] for pair in self.singular_values]
        values["lipschitz"] = list(self.lipschitz)
        return values

    def inverted(self, name: str, box: np.ndarray | None) -> Certificate:
        """The certificate of the inverse of a map that is proved on all of R^3, for a box."""
        return replace(
            self,
            map=name,
            region=as_region(box),
            singular_values=tuple(
                (1.0 / b, 1.0 / a if a else math.inf) for a, b in reversed(self.singular_values)
            ),
            lipschitz=self.lipschitz[::-1],
        )


def certify(map_: Map, box=None) -> Certificate:
    """State whether a map is proved injective, and bound what it does to lengths.

    Args:
        map_: any map.
        box: (2, 3) low and high corner of the region in question; all of R^3 by default. Needed
            for maps that are injective on a part of space only, such as `Bend`; for others it
            sharpens the Lipschitz bounds.

    Raises:
        InputError: not a map, or a malformed box.
    """
    from implicit_warp.local_bounds import checked_boxes
    from implicit_warp.maps import Map

    if not isinstance(map_, Map):
        raise InputError("map_", map_, "not a map", "pass a Warp, TutteNet, Affine, ...")
    region = None
    if box is not None:
        region = checked_boxes([box])[0]
    certificate = map_._certify(region)
    if not certificate.proved:
        return certificate
    if region is None:
        given = certificate.lipschitz
        constants = map_.lipschitz if given == (None, None) else given
        return replace(certificate, lipschitz=tuple(_finite(x) for x in constants))
    bounds = _known(lambda: map_._local_bounds(region[None]))
    back = None
    if bounds is not None and np.isfinite(bounds.boxes).all():
        back = _known(lambda: map_._local_bounds_of_inverse(bounds.boxes))
    constants = [None if b is None else _finite(b.lipschitz[0]) for b in (bounds, back)]
    return replace(certificate, lipschitz=tuple(constants))


def no_certificate(map_: Map, reason: str, box: np.ndarray | None) -> Certificate:
    """Nothing is proved of a map, for the reason given."""
    return Certificate(repr(map_), False, reason, as_region(box))


def as_region(box: np.ndarray | None) -> Box | None:
    """A box (2, 3) as plain numbers."""
    return None if box is None else tuple(tuple(map(float, corner)) for corner in box)


def certify_in_turn(map_: Map, parts: Sequence[Map], box: np.ndarray | None) -> Certificate:
    """The certificate of a composition: proved if each part is, on a box around what reaches it."""
    found, region = [], box
    for i, part in enumerate(parts):
        certificate = part._certify(region)
        if not certificate.proved:
            return no_certificate(map_, f"part {i}, {part!r}: {certificate.reason}", box)
        found.append(certificate)
        if region is not None:
            pushed = _known(lambda part=part, region=region: part._local_bounds(region[None]))
            # Without a bound on the image the next part must be proved everywhere.
            known = pushed is not None and bool(np.isfinite(pushed.boxes).all())
            region = pushed.boxes[0] if known else None
    with_areas = [c for c in found if c.smallest_area is not None]
    smallest = min(with_areas, key=lambda c: c.smallest_area, default=None)
    return Certificate(
        repr(map_),
        True,
        region=as_region(box),
        by_filter=sum(c.by_filter for c in found),
        exactly=sum(c.exactly for c in found),
        smallest_area=None if smallest is None else smallest.smallest_area,
        smallest_area_sign=0 if smallest is None else smallest.smallest_area_sign,
        singular_values=tuple(pair for c in found for pair in c.singular_values),
    )


def disagreement(stored: dict[str, Any], computed: Certificate) -> str | None:
    """What a stored certificate, as a dictionary, says otherwise than a computed one, or None."""
    fresh = computed.to_dict()
    for name in ("proved", "region", "smallest_area", "singular_values", "lipschitz"):
        if name not in stored or not _agree(stored[name], fresh[name]):
            return f"{name} is stored as {stored.get(name)!r}, computed as {fresh[name]!r}"
    return None


def _agree(stored: Any, computed: Any) -> bool:
    if isinstance(computed, list):
        same_length = isinstance(stored, list) and len(stored) == len(computed)
        return same_length and all(map(_agree, stored, computed))
    if isinstance(computed, float):
        number = isinstance(stored, float | int) and not isinstance(stored, bool)
        return number and math.isclose(stored, computed, rel_tol=_AGREE)
    return type(stored) is type(computed) and stored == computed


def _known(bounds):
    """The bounds, or None where a map cannot say."""
    try:
        return bounds()
    except InputError:
        return None


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)


def _shown(region: Box) -> str:
    return " to ".join("(" + ", ".join(f"{x:g}" for x in corner) + ")" for corner in region)
