"""CGAL, which shares nothing with the checker but the definition, says the same."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from implicit_warp.checking import self_intersections
from implicit_warp.checking.exact import integer_points, visible_axis
from tests.implicit_warp.planted_defects import KINDS, planted

pytest.importorskip("CGAL", reason="the cgal wheel (GPL-3) is not installed")
from tests.implicit_warp import cgal_referee as referee

APART = np.array([[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize("spread", [2, 4, None])
def test_cgal_agrees_on_pairs_of_triangles(spread: int | None) -> None:
    """On small lattices, where contacts and common planes abound, and in general position."""
    rng = np.random.default_rng([spread or 0])
    answers = Counter()
    for _ in range(1500):
        points = (
            rng.standard_normal((6, 3))
            if spread is None
            else rng.integers(-spread, spread + 1, (6, 3)).astype(float)
        )
        corners = integer_points(points)
        if visible_axis(*corners[:3]) is None or visible_axis(*corners[3:]) is None:
            continue
        truth = referee.triangles_meet(points)
        answers[truth] += 1
        assert (len(self_intersections(points, APART)) > 0) == truth, points.tolist()
    assert min(answers[True], answers[False]) > 100, "one answer hardly occurs"


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"nonfinite_vertex"}))
def test_cgal_agrees_on_meshes_with_planted_defects(kind: str) -> None:
    """Where its data structure can hold the mesh at all."""
    for seed in range(3):
        defect = planted(kind, seed)
        verdict = referee.self_intersects(defect.vertices, defect.faces)
        if verdict is not None:
            ours = len(self_intersections(defect.vertices, defect.faces)) > 0
            assert ours == verdict, defect


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_cgal_agrees_on_closed_meshes_that_were_crumpled(seed: int) -> None:
    """Vertices moved at random and snapped to a lattice: some cross, some touch, some do not."""
    rng = np.random.default_rng(seed)
    verdicts = Counter()
    for number in range(40):
        defect = planted("inside_out", 100 * seed + number)
        grain = 2.0 ** rng.integers(3, 9)
        moved = rng.random((len(defect.vertices), 1)) < 0.4
        size = 10.0 ** rng.uniform(-3.0, -0.5)
        vertices = defect.vertices + moved * rng.normal(0.0, size, defect.vertices.shape)
        vertices = np.rint(vertices * grain) / grain
        corners = integer_points(vertices)
        if any(visible_axis(*(corners[i] for i in f)) is None for f in defect.faces.tolist()):
            continue
        verdict = referee.self_intersects(vertices, defect.faces)
        verdicts[verdict] += 1
        assert (len(self_intersections(vertices, defect.faces)) > 0) == verdict, (defect, grain)
    assert min(verdicts[True], verdicts[False]) > 0, "one verdict never occurs"
