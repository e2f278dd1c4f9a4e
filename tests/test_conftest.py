"""The test suite's own promises: one thread, visible seeds, markers that are declared."""

from __future__ import annotations

from pathlib import Path

import numba
import pytest
import torch

CONFTEST = Path(__file__).with_name("conftest.py").read_text()


def test_one_thread_everywhere():
    assert torch.get_num_threads() == 1
    assert numba.config.NUMBA_NUM_THREADS == 1


@pytest.fixture
def suite(pytester: pytest.Pytester) -> pytest.Pytester:
    """An empty suite with this project's conftest."""
    pytester.makeconftest(CONFTEST)
    return pytester


def test_a_failure_shows_its_seed(suite, monkeypatch):
    monkeypatch.setenv("IMPLICIT_WARP_SEED", "1234")
    suite.makepyfile("def test_bad(rng):\n    assert rng.uniform() > 2")
    result = suite.runpytest_inprocess()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*rerun with IMPLICIT_WARP_SEED=1234*"])


def test_a_pass_shows_no_seed(suite):
    suite.makepyfile("def test_good(rng):\n    assert rng.uniform() < 2")
    result = suite.runpytest_inprocess("-rA")
    result.assert_outcomes(passed=1)
    assert "IMPLICIT_WARP_SEED" not in result.stdout.str()


def test_several_seeds_run_each(suite, monkeypatch):
    monkeypatch.setenv("IMPLICIT_WARP_SEED", "3,4,5")
    suite.makepyfile(
        """
        import pytest

        def test_through_rng(rng, seed):
            assert seed != 4

        def test_without():
            pass

        @pytest.mark.parametrize(("x", "seed"), [(0, 1)])
        def test_own_seed(x, seed):
            assert seed == 1
        """
    )
    result = suite.runpytest_inprocess()
    result.assert_outcomes(passed=4, failed=1)
    result.stdout.fnmatch_lines(["*rerun with IMPLICIT_WARP_SEED=4*"])


def test_the_same_seed_gives_the_same_numbers(suite, monkeypatch):
    monkeypatch.setenv("IMPLICIT_WARP_SEED", "8")
    suite.makepyfile(
        """
        import numpy as np, torch

        def test_first(rng):
            assert rng.integers(1 << 40) == np.random.default_rng(8).integers(1 << 40)
            global_torch.append(torch.rand(3))

        def test_second():
            assert torch.equal(torch.rand(3), global_torch[0])

        global_torch = []
        """
    )
    suite.runpytest_inprocess().assert_outcomes(passed=2)


def test_an_unusable_seed_stops_the_run_with_a_reason(suite, monkeypatch):
    monkeypatch.setenv("IMPLICIT_WARP_SEED", "lucky")
    suite.makepyfile("def test_good():\n    pass")
    result = suite.runpytest_inprocess()
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*IMPLICIT_WARP_SEED='lucky' is not an integer*"])


def test_a_gpu_test_without_a_gpu_is_skipped_with_the_reason(suite, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    suite.makepyfile("import pytest\n@pytest.mark.gpu\ndef test_device():\n    raise OSError")
    result = suite.runpytest_inprocess("-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*torch sees no CUDA device*"])
