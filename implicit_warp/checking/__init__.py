"""Checks of triangle meshes: exact topology and self-intersections, and second opinions."""

from __future__ import annotations

from implicit_warp.checking.exact import IntersectionKind
from implicit_warp.checking.nesting import Nesting
from implicit_warp.checking.referees import REFEREES, Verdict
from implicit_warp.checking.report import BadMesh, CheckReport, check
from implicit_warp.checking.self_intersection import SelfIntersections, self_intersections
from implicit_warp.checking.topology import Topology, analyse

__all__ = [
    "REFEREES",
    "BadMesh",
    "CheckReport",
    "IntersectionKind",
    "Nesting",
    "SelfIntersections",
    "Topology",
    "Verdict",
    "analyse",
    "check",
    "self_intersections",
]
