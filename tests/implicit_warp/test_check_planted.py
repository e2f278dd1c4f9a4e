"""Planted defects: each kind is found by its own flags at its own place, and raises no other."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from implicit_warp.checking import check
from tests.implicit_warp.planted_defects import BASES, KINDS, Planted, clean, planted

NOTED = {"sliver_faces", "unreferenced_vertices", "duplicate_vertices"}
"""What is worth a note but makes no mesh bad."""


def verdict(defect: Planted) -> None:
    report = check(SimpleNamespace(vertices=defect.vertices, faces=defect.faces), referees=())
    raised = {name for name, n in report.counts().items() if n} - {"self_intersections"}
    assert raised >= defect.required, f"{defect}: missed {sorted(defect.required - raised)}"
    false = raised - defect.required - defect.implied
    assert not false, f"{defect}: false alarm {sorted(false)}"
    assert report.ok == (raised <= NOTED), f"{defect}: {report}"
    if defect.kind != "crossing":  # a spike may meet what stands in its way, itself included
        for pair in report.self_intersections.pairs.tolist():
            assert defect.where & set(pair), f"{defect}: {pair} is not at {sorted(defect.where)}"


@pytest.mark.parametrize("kind", KINDS)
def test_planted_defects_raise_their_own_flags_and_no_other(kind: str) -> None:
    for seed in range(12):
        verdict(planted(kind, seed))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_hundred_planted_defects_raise_their_own_flags_and_no_other(kind: str) -> None:
    for seed in range(100):
        verdict(planted(kind, 1000 + seed))


@pytest.mark.parametrize("base", BASES)
def test_the_meshes_they_are_planted_in_are_clean(base: str) -> None:
    for seed in range(8):
        vertices, faces = clean(base, np.random.default_rng(seed))
        report = check(SimpleNamespace(vertices=vertices, faces=faces), referees=())
        assert report.ok, (base, seed, str(report))
        assert not any(report.counts().values()), (base, seed, report.counts())


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_the_same_defect_again(kind: str) -> None:
    first, second = planted(kind, 3), planted(kind, 3)
    assert np.array_equal(first.vertices, second.vertices, equal_nan=True)
    assert np.array_equal(first.faces, second.faces)
    other = planted(kind, 4)
    assert other.vertices.shape != first.vertices.shape or not np.array_equal(
        first.vertices, other.vertices
    )


def test_an_unmerged_seam_is_named_as_the_cause_and_merging_mends_it() -> None:
    for seed in range(5):
        defect = planted("unmerged_seam", seed)
        mesh = SimpleNamespace(vertices=defect.vertices, faces=defect.faces)
        assert any("merged" in note for note in check(mesh, referees=()).notes), defect
        merged = check(mesh, referees=(), merge_vertices=True)
        assert merged.ok, (str(defect), str(merged))
        assert not any(merged.counts().values())


def test_no_seam_is_blamed_for_a_hole() -> None:
    """Equal vertices alone do not make the note: merging must close the mesh."""
    defect = planted("unmerged_seam", 1)
    patch = sorted(defect.where)
    mesh = SimpleNamespace(vertices=defect.vertices, faces=np.delete(defect.faces, patch[0], 0))
    report = check(mesh, referees=())
    assert len(report.topology.duplicate_vertices)
    assert not any("merged" in note for note in report.notes)
