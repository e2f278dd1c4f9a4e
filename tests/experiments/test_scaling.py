"""The experiments at tiny sizes: files are written, and the document is only changed inside."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from experiments.record_benchmarks import DOCS, Record, replace_table
from experiments.record_benchmarks import run as record
from experiments.scaling import AXES, STYLES, Curve, Scaling, power_law, run
from implicit_warp.benchmark import Machine, Report, Row, Settings
from implicit_warp.errors import InputError


def test_a_tiny_study_writes_both_files(tmp_path):
    options = Scaling(
        out=tmp_path / "new", points=(20, 10), layers=(1, 2), resolution=(3, 4), fixed_points=10,
        rounds=1,
    )  # fmt: skip
    found = run(options)
    assert sorted(p.name for p in options.out.iterdir()) == ["scaling.json", "scaling.png"]
    assert json.loads((options.out / "scaling.json").read_text()) == json.loads(json.dumps(found))
    expected = {(operation, axis) for operation in STYLES for axis in AXES}
    expected -= {("solve and adjoint", "points")}  # no points in it
    curves = found["curves"]
    assert {(c["operation"], c["axis"]) for c in curves} == expected
    for curve in curves:
        assert list(curve["values"]) == sorted(getattr(options, curve["axis"]))
        assert all(0 < s < np.inf for s in curve["seconds"])
        assert np.isfinite(curve["exponent"])
    picture = np.asarray(Image.open(options.out / "scaling.png").convert("RGB"))
    assert picture.shape[1] > 2 * picture.shape[0]
    for colour, _ in STYLES.values():
        rgb = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        assert (np.abs(picture.astype(int) - rgb).max(-1) < 8).any(), f"no line of {colour}"


def test_the_exponent_is_that_of_the_upper_half():
    x = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
    assert power_law(x, 3.0 * x**2.5) == pytest.approx(2.5)
    # A constant cost per call flattens the lower half only.
    assert power_law(x, np.maximum(x**4, 8.0**4)) == pytest.approx(4.0)
    assert Curve("map", "points", [5], [1.0]).exponent is None


def some_report(value: float = 4.0) -> Report:
    row = Row("map_float32", "map, float32", "million points/s", value, 5.0, True, 30.0, 1.0)
    machine = Machine("2024-06-12", "a CPU", "", 2, 2, "PASSIVE", 0.5, 1.5, {"python": "3"}, 0)
    return Report(machine, Settings(), [row])


def test_recording_replaces_the_table_and_nothing_else(tmp_path):
    document = tmp_path / "benchmarks.md"
    original = (DOCS / "benchmarks.md").read_text()
    document.write_text(original)
    (tmp_path / "b.json").write_text(json.dumps(some_report(4.0).to_dict()))
    record(Record(report=tmp_path / "b.json", docs=tmp_path))
    first = document.read_text()
    assert some_report(4.0).markdown() in first
    mark = "<!-- table cpu -->"
    assert first[: first.index(mark)] == original[: original.index(mark)]
    end = "<!-- end of table cpu -->"
    assert first[first.index(end) :] == original[original.index(end) :]
    (tmp_path / "b.json").write_text(json.dumps(some_report(7.0).to_dict()))
    record(Record(report=tmp_path / "b.json", docs=tmp_path))
    assert document.read_text() == first.replace(
        some_report(4.0).markdown(), some_report(7.0).markdown()
    )


def test_the_document_has_marks_for_both_devices():
    text = (DOCS / "benchmarks.md").read_text()
    for name in ("cpu", "cuda"):
        assert "new figures" in replace_table(text, name, "new figures")
    with pytest.raises(InputError, match="no marks for this table"):
        replace_table(text, "tpu", "new figures")
    with pytest.raises(InputError, match="no marks for this table"):
        replace_table("<!-- end of table cpu --><!-- table cpu -->\n", "cpu", "new figures")


def test_the_document_shows_the_scaling_picture():
    assert "pictures/scaling.png" in (DOCS / "benchmarks.md").read_text()
    assert (DOCS / "pictures" / "scaling.png").is_file()
