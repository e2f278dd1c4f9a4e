"""setup.cfg, constraints.txt and docs/decisions.md agree with each other and with the code."""

from __future__ import annotations

import ast
import configparser
import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PACKAGES = ("fields", "implicit_warp")


def read_setup(text: str) -> dict[str, Requirement]:
    """Every direct dependency in a setup.cfg, extras included, by canonical name."""
    parser = configparser.ConfigParser()
    parser.read_string(text)
    blocks = [
        parser["options"]["install_requires"],
        *parser["options.extras_require"].values(),
    ]
    lines = [line.strip() for block in blocks for line in block.splitlines()]
    found = [Requirement(line) for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(item.name): item for item in found}


def read_constraints(text: str) -> dict[str, str]:
    """Exact versions by canonical name; a line that is not `name==version` is an error."""
    lines = [line for line in text.splitlines() if line and not line.startswith("#")]
    matches = {line: re.fullmatch(r"([\w.-]+)==([\w.]+)", line) for line in lines}
    assert all(matches.values()), [line for line, match in matches.items() if not match]
    return {canonicalize_name(m[1]): m[2] for m in matches.values() if m}


def table_rows(text: str) -> set[str]:
    """The names in the first column of a document's tables."""
    return {canonicalize_name(m) for m in re.findall(r"^\| *`?([\w.-]+)`? *\|", text, re.M)}


REQUIRED = read_setup((ROOT / "setup.cfg").read_text())
PINNED = read_constraints((ROOT / "constraints.txt").read_text())


@pytest.mark.parametrize("name", sorted(REQUIRED))
def test_every_direct_dependency_is_pinned_inside_its_range(name):
    assert name in PINNED
    assert REQUIRED[name].specifier.contains(PINNED[name])


@pytest.mark.parametrize("name", sorted(REQUIRED))
def test_every_direct_dependency_has_its_reason_written_down(name):
    assert name in table_rows((ROOT / "docs" / "decisions.md").read_text())


def test_a_missing_dependency_would_be_noticed():
    setup = (
        "[options]\ninstall_requires =\n    numpy>=2\n[options.extras_require]\ntest =\n  Py_Test"
    )
    assert set(read_setup(setup)) == {"numpy", "py-test"}
    assert table_rows("| name | why |\n|---|---|\n| `numpy` | arrays |") >= {"numpy"}
    assert "scipy" not in table_rows("| numpy | not scipy |")
    with pytest.raises(AssertionError):
        read_constraints("numpy>=2")


def test_every_library_the_code_imports_is_declared():
    distributions = importlib.metadata.packages_distributions()
    undeclared = set()
    for path in (p for package in PACKAGES for p in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            else:
                continue
            for top in (name.partition(".")[0] for name in names):
                if top in sys.stdlib_module_names or top in PACKAGES:
                    continue
                owners = {canonicalize_name(name) for name in distributions.get(top, [top])}
                if not owners & set(REQUIRED):
                    undeclared.add((path.relative_to(ROOT).as_posix(), top))
    # triton comes with the CUDA builds of torch and is only ever imported there.
    assert {item for item in undeclared if item[1] != "triton"} == set()


def test_the_version_is_a_literal_that_setup_cfg_can_read_without_importing_torch():
    tree = ast.parse((ROOT / "implicit_warp" / "__init__.py").read_text())
    versions = [
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__version__"
    ]
    assert len(versions) == 1
    assert re.fullmatch(r"\d+\.\d+\.\d+", versions[0])


def test_make_explains_an_unsupported_python(tmp_path):
    for name in ("Makefile", "setup.cfg", "pyproject.toml", "constraints.txt"):
        (tmp_path / name).write_text((ROOT / name).read_text())
    result = subprocess.run(
        ["make", "-C", str(tmp_path), "test", "PYTHON=false"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode != 0
    assert "needs Python 3.11, 3.12 or 3.13" in result.stderr
    assert "make PYTHON=" in result.stderr
    assert not (tmp_path / ".venv").exists()
