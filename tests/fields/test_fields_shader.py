"""Shader text: the same numbers as torch, in a small interpreter and on real drivers.

Drivers: Mesa's software renderer is enough (moderngl with EGL for GLSL, wgpu for WGSL); tests that
find none say so and are skipped.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

import fields as sdf
from fields import InputError
from fields import expression as ex
from fields.evaluators.shader import SPELLINGS
from fields.expression import OPERATIONS, X, Y, Z
from tests.fields.random_expressions import random_expression
from tests.fields.shader_interpreter import run_shader

DIALECTS = sorted(SPELLINGS)


def _points(rng, n: int = 500) -> np.ndarray:
    return rng.uniform(-2, 2, (n, 3)).astype(np.float32)


def _allowed(field: sdf.Field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of everything that float32 arithmetic may give at points."""
    boxes = np.stack([points, points], axis=1).astype(np.float64)
    return tuple(field.enclose(boxes, np.float32).T)


# --- text ---


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_operation_has_a_spelling(dialect):
    assert SPELLINGS[dialect].keys() == OPERATIONS.keys()


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_short_function_reads_as_expected(dialect):
    text = sdf.Field(ex.where_negative(X, Y * 2.5, -1.0)).to_glsl("shape", dialect)
    expected = {
        "glsl": (
            "float shape(vec3 p) {\n"
            "    float v3 = p.y * 2.5;\n"
            "    float v5 = (p.x < 0.0 ? v3 : (-1.0));\n"
            "    return v5;\n"
            "}\n"
        ),
        "wgsl": (
            "fn shape(p: vec3<f32>) -> f32 {\n"
            "    let v3: f32 = p.y * 2.5;\n"
            "    let v5: f32 = select((-1.0), v3, p.x < 0.0);\n"
            "    return v5;\n"
            "}\n"
        ),
    }
    assert text == expected[dialect]


def test_constants_are_read_back_as_the_same_float32(rng):
    numbers = np.concatenate(
        [rng.normal(size=200), 10 ** rng.uniform(-37, 38, 200), [0.1, 1e7, 1e-4, 123456789.0, 1.0]]
    ).astype(np.float32)
    for number in numbers:
        text = sdf.Field(X + float(number)).to_glsl()
        (written,) = re.findall(r"p\.x \+ \(?(-?[\d.e+-]+)\)?;", text)
        assert np.float32(written) == number
        assert "." in written  # or GLSL would take it for an integer


@pytest.mark.parametrize("dialect", DIALECTS)
def test_values_by_the_interpreter(example, rng, dialect):
    if example.tape.calls_oracles:
        with pytest.raises(InputError, match="calls the function"):
            example.to_glsl(dialect=dialect)
        return
    points = _points(rng)
    values = run_shader(example.to_glsl(dialect=dialect), points)
    low, high = _allowed(example, points)
    assert ((low <= values) & (values <= high)).all()


@pytest.mark.parametrize("dialect", DIALECTS)
def test_random_expressions_by_the_interpreter(rng, dialect):
    for _ in range(30):
        field = sdf.Field(random_expression(rng, int(rng.integers(1, 50))))
        points = _points(rng, 50)
        values = run_shader(field.to_glsl(dialect=dialect), points)
        low, high = _allowed(field, points)
        known = np.isfinite(values)
        assert ((low <= values) & (values <= high))[known].all()
        assert known.mean() > 0.5


@pytest.mark.parametrize("dialect", DIALECTS)
def test_conventions_where_the_languages_leave_them_open(dialect):
    points = np.array([[0, 0, 0], [-1, 2, 0], [1, 2, 0], [0, 2, 1]], dtype=np.float32)
    for root in (ex.sqrt(X), ex.atan2(Y, X), ex.power(X, Y), ex.log(Y), ex.where_negative(X, Y, Z)):
        field = sdf.Field(root)
        values = run_shader(field.to_glsl(dialect=dialect), points)
        np.testing.assert_allclose(values, field(points), rtol=1e-6)


def test_a_name_a_dialect_or_a_constant_that_is_none():
    for name in ("", "1d", "a b", "gl_field", "a__b", "p", 3):
        with pytest.raises(InputError, match="name of a function"):
            sdf.sphere(1).to_glsl(name)
    with pytest.raises(InputError, match="no such language"):
        sdf.sphere(1).to_glsl(dialect="hlsl")
    with pytest.raises(InputError, match="too large for float32"):
        sdf.Field(X + 1e39).to_glsl()
    with pytest.raises(InputError, match="calls the function 'learned'"):
        (sdf.sphere(1) | sdf.from_function(lambda p: p.sum(-1), name="learned")).to_glsl()


# --- drivers ---

_COMPUTE = {
    "glsl": """#version 430
layout(local_size_x=64) in;
layout(std430, binding=0) buffer Points {{ float points[]; }};
layout(std430, binding=1) buffer Values {{ float values[]; }};
{0}
void main() {{
    uint i = gl_GlobalInvocationID.x;
    values[i] = field(vec3(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]));
}}""",
    "wgsl": """
@group(0) @binding(0) var<storage, read> points: array<f32>;
@group(0) @binding(1) var<storage, read_write> values: array<f32>;
{0}
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {{
    let i = id.x;
    values[i] = field(vec3<f32>(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]));
}}""",
}


def _run_glsl(context, field: sdf.Field, points: np.ndarray) -> np.ndarray:
    with context:  # the other driver may have made its own context the current one
        shader = context.compute_shader(_COMPUTE["glsl"].format(field.to_glsl()))
        inputs, outputs = context.buffer(points.tobytes()), context.buffer(reserve=4 * len(points))
        inputs.bind_to_storage_buffer(0)
        outputs.bind_to_storage_buffer(1)
        shader.run(len(points) // 64)
        values = np.frombuffer(outputs.read(), np.float32)
        for resource in (shader, inputs, outputs):
            resource.release()
    return values


def _run_wgsl(field: sdf.Field, points: np.ndarray) -> np.ndarray:
    from wgpu.utils.compute import compute_with_buffers

    code = _COMPUTE["wgsl"].format(field.to_glsl(dialect="wgsl"))
    found = compute_with_buffers({0: points}, {1: (len(points), "f")}, code, n=len(points) // 64)
    return np.frombuffer(found[1], np.float32)


@pytest.fixture(scope="module")
def drivers():
    """A function for each dialect that this machine can run."""
    found = {}
    try:
        import moderngl

        context = moderngl.create_standalone_context(backend="egl", require=430)
        found["glsl"] = lambda field, points: _run_glsl(context, field, points)
    except Exception as reason:  # noqa: BLE001 (whatever a driver may raise)
        found["no glsl"] = str(reason)
    try:
        import wgpu.utils

        wgpu.utils.get_default_device()
        found["wgsl"] = _run_wgsl
    except Exception as reason:  # noqa: BLE001
        found["no wgsl"] = str(reason)
    return found


@pytest.mark.parametrize("dialect", DIALECTS)
def test_values_by_a_driver(catalogue, drivers, rng, dialect):
    """The whole catalogue and some random expressions, compiled and run."""
    if dialect not in drivers:
        pytest.skip(f"no driver: {drivers[f'no {dialect}']}")
    points = _points(rng, 256)
    fields = [field for field in catalogue.values() if not field.tape.calls_oracles]
    for field in fields:
        values = drivers[dialect](field, points)
        low, high = _allowed(field, points)
        # Divisions and square roots may be off by 2.5 units in the last place in a shader,
        # five times what the bounds allow for.
        slack = 4 * (high - low)
        assert ((low - slack <= values) & (values <= high + slack)).all(), field


@pytest.mark.parametrize("dialect", DIALECTS)
def test_operations_by_a_driver(drivers, rng, dialect):
    if dialect not in drivers:
        pytest.skip(f"no driver: {drivers[f'no {dialect}']}")
    points = _points(rng, 256)
    points[:4] = 0
    points[4:8, 0] = 0
    for name, operation in OPERATIONS.items():
        field = sdf.Field(ex.apply(name, *(X, Y, Z)[: operation.arity]))
        values = drivers[dialect](field, points)
        expected = field(points)
        known = np.isfinite(expected)
        # WGSL allows 2**-11 for sin and cos, and errors of exp and pow that grow with their size.
        np.testing.assert_allclose(values[known], expected[known], rtol=2e-3, atol=2e-3)
