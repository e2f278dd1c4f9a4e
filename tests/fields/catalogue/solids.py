"""Solids made of profiles."""

from __future__ import annotations

import fields as sdf
from fields import Field
from tests.fields.catalogue.profiles import FLOWER, L_SHAPE
from tests.fields.catalogue.surface import Surface

_PLUS = sdf.rectangle((1.6, 0.4)) | sdf.rectangle((0.4, 1.6))
_WEDGE = sdf.polygon([(0.5, -0.6), (1.2, -0.3), (0.7, 0.6)])
_PATH = [(-1, -1, -0.8), (-1, 0.6, -0.5), (0.6, 0.8, 0.1), (0.8, -0.6, 0.9)]

EXAMPLES: dict[str, Field] = {
    "extrude": sdf.polygon(L_SHAPE).extrude(1.2),
    "extrude, searched": sdf.polygon(FLOWER).extrude(1.2),
    "extrude, inexact": _PLUS.extrude(1.2),
    "extrude, endless": sdf.strip(0.7).extrude(1.2),
    "twist_extrude": sdf.rectangle((1.8, 0.5)).twist_extrude(2.0, 200),
    "twist_extrude, inexact": _PLUS.twist_extrude(2.0, 90, top=0.6),
    "taper_extrude": sdf.star(5, 1.2, 0.6).taper_extrude(1.6, 0.3),
    "taper_extrude, inexact": _PLUS.taper_extrude(1.6, 1.5),
    "extrude_to": sdf.rectangle(1.6).extrude_to(sdf.circle(0.5), 1.8),
    "extrude_to, inexact": _PLUS.extrude_to(sdf.circle(0.5), 1.8, ease="smooth"),
    "loft": sdf.circle(0.4).loft(sdf.hexagon(1.8), sdf.circle(0.7), heights=(-1, 0, 1.2)),
    "slice": sdf.box((1.0, 0.6, 0.4)).rotate(35, (1, 2, 3)).slice(0.1),
    "revolve": _WEDGE.revolve(),
    "revolve, shifted": sdf.circle(0.3).revolve(offset=0.8),
    "revolve, mirrored": sdf.rectangle((1.6, 1.1)).revolve(),
    "revolve, across the axis": sdf.polygon(L_SHAPE).revolve(),
    "revolve, on the axis": sdf.polygon([(0, -0.8), (0.9, -0.5), (0, 0.8)]).revolve(),
    "revolve, part": _WEDGE.revolve(degrees=130),
    "revolve, most": _WEDGE.revolve(degrees=280),
    "revolve, part across the axis": sdf.polygon(L_SHAPE).revolve(degrees=100),
    "coil": sdf.rectangle((0.4, 0.2)).coil(0.9, 0.5, 3),
    "coil, left-handed": sdf.circle(0.2, (0.1, 0.05)).coil(0.8, -0.7, 2.5),
    "coil, overlapping": _PLUS.scale(0.4).coil(0.9, 0.4, 3),
    "sweep": sdf.rectangle((0.5, 0.3)).sweep(_PATH),
    "sweep, one segment": sdf.triangle(0.8, 0.6).sweep(_PATH[:2]),
    "sweep, one joint": sdf.star(5, 0.4, 0.2).sweep(_PATH[:3]),
}

SURFACES: dict[str, Surface] = {}
