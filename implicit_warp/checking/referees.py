"""Second opinions: what other mesh libraries say, each asked for what it can be trusted with.

==========  =========================================  =====================================
referee     trusted for                                not trusted for
==========  =========================================  =====================================
manifold3d  edge pairing and orientation, as long as   self-intersections: it builds happily
            it kept every face and vertex; it repairs  from shapes that pass through
            defects silently otherwise                 themselves
trimesh     closed, consistent winding, volume         pinched vertices: it passes them
open3d      pairs of faces without a common vertex     pairs that share a vertex, which it
            that cross                                 skips; near contacts: false alarms.
                                                       Slow above 10^5 faces
pymeshlab   faces in proper crossings                  coplanar overlaps and folds, which it
                                                       misses; coplanar neighbours: false
                                                       alarms. Not repeatable run to run
==========  =========================================  =====================================

What open3d and pymeshlab flag is therefore judged by exact arithmetic: a flag that it refutes
is counted as a false alarm.

pymeshlab is under the GPL. It is imported here only, and only when its opinion is asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from implicit_warp.checking.exact import IntersectionKind
from implicit_warp.checking.self_intersection import decide_exactly, faces_meeting
from implicit_warp.errors import InputError

Vertices = NDArray[np.float64]
Faces = NDArray[np.int64]


@dataclass(frozen=True)
class Verdict:
    """One library's opinion of a mesh.

    Attributes:
        referee: the library's name.
        passed: its opinion; None when it gave none that can be trusted, for the reason in
            `detail`.
        detail: what it found, one clause.
        installed: False when the library could not be imported.
        facts: its figures by name.
    """

    referee: str
    passed: bool | None
    detail: str
    installed: bool = True
    facts: Mapping[str, Any] = field(default_factory=dict)


def manifold3d(vertices: Vertices, faces: Faces) -> Verdict:
    """Whether manifold3d builds a solid from the mesh without dropping or splitting anything."""
    import manifold3d as library

    solid = library.Manifold(
        library.Mesh64(vert_properties=vertices, tri_verts=faces.astype(np.uint64))
    )
    status = solid.status().name
    facts = {
        "status": status,
        "num_tri": solid.num_tri(),
        "num_vert": solid.num_vert(),
        "genus": solid.genus(),
        "volume": solid.volume(),
    }
    if status != "NoError":
        return Verdict("manifold3d", False, f"refuses the mesh ({status})", facts=facts)
    if (facts["num_tri"], facts["num_vert"]) != (len(faces), len(vertices)):
        return Verdict(
            "manifold3d",
            None,
            f"no opinion: it repaired the mesh to {facts['num_tri']} faces and "
            f"{facts['num_vert']} vertices, from {len(faces)} and {len(vertices)}",
            facts=facts,
        )
    if facts["volume"] < 0:  # zero may be an underflow
        return Verdict("manifold3d", False, "negative volume: inside out", facts=facts)
    return Verdict("manifold3d", True, "NoError, every face and vertex kept", facts=facts)


def trimesh(vertices: Vertices, faces: Faces) -> Verdict:
    """Whether trimesh finds the mesh closed, wound consistently and of positive volume."""
    import trimesh as library

    mesh = library.Trimesh(vertices, faces, process=False)
    facts = {
        "is_watertight": bool(mesh.is_watertight),
        "is_winding_consistent": bool(mesh.is_winding_consistent),
        "volume": float(mesh.volume),
    }
    complaints = [
        text
        for text, bad in (
            ("not watertight", not facts["is_watertight"]),
            ("winding not consistent", not facts["is_winding_consistent"]),
            ("volume is not positive", not facts["volume"] > 0),
        )
        if bad
    ]
    detail = ", ".join(complaints) or "watertight, winding consistent, volume positive"
    return Verdict("trimesh", not complaints, detail, facts=facts)


def open3d(vertices: Vertices, faces: Faces) -> Verdict:
    """Pairs of faces that open3d finds to intersect, and how many exact arithmetic confirms."""
    import open3d as library

    mesh = library.geometry.TriangleMesh(
        library.utility.Vector3dVector(vertices),
        library.utility.Vector3iVector(faces.astype(np.int32)),
    )
    flagged = np.asarray(mesh.get_self_intersecting_triangles()).astype(np.int64).reshape(-1, 2)
    real = decide_exactly(vertices, faces, flagged) != IntersectionKind.NONE
    return _judged("open3d", "pairs", len(flagged), flagged[real])


def pymeshlab(vertices: Vertices, faces: Faces) -> Verdict:
    """Faces that pymeshlab finds to intersect, and how many exact arithmetic confirms.

    A flagged face is a false alarm when it intersects no other face of the mesh, each of
    those that its box meets decided by integers.
    """
    import pymeshlab as library

    meshes = library.MeshSet(verbose=False)
    meshes.add_mesh(library.Mesh(vertices, faces.astype(np.int32)))
    if meshes.current_mesh().face_number() != len(faces):
        return Verdict("pymeshlab", None, "no opinion: it dropped faces on reading the mesh")
    meshes.compute_selection_by_self_intersections_per_face()
    flagged = np.flatnonzero(meshes.current_mesh().face_selection_array())
    real = [int(f) for f in flagged if len(faces_meeting(vertices, faces, int(f)))]
    return _judged("pymeshlab", "faces", len(flagged), np.array(real, dtype=np.int64))


REFEREES: dict[str, Callable[[Vertices, Faces], Verdict]] = {
    "manifold3d": manifold3d,
    "trimesh": trimesh,
    "open3d": open3d,
    "pymeshlab": pymeshlab,
}
"""Every referee by name."""


def ask(name: str, vertices: Vertices, faces: Faces) -> Verdict:
    """The opinion of one referee on arrays that went through `mesh_arrays.validated`.

    A library that is missing, or a mesh that it cannot take, gives a verdict without an
    opinion that says so.

    Raises:
        InputError: no referee has that name.
    """
    if name not in REFEREES:
        raise InputError("referees", name, "no such referee", f"Choose from {list(REFEREES)}")
    if not len(faces):
        return Verdict(name, None, "not asked: the mesh has no faces")
    if not np.isfinite(vertices).all():
        return Verdict(name, None, "not asked: the mesh has coordinates that are not finite")
    try:
        return REFEREES[name](vertices, faces)
    except (ImportError, OSError) as error:  # OSError: a shared library of it is missing
        return Verdict(name, None, f"not installed ({error})", installed=False)


def _judged(referee: str, unit: str, flagged: int, real: NDArray[np.int64]) -> Verdict:
    facts = {
        "flagged": flagged,
        "confirmed": len(real),
        "false_alarms": flagged - len(real),
        "first_confirmed": real[:10].tolist(),
    }
    detail = f"flags {flagged} {unit}"
    if flagged:
        detail += f", of which exact arithmetic confirms {len(real)}"
    return Verdict(referee, not len(real), detail, facts=facts)
