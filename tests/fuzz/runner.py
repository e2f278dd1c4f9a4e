"""Run random cases as long as asked; on a failure print its seed and a small case.

    python -m tests.fuzz 1000                      1,000 cases of every kind
    python -m tests.fuzz 200 --kinds push_forward --seed 7
    python -m tests.fuzz --replay fuzz-failures/push_forward-7.json

Exit code 1 if anything failed.  Every failure is saved as JSON in `fuzz-failures/`; moved to
`tests/fuzz/corpus/`, it is a test from then on.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Any

from implicit_warp.errors import InputError
from tests.fuzz.properties import PROPERTIES
from tests.fuzz.shrinking import shrink


def failure(case: dict[str, Any]) -> BaseException | None:
    """What a case's property raised; None if it holds or the case is no valid one."""
    try:
        PROPERTIES[case["kind"]].holds(case)
    except InputError:
        return None  # an empty scene, say
    except Exception as error:  # noqa: BLE001 - whatever comes is a finding
        return error
    return None


def run(kinds: list[str], count: int, seed: int, shrink_seconds: float, folder: Path) -> int:
    """Run `count` cases of each kind; returns the number of failures."""
    failures = 0
    for kind in kinds:
        tally: Counter[str] = Counter()
        start, before = time.monotonic(), failures
        for number in range(seed, seed + count):
            case = PROPERTIES[kind].draw(number)
            try:
                tally.update(PROPERTIES[kind].holds(case))
                tally["ran"] += 1
            except InputError:
                tally["not a valid case"] += 1
            except Exception as error:  # noqa: BLE001 - whatever comes is a finding
                failures += 1
                _report(kind, number, case, error, shrink_seconds, folder)
            _progress(f"{kind}: {number - seed + 1}/{count}, {failures - before} failed")
        _progress("")
        details = ", ".join(f"{value} {what}" for what, value in sorted(tally.items()))
        seconds = time.monotonic() - start
        print(f"{kind}: {failures - before} of {count} failed in {seconds:.0f} s ({details})")
    return failures


def _report(
    kind: str,
    number: int,
    case: dict[str, Any],
    error: Exception,
    seconds: float,
    folder: Path,
) -> None:
    print(f"\n{kind} fails with seed {number}:")
    traceback.print_exception(error, limit=-3, file=sys.stdout)

    def fails(candidate: dict[str, Any]) -> bool:
        found = failure(candidate)
        return found is not None and type(found) is type(error)

    small = shrink(case, fails, seconds)
    folder.mkdir(exist_ok=True)
    path = folder / f"{kind}-{number}.json"
    path.write_text(json.dumps(small, indent=1) + "\n")
    print(f"shrunk to {path}: {json.dumps(small)}\nagain: python -m tests.fuzz --replay {path}\n")


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{text}")


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("count", type=int, nargs="?", default=100, help="cases of each kind")
    parser.add_argument("--kinds", nargs="+", choices=[*PROPERTIES], default=[*PROPERTIES])
    parser.add_argument("--seed", type=int, default=0, help="of the first case")
    parser.add_argument("--shrink-seconds", type=float, default=60.0)
    parser.add_argument("--folder", type=Path, default=Path("fuzz-failures"))
    parser.add_argument("--replay", type=Path, help="run this one case instead")
    options = parser.parse_args()
    if options.replay is not None:
        case = json.loads(options.replay.read_text())
        print(f"{options.replay} holds: {PROPERTIES[case['kind']].holds(case)}")
        return 0
    failed = run(options.kinds, options.count, options.seed, options.shrink_seconds, options.folder)
    return 1 if failed else 0
