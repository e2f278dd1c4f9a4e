"""`implicit-warp check` as a gate: files, exit codes, baselines, JSON and JUnit."""

from __future__ import annotations

import datetime
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from lxml import etree

import implicit_warp as iw
from implicit_warp.cli import main
from implicit_warp.mesh_files import WRITABLE
from implicit_warp.regression import Outcome, find_targets, junit_xml
from implicit_warp.regression.junit import writable


def ball(subdivisions=1):
    return trimesh.creation.icosphere(subdivisions)


def crossing(distance=0.5):
    return trimesh.util.concatenate([ball(), ball().apply_translation((distance, 0.1, 0.2))])


def holed(faces=1):
    return trimesh.Trimesh(ball().vertices, ball().faces[faces:], process=False)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A clean part, two that intersect differently, in a folder that is the working directory."""
    (tmp_path / "parts" / "deep").mkdir(parents=True)
    ball().export(tmp_path / "parts" / "clean.off")
    crossing().export(tmp_path / "parts" / "crossing.off")
    ball().export(tmp_path / "parts" / "deep" / "other.STL")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def paths(*arguments):
    return [str(target.path) for target in find_targets(arguments)]


def test_a_folder_means_its_meshes_at_any_depth(folder):
    (folder / "parts" / "notes.txt").write_text("no mesh")
    (folder / "parts" / ".hidden").mkdir()
    for hidden in ("parts/.hidden/a.stl", "parts/.b.stl"):
        (folder / hidden).write_text("solid")
    for suffix in WRITABLE:
        (folder / "parts" / "deep" / f"z{suffix}").write_text("")
    expected = ["parts/clean.off", "parts/crossing.off", "parts/deep/other.STL"]
    expected += sorted(f"parts/deep/z{suffix}" for suffix in WRITABLE)
    assert paths("parts") == expected


def test_a_pattern_means_what_it_matches_unless_a_file_has_that_name(folder):
    assert paths("parts/*.off") == ["parts/clean.off", "parts/crossing.off"]
    assert paths("parts/**/*.STL") == ["parts/deep/other.STL"]
    (folder / "parts" / "a[1].off").write_text("")
    assert paths("parts/a[1].off") == ["parts/a[1].off"]


def test_each_file_once_in_the_order_of_the_arguments(folder):
    assert paths("parts/deep", "parts", "./parts/clean.off")[0] == "parts/deep/other.STL"
    assert len(paths("parts/deep", "parts", "./parts/clean.off", folder / "parts")) == 3


@pytest.mark.parametrize("nothing", ["empty", "parts/*.glb", "none.stl"])
def test_what_names_no_file_is_an_error_and_stops_nothing(folder, nothing, capsys):
    (folder / "empty").mkdir()
    assert main(["check", nothing, "parts/clean.off"]) == 2
    shown = capsys.readouterr()
    assert nothing in shown.err
    assert "parts/clean.off: passed" in shown.out
    assert "1 passed, 0 failed, 1 unreadable" in shown.out


def test_exit_codes_rank_unreadable_over_failed_over_passed(folder, capsys):
    (folder / "broken.stl").write_text("solid but not really")
    assert main(["check", "parts/clean.off"]) == 0
    assert main(["check", "parts"]) == 1
    assert main(["check", "broken.stl", "parts"]) == 2
    shown = capsys.readouterr()
    assert "broken.stl" in shown.err
    assert "pairs of faces intersect" in shown.out


def test_a_file_without_permission_is_unreadable(folder, monkeypatch, capsys):
    from implicit_warp import checking

    def refuse(path, **_):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(checking, "check", refuse)
    assert main(["check", "parts/clean.off"]) == 2
    assert "Permission denied" in capsys.readouterr().err


def test_a_baseline_is_written_then_passes_then_fails_on_growth(folder, capsys):
    gate = ["check", "parts", "--baseline", "counts.json"]
    assert main(gate) == 2
    assert "--update" in capsys.readouterr().err
    assert main([*gate, "--update"]) == 0
    assert "3 files" in capsys.readouterr().out
    stored = json.loads((folder / "counts.json").read_text())["entries"]
    assert sorted(stored) == ["parts/clean.off", "parts/crossing.off", "parts/deep/other.STL"]
    pairs = iw.check(crossing()).num_self_intersections
    assert stored["parts/crossing.off"]["counts"]["self_intersections"] == pairs > 0

    before = (folder / "counts.json").read_bytes()
    assert main(gate) == 0
    assert "crossing.off: passed with tolerated defects" in capsys.readouterr().out

    holed(2).export(folder / "parts" / "clean.off")
    open_edges = len(iw.check(holed(2)).topology.open_edges)
    assert main(gate) == 1
    shown = capsys.readouterr().out
    assert re.search(rf"parts/clean.off  open_edges +0 -> {open_edges}\n", shown)
    assert "--update" in shown
    assert (folder / "counts.json").read_bytes() == before


def test_improvements_pass_and_ask_to_be_stored(folder, capsys):
    gate = ["check", "parts", "--baseline", "counts.json"]
    main([*gate, "--update"])
    ball().export(folder / "parts" / "crossing.off")
    capsys.readouterr()
    assert main(gate) == 0
    shown = capsys.readouterr().out
    assert "counts that shrank" in shown
    assert "--update" in shown
    assert main([*gate, "--update"]) == 0
    crossing().export(folder / "parts" / "crossing.off")
    assert main(gate) == 1


def test_growth_in_one_count_is_not_paid_for_by_another(folder):
    gate = ["check", "parts/crossing.off", "--baseline", "counts.json"]
    main([*gate, "--update"])
    holed().export(folder / "parts" / "crossing.off")  # no pairs any more, but open
    assert main(gate) == 1


def test_a_new_file_must_be_clean_and_the_limit_is_about_new_files_only(folder, capsys):
    gate = ["check", "parts", "--baseline", "counts.json"]
    main(["check", "parts/clean.off", "parts/deep", "--baseline", "counts.json", "--update"])
    assert main(gate) == 1
    shown = capsys.readouterr().out
    assert "parts/crossing.off) not stored and not clean" in shown
    pairs = iw.check(crossing()).num_self_intersections
    assert main([*gate, "--max-self-intersections", str(pairs)]) == 0
    crossing().export(folder / "parts" / "clean.off")  # this one is stored, as clean
    assert main([*gate, "--max-self-intersections", str(pairs)]) == 1


def test_entries_that_were_not_checked_are_mentioned_and_kept(folder, capsys):
    main(["check", "parts", "--baseline", "counts.json", "--update"])
    capsys.readouterr()
    assert main(["check", "parts/clean.off", "--baseline", "counts.json"]) == 0
    assert "2 files (parts/crossing.off, parts/deep/other.STL) stored, but" in (
        capsys.readouterr().out
    )
    before = (folder / "counts.json").read_bytes()
    assert main(["check", "parts/clean.off", "--baseline", "counts.json", "--update"]) == 0
    assert (folder / "counts.json").read_bytes() == before


def test_an_update_drops_files_that_are_gone_and_keeps_unreadable_ones(folder, capsys):
    main(["check", "parts", "--baseline", "counts.json", "--update"])
    before = json.loads((folder / "counts.json").read_text())["entries"]
    (folder / "parts" / "clean.off").unlink()
    (folder / "parts" / "crossing.off").write_text("OFF broken")
    assert main(["check", "parts", "--baseline", "counts.json", "--update"]) == 2
    after = json.loads((folder / "counts.json").read_text())["entries"]
    assert "parts/clean.off) removed" in capsys.readouterr().out
    del before["parts/clean.off"]
    assert after == before


def test_the_baseline_holds_from_any_working_directory(folder, monkeypatch):
    assert main(["check", "parts", "--baseline", "counts.json", "--update"]) == 0
    monkeypatch.chdir(folder / "parts")
    assert main(["check", ".", "--baseline", "../counts.json"]) == 0
    monkeypatch.chdir("/")
    assert main(["check", f"{folder}/parts", "--baseline", f"{folder}/counts.json"]) == 0
    os.rename(folder / "parts", folder / "moved")
    assert main(["check", f"{folder}/moved", "--baseline", f"{folder}/counts.json"]) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--update"], "add --baseline"),
        (["--baseline", "no/counts.json", "--update"], "folder does not exist"),
        (["--baseline", "parts/clean.off", "--update"], "use .json"),
        (["--baseline", "parts/clean.off"], "parts/clean.off"),
        (["--junit", "parts/clean.off"], "use .xml"),
        (["--junit", "no/a.xml"], "folder does not exist"),
        (["--max-self-intersections", "-1"], "not negative"),
        (["--referees", "nobody"], "nobody"),
    ],
)
def test_options_that_cannot_work_are_refused_before_the_work(folder, options, words, capsys):
    before = (folder / "parts" / "clean.off").read_bytes()
    try:
        code = main(["check", "parts/clean.off", *options])
    except SystemExit as exit_:  # tyro refuses unknown choices itself
        code = exit_.code
    assert code == 2
    shown = capsys.readouterr()
    assert words in shown.err + shown.out
    assert "passed" not in shown.out
    assert (folder / "parts" / "clean.off").read_bytes() == before


@pytest.mark.parametrize("update", [[], ["--update"]], ids=["compare", "update"])
def test_a_foreign_baseline_is_refused_and_never_overwritten(folder, update, capsys):
    (folder / "counts.json").write_text('{"precious": 1}')
    assert main(["check", "parts", "--baseline", "counts.json", *update]) == 2
    assert "holds no baseline" in capsys.readouterr().err
    assert (folder / "counts.json").read_text() == '{"precious": 1}'


def test_standard_output_is_pure_json_and_has_everything(folder, capsys):
    gate = ["check", "parts", "none.stl", "--baseline", "counts.json", "--json"]
    main(["check", "parts", "--baseline", "counts.json", "--update"])
    crossing(0.3).export(folder / "parts" / "clean.off")
    (folder / "parts" / "deep" / "other.STL").unlink()
    capsys.readouterr()
    assert main(gate) == 2
    shown = capsys.readouterr()
    told = json.loads(shown.out)
    assert "none.stl" in shown.err
    assert told["exit_code"] == 2
    assert [told[word] for word in ("passed", "failed", "unreadable")] == [1, 1, 1]
    clean, same, none = told["files"].values()
    assert [f["status"] for f in (clean, same, none)] == ["failed", "passed", "unreadable"]
    assert [f["ok"] for f in (clean, same, none)] == [False, False, False]
    pairs = clean["counts"]["self_intersections"]
    assert clean["baseline"]["regressions"]["self_intersections"] == [0, pairs]
    assert same["baseline"] == {
        "key": "parts/crossing.off", "known": True, "regressions": {}, "improvements": {}
    }  # fmt: skip
    assert "no such file" in none["error"]
    assert told["baseline"]["not_checked"] == ["parts/deep/other.STL"]
    assert told["baseline"]["gone"] == ["parts/deep/other.STL"]


def test_evidence_shows_what_failed_and_nothing_else(folder, capsys, monkeypatch):
    # Drawing takes seconds and has tests of its own.
    monkeypatch.setattr(iw.CheckReport, "write_picture", lambda self, path: path.touch())
    assert main(["check", "parts", "--evidence", "shown"]) == 1
    files = sorted(str(p) for p in (folder / "shown").rglob("*") if p.is_file())
    where = folder / "shown" / "parts" / "crossing.off"
    assert files == [f"{where}.ply", f"{where}.png"]
    assert "see shown/parts/crossing.off.png" in capsys.readouterr().out
    monkeypatch.chdir(folder / "parts" / "deep")
    assert main(["check", "../crossing.off", "--evidence", "shown", "--json"]) == 1
    (told,) = json.loads(capsys.readouterr().out)["files"].values()
    assert told["evidence"] == ["shown/crossing.off.ply", "shown/crossing.off.png"]


def test_evidence_is_not_checked_in_its_turn(folder, monkeypatch):
    monkeypatch.setattr(iw.CheckReport, "write_picture", lambda self, path: path.touch())
    for _ in range(2):
        assert main(["check", ".", "--evidence", "shown", "--junit", "out.xml"]) == 1
        assert etree.parse(folder / "out.xml").find("testsuite").get("tests") == "3"


def test_evidence_that_cannot_be_written_changes_no_verdict(folder, capsys):
    (folder / "shown").mkdir()
    (folder / "shown" / "parts").write_text("a file where a folder should be")
    assert main(["check", "parts", "--evidence", "shown"]) == 1
    shown = capsys.readouterr()
    assert "no picture" in shown.err
    assert "1 failed" in shown.out


def test_names_that_are_no_text_are_no_crash(tmp_path, capsys):
    """In a process of its own: an odd byte in a name, and a standard output that is ASCII."""
    odd = os.fsencode(tmp_path) + b"/odd \xff\x1b<&>.off"
    holed().export(tmp_path / "plain.off")
    os.rename(tmp_path / "plain.off", odd)
    arguments = ["check", os.fsdecode(odd), "--baseline", str(tmp_path / "counts.json")]
    arguments += ["--junit", str(tmp_path / "a.xml")]
    ran = subprocess.run(
        [sys.executable, "-m", "implicit_warp.cli", *arguments, "--update"],
        capture_output=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert ran.returncode == 0, ran.stderr.decode()
    assert main([*arguments, "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)["files"]) == [os.fsdecode(odd)]
    case = etree.parse(tmp_path / "a.xml").find(".//testcase")
    assert case.get("name").endswith(r"odd \udcff\x1b<&>.off")


# The part that the schemas of Ant and of Jenkins' xUnit plugin have in common, so that a document
# valid under this one is valid under both.
SCHEMA = """
<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema">
  <xs:simpleType name="seconds">
    <xs:restriction base="xs:string"><xs:pattern value="[0-9]{1,6}\\.[0-9]{3}"/></xs:restriction>
  </xs:simpleType>
  <xs:simpleType name="moment">
    <xs:restriction base="xs:dateTime">
      <xs:pattern value="[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9]{2}:[0-9]{2}:[0-9]{2}"/>
    </xs:restriction>
  </xs:simpleType>
  <xs:simpleType name="word">
    <xs:restriction base="xs:token"><xs:minLength value="1"/></xs:restriction>
  </xs:simpleType>
  <xs:complexType name="result"><xs:simpleContent><xs:extension base="xs:string">
    <xs:attribute name="message" type="xs:string" use="required"/>
    <xs:attribute name="type" type="word" use="required"/>
  </xs:extension></xs:simpleContent></xs:complexType>
  <xs:element name="testsuites"><xs:complexType><xs:sequence>
    <xs:element name="testsuite" maxOccurs="unbounded"><xs:complexType>
      <xs:sequence>
        <xs:element name="properties"><xs:complexType><xs:sequence>
          <xs:element name="property" minOccurs="0" maxOccurs="unbounded"><xs:complexType>
            <xs:attribute name="name" type="word" use="required"/>
            <xs:attribute name="value" type="xs:string" use="required"/>
          </xs:complexType></xs:element>
        </xs:sequence></xs:complexType></xs:element>
        <xs:element name="testcase" minOccurs="0" maxOccurs="unbounded"><xs:complexType>
          <xs:choice minOccurs="0">
            <xs:element name="failure" type="result"/>
            <xs:element name="error" type="result"/>
          </xs:choice>
          <xs:attribute name="classname" type="word" use="required"/>
          <xs:attribute name="name" type="word" use="required"/>
          <xs:attribute name="time" type="seconds" use="required"/>
        </xs:complexType></xs:element>
        <xs:element name="system-out" type="xs:string"/>
        <xs:element name="system-err" type="xs:string"/>
      </xs:sequence>
      <xs:attribute name="name" type="word" use="required"/>
      <xs:attribute name="id" type="xs:int" use="required"/>
      <xs:attribute name="package" type="word" use="required"/>
      <xs:attribute name="hostname" type="word" use="required"/>
      <xs:attribute name="timestamp" type="moment" use="required"/>
      <xs:attribute name="tests" type="xs:int" use="required"/>
      <xs:attribute name="failures" type="xs:int" use="required"/>
      <xs:attribute name="errors" type="xs:int" use="required"/>
      <xs:attribute name="skipped" type="xs:int" use="required"/>
      <xs:attribute name="time" type="seconds" use="required"/>
    </xs:complexType></xs:element>
  </xs:sequence></xs:complexType></xs:element>
</xs:schema>
"""


@pytest.fixture(scope="module")
def schema():
    return etree.XMLSchema(etree.fromstring(SCHEMA))


def test_junit_is_valid_and_says_what_the_run_said(folder, schema):
    (folder / "broken.stl").write_text("solid but not really")
    assert main(["check", "parts", "broken.stl", "--junit", "out.xml"]) == 2
    document = etree.parse(folder / "out.xml")
    schema.assertValid(document)
    suite = document.find("testsuite")
    assert suite.get("name") == "implicit-warp check"
    assert [suite.get(a) for a in ("tests", "failures", "errors")] == ["4", "1", "1"]
    assert [(c.get("name"), *(r.tag for r in c)) for c in suite.iter("testcase")] == [
        ("parts/clean.off",),
        ("parts/crossing.off", "failure"),
        ("parts/deep/other.STL",),
        ("broken.stl", "error"),
    ]
    pairs = iw.check(crossing()).num_self_intersections
    assert f"{pairs} pairs of faces intersect" in suite.find(".//failure").get("message")
    assert "watertight" in suite.find(".//failure").text
    assert "broken.stl" in suite.find(".//error").get("message")
    properties = {p.get("name"): p.get("value") for p in suite.iter("property")}
    assert properties["parts/crossing.off: self_intersections"] == str(pairs)
    assert properties["implicit_warp"] == iw.__version__


def test_junit_reports_growth_and_is_written_on_success_too(folder, schema):
    gate = ["check", "parts", "--baseline", "counts.json", "--junit", "out.xml"]
    for options, failures in (["--update"], 0), ([], 0):
        assert main([*gate, *options]) == 0
        document = etree.parse(folder / "out.xml")
        schema.assertValid(document)
        assert document.find("testsuite").get("failures") == str(failures)
    holed().export(folder / "parts" / "clean.off")
    assert main(gate) == 1
    failure = etree.parse(folder / "out.xml").find(".//failure")
    assert failure.get("type") == "CountsGrew"
    assert failure.get("message") == "open_edges: 0 -> 3"


@pytest.mark.parametrize("seed", range(5))
def test_any_text_makes_a_well_formed_document(schema, seed):
    rng = np.random.default_rng(seed)
    codes = [*range(0x100), 0x7F, 0xD800, 0xDFFF, 0xFFFE, 0xFFFF, 0x1F600, 0x2028, 0x10FFFF]
    text = "".join(map(chr, rng.permutation(codes))) + "]]><!--"
    outcomes = [Outcome(f"a {text}", 1234.5678, error=ValueError(text))]
    document = etree.fromstring(junit_xml(outcomes, datetime.datetime(2025, 1, 2, 3, 4, 5)))
    schema.assertValid(document)
    assert document.find(".//error").text == writable(text)


def test_readable_text_is_kept_and_what_xml_lacks_is_named():
    assert writable("Gehäuse 😀\t<&>\n") == "Gehäuse 😀\t<&>\n"
    assert writable("\x00\x1b\r\ud800\uffff") == r"\x00\x1b\r\ud800\uffff"


def test_the_schema_refuses_what_readers_would_stumble_over(schema):
    good = junit_xml([Outcome("a", 0.0, error=ValueError("x"))]).decode()
    schema.assertValid(etree.fromstring(good.encode()))
    for old, new in (
        ('tests="1"', ""),
        ('tests="1"', 'tests="one"'),
        ('type="ValueError"', ""),
        ('name="a"', 'name=""'),
        ("<system-out />", ""),
        ("</testcase>", "<failure message='' type='x'/></testcase>"),
        ('time="0.000"', 'time="1e-5"'),
    ):
        assert old in good
        bad = etree.fromstring(good.replace(old, new).encode())
        assert not schema.validate(bad), (old, new)


def test_a_terminal_shows_a_bar_and_loses_no_report(folder, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    assert main(["check", "parts"]) == 1
    shown = capsys.readouterr()
    assert shown.out.count(": passed,") == 2
    assert "parts/crossing.off: failed" in shown.out


def test_evidence_that_cannot_be_written_is_refused_before_the_work(tmp_path, capsys):
    trimesh.creation.box().export(tmp_path / "box.ply")
    (tmp_path / "file").write_text("")
    code = main(["check", str(tmp_path / "box.ply"), "--evidence", str(tmp_path / "file" / "x")])
    assert code == 2
    assert "no writable folder" in capsys.readouterr().err


def test_evidence_never_becomes_a_mesh_to_check(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "parts").mkdir()
    trimesh.creation.box().export(tmp_path / "parts" / "box.ply")
    (tmp_path / "shown").mkdir()
    trimesh.creation.box().export(tmp_path / "shown" / "old.ply")
    for folder in ("parts", ".", str(tmp_path)):
        assert main(["check", "parts", "--evidence", folder]) == 2
        assert "choose a folder of its own" in capsys.readouterr().err
    assert main(["check", "**/*.ply", "--evidence", "shown"]) == 0
    assert "old.ply" not in capsys.readouterr().out
