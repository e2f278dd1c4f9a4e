"""Helices, screw threads and knots: tubes and ridges that wind about the z axis.

Sources: the distance to a helix is Kepler's equation (as noted for example by Nievergelt,
"Computing the distance from a point to a helix and solving Kepler's equation", 2009); the thread
has the basic profile of ISO 68-1. Angles are in degrees; `hand` is "right" for an ordinary screw.
"""

from __future__ import annotations

import math

import numpy as np

from fields import arguments
from fields.errors import InputError
from fields.expression import (
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    atan2,
    clamp,
    cos,
    floor,
    length,
    maximum,
    minimum,
    modulo,
    sin,
    sqrt,
    square,
    where_negative,
)
from fields.formulas import bounding_body, disc_reach
from fields.operations import Body, Matrix
from fields.primitives import primitive

NEWTON_STEPS = 10
"""Enough for 1e-15 in the distance, for all pitches and points; 8 leave 6e-10."""

STEEP = 1e-9
"""Least divisor of a Newton step; smaller ones belong to no minimum of the distance."""

UNSETTLED = 1e-3
"""What a Newton iteration without a crossing leaves is more than this, and rounding is less."""

STEPS = 1000
"""Along a turn, where its box is looked up."""

TURN = 2 * math.pi


def _side(hand: str) -> float:
    return 1.0 if arguments.choice("hand", hand, ("right", "left")) == "right" else -1.0


@primitive
def helix(
    radius: float, tube: float, pitch: float, turns: float, ends: str = "round", hand: str = "right"
) -> Body:
    """A tube along a helix about the z axis: a spring.

    Its middle is at height 0 above +x. Exact, as long as neighbouring turns do not meet and the
    tube is not thicker than the helix is curved; otherwise a bound inside.

    Args:
        radius: of the helix.
        tube: radius of the tube, less than `radius`.
        pitch: height of one turn.
        turns: how many, whole or not.
        ends: "round" (half balls) or "flat" (cut square to the helix).
        hand: "right" or "left".
    """
    r = arguments.positive("radius", radius)
    thin = arguments.between("tube", tube, 0, r)
    rise = arguments.positive("pitch", pitch) / TURN
    last = arguments.positive("turns", turns) * math.pi
    flat = arguments.choice("ends", ends, ("round", "flat")) == "flat"
    side = _side(hand)
    curve = _Helix(r, rise, last, side)
    distance = curve.tube_with_flat_ends(thin) if flat else curve.distance() - thin
    low, high = curve.extent(thin, flat)
    return bounding_body(distance, low, high, exact=thin <= curve.reach())


def _box(low: Matrix, high: Matrix, step: float, curvature: float) -> tuple[Matrix, Matrix]:
    """The box around boxes `(n, d)` that follow a curve in steps of its parameter.

    Between two steps the sides can be farther out by a second derivative times step^2 / 8.
    """
    slack = curvature * step**2 / 8
    return low.min(axis=0) - slack, high.max(axis=0) + slack


class _Helix:
    """The curve (r cos t, r sin t, rise t) for |t| <= last, and tubes around it.

    With the point's own angle and the turn nearest to it subtracted, t = center + phi, half the
    squared distance is, up to a constant, r rho (1 - cos phi) + rise^2 (phi - m)^2 / 2. Mirrored
    so that m >= 0, its derivative vanishes where phi + a sin phi = m, a = r rho / rise^2:
    Kepler's equation. The left side is concave on [0, pi], so there is one crossing from below,
    and Newton's iteration from the left of it is monotone. For m <= pi the nearest point of the
    whole helix is there. Past an end of the curve m is larger: then the crossing is the only
    local minimum besides the end itself, or there is none.
    """

    def __init__(self, r: float, rise: float, last: float, side: float) -> None:
        self.r, self.rise, self.last = r, rise, last
        self.y = Y if side > 0 else -Y
        self.parameter, self.residual = self._nearest()

    def _nearest(self) -> tuple[Expression, Expression]:
        """Where the local minimum is, perhaps beyond the ends, and what is left of m there."""
        angle = atan2(self.y, X)
        wanted = Z / self.rise
        a = length(X, self.y) * (self.r / self.rise**2)
        # The turn nearest in height, if its middle is on the curve; or just past an end from
        # which the distance decreases inwards, so that the minimum is before the end.
        turn = floor((wanted - angle) / TURN + 0.5)
        for sign in (1.0, -1.0):
            ahead = sign * wanted - self.last
            slope = ahead - a * sin(self.last - sign * angle)
            limit = floor((self.last - sign * angle) / TURN)
            limit = limit + where_negative(maximum(ahead, slope), 1.0, 0.0)
            turn = sign * minimum(sign * turn, limit)
        center = angle + TURN * turn
        m = wanted - center
        size = abs(m)
        # Not beyond the crossing, since sin phi is at most phi and at most pi - phi.
        phi = maximum(size / (1.0 + a), (size - math.pi * a) / maximum(1.0 - a, STEEP))
        phi = minimum(phi, math.pi)
        for _ in range(NEWTON_STEPS):
            step = (size - phi - a * sin(phi)) / maximum(1.0 + a * cos(phi), STEEP)
            phi = clamp(phi + step, 0.0, math.pi)
        return center + where_negative(m, -phi, phi), size - phi - a * sin(phi)

    def distance(self) -> Expression:
        """To the nearest of the local minimum, moved into the curve, and both ends."""
        within = clamp(self.parameter, -self.last, self.last)
        offsets = (X - self.r * cos(within), self.y - self.r * sin(within), Z - self.rise * within)
        ends = (length(*self._from_end(sign)) for sign in (1.0, -1.0))
        return minimum(length(*offsets), *ends)

    def tube_with_flat_ends(self, thin: float) -> Expression:
        """The distance to the discs of radius `thin` square to the curve, taken together.

        Outside it is the least to the tube's side, where the foot is on the curve, and to both
        end discs; inside, to what bounds it, the same three.
        """
        t = self.parameter
        side = length(X - self.r * cos(t), self.y - self.r * sin(t), Z - self.rise * t) - thin
        flush = STEEP * thin
        to_disc, within = [], []
        for sign in (1.0, -1.0):
            ahead, outward, sideways = self._from_end(sign)
            beside = length(outward, sideways) - thin
            rim = length(ahead, beside)
            # Next to a disc the height above it keeps its sign, whichever side rounding puts
            # the point on.
            outside = where_negative(ahead + flush, -ahead, ahead)
            inside = where_negative(ahead - flush, ahead, -ahead)
            to_disc.append(where_negative(beside, outside, rim))
            within.append(where_negative(beside, inside, -rim))
        has_foot = maximum(abs(t) - self.last, self.residual - UNSETTLED)
        at_foot = where_negative(side, maximum(side, *within), minimum(side, *to_disc))
        return where_negative(has_foot, at_foot, minimum(*to_disc))

    def _from_end(self, sign: float) -> Coordinates:
        """The offset from one end: along the curve outwards, from the axis, and square to both."""
        sine, cosine = math.sin(self.last), math.cos(self.last)
        slope = math.hypot(self.r, self.rise)
        # The helix looks the same from both ends.
        y, z = (self.y, Z) if sign > 0 else (-self.y, -Z)
        around = cosine * y - sine * X
        up = z - self.rise * self.last
        return (
            (self.r * around + self.rise * up) / slope,
            cosine * X + sine * y - self.r,
            (self.r * up - self.rise * around) / slope,
        )

    def extent(self, thin: float, flat: bool) -> tuple[Matrix, Matrix]:
        """The box around the discs square to the curve, or around the balls on it.

        From above the curve is an arc, or a circle; its ends are the highest and lowest.
        """
        half = min(self.last, math.pi)
        t, step = np.linspace(-half, half, STEPS, retstep=True)
        x, y = self.r * np.cos(t), self.r * np.sin(t)
        slope = math.hypot(self.r, self.rise)
        reach = np.full((STEPS, 2), thin)
        if flat:
            reach = thin * disc_reach(np.stack([y, x], axis=1) / slope)
        middle = np.stack([x, y], axis=1)
        low, high = _box(middle - reach, middle + reach, float(step), self.r + thin)
        # It looks the same from both ends, so that the sides in y are equal; of either hand.
        top = self.rise * self.last + thin * (self.r / slope if flat else 1.0)
        rim = self.r + thin
        return (
            np.array([max(low[0], -rim), max(low[1], -rim), -top]),
            np.array([min(high[0], rim), min(high[1], rim), top]),
        )

    def reach(self) -> float:
        """A radius up to which a tube has one nearest point of the curve everywhere.

        The least radius of curvature, and half the way to a turn that passes by. The latter is
        looked up in a table; its error is of second order, below one part in 10^4.
        """
        curved = (self.r**2 + self.rise**2) / self.r
        if 2 * self.last <= math.pi:
            return curved
        apart = np.linspace(math.pi, min(2 * self.last, 3 * math.pi), 1000)
        chord = np.hypot(2 * self.r * np.sin(apart / 2), self.rise * apart)
        return min(curved, (1 - 1e-4) * float(chord.min()) / 2)


@primitive
def thread(
    diameter: float, pitch: float, height: float, starts: int = 1, hand: str = "right"
) -> Body:
    """An external screw thread about the z axis, with the basic 60 degree profile of ISO 68-1.

    Crests are pitch / 8 wide and roots pitch / 4, and 5/8 of the sharp triangle's height apart;
    the ends are flat. The field is no distance: it bounds one within each half-plane through the
    axis. From one half-plane to the next a flank's field changes by cos(30) lead / (2 pi rho) a
    unit of length, at a distance rho from the axis. To keep that finite, no ridge's field is less
    than -margin, below which the core's is; so flanks only count where rho is at least the root's
    radius less the margin, which gives the Lipschitz constant.

    Args:
        diameter: over the crests, the nominal size (M8: 8).
        pitch: from one crest to the next (M8: 1.25), so small that a core is left.
        height: full length along z, centred at the origin.
        starts: ridges side by side; one turn advances by pitch * starts.
        hand: "right" or "left".
    """
    crest = arguments.positive("diameter", diameter) / 2
    step = arguments.positive("pitch", pitch)
    half = arguments.positive("height", height) / 2
    count = arguments.whole("starts", starts, 1)
    side = _side(hand)
    root = crest - 0.625 * math.sqrt(0.75) * step
    if root <= 0:
        raise InputError(
            "pitch", pitch, f"the thread is deeper than diameter / 2 = {crest:g}", "pass less"
        )
    across = length(X, Y)
    advance = side * count * step / TURN
    from_crest = abs(modulo(Z - advance * atan2(Y, X) + step / 2, step) - step / 2)
    flank = math.sqrt(0.75) * (from_crest - step / 16) + 0.5 * (across - crest)
    margin = min(root, step) / 2
    ridge = maximum(across - crest, flank, -margin)
    screw = minimum(across - root, ridge)
    twist = math.sqrt(0.75) * abs(advance) / (root - margin)
    return bounding_body(
        maximum(screw, abs(Z) - half),
        (-crest, -crest, -half),
        (crest, crest, half),
        lipschitz=math.hypot(1.0, twist),
    )


@primitive
def torus_knot(p: int, q: int, major: float, minor: float, tube: float) -> Body:
    """A tube along a knot that runs p times around the z axis and q times around a ring's tube.

    The field is no distance: it is the least one, in the half-plane through the axis and the
    point, to the p places where the knot crosses it. Sections by these half-planes are discs,
    so that where the knot is steep the tube is thinner when measured across itself. For a tube
    of one thickness, pass points of the knot to `polyline`.

    Turning the half-plane moves the crossings by q/p minor a radian, which is too fast near
    the axis. Up to the radius `clear` of the hole the field is therefore mixed, in proportion to
    the radius, with the distance to the ring that the knot is wound on; both are positive there.
    They differ by at most 2 minor and are no steeper than 1 in the half-plane, so the gradient is
    at most hypot(1 + 2 minor / clear, q minor / (p clear)).

    Args:
        p: times around the z axis, 1 or more.
        q: times around the ring's middle line, 1 or more; without common divisor with p.
        major: radius of the ring's middle line.
        minor: radius of the ring on which the knot lies.
        tube: radius of the tube; minor + tube must be less than `major`.
    """
    around, through = arguments.whole("p", p, 1), arguments.whole("q", q, 1)
    if math.gcd(around, through) != 1:
        raise InputError(
            "q", q, f"it has a divisor in common with p = {around}", "pass coprime numbers"
        )
    ring = arguments.positive("major", major)
    wound = arguments.positive("minor", minor)
    thin = arguments.positive("tube", tube)
    clear = ring - wound - thin
    if clear <= 0:
        raise InputError(
            "tube", tube, f"the hole of major = {ring:g} closes", "pass minor + tube < major"
        )
    across = length(X, Y)
    turned = atan2(Y, X) * (through / around)
    crossings = []
    for index in range(around):
        angle = turned + TURN * index * through / around
        crossings.append(
            square(across - ring - wound * cos(angle)) + square(Z - wound * sin(angle))
        )
    knot = sqrt(minimum(*crossings))
    hull = length(across - ring, Z) - wound
    blend = minimum(across / clear, 1.0)
    turn, step = np.linspace(0, TURN * around, STEPS * around, retstep=True)
    winding = turn * through / around
    far = ring + wound * np.cos(winding) + thin
    x, y, z = far * np.cos(turn), far * np.sin(turn), wound * np.sin(winding)
    curvature = (ring + wound + thin) * (1 + through / around) ** 2
    low, high = _box(
        np.stack([x, y, z - thin], axis=1),
        np.stack([x, y, z + thin], axis=1),
        float(step),
        curvature,
    )
    return bounding_body(
        hull + blend * (knot - hull) - thin,
        low,
        high,
        lipschitz=math.hypot(1 + 2 * wound / clear, through * wound / (around * clear)),
    )
