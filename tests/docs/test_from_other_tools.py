"""The guide for users of other tools: its programs run, and its tables name what exists."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import fields

PAGE = (Path(__file__).parents[2] / "docs" / "from_other_tools.md").read_text(encoding="utf-8")
PROGRAMS = [
    block
    for block in re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    if block.startswith("import fields")
]


def test_each_tool_has_its_program():
    assert len(PROGRAMS) == 3


@pytest.mark.parametrize("index", range(3))
def test_a_program_runs(index):
    names: dict[str, object] = {}
    exec(compile(PROGRAMS[index], f"program {index}", "exec"), names)
    if "mesh" in names:
        assert names["mesh"].is_watertight
    else:
        part = names["part"]
        np.testing.assert_array_equal(part.bounds[:, :2], [[-40, -30], [40, 30]])
        # In the bore, in a corner hole, in the plate.
        at = np.array([(0, 0, 1), (32, -22, 1), (20, 10, 1)])
        np.testing.assert_array_equal(part(at) < 0, [False, False, True])


def test_the_first_column_names_what_exists():
    rows = re.findall(r"^\| (`.*?) \|", PAGE, flags=re.MULTILINE)
    calls = {name for row in rows for name in re.findall(r"(?<![\w.])([a-z_]+)\(", row)}
    calls |= {name for row in rows for name in re.findall(r"\ba\.([a-z_]+)\(", row)}
    assert len(calls) > 30
    unknown = calls - set(fields.__all__)
    assert unknown == set()
