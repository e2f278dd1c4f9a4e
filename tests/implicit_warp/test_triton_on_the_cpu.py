"""What can be said about the Triton back end without a GPU."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from implicit_warp import evaluate
from implicit_warp.errors import InputError, MissingDependency
from tests.implicit_warp.registered_maps import random_warp

ROOT = Path(__file__).parents[2]


def _triton_version() -> tuple[int, int]:
    pytest.importorskip("triton", reason="no Triton on this platform")
    major, minor = importlib.metadata.version("triton").split(".")[:2]
    return int(major), int(minor)


def run(*arguments: str, **environment: str) -> str:
    """The output of a Python process of its own, which must succeed."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_all_checks_of_the_back_end_pass_under_the_interpreter():
    if _triton_version() < (3, 7):
        pytest.skip("the interpreter of Triton before 3.7 fails with numpy 2.4 and later")
    checks = Path(__file__).with_name("test_triton_backend.py")
    output = run("-m", "pytest", "-q", "-p", "no:cacheprovider", str(checks), TRITON_INTERPRET="1")
    assert "passed" in output
    assert "skipped" not in output


def test_kernels_compile_for_hopper(tmp_path):
    """Down to machine code, with the assembler that Triton brings; no device is needed."""
    if _triton_version() < (3, 6):
        pytest.skip("older versions of Triton describe kernels differently")
    run("-c", _COMPILE, TRITON_CACHE_DIR=str(tmp_path), TRITON_INTERPRET="0")


_COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from implicit_warp import triton_gradient_kernels as gradients, triton_kernels as kernels

INTEGERS = {"guesses": "*i32", "neighbours": "*i32", "found": "*i32", "order": "*i64",
            "starts": "*i64", "n": "i64", "n_layers": "i32", "first": "i32", "m": "i32"}

def check(kernel, kind, **constants):
    constants = {"N_CELLS": 440, "BLOCK": 256, **constants}
    constants = {name: constants[name] for name in kernel.arg_names if name in constants}
    signature = {name: INTEGERS.get(name, "*" + kind) for name in kernel.arg_names}
    signature.update(dict.fromkeys(constants, "constexpr"))
    source = ASTSource(fn=kernel, signature=signature, constexprs=constants)
    compiled = compile(source, target=GPUTarget("cuda", 90, 32))
    assert compiled.asm["cubin"]

for kind in ("fp32", "fp64"):
    grid = {"N_SIDE": 10, "GRID": 128, "STEPS": 119}
    for shared in (False, True):
        gather = {"SHARED": shared, "PADDED": 512}
        for inverse in (False, True):
            check(kernels.traverse, kind, INVERSE=inverse, JACOBIAN=True, RECORD=True,
                  **grid, **gather)
    check(kernels.fill_guesses, kind, **grid)
    check(gradients.replay, kind, JACOBIAN=True, **gather)
    check(gradients.differentiate, kind, JACOBIAN=True, CELLS=True, TRANSITIONS=True, **gather)
    check(gradients.sum_cells, kind)
"""


def test_it_is_refused_for_cpu_tensors(seed):
    _triton_version()
    warp = random_warp(seed, layers=1, resolution=2)
    with evaluate.back_end("triton"), pytest.raises(InputError, match="on a CUDA device"):
        warp(np.zeros((1, 3)))


def test_without_triton_it_is_missed_only_when_asked_for(monkeypatch, seed):
    monkeypatch.setitem(sys.modules, "triton", None)  # makes its import fail
    evaluate._triton_backend.cache_clear()
    try:
        with pytest.raises(MissingDependency, match="triton"), evaluate.back_end("triton"):
            pass
        points = torch.zeros(2, 3)
        assert random_warp(seed, layers=1, resolution=2)(points).shape == (2, 3)
    finally:
        evaluate._triton_backend.cache_clear()


def test_importing_the_package_and_using_a_map_does_not_import_triton():
    run(
        "-c",
        "import sys, numpy as np, torch, implicit_warp as iw\n"
        "before = 'triton' in sys.modules\n"
        "iw.TutteNet(1, 2)(np.zeros((1, 3)))\n"
        "assert before or 'triton' not in sys.modules",
    )
