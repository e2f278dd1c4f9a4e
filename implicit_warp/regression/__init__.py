"""Gate meshes in continuous integration: stored counts, comparisons, JUnit reports."""

from __future__ import annotations

from implicit_warp.regression.baseline import (
    Baseline,
    Comparison,
    Difference,
    Entry,
    difference_table,
    portable_key,
)
from implicit_warp.regression.gate import Outcome, Target, examine, find_targets, judge
from implicit_warp.regression.junit import junit_xml
from implicit_warp.regression.results import Gate, Results

__all__ = [
    "Baseline",
    "Comparison",
    "Difference",
    "Entry",
    "Gate",
    "Outcome",
    "Results",
    "Target",
    "difference_table",
    "examine",
    "find_targets",
    "judge",
    "junit_xml",
    "portable_key",
]
