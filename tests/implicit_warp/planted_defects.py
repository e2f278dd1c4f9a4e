"""Clean meshes with one defect each, planted at a random place: what a checker must find.

    defect = planted("fold", seed=7)
    defect.vertices, defect.faces, defect.required, defect.implied

Everything follows from the kind and the seed. The clean meshes are turned at random and then
snapped to a lattice of 2^-24, so that points in a face, on an edge or at a mean of corners are
exact in float64: a planted fold is flat and a planted contact touches, not nearly so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh

LATTICE = 2.0**24

Mesh = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Planted:
    """A mesh with one defect.

    Attributes:
        kind: its name, a key of `KINDS`.
        seed: what it was made from.
        base: name of the clean mesh.
        vertices: `(V, 3)` float64.
        faces: `(F, 3)` int64.
        required: names of `CheckReport.counts` that must not be zero.
        implied: names that may be, too, because they follow from the defect. All others, but for
            the sum "self_intersections", must be zero.
        where: faces that the defect is made of; each intersecting pair has one of them.
    """

    kind: str
    seed: int
    base: str
    vertices: np.ndarray
    faces: np.ndarray
    required: frozenset[str]
    implied: frozenset[str]
    where: frozenset[int]

    def __str__(self) -> str:
        return f"planted({self.kind!r}, seed={self.seed}) on {self.base}"


def planted(kind: str, seed: int) -> Planted:
    """A defect of one kind at a random place of a random clean mesh."""
    rng = np.random.default_rng([seed, *kind.encode()])
    base = str(rng.choice(list(BASES)))
    vertices, faces = clean(base, rng)
    plant, required, implied = KINDS[kind]
    vertices, faces, where = plant(vertices, faces, rng)
    return Planted(
        kind=kind,
        seed=seed,
        base=base,
        vertices=vertices,
        faces=faces,
        required=frozenset(required),
        implied=frozenset(implied),
        where=frozenset(int(f) for f in where),
    )


def clean(base: str, rng: np.random.Generator) -> Mesh:
    """One of `BASES`, turned at random, in [-1, 1]^3, on the lattice."""
    vertices, faces = BASES[base]()
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn[:, 0] *= np.linalg.det(turn)
    turned = vertices @ turn.T
    turned /= np.abs(turned).max()
    return np.rint(turned * LATTICE) / LATTICE, faces.copy()


# --- clean meshes ---------------------------------------------------------------------------


def _arrays(mesh: trimesh.Trimesh) -> Mesh:
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


@cache
def _sphere() -> Mesh:
    return _arrays(trimesh.creation.icosphere(2))


@cache
def _torus() -> Mesh:
    return _arrays(trimesh.creation.torus(1.0, 0.4, major_sections=24, minor_sections=12))


@cache
def _box() -> Mesh:
    """Flat sides, where neighbours lie within rounding of one plane."""
    return _arrays(trimesh.creation.box((1.0, 1.5, 0.7)).subdivide().subdivide())


@cache
def _part() -> Mesh:
    """An extracted CSG part: creases, inner corners and thin triangles."""
    import fields as sdf
    import implicit_warp as iw

    shape = (sdf.sphere(1.0) & sdf.box(1.5)) - sdf.cylinder(0.45)
    return _arrays(iw.extract(shape, resolution=14))


@cache
def _two_shells() -> Mesh:
    """A hollow sphere, and a box beside it: three components that are nested rightly."""
    vertices, faces = _sphere()
    box, box_faces = _box()
    return (
        np.concatenate([vertices, 0.6 * vertices, box + np.array([2.5, 0.0, 0.0])]),
        np.concatenate(
            [faces, faces[:, ::-1] + len(vertices), box_faces + 2 * len(vertices)],
        ),
    )


BASES: dict[str, Callable[[], Mesh]] = {
    "sphere": _sphere,
    "torus": _torus,
    "box": _box,
    "part": _part,
    "two shells": _two_shells,
}

# --- places ---------------------------------------------------------------------------------


def _wide_face(vertices, faces, rng) -> int:
    """A random face that is not thin, so that what is planted there has room."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    double = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([((b - a) ** 2).sum(1), ((c - b) ** 2).sum(1), ((a - c) ** 2).sum(1)], axis=0)
    wide = (double > 0.3 * longest) & (longest > 0.3 * np.median(longest))
    return int(rng.choice(np.flatnonzero(wide)))


def _turned_face(faces, face, rng) -> np.ndarray:
    return np.roll(faces[face], rng.integers(3))


def _in_face(vertices, corners, weights) -> np.ndarray:
    """An exact point of the plane of a face: weights are sixteenths that sum to 16."""
    return np.asarray(weights) @ vertices[corners] / 16.0


def _outward(vertices, corners) -> tuple[np.ndarray, float]:
    """Unit normal of a face, and the length of its shortest side."""
    a, b, c = vertices[corners]
    normal = np.cross(b - a, c - a)
    sides = [np.linalg.norm(d) for d in (b - a, c - b, a - c)]
    return normal / np.linalg.norm(normal), float(min(sides))


def _across(normal) -> np.ndarray:
    """Two unit vectors `(2, 3)` that make a right-handed frame with the normal."""
    first = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(normal, first)])


def _needle(tip, normal, length) -> np.ndarray:
    """Corners of a thin tetrahedron that stands on its tip: tip, then its far end from above."""
    across = _across(normal)
    far = tip + length * normal
    angles = 2 * np.pi * np.arange(3) / 3
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) @ across
    return np.concatenate([[tip], far + 0.05 * length * ring])


# Outward faces of a tetrahedron whose corner 0 is below corners 1, 2, 3 that run
# counter-clockwise seen from above.
_TETRAHEDRON = np.array([[1, 2, 3], [0, 2, 1], [0, 3, 2], [0, 1, 3]])


def _with_component(vertices, faces, corners, own=_TETRAHEDRON):
    where = range(len(faces), len(faces) + len(own))
    return (
        np.concatenate([vertices, corners]),
        np.concatenate([faces, own + len(vertices)]),
        where,
    )


def _split(faces, face, corners, point: int) -> np.ndarray:
    """Faces with one of them replaced by three round a new vertex."""
    a, b, c = corners
    faces = faces.copy()
    faces[face] = a, b, point
    return np.concatenate([faces, [[b, c, point], [c, a, point]]])


# --- defects --------------------------------------------------------------------------------


def hole(vertices, faces, rng):
    """A face is missing."""
    return vertices, np.delete(faces, rng.integers(len(faces)), axis=0), ()


def flipped_face(vertices, faces, rng):
    """A face runs the wrong way round."""
    face = rng.integers(len(faces))
    faces[face] = faces[face, ::-1]
    return vertices, faces, (face,)


def inside_out(vertices, faces, rng):
    """All faces look inwards."""
    return vertices, np.ascontiguousarray(faces[:, ::-1]), ()


def duplicated_face(vertices, faces, rng):
    """A face is there twice, its corners in any order."""
    again = rng.permutation(faces[rng.integers(len(faces))])
    return vertices, np.concatenate([faces, [again]]), (len(faces),)


def fin(vertices, faces, rng):
    """A third face stands on an edge."""
    face = _wide_face(vertices, faces, rng)
    a, b, c = _turned_face(faces, face, rng)
    normal, side = _outward(vertices, [a, b, c])
    # Leaning over the face it starts from, so that no neighbour is in its way.
    top = 0.5 * (vertices[a] + vertices[b]) + 0.05 * side * normal
    top += 0.02 * (vertices[c] - vertices[a])
    return (
        np.concatenate([vertices, [top]]),
        np.concatenate([faces, [[a, b, len(vertices)]]]),
        (len(faces),),
    )


def pinched_vertex(vertices, faces, rng):
    """Two closed surfaces have one vertex in common."""
    face = _wide_face(vertices, faces, rng)
    corner = int(_turned_face(faces, face, rng)[0])
    needle = _needle(vertices[corner], _vertex_normal(vertices, faces, corner), 0.05)
    own = np.where(_TETRAHEDRON == 0, corner, _TETRAHEDRON + len(vertices) - 1)
    where = range(len(faces), len(faces) + 4)
    return np.concatenate([vertices, needle[1:]]), np.concatenate([faces, own]), where


def _vertex_normal(vertices, faces, vertex) -> np.ndarray:
    """The direction that is farthest from all faces round a vertex, outwards."""
    around = faces[(faces == vertex).any(axis=1)]
    total = np.sum([_outward(vertices, f)[0] for f in around], axis=0)
    return total / np.linalg.norm(total)


def zero_area_face(vertices, faces, rng):
    """An edge is split on one of its sides only, and a flat face fills the gap."""
    return _thin_face(vertices, faces, rng, 0.0)


def sliver(vertices, faces, rng):
    """The same, and the gap is a hair wide."""
    return _thin_face(vertices, faces, rng, 2.0**-26)


def _thin_face(vertices, faces, rng, width):
    face = _wide_face(vertices, faces, rng)
    a, b, c = corners = _turned_face(faces, face, rng)
    point = _in_face(vertices, corners, [8, 8, 0])
    point = point + width * (vertices[c] - point)
    new = len(vertices)
    faces[face] = a, b, new
    return (
        np.concatenate([vertices, [point]]),
        np.concatenate([faces, [[b, c, new], [c, a, new]]]),
        (face, len(faces), len(faces) + 1),
    )


def crossing(vertices, faces, rng):
    """A spike goes from one face through the body and out of the other side."""
    face = _wide_face(vertices, faces, rng)
    corners = _turned_face(faces, face, rng)
    normal, _ = _outward(vertices, corners)
    tip = vertices[corners].mean(axis=0) - 4.0 * normal
    where = (face, len(faces), len(faces) + 1)
    return np.concatenate([vertices, [tip]]), _split(faces, face, corners, len(vertices)), where


def coplanar_overlap(vertices, faces, rng):
    """A tetrahedron stands on a face: their bottoms lie in one plane and overlap."""
    face = _wide_face(vertices, faces, rng)
    corners = _turned_face(faces, face, rng)
    normal, side = _outward(vertices, corners)
    low = [_in_face(vertices, corners, w) for w in rng.permutation([[10, 3, 3], [3, 10, 3]])]
    low.append(_in_face(vertices, corners, [2, 4, 10]))
    if np.dot(np.cross(low[1] - low[0], low[2] - low[0]), normal) < 0:
        low[:2] = low[1::-1]
    top = np.mean(low, axis=0) + 0.1 * side * normal
    # Corner 0 on top: the same faces, each the other way round.
    return _with_component(vertices, faces, np.array([top, *low]), _TETRAHEDRON[:, ::-1])


def touching_vertex(vertices, faces, rng):
    """A tetrahedron stands on its tip: in a face, on an edge, or on a vertex."""
    face = _wide_face(vertices, faces, rng)
    corners = _turned_face(faces, face, rng)
    weights = [[5, 4, 7], [8, 8, 0], [16, 0, 0]][rng.integers(3)]
    normal, _ = _outward(vertices, corners)
    if weights[2] == 0:
        ends = [int(corners[0])] if weights[1] == 0 else [int(corners[0]), int(corners[1])]
        normals = [_vertex_normal(vertices, faces, v) for v in ends]
        normal = normals[0] if len(ends) == 1 else _edge_normal(vertices, faces, ends)
    tip = _in_face(vertices, corners, weights)
    return _with_component(vertices, faces, _needle(tip, normal, 0.05))


def _edge_normal(vertices, faces, ends) -> np.ndarray:
    both = faces[np.isin(faces, ends).sum(axis=1) == 2]
    total = np.sum([_outward(vertices, f)[0] for f in both], axis=0)
    return total / np.linalg.norm(total)


def fold(vertices, faces, rng):
    """Within one face the surface is folded flat, over an edge and back."""
    face = _wide_face(vertices, faces, rng)
    corners = _turned_face(faces, face, rng)
    a, b = corners[:2]
    p, q = len(vertices), len(vertices) + 1
    points = [_in_face(vertices, corners, w) for w in ([6, 5, 5], [4, 5, 7])]
    faces = _split(faces, face, corners, p)
    # q splits the face a, b, p but lies beyond its edge to p.
    faces[face] = a, b, q
    where = (face, *range(len(faces) - 2, len(faces) + 2))
    return (
        np.concatenate([vertices, points]),
        np.concatenate([faces, [[b, p, q], [p, a, q]]]),
        where,
    )


def nonfinite_vertex(vertices, faces, rng):
    """A coordinate is NaN or infinite."""
    vertex = faces[rng.integers(len(faces)), 0]
    vertices[vertex, rng.integers(3)] = rng.choice([np.nan, np.inf, -np.inf])
    return vertices, faces, ()


def unreferenced_vertex(vertices, faces, rng):
    """A vertex belongs to no face."""
    place = rng.integers(len(vertices) + 1)
    moved = faces + (faces >= place)
    return np.insert(vertices, place, rng.standard_normal(3) * 3, axis=0), moved, ()


def unmerged_seam(vertices, faces, rng):
    """The faces round a vertex have corners of their own, at the same places."""
    vertex = faces[rng.integers(len(faces)), 0]
    patch = np.flatnonzero((faces == vertex).any(axis=1))
    rim = np.setdiff1d(faces[patch], [vertex])
    own = np.arange(len(vertices))
    own[rim] = len(vertices) + np.arange(len(rim))
    faces[patch] = own[faces[patch]]
    return np.concatenate([vertices, vertices[rim]]), faces, patch


def wrong_nesting(vertices, faces, rng):
    """A solid lies inside the solid, its faces outwards: its matter would count twice."""
    face = _wide_face(vertices, faces, rng)
    corners = faces[face]
    normal, side = _outward(vertices, corners)
    tip = vertices[corners].mean(axis=0) - 0.04 * side * normal
    return _with_component(vertices, faces, _needle(tip, normal, 0.02 * side))


_S = "self_intersections."

KINDS: dict[str, tuple[Callable, set[str], set[str]]] = {
    "hole": (hole, {"open_edges"}, set()),
    "flipped_face": (flipped_face, {"misoriented_edges"}, set()),
    "inside_out": (inside_out, {"inside_out_components"}, {"misnested_components"}),
    "duplicated_face": (
        duplicated_face,
        {"duplicate_faces", "nonmanifold_edges", _S + "duplicate"},
        set(),
    ),
    "fin": (fin, {"nonmanifold_edges", "open_edges"}, set()),
    "pinched_vertex": (pinched_vertex, {"pinched_vertices"}, set()),
    "zero_area_face": (zero_area_face, {"zero_area_faces", _S + "touching"}, set()),
    "sliver": (sliver, {"sliver_faces"}, set()),
    "crossing": (crossing, {_S + "crossing"}, {"inside_out_components"}),
    "coplanar_overlap": (coplanar_overlap, {_S + "overlap"}, {_S + "touching"}),
    "touching_vertex": (touching_vertex, {_S + "touching"}, {"duplicate_vertices"}),
    "fold": (fold, {_S + "fold"}, set()),
    "nonfinite_vertex": (nonfinite_vertex, {"nonfinite_vertices"}, set()),
    "unreferenced_vertex": (unreferenced_vertex, {"unreferenced_vertices"}, set()),
    "unmerged_seam": (
        unmerged_seam,
        {"open_edges", "duplicate_vertices", _S + "touching"},
        set(),
    ),
    "wrong_nesting": (wrong_nesting, {"misnested_components"}, set()),
}
"""How each kind is planted, what must be found, and what follows from it."""
