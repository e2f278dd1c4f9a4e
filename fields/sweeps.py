"""What is made of profiles along circles and paths: the rules, and which tags survive."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    atan2,
    length,
    maximum,
    minimum,
    modulo,
    remap,
    where_negative,
)
from fields.formulas import box_distance
from fields.operations import Body, rule, shortest_turn
from fields.solids import bounded_profile, checked_profile, reach_of
from fields.tags import Box, Tags, largest
from fields.tape import flatten

Vectors = NDArray[np.float64]

_TOUCHING = 1e-9
"""A profile is on the axis of revolution if it ends so near to it, as a part of its far end."""

_OFF_AXIS = 1e-6
"""Where a profile is on the axis, points nearer than so much of its far end count as so far out."""

# --- along circles --------------------------------------------------------------------


@rule
def revolve(body: Body, offset: float = 0.0, degrees: float = 360.0) -> Body:
    """a(r - offset, z), with r the distance from the axis; S is moved by `offset` along x first.

    Full turn. Lipschitz: (r, z) is a map of Lipschitz constant 1. Exact if a is, and S lies beyond
    the axis: the nearest point is in the half-plane of the point itself. Or if S is its own mirror
    image, shown by the formula being the same node for -x: its nearest point is on the side of the
    point. A shape that only touches the axis has surface there that the solid does not have: then r
    is kept from falling to 0, so that the axis is not on the surface, and nothing is exact.

    Part of a turn. Let w be the distance from the plane of the nearer end, positive beyond it, and
    u the coordinate in that plane. Beyond the end, hypot(max(a(u), 0), w); before it, max(a(r), w),
    or -r in place of w where u < 0. Exact if a is and S lies beyond the axis: beyond the end every
    circle of the solid is nearest at its end; before it the complement is reached through the side
    or through the plane. u and w are orthonormal, so the Lipschitz bound is max(L, 1).
    """
    shift, turn = arguments.number("offset", offset), arguments.number("degrees", degrees)
    if not 0 < turn <= 360:
        raise InputError("degrees", degrees, "it is not within a turn", "pass 0 < degrees <= 360")
    tags = checked_profile(body).tags
    inner, outer = (tags.extent[:, 0] + shift).tolist()
    if outer <= 0:
        raise InputError(
            "offset",
            offset,
            f"the profile lies on the far side of the axis, up to x = {outer:g}",
            "move it to positive x by a larger offset",
        )
    is_mirrored = shift == 0 and _is_mirrored(body.expression)
    size = outer if math.isfinite(outer) else 1.0
    is_touching = not is_mirrored and abs(inner) <= _TOUCHING * size
    radius = length(X, Y)
    across = maximum(radius, _OFF_AXIS * size) if is_touching else radius
    is_beyond = inner > 0 and not is_touching
    growth = tags.growth
    if turn == 360:
        value = remap(body.expression, (across - shift, Z, Z))
        exact = tags.exact and (is_beyond or is_mirrored)
        lipschitz = tags.lipschitz
    else:
        value = _part_of_a_turn(body.expression, across, shift, math.radians(turn) / 2)
        exact = tags.exact and is_beyond
        lipschitz, growth = largest([1.0, tags.lipschitz]), largest([1.0, growth])
    extent = _ring_extent(max(inner, 0.0), outer, math.radians(turn))
    extent[:, 2] = tags.extent[:, 1]
    return Body(value, Tags(exact, lipschitz, extent, growth))


def _is_mirrored(expression: Expression) -> bool:
    """Is the formula the same for -x? No says nothing: it may be so written another way."""
    return flatten(remap(expression, (-X, Y, Z))) is flatten(expression)


def _part_of_a_turn(
    section: Expression, across: Expression, shift: float, half_turn: float
) -> Expression:
    """From the half-plane y = 0, x > 0 counter-clockwise; the plane between is a mirror."""
    cosine, sine = math.cos(half_turn), math.sin(half_turn)
    along, aside = cosine * X + sine * Y, abs(cosine * Y - sine * X)
    u, w = cosine * along + sine * aside, cosine * aside - sine * along
    value = remap(section, (where_negative(-w, u, across) - shift, Z, Z))
    before = maximum(value, where_negative(u, -length(X, Y), w))
    return where_negative(-w, length(maximum(value, 0.0), w), before)


def _ring_extent(inner: float, outer: float, turn: float) -> Box:
    """The box around a ring from the angle 0 to `turn`; z is left to the caller."""
    quarters = [k * math.pi / 2 for k in range(5) if k * math.pi / 2 <= turn + 1e-12]
    angles = np.array([*quarters, turn])
    rays = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rays[np.abs(rays) < 1e-15] = 0.0
    with np.errstate(invalid="ignore"):
        ends = np.concatenate([rays * inner, np.where(rays == 0, 0.0, rays * outer)])
    extent = np.zeros((2, 3))
    extent[0, :2], extent[1, :2] = ends.min(axis=0), ends.max(axis=0)
    return extent


@rule
def coil(body: Body, radius: float, pitch: float, turns: float) -> Body:
    """The nearest two of the sections a(r - radius, z - p phi - k pitch), cut off at both ends.

    With e the largest |y| of S, g the growth of a and m the inner radius of the coil, a section is
    at least (pitch - e) / g where it is swapped for the next one, and at least m / (2 g) within m/2
    of the axis. No value above the smaller of both is kept, so the result is continuous, and flat
    near the axis, where the slope of the coil would have no bound. So the Lipschitz bound is that
    of a times sqrt(1 + (p / (m/2))^2), p = pitch / (2 pi). The solid is cut out of its cylinder,
    whose distance takes over beyond, and gives it growth 1.
    """
    around, rise = arguments.positive("radius", radius), arguments.number("pitch", pitch)
    half = abs(rise) * arguments.positive("turns", turns) / 2
    tags = bounded_profile(body).tags
    tallest = float(np.abs(tags.extent[:, 1]).max())
    inner, outer = (tags.extent[:, 0] + around).tolist()
    if abs(rise) <= tallest:
        raise InputError(
            "pitch", pitch, f"the profile reaches {tallest:g} up or down", "pass a larger pitch"
        )
    if inner <= 0:
        raise InputError(
            "radius", radius, f"the profile reaches the axis, to {inner:g}", "pass a larger radius"
        )
    angle = atan2(Y, X) if rise > 0 else -atan2(Y, X)
    over = modulo(Z - angle * (abs(rise) / (2 * math.pi)), abs(rise))
    across = length(X, Y) - around
    sections = [remap(body.expression, (across, y, Z)) for y in (over, over - abs(rise))]
    lipschitz = tags.lipschitz
    if lipschitz is not None:
        lipschitz = max(1.0, lipschitz * math.hypot(1.0, abs(rise) / (math.pi * inner)))
    cylinder = box_distance((length(X, Y) - outer, abs(Z) - half))
    extent = np.array([(-outer, -outer, -half), (outer, outer, half)])
    most = min(abs(rise) - tallest, inner / 2) / _known_growth(body)
    expression = maximum(minimum(*sections, most), cylinder)
    return Body(expression, Tags(False, lipschitz, extent, 1.0))


def _known_growth(body: Body) -> float:
    """At most t only within so much times t of the bounds."""
    if body.tags.growth is None:
        raise InputError(
            "field",
            body.expression,
            "nothing is known of its values away from its shape",
            "state the growth of a remapped field",
        )
    return body.tags.growth


# --- along paths ----------------------------------------------------------------------


class _Path(NamedTuple):
    """A chain of segments with what belongs to each.

    Attributes:
        points: `(n + 1, 3)`.
        frames: `(n, 3, 3)`, columns: where the profile's x, y and z point.
        planes: `(n + 1, 3)`, unit normals of the planes through the points: square to the path at
            its ends, half-way between the segments at joints.
        half_turns: `(n + 1,)`, half of the angle at each joint; 0 at the ends.
    """

    points: Vectors
    frames: Vectors
    planes: Vectors
    half_turns: NDArray[np.float64]


@rule
def sweep(body: Body, points: ArrayLike) -> Body:
    """The union of bent prisms, one for each joint, each of two endless prisms that meet in the
    joint's plane and are cut off at the planes of the joints beside it.

    Frames turn by the least angle from segment to segment, so both prisms of a joint are mirror
    images in its plane: the value is continuous there, and has the Lipschitz bound of a. A cut
    acts only on its own side of the joint, as the minimum of two plane distances, and so has
    bound 1. The prisms of neighbouring joints share a segment, so no surface is left inside.
    One segment alone is an extrusion, exact if a is; more are not, because a prism's plane
    distances fall short beside its edges.
    Extent: around the corners of the profile's box in all planes. Growth: where the value is at
    most t, the profile's coordinates are within sqrt(2) g t of its box, so the planes are up to
    sqrt(2) g t tan farther than where the box meets them, and up to t / cos may be beyond; with
    half of the turn at a joint in sin, cos and tan.
    """
    tags = bounded_profile(body).tags
    reach = reach_of(tags.extent)
    path = _path(points)
    _check_room(points, path, reach)
    planes = [_plane(path.points[i], path.planes[i]) for i in range(len(path.points))]
    frames = [_in_frame(path.points[i], frame) for i, frame in enumerate(path.frames)]
    if len(frames) == 1:
        section = remap(body.expression, frames[0])
        expression = box_distance((section, -planes[0], planes[1]))
    else:
        pieces = [
            _bent_prism(body.expression, frames[i - 1 : i + 1], planes[i - 1 : i + 2])
            for i in range(1, len(frames))
        ]
        expression = minimum(*pieces)
    exact = tags.exact and len(frames) == 1
    growth = None
    if exact:
        growth = 1.0
    elif tags.growth is not None:
        steepest, wide = float(path.half_turns.max()), math.sqrt(2) * tags.growth
        growth = math.hypot(wide, (1 + wide * math.sin(steepest)) / math.cos(steepest))
    extent = _swept_extent(path, tags.extent)
    return Body(expression, Tags(exact, largest([1.0, tags.lipschitz]), extent, growth))


def _swept_extent(path: _Path, profile: Box) -> Box:
    """The box around the corners of the profile's own box in the planes of all joints."""
    u, v = np.meshgrid(*profile[:, :2].T)
    corners = np.stack([u.ravel(), v.ravel(), np.zeros(4)])
    frames = np.concatenate([path.frames[:1], path.frames])
    square = np.einsum("ijk,kc->icj", frames, corners)
    along, normal = frames[:, :, 2], path.planes
    slide = np.einsum("icj,ij->ic", square, normal) / np.einsum("ij,ij->i", along, normal)[:, None]
    placed = path.points[:, None] + square - slide[:, :, None] * along[:, None]
    return np.stack([placed.min(axis=(0, 1)), placed.max(axis=(0, 1))])


def _bent_prism(
    section: Expression, frames: list[Coordinates], planes: list[Expression]
) -> Expression:
    before, at, after = planes
    coordinates = tuple(where_negative(at, a, b) for a, b in zip(*frames, strict=True))
    value = remap(section, coordinates)  # type: ignore[arg-type]
    return maximum(value, minimum(-before, -at), minimum(after, at))


def _plane(point: Vectors, normal: Vectors) -> Expression:
    nx, ny, nz = normal.tolist()
    return nx * X + ny * Y + nz * Z - float(point @ normal)


def _in_frame(point: Vectors, frame: Vectors) -> Coordinates:
    return tuple(_plane(point, axis) for axis in frame.T)  # type: ignore[return-value]


def _path(points: ArrayLike) -> _Path:
    corners = _path_points(points)
    along = np.diff(corners, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    frames = [shortest_turn(tuple(along[0].tolist()))]
    for before, after in pairwise(along):
        # Seen in the frame so far, in which it points along z, the path turns by the shortest way.
        frames.append(frames[-1] @ shortest_turn(tuple((frames[-1].T @ after).tolist())))
        if before @ after < -0.9:
            raise InputError(
                "points",
                points,
                "the path turns back by more than 154 degrees at one joint",
                "bend it in several steps",
            )
    planes = np.concatenate([along[:1], along[1:] + along[:-1], along[-1:]])
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    cosines = np.einsum("ij,ij->i", along[1:], along[:-1]).clip(-1, 1)
    half_turns = np.concatenate([[0.0], np.arccos(cosines) / 2, [0.0]])
    return _Path(corners, np.array(frames), planes, half_turns)


def _path_points(points: ArrayLike) -> Vectors:
    items = np.asarray(points, dtype=object)
    if items.ndim != 2 or len(items) < 2:
        raise InputError("points", points, "a path has two or more points", "pass [(x, y, z), ...]")
    corners = np.array(
        [arguments.vector(f"points[{i}]", item) for i, item in enumerate(items.tolist())]
    )
    if (corners[1:] == corners[:-1]).all(axis=1).any():
        raise InputError("points", points, "two points in a row are equal", "leave one out")
    return corners


def _check_room(points: ArrayLike, path: _Path, reach: float) -> None:
    """The planes of neighbouring joints must not meet within the profile's reach."""
    lengths = np.linalg.norm(np.diff(path.points, axis=0), axis=1)
    tangents = np.tan(path.half_turns)
    needed = reach * (tangents[1:] + tangents[:-1])
    if (needed > lengths).any():
        worst = int((needed - lengths).argmax())
        raise InputError(
            "points",
            points,
            f"segment {worst} is {lengths[worst]:g} long; with bends like those at its ends and a "
            f"profile that reaches {reach:g} from the path, it takes {needed[worst]:g}",
            "pass longer segments, gentler bends or a smaller profile",
        )
