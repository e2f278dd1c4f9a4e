"""The region language: what it reads, and everything it must not."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

import fields as sdf
from fields import InputError, parse


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("sphere(1) & box(1.5)", sdf.sphere(1) & sdf.box(1.5)),
        ("  below(-0.6)\n", sdf.below(-0.6)),
        ("above(+0.5)", sdf.above(0.5)),
        ("box([1, 2, 3], center=(0, -1e-1, 0))", sdf.box((1, 2, 3), center=(0, -0.1, 0))),
        ("cylinder(0.5).orient('x')", sdf.cylinder(0.5).orient("x")),
        ("sphere(1) - box(1) - box(2)", (sdf.sphere(1) - sdf.box(1)) - sdf.box(2)),
        ("sphere(1) - (box(1) - box(2))", sdf.sphere(1) - (sdf.box(1) - sdf.box(2))),
        ("sphere(1) | box(1) & box(2)", sdf.sphere(1) | (sdf.box(1) & sdf.box(2))),
        ("union(sphere(1), box(1), smooth=0.1)", sdf.sphere(1).union(sdf.box(1), smooth=0.1)),
        ("translate(sphere(1), offset=(1, 0, 0))", sdf.sphere(1).translate((1, 0, 0))),
        ("(\n  sphere(1)\n  | box(1)\n)", sdf.sphere(1) | sdf.box(1)),
    ],
)
def test_reads_what_users_write(text, field):
    assert parse(text).expression is field.expression


@pytest.mark.parametrize(
    ("field", "text"),
    [
        (sdf.sphere(1) & sdf.box(1.5), "sphere(1.0) & box(1.5)"),
        (sdf.cylinder(0.5).orient("x"), "cylinder(0.5).orient('x')"),
        (sdf.cylinder(0.5, 2), "cylinder(0.5, height=2.0)"),
        (sdf.sphere(1, center=[0, 0, 0]), "sphere(1.0)"),
        (sdf.sphere(1, (0, 0, 2)), "sphere(1.0, center=(0.0, 0.0, 2.0))"),
        (sdf.box(1).rotate(30), "box(1.0).rotate(30.0)"),
        (sdf.box(1).rotate(30, axis="x"), "box(1.0).rotate(30.0, axis='x')"),
        (sdf.union(sdf.box(1), sdf.box(2), sdf.box(3)), "box(1.0) | box(2.0) | box(3.0)"),
        (
            sdf.sphere(1) - (sdf.box(1) | sdf.box(2)).translate((0, 0, 1)),
            "sphere(1.0) - (box(1.0) | box(2.0)).translate((0.0, 0.0, 1.0))",
        ),
        (
            sdf.sphere(1) - (sdf.box(1) - sdf.box(2)),
            "sphere(1.0) - (box(1.0) - box(2.0))",
        ),
        (sdf.sphere(1).union(sdf.box(1), smooth=0.5), "sphere(1.0).union(box(1.0), smooth=0.5)"),
        (sdf.sphere(1).remap(abs, name="bend"), "sphere(1.0).remap(<bend>)"),
        (sdf.from_function(abs) | sdf.box(1), "<abs> | box(1.0)"),
        (sdf.Field(sdf.sphere(1).expression), "<expression>"),
    ],
)
def test_repr_is_the_expression_that_made_the_field(field, text):
    assert repr(field) == text


def test_the_record_does_not_change_with_the_arrays_it_was_made_from():
    offset = np.zeros(3)
    moved = sdf.sphere(1).translate(offset)
    offset[:] = 7
    assert repr(moved) == "sphere(1.0).translate((0.0, 0.0, 0.0))"


ATTACKS = [
    "__import__('os').system('touch stolen')",
    "open('/etc/passwd')",
    "eval('1')",
    "exec('1')",
    "print(sphere(1))",
    "Field(1)",
    "parse('sphere(1)')",
    "from_function(1)",
    "sphere(1).__class__",
    "sphere(1).__class__.__mro__",
    "sphere(1).__init__(2)",
    "sphere(1).remap(abs)",
    "sphere(1).tape",
    "sphere(1).gradient((0, 0, 0))",
    "sphere(1)((0, 0, 0))",
    "sphere.__globals__",
    "sphere.__wrapped__(1)",
    "sphere",
    "'{0.__class__}'.format(sphere(1))",
    "''.join(('a',))",
    "(lambda: sphere(1))()",
    "[sphere(r) for r in (1, 2)]",
    "[sphere(1)][0]",
    "{'a': sphere(1)}",
    "{sphere(1)}",
    "sphere(1) if 1 else box(1)",
    "sphere(1) and box(1)",
    "sphere(1) < box(1)",
    "not sphere(1)",
    "not sphere(1)",
    "-sphere(1)",
    "-'x'",
    "--True",
    "(s := sphere(1))",
    "f'{sphere(1)}'",
    "sphere(*(1,))",
    "sphere(**{'radius': 1})",
    "sphere(9**9**9)",
    "sphere(1 << 99999)",
    "sphere('1' * 999999999)",
    "sphere(2 * 3)",
    "sphere(1 - 2)",
    "sphere(1) + box(1)",
    "sphere(1) << box(1)",
    "~3",
    "sphere(1) | 3",
    "sphere(1) - 3",
    "sphere(True)",
    "sphere(None)",
    "sphere(...)",
    "sphere(1j)",
    "sphere(b'1')",
    "sphere(1e999)",
    "sphere(" + "9" * 4000 + ")",
    "sphere(" + "9" * 5000 + ")",
    "sphere()",
    "sphere(1, 2, 3, 4)",
    "sphere(size=1)",
    "sphere(sphere(1))",
    "box((1, sphere(1), 2))",
    "sphere(1).translate(sphere(1))",
    "union()",
    "union(1, 2)",
    "sphere(-1)",
    "rotate(90)",
    "import os",
    "x = sphere(1)",
    "sphere(1); box(1)",
    "sphere(1)\nbox(1)",
    "sphere(1",
    "sphere(1))",
    "",
    "   ",
    "# sphere(1)",
    "3",
    "'sphere(1)'",
    "(sphere(1), box(1))",
    "sphere(1)\0",
    "mesh('part.stl')",
    "mesh(source='part.stl')",
    "text('abc')",
    "svg('drawing.svg')",
    "image('picture.png')",
    "await sphere(1)",
    "yield sphere(1)",
]


@pytest.mark.parametrize("text", ATTACKS, ids=range(len(ATTACKS)))
def test_refuses_everything_else(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as caught:
        parse(text)
    assert caught.value.remedy
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "text",
    [
        "sphere(1)" + ".negate()" * 20_000,
        " | ".join(["sphere(1)"] * 9_000),
        "(" * 5_000 + "sphere(1)" + ")" * 5_000,
        "sphere(" + "-" * 50_000 + "1)",
        "~" * 50_000 + "sphere(1)",
        "union(" * 90 + "sphere(1)" + ")" * 90 + " - " + "sphere(1)" * 120_000,
        "translate(" * 3_000,
    ],
    ids=["methods", "operators", "parentheses", "signs", "complements", "long", "open"],
)
def test_refuses_what_is_too_long_or_too_deep(text):
    with pytest.raises(InputError):
        parse(text)


def test_reads_chains_of_hundreds_of_steps():
    field = sdf.sphere(1)
    for i in range(400):
        field = field.union(sdf.box(0.1, (i, 0, 0)), smooth=0.1).translate((0, 0, 1))
    for i in range(400):
        field = field | sdf.box(0.1, (0, i, 0))
    for i in range(150):
        field = (field - sdf.box(0.1, (0, i, 0))).translate((0, 0, 1))
    assert parse(repr(field)).expression is field.expression


@pytest.mark.parametrize(
    ("text", "column", "words"),
    [
        ("sphere(1) | kugel(2)", 13, ["'kugel'", "the known names are above, "]),
        ("  kugel(2)", 3, ["'kugel'"]),
        ("sphere(1).verschiebe((0, 0, 1))", 11, ["'verschiebe'", "known methods are", "shell"]),
        ("sphere(1).radius", 11, ["'radius'", "parentheses"]),
        ("union('é', kugel(2))", 12, ["'kugel'"]),
        ("sphere(\n1) | kugel(2)", 6, ["'kugel'"]),
        ("sphere(1", 7, ["never closed", "allowed are constructors"]),
        ("  sphere(1", 9, ["never closed"]),
        ("box(1) | sphere()", 10, ["missing a required argument: 'radius'", "radius, center"]),
        ("box(1) | sphere(-2)", 10, ["radius = -2", "greater than zero"]),
        ("box(1) | mesh('a.stl')", 10, ["not permitted", "allow_files=True"]),
        ("below", 1, ["below needs its arguments"]),
        ("box(1) | 2", 10, ["fields only"]),
        ("box(1) * box(2)", 10, ["Mult"]),
        ("box(1) | ~3", 10, ["complement"]),
        ("box(1) | sphere(**box(1))", 10, ["** is not allowed"]),
        ("box(1) | sphere(True)", 10, ["radius = True", "real number"]),
    ],
)
def test_messages_name_the_column_and_what_is_allowed(text, column, words):
    with pytest.raises(InputError, match=f"column {column}\\b") as caught:
        parse(text)
    for word in words:
        assert word in str(caught.value)


def test_text_must_be_text():
    with pytest.raises(InputError, match="not a string"):
        parse(b"sphere(1)")


def test_importing_fields_loads_numpy_and_torch_only():
    code = (
        "import sys, numpy, torch; before = set(sys.modules); import fields; "
        "new = {name.split('.')[0] for name in set(sys.modules) - before}; "
        "print(*sorted(new - set(sys.stdlib_module_names)))"
    )
    root = os.path.dirname(os.path.dirname(os.path.abspath(sdf.__file__)))
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=root
    )
    names = result.stdout.split()
    assert "fields" in names
    assert not {"open3d", "trimesh", "scipy", "skimage", "implicit_warp"} & set(names)
    # torch loads parts of itself and of numpy late; nothing else may appear
    assert set(names) <= {"fields", "torch", "numpy"}, names
