"""The shapes a boolean operation can give to the place where two surfaces meet.

A joint is a profile: the union of a and b is

    min(a, b) - material(|a - b|),    with material >= 0 and its slope in [-1, 0].

One argument serves all of them. Where a < b the gradient is (1 + m') grad a - m' grad b, with m'
the slope at |a - b|: a convex combination, whatever the angle between the gradients. So **every
joint keeps the larger Lipschitz bound of its operands**, and lowers the minimum by at most its
*depth*, the material at a = b. The intersection is max(a, b) + material(|a - b|), by complements.

This is where our chamfer departs from the usual min(a, b, (a + b - r) / sqrt(2)) of hg_sdf: that
bevel is a distance where two planes are square to each other, but where the gradients are parallel
it is steeper than its operands by sqrt(2). Ours is (a + b - r) / 2, which has the same zero set and
is never steeper; its bevel is underestimated by 1 / sqrt(2) at right angles. The circular joint
differs from hg_sdf's in the same way: the arc is the same, and it is moved along a = b for other
levels.

Sources of the profiles: Inigo Quilez, "smooth minimum" (https://iquilezles.org/articles/smin/);
Mercury, "hg_sdf" (https://mercury.sexy/hg_sdf/). Parameters keep the meaning they have there,
except that Quilez divides `cubic`, `root` and `exponential` further so that their depth is k.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from inspect import Parameter, signature
from typing import NamedTuple, TypedDict, TypeVar

from fields import arguments
from fields.errors import InputError
from fields.expression import Expression, exp, log, maximum, minimum, modulo, sqrt, square


class Joint(TypedDict, total=False):
    """How two surfaces meet, by name; at most one is given, and 0 means a sharp edge.

    Lengths are field values: distances along either surface from the edge, where both fields are
    distances and the surfaces are square to each other.
    """

    smooth: float
    """k: quadratic blend where the values differ by less than k; k / 4 deep."""
    cubic: float
    """k: cubic blend where the values differ by less than k, with continuous curvature; k / 6."""
    exponential: float
    """k: -k log(exp(-a / k) + exp(-b / k) + ...), everywhere; k log n deep for n fields. The only
    joint that does not depend on the order of its fields."""
    root: float
    """k: (a + b - sqrt((a - b)^2 + k^2)) / 2, everywhere; k / 2 deep."""
    round: float
    """r: an arc of radius r, from r to r along both surfaces."""
    chamfer: float
    """r: a flat bevel, from r to r along both surfaces."""
    stairs: tuple[float, int]
    """(r, n): n rises of r / n, so n - 1 treads, from r to r along both surfaces."""


class Profile(NamedTuple):
    """One joint with its size; see the module's docstring.

    Attributes:
        name: its key in `JOINTS`.
        size: its radius.
        depth: the most by which it lowers the minimum of two fields.
        material: the profile as a function of |a - b|.
    """

    name: str
    size: float
    depth: float
    material: Callable[[Expression], Expression]


def _smooth(size: float) -> Profile:
    return Profile(
        "smooth", size, size / 4, lambda gap: square(maximum(size - gap, 0.0)) * (0.25 / size)
    )


def _cubic(size: float) -> Profile:
    def material(gap: Expression) -> Expression:
        nearness = maximum(1.0 - gap / size, 0.0)
        return square(nearness) * nearness * (size / 6)

    return Profile("cubic", size, size / 6, material)


def _exponential(size: float) -> Profile:
    return Profile(
        "exponential", size, size * math.log(2), lambda gap: log(exp(-gap / size) + 1.0) * size
    )


def _root(size: float) -> Profile:
    return Profile(
        "root", size, size / 2, lambda gap: (sqrt(square(gap) + size * size) - gap) * 0.5
    )


def _round(size: float) -> Profile:
    def material(gap: Expression) -> Expression:
        # On the circle (a - r)^2 + (b - r)^2 = r^2, moved along a = b through (a, b). The slope
        # is -1/2 at the middle and 0 at the ends of the arc.
        within = minimum(gap, size)
        return size - within * 0.5 - sqrt(0.5 * size * size - square(within) * 0.25)

    return Profile("round", size, size * (1 - math.sqrt(0.5)), material)


def _chamfer(size: float) -> Profile:
    return Profile("chamfer", size, size / 2, lambda gap: maximum(size - gap, 0.0) * 0.5)


def _stairs(size: float, count: int) -> Profile:
    def material(gap: Expression) -> Expression:
        # The chamfer less a triangle wave: its slope is 0 on treads and -1 on risers.
        step = size / count
        wave = abs(modulo(gap - size + step, 2 * step) - step)
        return maximum(size - gap - wave, 0.0) * 0.5

    return Profile("stairs", size, size / 2, material)


JOINTS: dict[str, Callable[..., Profile]] = {
    "smooth": _smooth,
    "cubic": _cubic,
    "exponential": _exponential,
    "root": _root,
    "round": _round,
    "chamfer": _chamfer,
    "stairs": _stairs,
}
"""The profile of each key of `Joint`, for a radius greater than zero."""


def chosen(joint: Mapping[str, object]) -> Profile | None:
    """The one joint that is asked for; None for sharp edges.

    Raises:
        InputError: more than one is not zero, there is none of that name, or its size is negative.
    """
    profiles = []
    for name, value in joint.items():
        if name not in JOINTS:
            raise InputError(
                name, value, "there is no joint of that name", f"the joints are {', '.join(JOINTS)}"
            )
        size, *others = _radius_and_count(value) if name == "stairs" and value != 0 else (value,)
        size = arguments.not_negative(name, size)
        if size > 0:
            profiles.append(JOINTS[name](size, *others))
    if len(profiles) > 1:
        names = " and ".join(profile.name for profile in profiles)
        raise InputError(
            profiles[1].name,
            joint[profiles[1].name],
            f"{names} are both given, and edges can have one shape only",
            "pass one of them, and combine in two steps if you need both",
        )
    return profiles[0] if profiles else None


def _radius_and_count(value: object) -> tuple[object, int]:
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise InputError(
            "stairs", value, "stairs need a size and a number of steps", "pass (0.2, 4), say"
        )
    return value[0], arguments.whole("stairs[1]", value[1])


F = TypeVar("F", bound=Callable[..., object])


def with_joints(function: F) -> F:
    """Spell the joints out in the signature of a function that takes them as `**joint`."""
    own = signature(function)
    *others, _ = own.parameters.values()
    named = [
        Parameter(name, Parameter.KEYWORD_ONLY, default=0.0, annotation=annotation)
        for name, annotation in Joint.__annotations__.items()
    ]
    function.__signature__ = own.replace(parameters=[*others, *named])  # type: ignore[attr-defined]
    return function
