"""Stored counts of defects, and what grew since.

A baseline is a JSON file meant for version control: sorted, one figure a line, zeros left out,
so that a change of one count is a change of one line.

    {
      "format": "implicit_warp.baseline",
      "format_version": 1,
      "library_version": "0.1.0",
      "entries": {
        "parts/bracket.stl": {
          "counts": {
            "self_intersections": 3,
            "self_intersections.crossing": 3
          }
        },
        "parts/lid.stl": {
          "counts": {}
        }
      }
    }

Guarantee: a comparison passes only if no count of `Entry.of` is above the stored one; a count that
is not stored is zero.
Non-guarantees: counts say how many, not where. A defect that is mended in one place and appears in
another leaves them as they are. They are counts of faces and edges of one triangulation, so a finer
mesh of the same bad shape has more.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from implicit_warp.errors import FileFormatError, InputError
from implicit_warp.files import atomic_write

if TYPE_CHECKING:
    from implicit_warp.checking import CheckReport

FORMAT = "implicit_warp.baseline"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class Entry:
    """What is stored of one mesh.

    Attributes:
        counts: number of defects by name, those that are not zero: `CheckReport.counts` and two
            of `Entry.of`. They may not grow.
        topology: "components" and, by genus, how many of them there are ("components.genus_0",
            "components.open"); they may not change. None where that is not asked for.
    """

    counts: Mapping[str, int]
    topology: Mapping[str, int] | None = None

    @classmethod
    def of(cls, report: CheckReport, *, topology: bool = False) -> Entry:
        """The figures of a report, with its topology if asked for.

        Two problems of a mesh as a whole are counted here, 0 or 1, so that neither passes for an
        absence of defects: "empty", no faces, and "no_volume", closed around no positive volume.
        """
        t = report.topology
        figures = {
            **report.counts(),
            "empty": int(not t.num_faces),
            "no_volume": int(t.watertight and t.unit_volume <= 0),
        }
        counts = {name: n for name, n in figures.items() if n}
        return cls(counts, _topology(report) if topology else None)

    def to_dict(self) -> dict[str, dict[str, int]]:
        """Plain values for JSON."""
        parts = {"counts": dict(self.counts)}
        if self.topology is not None:
            parts["topology"] = dict(self.topology)
        return parts


@dataclass(frozen=True)
class Difference:
    """One figure that is not what it was.

    Attributes:
        name: of the count, or of the topological figure.
        stored: its value in the baseline.
        now: its value in the mesh checked.
        is_regression: a count that grew, or topology that changed either way.
    """

    name: str
    stored: int
    now: int
    is_regression: bool


@dataclass(frozen=True)
class Comparison:
    """One mesh against its entry.

    Attributes:
        key: of the entry.
        known: whether the baseline has that entry.
        differences: the figures that differ, by name; empty if there is no entry.
    """

    key: str
    known: bool
    differences: tuple[Difference, ...] = ()

    @property
    def regressions(self) -> tuple[Difference, ...]:
        """The differences that fail a gate."""
        return tuple(d for d in self.differences if d.is_regression)

    @property
    def improvements(self) -> tuple[Difference, ...]:
        """The counts that shrank."""
        return tuple(d for d in self.differences if not d.is_regression)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; each figure as [stored, now]."""
        return {
            "key": self.key,
            "known": self.known,
            "regressions": {d.name: [d.stored, d.now] for d in self.regressions},
            "improvements": {d.name: [d.stored, d.now] for d in self.improvements},
        }


@dataclass(frozen=True)
class Baseline:
    """The entries of one baseline file by key.

    Attributes:
        entries: figures by key; for files the key is `portable_key`.
        library_version: the version that wrote the file; "" for a new one.
    """

    entries: Mapping[str, Entry] = field(default_factory=dict)
    library_version: str = ""

    @classmethod
    def load(cls, path: str | Path) -> Baseline:
        """Read a baseline file.

        Raises:
            InputError: there is no such file, or it cannot be read.
            FileFormatError: damaged, no baseline, or written by a newer version.
        """
        try:
            text = Path(path).read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(
                "baseline",
                str(path),
                f"the file cannot be read ({error.strerror})",
                "check the path, or write a first baseline with --update",
            ) from error
        except UnicodeDecodeError as error:
            raise _damaged(path, f"not UTF-8 text ({error.reason})") from error
        try:
            content = json.loads(text, object_pairs_hook=_without_repeats)
        except (ValueError, RecursionError) as error:
            raise _damaged(path, f"not readable as JSON ({error})") from error
        return cls._from_content(path, content)

    @classmethod
    def _from_content(cls, path: str | Path, content: Any) -> Baseline:
        found = content.get("format") if isinstance(content, dict) else None
        if found != FORMAT:
            raise FileFormatError(
                f"{path}: holds no baseline (its format is {found!r}, not {FORMAT!r}). Name "
                "another file, or delete this one if it is not needed"
            )
        version, library = content.get("format_version"), content.get("library_version", "")
        if version != FORMAT_VERSION:
            raise FileFormatError(
                f"{path}: format version {version!r}, but this library reads {FORMAT_VERSION}. "
                f"Install the version of implicit_warp that wrote it ({library or 'unknown'}) or a "
                "newer one"
            )
        entries = content.get("entries")
        if not isinstance(entries, dict) or not isinstance(library, str):
            raise _damaged(path, "it has no table of entries")
        return cls({key: _entry(path, key, value) for key, value in entries.items()}, library)

    def save(self, path: str | Path) -> None:
        """Write the file under a temporary name and rename it; the same entries, the same bytes.

        Raises:
            InputError: the path cannot be written.
        """
        import implicit_warp

        content = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "library_version": implicit_warp.__version__,
            "entries": {
                key: {part: dict(sorted(n.items())) for part, n in entry.to_dict().items()}
                for key, entry in sorted(self.entries.items())
            },
        }
        text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
        # Bytes of a file name that are no UTF-8 are lone surrogates here; written as a backslash
        # escape they are what JSON expects.
        with atomic_write(path) as temporary:
            temporary.write_bytes(text.encode("utf-8", "backslashreplace"))

    def compare(self, key: str, now: Entry) -> Comparison:
        """What differs between the stored entry and the figures of now.

        Topology is compared only where `now` has it; where it is not stored, all of it is new.
        """
        stored = self.entries.get(key)
        if stored is None:
            return Comparison(key, known=False)
        differences = [
            Difference(name, before, after, is_regression=after > before)
            for name, before, after in _changed(stored.counts, now.counts)
        ]
        if now.topology is not None:
            differences += [
                Difference(name, before, after, is_regression=True)
                for name, before, after in _changed(stored.topology or {}, now.topology)
            ]
        return Comparison(key, known=True, differences=tuple(differences))

    def updated(self, entries: Mapping[str, Entry], gone: Iterable[str] = ()) -> Baseline:
        """The same baseline with these entries new or replaced, and those of `gone` removed."""
        merged = {**self.entries, **entries}
        for key in gone:
            merged.pop(key, None)
        return Baseline(merged, self.library_version)

    def version_note(self) -> str | None:
        """A sentence for failures where another version of the library counted, else None."""
        import implicit_warp

        if self.library_version in ("", implicit_warp.__version__):
            return None
        return (
            f"the baseline was written by version {self.library_version}, and this is "
            f"{implicit_warp.__version__}: the checks themselves may count more"
        )


def portable_key(file: str | Path, folder: str | Path) -> str:
    """The path of a file relative to a folder, with forward slashes.

    It is the same on every machine that has the same tree, and does not depend on the working
    directory. Links are followed only where the file would otherwise seem to lie outside.
    """
    file, folder = Path(file), Path(folder)
    plain = os.path.relpath(os.path.abspath(file), os.path.abspath(folder))
    if plain.split(os.sep)[0] == os.pardir:
        real = os.path.relpath(
            os.path.join(os.path.realpath(file.parent), file.name), os.path.realpath(folder)
        )
        plain = plain if real.split(os.sep)[0] == os.pardir else real
    return plain.replace(os.sep, "/")


def difference_table(
    rows: Iterable[tuple[str, Difference]], heading: str = "file", indent: str = "  "
) -> str:
    """Lines of "key, what, stored -> now", in columns; a key is written once.

    Args:
        rows: keys and their differences.
        heading: what the keys are.
        indent: before each line.
    """
    rows = list(rows)
    cells = [(key, d.name, str(d.stored), str(d.now)) for key, d in rows]
    cells.insert(0, (heading, "what", "stored", "now"))
    wide = [max(len(row[k]) for row in cells) for k in range(4)]
    lines, previous = [], None
    for key, name, stored, now in cells:
        shown = "" if key == previous else key
        previous = key
        lines.append(
            f"{indent}{shown:<{wide[0]}}  {name:<{wide[1]}}  {stored:>{wide[2]}} -> {now}".rstrip()
        )
    return "\n".join(lines)


def _topology(report: CheckReport) -> dict[str, int]:
    genera = report.topology.genus
    figures = {"components": len(genera)}
    for genus in genera:
        name = "components.open" if genus is None else f"components.genus_{genus}"
        figures[name] = figures.get(name, 0) + 1
    return figures


def _changed(before: Mapping[str, int], after: Mapping[str, int]) -> list[tuple[str, int, int]]:
    names = sorted(before.keys() | after.keys())
    pairs = [(name, before.get(name, 0), after.get(name, 0)) for name in names]
    return [(name, b, a) for name, b, a in pairs if a != b]


def _entry(path: str | Path, key: str, value: Any) -> Entry:
    if not isinstance(value, dict) or "counts" not in value or value.keys() - _PARTS:
        raise _damaged(path, f"the entry {key!r} is no table of counts")
    for part, numbers in value.items():
        if not isinstance(numbers, dict) or not all(_is_count(n) for n in numbers.values()):
            raise _damaged(path, f"{part} of the entry {key!r} are no whole numbers")
    return Entry(**value)


_PARTS = {"counts", "topology"}


def _is_count(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"{next(n for n in names if names.count(n) > 1)!r} occurs twice")
    return table


def _damaged(path: str | Path, cause: str) -> FileFormatError:
    return FileFormatError(
        f"{path}: a damaged baseline: {cause}. Restore it from version control (a merge may have "
        "left its marks in it), or delete it and update the baseline to write it anew"
    )
