"""experiments -> implicit_warp -> fields, never back; and nothing heavy is imported unasked.

Two checkers. One reads every module's syntax tree, so that it also sees imports no test
happens to execute. The other really imports the packages while the heavy libraries are
made unimportable. Both are themselves tested on trees that break the rules.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# What each package may import of the project itself.
ALLOWED = {
    "fields": {"fields"},
    "implicit_warp": {"implicit_warp", "fields"},
    "experiments": {"experiments", "implicit_warp", "fields"},
}
OURS = {*ALLOWED, "tests", "examples"}

FIELDS_LIBRARIES = {"numpy", "torch"}
FIELDS_ON_USE = {
    "fields/evaluators/threads.py": {"numba"},
    "fields/grid_files.py": {"nrrd"},
    "fields/mesh_files.py": {"trimesh"},
    "fields/neural/files.py": {"safetensors"},
    "fields/profiles/drawing.py": {"fontTools"},
    "fields/profiles/filling.py": {"manifold3d"},
    "fields/profiles/lettering.py": {"fontTools"},
    "fields/profiles/pens.py": {"fontTools"},
    "fields/profiles/picture.py": {"PIL", "skimage"},
    "fields/spline.py": {"scipy"},
}
# Compiled kernels: these modules import numba, and are themselves imported on use.
FIELDS_KERNELS = {
    "fields/jit.py",
    "fields/kernels/distance_transform.py",
    "fields/kernels/interpolation.py",
    "fields/kernels/triangle_tree.py",
    "fields/kernels/winding_number.py",
    "fields/neural/enclosure_kernels.py",
    "fields/neural/hash_kernels.py",
    "fields/profiles/outline_kernel.py",
}

HEAVY = (
    *("open3d", "pymeshlab", "trimesh", "skimage", "manifold3d", "tyro", "rich", "PIL"),
    *("matplotlib", "nrrd", "fontTools", "imageio_ffmpeg"),
)


@dataclass(frozen=True)
class Import:
    """One imported module: its absolute name, where, and whether it waits for a call."""

    module: str
    line: int
    deferred: bool

    @property
    def top(self) -> str:
        return self.module.partition(".")[0]


def imports_of(source: str, module: str, is_package: bool) -> list[Import]:
    """Every import in `source`, the code of `module`, relative names made absolute.

    Deferred means inside a function or under `if TYPE_CHECKING`: importing the module does not
    execute it.
    """

    def visit(node: ast.AST, deferred: bool) -> Iterator[Import]:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield Import(alias.name, node.lineno, deferred)
        elif isinstance(node, ast.ImportFrom):
            yield Import(absolute(node), node.lineno, deferred)
        elif isinstance(node, ast.Call) and (name := imported_by_call(node)):
            yield Import(name, node.lineno, deferred)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for child in node.body:
                yield from visit(child, True)
            for child in node.orelse:
                yield from visit(child, deferred)
            return
        inside = deferred or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            yield from visit(child, inside)

    def absolute(node: ast.ImportFrom) -> str:
        if node.level == 0:
            return node.module or ""
        package = module.split(".") if is_package else module.split(".")[:-1]
        base = package[: len(package) - (node.level - 1)]
        return ".".join([*base, *([node.module] if node.module else [])])

    return list(visit(ast.parse(source), False))


def imported_by_call(node: ast.Call) -> str | None:
    """The module of `importlib.import_module("x")` and `__import__("x")`, else None."""
    name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    if name not in {"import_module", "__import__"} or not node.args:
        return None
    argument = node.args[0]
    return argument.value if isinstance(argument, ast.Constant) else None


def violations(root: Path) -> list[str]:
    """Every import in the packages under `root` that breaks a rule, as `file:line: reason`."""
    found = []
    for package, allowed in ALLOWED.items():
        for path in sorted((root / package).rglob("*.py")):
            relative = path.relative_to(root)
            is_package = path.name == "__init__.py"
            parts = relative.parent.parts if is_package else relative.with_suffix("").parts
            for item in imports_of(path.read_text(), ".".join(parts), is_package):
                if item.top in OURS:
                    reason = None if item.top in allowed else "is the wrong direction"
                elif package == "fields":
                    reason = fields_reason(item, relative.as_posix())
                else:
                    reason = None
                if reason:
                    found.append(f"{relative}:{item.line}: import of {item.module} {reason}")
    return found


def fields_reason(item: Import, path: str) -> str | None:
    """Why `fields` may not import `item`, which is not the project's own, or None."""
    if item.top in sys.stdlib_module_names or item.top in FIELDS_LIBRARIES:
        return None
    if item.top == "numba" and path in FIELDS_KERNELS:
        return None
    if item.top not in FIELDS_ON_USE.get(path, set()):
        return "is not one of numpy, torch and the standard library"
    return None if item.deferred else "belongs inside the function that uses it"


def import_without_heavy(tree: Path) -> subprocess.CompletedProcess[str]:
    """Import both packages of `tree` in a fresh interpreter that refuses the heavy libraries."""
    program = f"""
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {HEAVY!r}:
            raise ImportError("heavy import of " + name)

sys.meta_path.insert(0, Refuse())
sys.path.insert(0, {str(tree)!r})
import fields, implicit_warp
assert "numba" not in sys.modules  # kernels are loaded on use
for package in (fields, implicit_warp):
    assert package.__file__.startswith({str(tree)!r}), package.__file__
    for name in getattr(package, "__all__", ()):
        getattr(package, name)  # public names may be loaded on first use
"""
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )


def test_imports_point_one_way():
    assert violations(ROOT) == []


def test_every_package_is_seen():
    for package in ("fields", "implicit_warp"):
        assert (ROOT / package / "__init__.py").is_file()


def test_the_packages_import_without_the_heavy_libraries():
    result = import_without_heavy(ROOT)
    assert result.returncode == 0, result.stderr


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small project that keeps every rule."""
    files = {
        "fields/__init__.py": "from . import mesh\nimport math, numpy as np, torch.nn",
        "fields/mesh.py": "",
        "fields/mesh_files.py": "def load():\n    import trimesh\n    return trimesh",
        "implicit_warp/__init__.py": "from fields import mesh\nfrom .maps import affine",
        "implicit_warp/maps/__init__.py": "",
        "implicit_warp/maps/affine.py": "from ..maps import affine\nimport fields.mesh, trimesh",
        "experiments/table.py": "import implicit_warp, fields, matplotlib",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def test_a_clean_tree_passes(tree):
    assert violations(tree) == []


@pytest.mark.parametrize(
    ("file", "line", "complaint"),
    [
        ("fields/mesh.py", "import implicit_warp", "implicit_warp is the wrong direction"),
        ("fields/mesh.py", "from implicit_warp.maps import affine", "wrong direction"),
        ("fields/mesh.py", "def f():\n    import implicit_warp", "wrong direction"),
        ("fields/mesh.py", "import importlib\nimportlib.import_module('implicit_warp')", "wrong"),
        ("fields/mesh.py", "__import__('experiments.table')", "wrong direction"),
        ("fields/mesh.py", "if 1:\n    try:\n        import tests\n    finally: pass", "wrong"),
        ("fields/mesh.py", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n"
         "    import implicit_warp", "wrong direction"),
        ("fields/mesh.py", "import scipy.sparse", "scipy.sparse is not one of numpy"),
        ("fields/mesh_files.py", "import trimesh", "inside the function"),
        ("fields/mesh_files.py", "class Mesh:\n    import trimesh", "inside the function"),
        ("fields/csg.py", "def f():\n    import open3d", "is not one of numpy"),
        ("fields/deep/er.py", "from ...implicit_warp import maps", "wrong direction"),
        ("implicit_warp/maps/affine.py", "import experiments.table", "wrong direction"),
        ("implicit_warp/maps/affine.py", "from ...experiments import table", "wrong direction"),
        ("implicit_warp/maps/affine.py", "import tests.conftest", "wrong direction"),
        ("experiments/table.py", "import tests", "wrong direction"),
    ],
)  # fmt: skip
def test_sabotage_is_reported_with_its_place(tree, file, line, complaint):
    path = tree / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n" + line)
    (report,) = violations(tree)
    assert complaint in report
    expected = next(i for i, text in enumerate(line.split("\n"), 2) if complaint_line(text))
    assert report.startswith(f"{Path(file)}:{expected}: ")


def complaint_line(text: str) -> bool:
    """Whether a sabotaged line is the offending one: it names what must not be imported."""
    return any(
        name in text
        for name in ("implicit_warp", "experiments", "tests", "scipy", "open3d", "trimesh")
    )


@pytest.mark.parametrize("library", HEAVY)
def test_a_heavy_import_at_module_level_is_noticed(tree, library):
    (tree / "implicit_warp/maps/affine.py").write_text(f"import {library}")
    (tree / "fields/__init__.py").write_text("")
    result = import_without_heavy(tree)
    assert result.returncode != 0
    assert f"heavy import of {library}" in result.stderr


def test_a_heavy_import_behind_a_lazy_name_is_noticed(tree):
    (tree / "fields/__init__.py").write_text("")
    (tree / "implicit_warp/maps/affine.py").write_text("import trimesh\ndef Affine(): pass")
    (tree / "implicit_warp/__init__.py").write_text(
        "__all__ = ['Affine']\n"
        "def __getattr__(name):\n"
        "    from implicit_warp.maps.affine import Affine\n"
        "    return Affine\n"
    )
    result = import_without_heavy(tree)
    assert result.returncode != 0
    assert "heavy import of trimesh" in result.stderr


def test_a_heavy_import_inside_a_function_is_fine(tree):
    (tree / "implicit_warp/maps/affine.py").write_text("def f():\n    import trimesh")
    (tree / "fields/__init__.py").write_text("")
    result = import_without_heavy(tree)
    assert result.returncode == 0, result.stderr
