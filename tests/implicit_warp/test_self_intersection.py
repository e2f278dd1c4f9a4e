"""Self-intersecting pairs: the same answer as plain rational arithmetic, in every case."""

from __future__ import annotations

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
import trimesh

from implicit_warp.checking import IntersectionKind, self_intersections
from implicit_warp.checking.exact import decide
from implicit_warp.checking.self_intersection import decide_exactly, faces_meeting
from implicit_warp.errors import InputError
from tests.implicit_warp.pair_oracle import kind_of_intersection, meet_outside_shared

PAIRS = {
    0: np.array([[0, 1, 2], [3, 4, 5]]),
    1: np.array([[0, 1, 2], [2, 3, 4]]),
    2: np.array([[0, 1, 2], [1, 0, 3]]),
}


def random_points(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Six points: general, on a small lattice, on one of a plane, or within rounding of one."""
    if kind == "float":
        return rng.standard_normal((6, 3))
    if kind == "flat":
        return rng.integers(-3, 4, (6, 2)) @ rng.integers(-2, 3, (2, 3)).astype(float)
    points = rng.integers(-2, 3, (6, 3)).astype(float)
    if kind == "near":
        turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        points = (points @ turn + rng.choice([0.0, 100.0])) * rng.choice([1e-30, 1 / 3, 1e7])
    return points


def kind_found(points: np.ndarray, shared: int) -> str:
    found = self_intersections(points, PAIRS[shared])
    return IntersectionKind(int(found.kinds[0])).name.lower() if len(found) else "none"


def disagreements(cases: int, kind: str, shared: int) -> tuple[Counter[str], list[np.ndarray]]:
    """How often each kind occurs by the oracle, and the points of all pairs judged otherwise."""
    rng = np.random.default_rng([cases, shared, *kind.encode()])
    truths, wrong = Counter(), []
    for _ in range(cases):
        points = random_points(kind, rng)
        truth = kind_of_intersection(points, *PAIRS[shared])
        truths[truth] += 1
        if kind_found(points, shared) != truth:
            wrong.append(points)
    return truths, wrong


# What random pairs must bring about, or they test nothing. Two faces that share an edge can only
# be folded, and are never so by chance in general position.
EXPECTED_KINDS = {
    ("float", 0): {"crossing"},
    ("float", 1): {"crossing"},
    ("float", 2): set(),
    ("int", 0): {"crossing", "touching", "degenerate"},
    ("int", 1): {"crossing", "fold", "touching", "degenerate"},
    ("int", 2): {"fold"},
    ("flat", 0): {"overlap", "touching", "degenerate"},
    ("flat", 1): {"fold", "touching", "degenerate"},
    ("flat", 2): {"fold", "degenerate"},
    ("near", 0): {"crossing", "touching"},
    ("near", 1): {"crossing", "touching"},
    ("near", 2): set(),
}


@pytest.mark.parametrize(("kind", "shared"), EXPECTED_KINDS)
def test_random_pairs_get_the_kind_that_rational_arithmetic_says(kind: str, shared: int) -> None:
    truths, wrong = disagreements(1_700, kind, shared)
    assert not wrong, (wrong[0].tolist(), shared)
    assert set(truths) >= EXPECTED_KINDS[kind, shared], "the cases test too little"


@pytest.mark.statistical
@pytest.mark.parametrize(("kind", "shared"), EXPECTED_KINDS)
def test_a_million_random_pairs_get_the_kind_that_rational_arithmetic_says(
    kind: str, shared: int
) -> None:
    """A twelfth of a million each. None wrong in 10^6 bounds the error rate by 3e-6, at 95 %."""
    _, wrong = disagreements(83_334, kind, shared)
    assert not wrong, (wrong[0].tolist(), shared)


@pytest.mark.parametrize("seed", range(3))
def test_soups_full_of_degenerate_faces_agree_pair_by_pair(seed: int) -> None:
    """Few points on a tiny lattice: zero areas, equal corners, repeated indices, duplicates."""
    rng = np.random.default_rng(seed)
    vertices = rng.integers(0, 3, (12, 3)).astype(float) / 3.0
    faces = rng.integers(0, 12, (24, 3))
    expected = [
        (i, j)
        for i, j in combinations(range(len(faces)), 2)
        if meet_outside_shared(vertices, faces[i], faces[j])
    ]
    found = self_intersections(vertices, faces)
    assert found.pairs.tolist() == [list(pair) for pair in expected]


@pytest.mark.parametrize("seed", range(2))
def test_the_box_tree_loses_no_pair(seed: int) -> None:
    """Random triangles of all sizes, against the exact decision on every pair of them."""
    rng = np.random.default_rng(seed)
    centres = rng.random((150, 1, 3))
    vertices = centres + rng.standard_normal((150, 3, 3)) * 10 ** rng.uniform(-3, 0, (150, 1, 1))
    vertices, faces = vertices.reshape(-1, 3), np.arange(450).reshape(-1, 3)
    every = np.array(list(combinations(range(150), 2)))
    truth = every[decide_exactly(vertices, faces, every) != IntersectionKind.NONE]
    assert np.array_equal(self_intersections(vertices, faces).pairs, truth)


BASE = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]
# The other face's own corners, how many vertices it shares with the base (one is the corner
# (0, 4, 0), two are the edge along y = 0), and the kind.
NAMED = {
    "pierced": ([[1, 1, -1], [1, 1, 1], [9, 9, 1]], 0, "crossing"),
    "pierced from a common vertex": ([[2, -1, -1], [2, -1, 1]], 1, "crossing"),
    "corner on the inside": ([[1, 1, 0], [1, 1, 1], [9, 9, 1]], 0, "touching"),
    "edge on the inside": ([[1, 1, 0], [2, 1, 0], [1, 1, 3]], 0, "touching"),
    "corner on a corner": ([[4, 0, 0], [5, 0, 1], [5, 1, 1]], 0, "touching"),
    "coplanar, corner on an edge": ([[2, 2, 0], [9, 3, 0], [9, 9, 0]], 0, "touching"),
    "coplanar, edge along an edge": ([[1, 0, 0], [3, 0, 0], [2, -5, 0]], 0, "touching"),
    "coplanar, edge along an edge from a common vertex": ([[0, 2, 0], [-5, 2, 0]], 1, "touching"),
    "coplanar, one inside the other": ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], 0, "overlap"),
    "coplanar, partly": ([[1, 1, 0], [9, 1, 0], [9, 9, 0]], 0, "overlap"),
    "coplanar, equal but for the indices": (BASE, 0, "overlap"),
    "coplanar, from a common vertex": ([[1, 0, 0], [2, 0, 0]], 1, "fold"),
    "coplanar, from a common edge": ([[1, 1, 0]], 2, "fold"),
    "zero area, across": ([[1, 1, -1], [1, 1, 0], [1, 1, 2]], 0, "degenerate"),
    "zero area, along": ([[1, 1, 0], [1, 2, 0], [1, 1, 0]], 0, "degenerate"),
    "above": ([[1, 1, 1], [2, 1, 1], [1, 2, 1]], 0, "none"),
    "neighbours of one plane": ([[9, -9, 0]], 2, "none"),
    "neighbours at a corner of one plane": ([[-1, 9, 0], [1, 9, 0]], 1, "none"),
}


@pytest.mark.parametrize("name", NAMED)
def test_each_kind_of_intersection_is_named(name: str) -> None:
    others, shared, expected = NAMED[name]
    assert kind_found(np.array(BASE + others, float), shared) == expected


def test_duplicates_are_named() -> None:
    found = self_intersections(np.eye(3), np.array([[0, 1, 2], [2, 1, 0]]))
    assert found.count_by_kind()["duplicate"] == len(found) == 1


def test_triangles_whose_edges_cross_in_their_insides_plane_by_plane_are_crossing() -> None:
    """Mirror images through x = 0: edge meets edge, and no edge pierces an inside."""
    one = np.array([[-1.0, 0, 0], [1, 0.5, 0], [1, -0.5, 2]])
    mirrored = one * [-1, 1, 1]
    found = self_intersections(np.vstack([one, mirrored]), PAIRS[0])
    assert found.count_by_kind()["crossing"] == len(found) == 1


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1.0, 1e30, 1e300])
def test_verdicts_do_not_depend_on_the_unit(scale: float) -> None:
    mesh = trimesh.creation.icosphere(2)
    assert len(self_intersections(mesh.vertices * scale, mesh.faces)) == 0
    pushed = np.array(mesh.vertices)
    pushed[0] *= -1.5
    expected = self_intersections(pushed, mesh.faces).pairs
    assert len(expected)
    # A power of two is exact, so the answer must be the very same.
    power = 2.0 ** round(np.log2(scale))
    assert np.array_equal(self_intersections(pushed * power, mesh.faces).pairs, expected)


@pytest.mark.parametrize("apex", [-1, 1])
def test_products_that_underflow_give_no_wrong_sign(apex: int) -> None:
    """A triangle of size 1e-200 beside coordinates of size 1: only integers can tell."""
    tiny = 1e-200
    triangle = np.array([[0, 0, 0], [tiny, 0, 0], [0, tiny, 0]])
    other = np.array([[tiny / 4, tiny / 4, apex * tiny], [1, 1, 1], [2, 1, 1]])
    points = np.vstack([triangle, other])
    truth = meet_outside_shared(points, *PAIRS[0])
    assert (len(self_intersections(points, PAIRS[0])) > 0) == truth
    pierced = points.copy()
    pierced[4:] = [[tiny / 4, tiny / 4, -apex], [1, 1, -apex]]
    assert len(self_intersections(pierced, PAIRS[0])) == 1


@pytest.mark.parametrize("turned", [False, True])
def test_flat_sides_are_cleared_without_integer_arithmetic(turned: bool) -> None:
    """The filter must separate coplanar neighbours, or a CAD part takes minutes."""
    vertices, faces = np.array(trimesh.creation.box().vertices), trimesh.creation.box().faces
    for _ in range(4):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    if turned:
        vertices = vertices @ trimesh.transformations.rotation_matrix(1.0, [1, 2, 3])[:3, :3]
    found = self_intersections(vertices, faces)
    assert len(found) == 0
    assert found.decided_exactly <= 0.01 * found.judged


def test_clean_meshes_have_none() -> None:
    for mesh in (
        trimesh.creation.icosphere(3),
        trimesh.creation.torus(1.0, 0.3),
        trimesh.creation.cylinder(1.0, 2.0),
        trimesh.creation.capsule(),
    ):
        assert len(self_intersections(mesh.vertices, mesh.faces)) == 0


def test_pairs_are_sorted_and_do_not_depend_on_the_order_of_faces() -> None:
    mesh = trimesh.creation.icosphere(2)
    other = trimesh.creation.icosphere(2).apply_translation([0.5, 0.3, 0.1])
    both = trimesh.util.concatenate([mesh, other])
    found = self_intersections(both.vertices, both.faces)
    assert found.pairs.dtype == np.int64
    assert (found.pairs[:, 0] < found.pairs[:, 1]).all()
    assert sorted(map(tuple, found.pairs)) == list(map(tuple, found.pairs))
    order = np.random.default_rng(0).permutation(len(both.faces))
    shuffled = self_intersections(both.vertices, both.faces[order])
    assert set(map(tuple, np.sort(order[shuffled.pairs], axis=1))) == set(map(tuple, found.pairs))


def test_the_single_face_judge_agrees_with_the_whole_search() -> None:
    mesh = trimesh.creation.icosphere(1)
    vertices = np.array(mesh.vertices)
    vertices[0] *= -1.5
    found = self_intersections(vertices, mesh.faces).pairs
    for face in range(len(mesh.faces)):
        partners = np.concatenate([found[found[:, k] == face, 1 - k] for k in (0, 1)])
        assert faces_meeting(vertices, mesh.faces, face).tolist() == sorted(partners)


def test_collapsed_mesh_stops_at_the_limit_and_says_so() -> None:
    mesh = trimesh.creation.icosphere(3)
    found = self_intersections(np.zeros_like(mesh.vertices), mesh.faces, limit=1000)
    assert not found.complete
    assert len(found) >= 1000
    assert (found.kinds == IntersectionKind.DEGENERATE).all()


def test_many_real_pairs_below_the_limit_are_all_found() -> None:
    """More than one buffer holds: the second pass must find what the first could not store."""
    rng = np.random.default_rng(0)
    vertices, faces = rng.random((450, 3)), np.arange(450).reshape(-1, 3)
    found = self_intersections(vertices, faces)
    assert len(found) > 1024, "one buffer held them all"
    every = np.array(list(combinations(range(150), 2)))
    truth = every[decide_exactly(vertices, faces, every) != IntersectionKind.NONE]
    assert found.complete
    assert np.array_equal(found.pairs, truth)


def test_faces_that_are_not_finite_are_left_out_and_listed() -> None:
    mesh = trimesh.creation.icosphere(2)
    vertices = np.array(mesh.vertices)
    vertices[7, 1] = np.nan
    found = self_intersections(vertices, mesh.faces)
    assert found.skipped_faces.tolist() == np.flatnonzero((mesh.faces == 7).any(axis=1)).tolist()
    assert len(found) == 0


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_faces_have_none(count: int) -> None:
    assert len(self_intersections(np.eye(3), np.array([[0, 1, 2]])[:count])) == 0


def test_the_oracle_is_not_fooled_by_the_order_of_corners() -> None:
    """A test of the test: cyclic shifts and swaps of a pair leave its answer."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        points = rng.integers(-2, 3, (6, 3)).astype(float)
        face, other = PAIRS[0]
        answers = {
            meet_outside_shared(points, f, g)
            for f, g in ((face, other), (other, face[[1, 2, 0]]), (face[::-1], other[[2, 0, 1]]))
        }
        assert len(answers) == 1, points.tolist()


def test_the_exact_decision_takes_huge_integers() -> None:
    big = 10**40
    points = [(0, 0, 0), (big, 0, 0), (0, big, 0), (1, 1, -1), (1, 1, 1), (big, big, 1)]
    assert decide(points, (0, 1, 2), (3, 4, 5)) == IntersectionKind.CROSSING
    points[3] = (1, 1, 1)
    assert decide(points, (0, 1, 2), (3, 4, 5)) == IntersectionKind.NONE


@pytest.mark.parametrize(
    ("vertices", "faces", "argument"),
    [
        (np.eye(3), [[0, 1, 3]], "faces"),
        (np.eye(3), [[0, 1, -1]], "faces"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "faces"),
        (np.eye(3), [[0, 1, 2, 0]], "faces"),
        (np.eye(2), [[0, 1, 1]], "vertices"),
        ([[0, 0, 0], [1]], [[0, 1, 1]], "vertices"),
    ],
)
def test_arrays_that_are_no_mesh_are_refused(vertices, faces, argument: str) -> None:
    with pytest.raises(InputError) as refusal:
        self_intersections(vertices, faces)
    assert refusal.value.argument == argument
