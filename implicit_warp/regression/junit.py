"""JUnit XML, the form of test results that Jenkins, GitLab and GitHub actions read.

One suite with one case a file, in the common part of the two schemas in use, Ant's and that of
Jenkins' xUnit plugin: no attributes of the root, at most one result a case, properties on the suite
only. The counts that are not zero are therefore properties of the suite, "FILE: NAME".
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterable
from xml.etree import ElementTree

from implicit_warp.regression.gate import Outcome

SUITE = "implicit-warp check"
CLASS = "implicit_warp.check"

# What XML 1.0 cannot hold, escaped or not; also the line ends that parsers would normalise.
_UNWRITABLE = re.compile("[^\t\n\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(outcomes: Iterable[Outcome], started: datetime.datetime | None = None) -> bytes:
    """The outcomes as a JUnit document in UTF-8.

    A failed file is a failure with its reasons and the whole report; an unreadable one is an error.
    Characters that XML cannot hold (control characters, bytes of a file name that are no UTF-8)
    are written as backslash escapes.

    Args:
        outcomes: one a file.
        started: when the run began; now if not given.
    """
    import implicit_warp

    outcomes = list(outcomes)
    started = started or datetime.datetime.now(datetime.UTC)
    statuses = [outcome.status for outcome in outcomes]
    root = ElementTree.Element("testsuites")
    suite = _add(
        root,
        "testsuite",
        name=SUITE,
        id="0",
        package="implicit_warp",
        hostname="localhost",
        timestamp=started.strftime("%Y-%m-%dT%H:%M:%S"),
        tests=str(len(outcomes)),
        failures=str(statuses.count("failed")),
        errors=str(statuses.count("unreadable")),
        skipped="0",
        time=f"{sum(outcome.seconds for outcome in outcomes):.3f}",
    )
    properties = _add(suite, "properties")
    _add(properties, "property", name="implicit_warp", value=implicit_warp.__version__)
    for outcome in outcomes:
        counts = {} if outcome.entry is None else outcome.entry.counts
        for name, count in counts.items():
            _add(properties, "property", name=f"{outcome.path}: {name}", value=str(count))
    for outcome in outcomes:
        _add_case(suite, outcome)
    _add(suite, "system-out")
    _add(suite, "system-err")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _add_case(suite: ElementTree.Element, outcome: Outcome) -> None:
    case = _add(
        suite, "testcase", classname=CLASS, name=str(outcome.path), time=f"{outcome.seconds:.3f}"
    )
    if outcome.facts is None:
        error = _add(
            case, "error", type=type(outcome.error).__name__, message=_line(str(outcome.error))
        )
        error.text = writable(str(outcome.error))
    elif outcome.failures:
        kind = "BadMesh"
        if outcome.comparison is not None and outcome.comparison.known:
            kind = "CountsGrew"
        failure = _add(case, "failure", type=kind, message=_line("; ".join(outcome.failures)))
        failure.text = writable("\n".join([*outcome.failures, "", outcome.text]))


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    clean = {name: writable(value) for name, value in attributes.items()}
    return ElementTree.SubElement(parent, tag, clean)


def _line(text: str) -> str:
    """One line: readers show the message in a table, and XML folds line ends in attributes."""
    return " ".join(text.split())


def writable(text: str) -> str:
    r"""The text with every character that XML 1.0 cannot hold as an escape such as `\x1b`."""
    return _UNWRITABLE.sub(lambda match: ascii(match[0])[1:-1], text)
