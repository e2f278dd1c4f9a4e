"""Measure what mesh tools say about planted defects: the table and the picture of checking.md.

python docs/measure_checking.py                  # the picture, and 25 placements of each kind
python docs/measure_checking.py --placements 100

Each tool is asked in a process of its own, because some abort on bad input. The libraries of the
`test` extra are needed: pymeshlab and cgal (both GPL-3) besides the others.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))

from implicit_warp.checking import check  # noqa: E402 - the tree of this file, not another one
from tests.implicit_warp import planted_defects  # noqa: E402

BEGIN, END = "<!-- begin: measured -->", "<!-- end: measured -->"
CLEAN = "clean mesh"

# A defect of the first group makes a mesh unfit for a solid; the second group is worth a note.
NOTED = ("sliver", "unreferenced_vertex")
KINDS = [*(k for k in planted_defects.KINDS if k not in NOTED), *NOTED]

Complaints = list[str]


def ours(vertices, faces) -> Complaints:
    """The counts that are not zero."""
    counts = check(SimpleNamespace(vertices=vertices, faces=faces), referees=()).counts()
    return [name for name, n in counts.items() if n and name != "self_intersections"]


def open3d(vertices, faces) -> Complaints:
    """Its predicates, and its search for self-intersections."""
    import open3d as library

    mesh = library.geometry.TriangleMesh(
        library.utility.Vector3dVector(vertices),
        library.utility.Vector3iVector(faces.astype(np.int32)),
    )
    return _named(
        {
            "not edge-manifold": not mesh.is_edge_manifold(allow_boundary_edges=False),
            "not vertex-manifold": not mesh.is_vertex_manifold(),
            "self-intersecting": mesh.is_self_intersecting(),
            "not orientable": not mesh.is_orientable(),
        }
    )


def pymeshlab(vertices, faces) -> Complaints:
    """Its topological measures, signed volume, and search for self-intersections."""
    import pymeshlab as library

    meshes = library.MeshSet(verbose=False)
    meshes.add_mesh(library.Mesh(vertices, faces.astype(np.int32)))
    mesh = meshes.current_mesh()
    complaints = {
        "dropped on reading": (mesh.face_number(), mesh.vertex_number())
        != (len(faces), len(vertices))
    }
    facts = meshes.get_topological_measures()
    complaints |= {
        "open": facts["boundary_edges"] > 0,
        "not two-manifold": not facts["is_mesh_two_manifold"],
        "unreferenced": facts["unreferenced_vertices"] > 0,
    }
    # The volume is signed, the filter gives none for an open mesh.
    complaints["negative volume"] = meshes.get_geometric_measures().get("mesh_volume", 1.0) < 0
    meshes.compute_selection_by_self_intersections_per_face()
    complaints["self-intersecting"] = bool(meshes.current_mesh().face_selection_array().any())
    return _named(complaints)


def manifold3d(vertices, faces) -> Complaints:
    """Its status, whether it kept everything, the volume, and whether M - M is empty."""
    import manifold3d as library

    solid = library.Manifold(
        library.Mesh64(vert_properties=vertices, tri_verts=faces.astype(np.uint64))
    )
    status = solid.status().name
    if status != "NoError":
        return [status]
    kept = (solid.num_tri(), solid.num_vert()) == (len(faces), len(vertices))
    return _named(
        {
            "repaired in silence": not kept,
            "negative volume": solid.volume() < 0,
            "M - M not empty": solid.volume() >= 0 and not (solid - solid).is_empty(),
        }
    )


def trimesh(vertices, faces) -> Complaints:
    """Its properties."""
    import trimesh as library

    mesh = library.Trimesh(vertices, faces, process=False)
    return _named(
        {
            "not watertight": not mesh.is_watertight,
            "winding not consistent": not mesh.is_winding_consistent,
            "not a volume": not mesh.is_volume,
        }
    )


def cgal(vertices, faces) -> Complaints:
    """Its half-edge structure, search for self-intersections, and orientation."""
    from CGAL.CGAL_Polygon_mesh_processing import is_outward_oriented

    from tests.implicit_warp.cgal_referee import does_self_intersect, polyhedron

    mesh = polyhedron(vertices, faces)
    complaints = {
        "dropped or split on reading": (mesh.size_of_facets(), mesh.size_of_vertices())
        != (len(faces), len(vertices)),
        "open": not mesh.is_closed(),
        "self-intersecting": does_self_intersect(mesh),
    }
    if mesh.is_closed():
        complaints["inside out"] = not is_outward_oriented(mesh)
    return _named(complaints)


TOOLS: dict[str, Callable[[np.ndarray, np.ndarray], Complaints]] = {
    "ours": ours,
    "open3d": open3d,
    "pymeshlab": pymeshlab,
    "manifold3d": manifold3d,
    "trimesh": trimesh,
    "cgal": cgal,
}


# What a complaint is about.
ABOUT = {
    "open": "closed",
    "not edge-manifold": "closed",
    "not two-manifold": "closed",
    "not watertight": "closed",
    "NotManifold": "closed",
    "not a volume": "solid",
    "not vertex-manifold": "pinched",
    "not orientable": "winding",
    "winding not consistent": "winding",
    "self-intersecting": "meets",
    "M - M not empty": "overlaps",
    "negative volume": "sign",
    "inside out": "sign",
    "NonFiniteVertex": "finite",
    "unreferenced": "unused",
    "repaired in silence": "changed",
    "dropped on reading": "changed",
    "dropped or split on reading": "changed",
}

# What a complaint may be about to be true of a kind; else it is a false alarm. That a tool had to
# change the mesh is true of every defect.
TRUE_OF = {
    "hole": {"closed", "solid"},
    "flipped_face": {"winding", "closed", "solid"},
    "inside_out": {"sign", "solid"},
    "duplicated_face": {"closed", "winding", "meets", "solid"},
    "fin": {"closed", "winding", "solid"},
    "pinched_vertex": {"pinched", "closed"},
    "zero_area_face": {"meets"},
    "crossing": {"meets", "overlaps"},
    "coplanar_overlap": {"meets", "overlaps"},
    "touching_vertex": {"meets", "overlaps"},
    "fold": {"meets", "overlaps"},
    "nonfinite_vertex": {"finite", "solid"},
    "unmerged_seam": {"closed", "solid", "meets"},
    "wrong_nesting": {"sign", "overlaps"},
    "sliver": set(),
    "unreferenced_vertex": {"unused"},
}


def _named(complaints: dict[str, bool]) -> Complaints:
    return [name for name, complained in complaints.items() if complained]


def mesh_of(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A planted defect, or a clean mesh of the same sort."""
    if kind != CLEAN:
        defect = planted_defects.planted(kind, seed)
        return defect.vertices, defect.faces
    rng = np.random.default_rng(seed)
    return planted_defects.clean(list(planted_defects.BASES)[seed % 5], rng)


def ask(tool: str, kind: str, placements: int) -> list[Complaints | None]:
    """What a tool says of each placement; None where it raised, aborted or took a minute.

    A process runs until it dies; the next one goes on behind the mesh that killed it.
    """
    verdicts: list[Complaints | None] = []
    while len(verdicts) < placements:
        command = [
            sys.executable,
            __file__,
            "--ask",
            tool,
            kind,
            str(len(verdicts)),
            str(placements),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=600)
            lines = done.stdout.splitlines()
        except subprocess.TimeoutExpired as late:
            lines = (late.stdout or b"").decode().splitlines()
        answers = [json.loads(line[8:]) for line in lines if line.startswith("verdict ")]
        verdicts += answers
        if len(verdicts) < placements:
            verdicts.append(None)
    return verdicts


def answer(tool: str, kind: str, first: int, last: int) -> None:
    """The other side of `ask`."""
    for seed in range(first, last):
        try:
            complaints = TOOLS[tool](*mesh_of(kind, seed))
        except (RuntimeError, ValueError) as error:
            print(f"{tool} on {kind} {seed}: {error}", file=sys.stderr)  # noqa: T201
            complaints = None
        print("verdict " + json.dumps(complaints), flush=True)  # noqa: T201 - read by `ask`


def cell(tool: str, kind: str, verdicts: list[Complaints | None]) -> str:
    """Found, and where there are any, false alarms and failures, of one kind's placements."""
    found = false = 0
    for complaints in verdicts:
        true = [c for c in complaints or () if _is_true(tool, kind, c)]
        found += bool(true)
        false += len(true) < len(complaints or ())
    failed = sum(v is None for v in verdicts)
    parts = [str(found)] if kind != CLEAN else []
    parts += [f"{false} false"] if false else []
    parts += [f"{failed} failed"] if failed else []
    return ", ".join(parts) or "0 false"


def _is_true(tool: str, kind: str, complaint: str) -> bool:
    if kind == CLEAN:
        return False
    if tool != "ours":
        return ABOUT[complaint] in TRUE_OF[kind] | {"changed"}
    _, required, implied = planted_defects.KINDS[kind]
    return complaint in required | implied


def table(placements: int) -> str:
    """The measured table in Markdown, and below it what each tool's complaints were."""
    rows, reasons = [], []
    for kind in [CLEAN, *KINDS]:
        cells = []
        for tool in TOOLS:
            verdicts = ask(tool, kind, placements)
            cells.append(cell(tool, kind, verdicts))
            reasons.append((kind, tool, sorted({c for v in verdicts if v for c in v})))
        rows.append(f"| {kind.replace('_', ' ')} | " + " | ".join(cells) + " |")
    head = f"| of {placements} placements | " + " | ".join(TOOLS) + " |"
    lines = [head, "|---" * (len(TOOLS) + 1) + "|", *rows, ""]
    lines += ["What they complained of:", ""]
    for kind in [CLEAN, *KINDS]:
        said = [f"{t}: {', '.join(w)}" for k, t, w in reasons if k == kind and w and t != "ours"]
        lines.append(
            f"- *{kind.replace('_', ' ')}*: " + ("; ".join(said) or "nobody but ours") + "."
        )
    return "\n".join(lines)


def picture() -> None:
    """A part with three defects, and the checker's picture of them."""
    import trimesh as library

    ring = library.creation.torus(1.0, 0.35, major_sections=48, minor_sections=24)
    rod = library.creation.cylinder(0.16, 1.6, sections=24).subdivide()
    rod.apply_transform(library.transformations.rotation_matrix(1.2, [1, 0.3, 0]))
    rod.apply_translation([0.2, -0.95, 0.15])
    both = library.util.concatenate([ring, rod])
    faces = np.delete(both.faces, [1160, 1161, 1162, 1208, 1209], axis=0)
    faces[520] = faces[520, ::-1]
    report = check(SimpleNamespace(vertices=both.vertices, faces=faces), referees=())
    report.write_picture(ROOT / "docs/pictures/checking.png")


def main() -> None:
    """Make the picture, measure, and put the table into checking.md."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--placements", type=int, default=25)
    parser.add_argument("--ask", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.ask:
        tool, kind, first, last = options.ask
        answer(tool, kind, int(first), int(last))
        return
    picture()
    measured = table(options.placements)
    page = ROOT / "docs/checking.md"
    before, _, rest = page.read_text().partition(BEGIN)
    _, _, after = rest.partition(END)
    page.write_text(f"{before}{BEGIN}\n{measured}\n{END}{after}")


if __name__ == "__main__":
    main()
