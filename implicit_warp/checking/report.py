"""`check`: everything that can be said of a mesh, in one report that can be gated on."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking.mesh_arrays import mesh_arrays
from implicit_warp.checking.nesting import Nesting, nesting
from implicit_warp.checking.referees import REFEREES, Verdict, ask
from implicit_warp.checking.self_intersection import (
    DEFAULT_LIMIT,
    SelfIntersections,
    self_intersections,
)
from implicit_warp.checking.topology import OFFENDERS, SLIVER_RATIO, Topology, analyse
from implicit_warp.errors import InputError

if TYPE_CHECKING:
    import trimesh

_SHOWN = 5  # offenders named in a sentence
_LISTED = 20  # offenders listed in JSON


class BadMesh(Exception):  # noqa: N818 - reads well where it is raised and caught
    """A mesh failed its check. The message lists the problems; `report` has the rest."""

    def __init__(self, report: CheckReport, problems: Sequence[str]) -> None:
        self.report = report
        self.problems = tuple(problems)
        what = report.source or "mesh"
        super().__init__(f"{what} failed its check: " + "; ".join(self.problems) + ".")


def check(
    mesh: trimesh.Trimesh | str | os.PathLike[str],
    *,
    referees: Iterable[str] = ("manifold3d",),
    limit: int = DEFAULT_LIMIT,
    merge_vertices: bool = False,
) -> CheckReport:
    """Check a triangle mesh: topology, nesting, degeneracies, volume, self-intersections.

    The arrays are checked as they are: nothing is merged or repaired first. The exceptions are
    files whose format cannot say which corners are one vertex: in STL, GLB and glTF files,
    vertices with equal coordinates are one.

    Args:
        mesh: a mesh with `vertices` (V, 3) and `faces` (F, 3), such as `trimesh.Trimesh`, or
            the path of a mesh file.
        referees: libraries to ask for a second opinion: any of "manifold3d", "trimesh",
            "open3d" (slow above 10^5 faces) and "pymeshlab" (GPL). What each is trusted with
            is in `implicit_warp.checking.referees`. One that is missing is noted in the
            report, and is no error.
        limit: the search for self-intersections stops at about this many pairs; the report
            then says so.
        merge_vertices: make vertices with exactly equal coordinates one before the check, for a
            mesh whose seams are split by its normals or texture coordinates. A note in the
            report says when this would close an open mesh. Vertices are then numbered anew, in
            order of first appearance; faces keep their numbers.

    Returns:
        The report. It guarantees, for the float64 coordinates checked, exact answers on
        connectivity, equal vertices, zero area, self-intersection, the sign of each component's
        volume and its nesting. Area, volume and height ratios are rounded. It
        does not speak of the coordinates once they are rounded again, as by saving to STL: check
        the file.

    Raises:
        InputError: not a mesh, no such file, arrays of the wrong shape, an index out of
            range, or an unknown referee. A bad mesh is no error: see `raise_if_bad`.
        FileFormatError: the file is damaged, or holds no triangles.
    """
    names = (referees,) if isinstance(referees, str) else tuple(referees)
    for name in names:
        if name not in REFEREES:
            raise InputError("referees", name, "no such referee", f"Choose from {list(REFEREES)}")
    vertices, faces = mesh_arrays(mesh, merge_vertices=merge_vertices)
    topology = analyse(vertices, faces)
    intersections = self_intersections(vertices, faces, limit=limit)
    return CheckReport(
        topology=topology,
        self_intersections=intersections,
        nesting=nesting(vertices, faces, topology, intersections),
        referees=tuple(ask(name, vertices, faces) for name in names),
        vertices=vertices,
        faces=faces,
        source=os.fspath(mesh) if isinstance(mesh, str | os.PathLike) else None,
    )


@dataclass(frozen=True, eq=False)
class CheckReport:
    """What `check` found.

    Attributes:
        topology: connectivity, degeneracies, volume and area.
        self_intersections: the intersecting pairs of faces.
        nesting: which components lie inside which others.
        vertices: `(V, 3)` what was checked: no copy, where the caller's array was float64.
        faces: `(F, 3)` likewise, of int64.
        referees: opinions of other libraries.
        source: the file checked, if it was one.
    """

    topology: Topology
    self_intersections: SelfIntersections
    nesting: Nesting
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    referees: tuple[Verdict, ...] = ()
    source: str | None = None

    @property
    def ok(self) -> bool:
        """Whether there are no problems: a watertight, manifold, outward, clean mesh."""
        return not self.problems

    @property
    def watertight(self) -> bool:
        """Every directed edge occurs exactly once, and so does its reverse."""
        return self.topology.watertight

    @property
    def volume(self) -> float | None:
        """Signed volume in cubed units of the vertices; None if not watertight."""
        return self.topology.volume

    @property
    def area(self) -> float:
        """Area in squared units of the vertices."""
        return self.topology.area

    @property
    def num_self_intersections(self) -> int:
        """Number of pairs of faces that intersect."""
        return len(self.self_intersections)

    def counts(self) -> dict[str, int]:
        """Number of defects of each kind, by a name that stays the same from release to release.

        Every name is always there, zero where nothing was found. "self_intersections" counts
        pairs of faces, and "self_intersections.<kind>" those of each `IntersectionKind`. Notes
        (slivers, vertices that are unreferenced or duplicated) are counted too.
        """
        return {
            "self_intersections": self.num_self_intersections,
            **{
                f"self_intersections.{kind}": count
                for kind, count in self.self_intersections.count_by_kind().items()
            },
            **{name: len(offenders) for name, offenders in self._offenders().items()},
        }

    @property
    def problems(self) -> list[str]:
        """What is wrong, a sentence each, with counts and the first offending indices."""
        return self._problems(max_self_intersections=0)

    @property
    def notes(self) -> list[str]:
        """What is worth knowing but makes no mesh bad."""
        t = self.topology
        notes = _sentences(
            ("{} vertices belong to no face (vertices {})", t.unreferenced_vertices),
            (
                "{} vertices have the coordinates of an earlier one (vertices {})",
                t.duplicate_vertices,
            ),
            (f"{{}} faces are slivers, thinner than {SLIVER_RATIO:g} (faces {{}})", t.sliver_faces),
        )
        if t.watertight_if_merged:
            notes.append(
                "vertices with equal coordinates are separate: merged, they would make the mesh "
                "watertight; check it with merge_vertices=True"
            )
        notes += [f"{v.referee}: {v.detail}" for v in self.referees if v.passed is None]
        return notes

    def raise_if_bad(self, max_self_intersections: int = 0) -> CheckReport:
        """Raise `BadMesh` if there are problems, else return the report itself.

        Args:
            max_self_intersections: this many intersecting pairs are tolerated, with duplicate
                faces counted as problems of their own.

        Raises:
            BadMesh: with the problems and this report.
        """
        problems = self._problems(max_self_intersections)
        if problems:
            raise BadMesh(self, problems)
        return self

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON: offenders as a count and the first few, NaN as None."""
        t, s = self.topology, self.self_intersections
        offenders = {name: _listed(found) for name, found in self._offenders().items()}
        return {
            "source": self.source,
            "ok": self.ok,
            "problems": self.problems,
            "notes": self.notes,
            "vertices": t.num_vertices,
            "faces": t.num_faces,
            "watertight": t.watertight,
            "edge_manifold": t.edge_manifold,
            "vertex_manifold": t.vertex_manifold,
            "oriented": t.oriented,
            "components": t.num_components,
            "genus": list(t.genus[:_LISTED]),
            "volume": _number(t.volume),
            "component_depths": self.nesting.depth[:_LISTED].tolist(),
            "component_volumes": [_number(v) for v in t.component_volumes[:_LISTED].tolist()],
            "area": _number(t.area),
            "smallest_height_ratio": _number(t.smallest_height_ratio),
            **offenders,
            "self_intersections": {
                **_listed(s.pairs),
                "kinds": s.count_by_kind(),
                "complete": s.complete,
                "judged": s.judged,
                "decided_exactly": s.decided_exactly,
            },
            "referees": [_finite(asdict(v)) for v in self.referees],
        }

    def write_coloured_mesh(self, path: str | os.PathLike[str]) -> None:
        """Write the mesh as a PLY file whose faces have the colours of their defects.

        Besides its colour, each face has a `defect`, which the file's comments explain. A face
        beside a bad edge or at a bad vertex has its colour, unless it has a worse defect of its
        own. Coordinates are float64, and faces and vertices keep their numbers.

        Raises:
            InputError: a name without `.ply`, or a folder that does not exist.
        """
        from implicit_warp.checking.evidence import evidence, write_ply

        write_ply(Path(path), self.vertices, self.faces, evidence(self))

    def write_picture(self, path: str | os.PathLike[str]) -> None:
        """Write a PNG that shows where the defects are, each class in its colour, with a legend.

        The left half shows the whole mesh, the right half the largest cluster of offenders from
        the side that sees most of them. A line or dot that something hides is drawn thinner.
        Works without a display.

        Raises:
            InputError: a name without `.png`, a folder that does not exist, or no face with
                finite coordinates and an extent: there is nothing to show.
            MissingDependency: Open3D or Pillow cannot be imported.
        """
        from implicit_warp.checking.evidence import evidence
        from implicit_warp.checking.evidence_picture import write_picture

        write_picture(
            Path(path), self.vertices, self.faces, evidence(self), str(self).split("\n")[0]
        )

    def to_json(self, indent: int | None = 2) -> str:
        """`to_dict` as strict JSON (no NaN)."""
        return json.dumps(self.to_dict(), indent=indent, allow_nan=False)

    def __str__(self) -> str:
        t, s = self.topology, self.self_intersections
        genus = ", ".join("?" if g is None else str(g) for g in t.genus[:_SHOWN])
        more = ", ..." if t.num_components > _SHOWN else ""
        volume = "none (not watertight)" if t.volume is None else f"{t.volume:.6g}"
        kinds = ", ".join(f"{n} {kind}" for kind, n in s.count_by_kind().items() if n)
        rows = [
            ("mesh", f"{t.num_vertices} vertices, {t.num_faces} faces"),
            ("watertight", _yes(t.watertight)),
            ("manifold", f"edges {_yes(t.edge_manifold)}, vertices {_yes(t.vertex_manifold)}"),
            ("oriented", _yes(t.oriented)),
            ("components", f"{t.num_components} (genus {genus}{more})" if t.genus else "0"),
            ("volume", volume),
            ("area", f"{t.area:.6g}"),
            ("self-intersections", f"{len(s)} pairs" + (f" ({kinds})" if kinds else "")),
        ]
        rows += [(v.referee, v.detail) for v in self.referees]
        width = max(len(name) for name, _ in rows)
        lines = [f"{self.source or 'mesh'}: {'ok' if self.ok else 'BAD'}"]
        lines += [f"  {name:<{width}}  {text}" for name, text in rows]
        lines += [f"  problem: {text}" for text in self.problems]
        lines += [f"  note: {text}" for text in self.notes]
        return "\n".join(lines)

    def _offenders(self) -> dict[str, NDArray[np.int64]]:
        return {
            **{name: getattr(self.topology, name) for name in OFFENDERS},
            "inside_out_components": self.nesting.inside_out_components,
            "misnested_components": self.nesting.misnested_components,
        }

    def _problems(self, max_self_intersections: int) -> list[str]:
        t, s = self.topology, self.self_intersections
        if not t.num_faces:
            return ["the mesh has no faces"]
        problems = _sentences(
            (
                "{} vertices have coordinates that are not finite (vertices {})",
                t.nonfinite_vertices,
            ),
            ("{} edges are open: they have one face (vertices {})", t.open_edges),
            ("{} edges have three or more faces (vertices {})", t.nonmanifold_edges),
            ("{} edges join faces of opposite orientation (vertices {})", t.misoriented_edges),
            (
                "{} vertices are pinched: fans of faces touch there (vertices {})",
                t.pinched_vertices,
            ),
            ("{} faces use a vertex twice (faces {})", t.repeated_vertex_faces),
            ("{} faces have exactly zero area (faces {})", t.zero_area_faces),
            ("{} faces repeat an earlier face (faces {})", t.duplicate_faces),
        )
        problems += _sentences(
            (
                "{} components are inside out: their faces look inwards (components {})",
                self.nesting.inside_out_components,
            ),
            (
                "{} components are nested wrongly: solids inside a solid, or cavities whose faces "
                "look outwards (components {})",
                self.nesting.misnested_components,
            ),
        )
        if t.watertight and not _encloses(t):
            problems.append(
                f"the volume, {t.volume:.6g}, is not positive: the faces are inside out or enclose "
                "nothing"
            )
        if len(s) > max_self_intersections:
            problems += _sentences(("{} pairs of faces intersect (faces {})", s.pairs))
        if not s.complete:
            problems.append("the search for self-intersections stopped at its limit")
        problems += [f"{v.referee}: {v.detail}" for v in self.referees if v.passed is False]
        return problems


def _encloses(t: Topology) -> bool:
    """Whether a watertight mesh has positive volume, even one too small for float64."""
    volume = t.volume
    if volume is None or math.isnan(volume):
        return True  # reported as non-finite vertices
    return t.unit_volume > 0


def _sentences(*templates: tuple[str, NDArray[np.int64]]) -> list[str]:
    """Fill each template that has offenders with their count and the first few of them."""
    return [
        template.format(len(offenders), _named(offenders))
        for template, offenders in templates
        if len(offenders)
    ]


def _named(offenders: NDArray[np.int64]) -> str:
    items = ["-".join(map(str, np.atleast_1d(o).tolist())) for o in offenders[:_SHOWN]]
    return ", ".join(items) + (", ..." if len(offenders) > _SHOWN else "")


def _listed(offenders: NDArray[np.int64]) -> dict[str, Any]:
    return {"count": len(offenders), "first": offenders[:_LISTED].tolist()}


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _finite(value: Any) -> Any:
    """The same nested value with every float that JSON cannot hold replaced by None."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return _number(value) if isinstance(value, float) else value


def _yes(flag: bool) -> str:
    return "yes" if flag else "NO"
