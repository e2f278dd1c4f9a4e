"""One thread, fixed seeds that a failure shows, and markers that explain themselves."""

from __future__ import annotations

import os

# Read by the libraries when they are first imported, so this comes before every other import.
# On a busy machine small loops are many times slower with two threads than with one.
for _variable in (
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "NUMBA_NUM_THREADS",
):
    os.environ.setdefault(_variable, "1")

import random
from collections.abc import Generator

import hypothesis
import numpy as np
import pytest
import torch

SEED_VARIABLE = "IMPLICIT_WARP_SEED"
DEFAULT_SEED = 20240612

# No deadline: a shared machine is slow at random. Derandomised: the same cases every run; the
# statistical tests are the place for fresh ones.
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, print_blob=True)
hypothesis.settings.load_profile("repeatable")


def seeds_from_environment() -> list[int]:
    """The seeds of IMPLICIT_WARP_SEED ("7" or "1,2,3"), or the default one."""
    text = os.environ.get(SEED_VARIABLE, str(DEFAULT_SEED))
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise pytest.UsageError(
            f'{SEED_VARIABLE}={text!r} is not an integer or a list of integers such as "1,2,3".'
        ) from None


def pytest_configure(config: pytest.Config) -> None:
    seeds_from_environment()  # a bad value stops the run once, not every test
    torch.set_num_threads(1)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Several seeds in the environment: every test that uses `seed` runs with each."""
    own = any(
        "seed" in (names.replace(" ", "").split(",") if isinstance(names, str) else names)
        for names in (mark.args[0] for mark in metafunc.definition.iter_markers("parametrize"))
    )
    seeds = seeds_from_environment()
    if "seed" in metafunc.fixturenames and not own and len(seeds) > 1:
        metafunc.parametrize("seed", seeds, ids=[f"seed={seed}" for seed in seeds])


@pytest.fixture(autouse=True)
def _fixed_global_generators() -> None:
    """A test that forgets to pass a generator is repeatable all the same, in any order."""
    random.seed(DEFAULT_SEED)
    np.random.seed(DEFAULT_SEED)  # noqa: NPY002 (the global generator is the point)
    torch.manual_seed(DEFAULT_SEED)


@pytest.fixture
def seed() -> int:
    """The seed of this test's random choices; IMPLICIT_WARP_SEED sets it."""
    return seeds_from_environment()[0]


@pytest.fixture
def rng(seed: int) -> np.random.Generator:
    """A numpy generator made from `seed`."""
    return np.random.default_rng(seed)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Say in the report of a failed test which seed it ran with, and how to get it back."""
    report = yield
    seed = getattr(item, "funcargs", {}).get("seed")
    if report.failed and seed is not None:
        report.sections.append(("seed", f"rerun with {SEED_VARIABLE}={seed}"))
    return report


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """`-m gpu` on a machine without one skips, with the reason, instead of failing."""
    if torch.cuda.is_available():
        return
    for item in items:
        if item.get_closest_marker("gpu"):
            item.add_marker(pytest.mark.skip(reason="torch sees no CUDA device"))
