"""Operations along the curve where two surfaces meet; see `fields.operations` and `fields.joints`.

The names and shapes are those of Mercury's hg_sdf (https://mercury.sexy/hg_sdf/). Where planes
meet at right angles the cross sections are what the names say; elsewhere they are sheared.
"""

from __future__ import annotations

from fields import arguments
from fields.expression import length, maximum, minimum
from fields.operations import Body, rule
from fields.tags import Tags, deepened, hull, largest, overlap


@rule
def pipe(a: Body, b: Body, radius: float) -> Body:
    """sqrt(a^2 + b^2) - radius.

    Lipschitz: the gradient is u grad a + v grad b with u^2 + v^2 = 1, at most the root of the sum
    of both squares (sharp where the gradients are parallel; 1 for distances at right angles).
    Extent: {.. <= t} is where |a| and |b| are at most radius + t.
    """
    r = arguments.positive("radius", radius)
    both = _level_box(a, b, r, r)
    known = a.tags.lipschitz is not None and b.tags.lipschitz is not None
    steepest = (a.tags.lipschitz**2 + b.tags.lipschitz**2) ** 0.5 if known else None
    return Body(length(a.expression, b.expression) - r, Tags(False, steepest, *both))


@rule
def engrave(a: Body, b: Body, depth: float) -> Body:
    """max(a, (a + depth - |b|) / 2): a V of that depth where the surface of b meets that of a.

    Lipschitz: a, or a mean of a and a field as steep as b. Extent: the value is at least a.
    (hg_sdf divides by sqrt(2), which makes it too steep where the gradients are parallel.)
    """
    v = (a.expression + arguments.positive("depth", depth) - abs(b.expression)) * 0.5
    return _carved(a, b, maximum(a.expression, v))


@rule
def groove(a: Body, b: Body, depth: float, width: float) -> Body:
    """max(a, min(a + depth, width / 2 - |b|)): a channel along the curve where the surfaces meet.

    Lipschitz: every piece is as steep as a or b. Extent: the value is at least a.
    """
    channel = minimum(
        a.expression + arguments.positive("depth", depth),
        arguments.positive("width", width) / 2 - abs(b.expression),
    )
    return _carved(a, b, maximum(a.expression, channel))


@rule
def tongue(a: Body, b: Body, height: float, width: float) -> Body:
    """min(a, max(a - height, |b| - width / 2)): a ridge along the curve where the surfaces meet.

    Lipschitz: every piece is as steep as a or b. Extent: the union of A and of where
    a <= height + t and |b| <= width / 2 + t.
    """
    rise, half = arguments.positive("height", height), arguments.positive("width", width) / 2
    ridge = maximum(a.expression - rise, abs(b.expression) - half)
    extent, growth = _level_box(a, b, rise, half)
    tags = Tags(
        exact=False,
        lipschitz=largest([a.tags.lipschitz, b.tags.lipschitz]),
        extent=hull(a.tags.extent, extent),
        growth=largest([a.tags.growth, growth]),
    )
    return Body(minimum(a.expression, ridge), tags)


def _carved(a: Body, b: Body, expression) -> Body:
    steepest = largest([a.tags.lipschitz, b.tags.lipschitz])
    return Body(expression, Tags(False, steepest, a.tags.extent, a.tags.growth))


def _level_box(a: Body, b: Body, level_a: float, level_b: float):
    """Extent and growth of the points where a and b are at most so much."""
    boxes = [deepened(body.tags, level).extent for body, level in ((a, level_a), (b, level_b))]
    return overlap(*boxes), largest([a.tags.growth, b.tags.growth])
