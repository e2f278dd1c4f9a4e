"""Stored counts: growth fails, shrinking passes, files are stable and refuse damage."""

from __future__ import annotations

import json
import os

import hypothesis.strategies as st
import pytest
import trimesh
from hypothesis import given

import implicit_warp as iw
from implicit_warp.regression import (
    Baseline,
    Difference,
    Entry,
    difference_table,
    judge,
    portable_key,
)

NAMES = ("self_intersections", "open_edges", "zero_area_faces", "no_volume")
counts = st.dictionaries(st.sampled_from(NAMES), st.integers(1, 3))
keys = st.text(st.characters(exclude_categories=()), min_size=1, max_size=6)


@given(stored=counts, now=counts)
def test_a_comparison_fails_exactly_when_a_count_grew(stored, now):
    comparison = Baseline({"a": Entry(stored)}).compare("a", Entry(now))
    grew = {n for n in NAMES if now.get(n, 0) > stored.get(n, 0)}
    shrank = {n for n in NAMES if now.get(n, 0) < stored.get(n, 0)}
    assert comparison.known
    assert {d.name for d in comparison.regressions} == grew
    assert {d.name for d in comparison.improvements} == shrank
    for d in comparison.differences:
        assert (d.stored, d.now) == (stored.get(d.name, 0), now.get(d.name, 0))


@given(stored=counts, now=counts)
def test_topology_may_change_in_neither_direction(stored, now):
    baseline = Baseline({"a": Entry({}, stored)})
    changed = {n for n in NAMES if now.get(n, 0) != stored.get(n, 0)}
    regressions = baseline.compare("a", Entry({}, now)).regressions
    assert {d.name for d in regressions} == changed
    assert baseline.compare("a", Entry({})).differences == ()


def test_topology_that_is_not_stored_is_all_new():
    comparison = Baseline({"a": Entry({})}).compare("a", Entry({}, {"components": 1}))
    assert comparison.regressions == (Difference("components", 0, 1, is_regression=True),)


@given(entries=st.dictionaries(keys, st.builds(Entry, counts, st.none() | counts)))
def test_a_file_comes_back_the_same_whatever_its_keys(tmp_path_factory, entries):
    path = tmp_path_factory.getbasetemp() / "round.json"
    Baseline(entries).save(path)
    again = Baseline.load(path)
    assert again.entries == entries
    assert again.library_version == iw.__version__
    path.read_text(encoding="utf-8", errors="strict")


def test_the_order_of_entries_and_counts_leaves_no_trace(tmp_path):
    one = {"b": Entry({"x": 1, "a": 2}), "a": Entry({})}
    other = {"a": Entry({}), "b": Entry({"a": 2, "x": 1})}
    Baseline(one).save(tmp_path / "one.json")
    Baseline(other).save(tmp_path / "other.json")
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "other.json").read_bytes()


def test_a_changed_count_is_one_changed_line(tmp_path):
    texts = []
    for n in (1, 2):
        Baseline({"a": Entry({"x": n, "y": 1}), "b": Entry({})}).save(tmp_path / "c.json")
        texts.append((tmp_path / "c.json").read_text().splitlines())
    assert sum(a != b for a, b in zip(*texts, strict=True)) == 1


GOOD = {
    "format": "implicit_warp.baseline",
    "format_version": 1,
    "library_version": "0.1.0",
    "entries": {"a": {"counts": {"x": 1}}},
}
DAMAGED = {
    "empty": "",
    "not JSON": "{",
    "merge marks": "<<<<<<< ours\n" + json.dumps(GOOD) + "\n=======",
    "deep": "[" * 100_000,
    "a list": "[]",
    "foreign": json.dumps({"a.stl": {"ok": True}}),
    "newer": json.dumps({**GOOD, "format_version": 2}),
    "older": json.dumps({**GOOD, "format_version": None}),
    "no entries": json.dumps({**GOOD, "entries": None}),
    "version no text": json.dumps({**GOOD, "library_version": 1}),
    "entry no table": json.dumps({**GOOD, "entries": {"a": 3}}),
    "no counts": json.dumps({**GOOD, "entries": {"a": {}}}),
    "unknown part": json.dumps({**GOOD, "entries": {"a": {"counts": {}, "size": {}}}}),
    "counts no table": json.dumps({**GOOD, "entries": {"a": {"counts": [1]}}}),
    "negative": json.dumps({**GOOD, "entries": {"a": {"counts": {"x": -1}}}}),
    "fraction": json.dumps({**GOOD, "entries": {"a": {"counts": {"x": 1.5}}}}),
    "truth": json.dumps({**GOOD, "entries": {"a": {"counts": {"x": True}}}}),
    "twice": '{"format": "implicit_warp.baseline", "format": "x"}',
    "not UTF-8": b"\xff\xfe{}",
}


@pytest.mark.parametrize("content", DAMAGED.values(), ids=DAMAGED.keys())
def test_damage_is_refused_with_a_remedy(tmp_path, content):
    path = tmp_path / "counts.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(iw.FileFormatError, match=r"counts\.json.*(Restore|Name another|Install)"):
        Baseline.load(path)


def test_the_undamaged_file_is_read(tmp_path):
    (tmp_path / "counts.json").write_text(json.dumps(GOOD))
    assert Baseline.load(tmp_path / "counts.json").entries == {"a": Entry({"x": 1})}


def test_a_missing_file_or_a_folder_is_bad_input(tmp_path):
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(iw.InputError, match="--update"):
            Baseline.load(path)


def test_keys_do_not_depend_on_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "deep" / "parts").mkdir(parents=True)
    file = tmp_path / "deep" / "parts" / "a.stl"
    monkeypatch.chdir(tmp_path)
    assert portable_key("deep/parts/a.stl", "deep") == "parts/a.stl"
    assert portable_key("deep/parts/../parts/a.stl", tmp_path / "deep") == "parts/a.stl"
    monkeypatch.chdir(tmp_path / "deep" / "parts")
    assert portable_key("a.stl", "..") == "parts/a.stl"
    assert portable_key(file, "../..") == "deep/parts/a.stl"
    assert portable_key(file, tmp_path / "deep" / "counts") == "../parts/a.stl"


def test_a_tree_reached_through_a_link_has_the_same_keys(tmp_path):
    (tmp_path / "real" / "parts").mkdir(parents=True)
    os.symlink(tmp_path / "real", tmp_path / "link")
    assert portable_key(tmp_path / "link" / "parts" / "a.stl", tmp_path / "real") == "parts/a.stl"
    os.symlink(tmp_path / "elsewhere", tmp_path / "real" / "parts" / "b.stl")
    assert portable_key(tmp_path / "real/parts/b.stl", tmp_path / "real") == "parts/b.stl"


def test_the_table_names_each_mesh_once_and_aligns_its_figures():
    rows = [
        ("long/name.stl", Difference("open_edges", 3, 12, True)),
        ("long/name.stl", Difference("x", 100, 0, False)),
        ("b", Difference("x", 1, 2, True)),
    ]
    assert difference_table(rows).splitlines() == [
        "  file           what        stored -> now",
        "  long/name.stl  open_edges       3 -> 12",
        "                 x              100 -> 0",
        "  b              x                1 -> 2",
    ]


def test_entries_count_what_report_counts_and_the_mesh_as_a_whole():
    ball = trimesh.creation.icosphere(1)
    assert Entry.of(iw.check(ball)) == Entry({})
    holed = trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False)
    assert Entry.of(iw.check(holed)).counts == {"open_edges": 3}
    inverted = trimesh.Trimesh(ball.vertices, ball.faces[:, ::-1], process=False)
    assert Entry.of(iw.check(inverted)).counts == {"inside_out_components": 1, "no_volume": 1}
    nothing = trimesh.Trimesh(ball.vertices, ball.faces[:0], process=False)
    assert Entry.of(iw.check(nothing)).counts["empty"] == 1


def test_every_problem_of_a_clean_mesh_gone_bad_is_a_count_that_grew():
    """What fails without a baseline fails with one, unless it is stored."""
    ball = trimesh.creation.icosphere(1)
    v, f = ball.vertices, ball.faces
    nan = v.copy()
    nan[3] = float("nan")
    flat = v.copy()
    flat[f[0]] = flat[f[0, 0]]
    flipped = f.copy()
    flipped[0] = flipped[0, ::-1]
    bad = {
        "hole": (v, f[1:]),
        "empty": (v, f[:0]),
        "inverted": (v, f[:, ::-1]),
        "not finite": (nan, f),
        "collapsed": (flat, f),
        "flipped": (v, flipped),
        "again": (v, [*f, f[0]]),
        "not a triangle": (v, [*f, [0, 0, 1]]),
    }
    clean = Baseline({"a": Entry({})})
    for name, (vertices, faces) in bad.items():
        report = iw.check(trimesh.Trimesh(vertices, faces, process=False))
        assert judge(report), name
        assert judge(report, comparison=clean.compare("a", Entry.of(report))), name
        stored = Baseline({"a": Entry.of(report)}).compare("a", Entry.of(report))
        assert judge(report, comparison=stored) == (), name


def test_topology_says_how_many_components_of_each_genus():
    ball, ring = trimesh.creation.icosphere(1), trimesh.creation.torus(1.0, 0.3)
    patch = trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False)
    scene = trimesh.util.concatenate(
        [ball, ball.copy().apply_translation((3, 0, 0)), ring.apply_translation((9, 0, 0)),
         patch.apply_translation((0, 0, 9))]
    )  # fmt: skip
    assert Entry.of(iw.check(scene), topology=True).topology == {
        "components": 4,
        "components.genus_0": 2,
        "components.genus_1": 1,
        "components.open": 1,
    }


def test_counts_of_an_unfinished_search_do_not_pass():
    ball = trimesh.creation.icosphere(2)
    two = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0.1, 0.2))])
    report = iw.check(two, limit=1)
    assert not report.self_intersections.complete
    generous = Baseline({"a": Entry(dict.fromkeys(report.counts(), 10**6))})
    (failure,) = judge(report, comparison=generous.compare("a", Entry.of(report)))
    assert "stopped at its limit" in failure


def test_another_version_of_the_library_is_named():
    assert Baseline(library_version=iw.__version__).version_note() is None
    assert Baseline().version_note() is None
    assert "0.0.1" in Baseline(library_version="0.0.1").version_note()
