"""The gallery shows everything there is; its fields are small enough to be drawn."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

import fields

DOCS = Path(__file__).parents[2] / "docs"
GALLERY = runpy.run_path(str(DOCS / "make_gallery.py"))
SHEETS = GALLERY["sheets"]()
ENTRIES = {name: text for sheet in SHEETS.values() for name, text in sheet["entries"].items()}


def test_no_primitive_or_operation_is_missing():
    assert GALLERY["missing"](SHEETS) == set()


def test_no_name_is_shown_twice_or_unknown():
    assert sum(len(sheet["entries"]) for sheet in SHEETS.values()) == len(ENTRIES)
    assert all(hasattr(fields, name) for name in ENTRIES)


@pytest.mark.parametrize(("name", "text"), ENTRIES.items(), ids=ENTRIES)
def test_an_entry_is_a_bounded_field_made_by_what_it_is_called(name, text):
    field = fields.parse(text)
    assert field.bounds is not None
    assert (
        f"{name}(" in text or {"union": "|", "intersection": "&", "difference": "-"}[name] in text
    )


def test_the_page_has_a_line_for_every_entry():
    page = GALLERY["markdown"](SHEETS)
    for name in ENTRIES:
        assert f"{name}(" in page
    assert "| `ellipsoid(radii, exact=False)` |" in page
    assert "Lipschitz 1 |" in page
