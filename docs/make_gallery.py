"""Draw every primitive and operation, from the fields of docs/gallery.toml.

python docs/make_gallery.py               # all sheets; some minutes
python docs/make_gallery.py flat round    # some
python docs/make_gallery.py --text        # docs/gallery.md only

Writes docs/pictures/gallery-*.png, one sheet a topic, and docs/gallery.md.
"""

from __future__ import annotations

import argparse
import inspect
import sys
import tomllib
from pathlib import Path

import numpy as np

import fields
from fields import Field
from fields.operations import RULES
from fields.primitives import PRIMITIVES

DOCS = Path(__file__).parent
COLUMNS = 6
SIZE = (200, 180)
COLORS = 128
"""A sheet is stored with a palette; more colours cannot be told apart and cost twice as much."""

RESOLUTION = 96


def sheets() -> dict[str, dict]:
    """The table: topics with a title and their entries, the text of a field by name."""
    return tomllib.loads((DOCS / "gallery.toml").read_text(encoding="utf-8"))


def missing(table: dict[str, dict]) -> set[str]:
    """Registered names that no sheet shows."""
    shown = {name for sheet in table.values() for name in sheet["entries"]}
    return (set(PRIMITIVES) | set(RULES)) - shown


def thumbnail(name: str, text: str) -> np.ndarray:
    """A small picture `(height, width, 3)` with the name below."""
    from implicit_warp.extraction import extract
    from implicit_warp.render import Panel, render_row

    mesh = extract(fields.parse(text), RESOLUTION)
    return render_row(
        [Panel(mesh, label=name)],
        size=SIZE,
        background=(0.965, 0.965, 0.965),
        crease_angle=25.0,
        supersampling=3,
    )


def draw(topic: str, entries: dict[str, str]) -> None:
    """One sheet of thumbnails, row by row."""
    from PIL import Image
    from rich.progress import track

    pictures = []
    for name, text in track(entries.items(), description=topic):
        pictures.append(thumbnail(name, text))
    height, width = pictures[0].shape[:2]
    blank = np.broadcast_to(pictures[0][0, 0], (height, width, 3))
    pictures += [blank] * (-len(pictures) % COLUMNS)
    rows = [
        np.concatenate(pictures[first : first + COLUMNS], axis=1)
        for first in range(0, len(pictures), COLUMNS)
    ]
    image = Image.fromarray(np.concatenate(rows))
    small = image.quantize(COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    small.save(DOCS / "pictures" / f"gallery-{topic}.png", optimize=True)


def markdown(table: dict[str, dict]) -> str:
    """The page: a picture a topic, and under it what each entry is called with and known of."""
    lines = [
        "# Gallery",
        "",
        "Every primitive and operation of `fields`, drawn by `make gallery` from the fields in",
        "[gallery.toml](gallery.toml). The last two columns are of the fields in the pictures:",
        "*exact* fields are true signed distances, inside and out; of the others the Lipschitz",
        "constant is given, a bound on the gradient. Angles are in degrees. What each argument",
        "means is in the docstrings: `help(fields.helix)`.",
    ]
    for topic, sheet in table.items():
        lines += [
            "",
            f"## {sheet['title']}",
            "",
            f"![{sheet['title']}](pictures/gallery-{topic}.png)",
            "",
            "| call | what it is | distance | bounded |",
            "|---|---|---|---|",
        ]
        lines += [_row(name, fields.parse(text)) for name, text in sheet["entries"].items()]
    return "\n".join(lines) + "\n"


def _row(name: str, shown: Field) -> str:
    """One line of the table; tags are of the bare primitive where one is shown cut off."""
    own = shown
    while name in PRIMITIVES and own.history.name != name:
        own = next(f for f in own.history.operands if name in repr(f))
    summary = inspect.getdoc(getattr(fields, name)).split("\n\n")[0].replace("\n", " ")
    known = "exact" if own.exact else _steepness(own.lipschitz)
    if own.is_profile and name in PRIMITIVES:
        bounded = "in x and y" if own.extrude(1.0).bounds is not None else "no"
    else:
        bounded = "yes" if own.bounds is not None else "no"
    return f"| `{_call(name)}` | {summary.replace('|', chr(92) + '|')} | {known} | {bounded} |"


def _steepness(lipschitz: float | None) -> str:
    return "unknown" if lipschitz is None else f"Lipschitz {lipschitz:.3g}"


def _call(name: str) -> str:
    """The call, with default values and without annotations."""
    own = inspect.signature(getattr(fields, name))
    receiver = "" if name in PRIMITIVES else "a."
    parts = []
    for parameter in list(own.parameters.values())[1 if receiver else 0 :]:
        text = str(parameter.replace(annotation=inspect.Parameter.empty))
        parts.append(text)
    return f"{receiver}{name}({', '.join(parts)})"


def main() -> None:
    """Draw what the command line asks for."""
    table = sheets()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("topics", nargs="*", choices=[*table, []])
    parser.add_argument("--text", action="store_true", help="write docs/gallery.md only")
    chosen = parser.parse_args()
    if unseen := missing(table):
        sys.exit(f"docs/gallery.toml lacks {', '.join(sorted(unseen))}")
    if not chosen.text:
        for topic in chosen.topics or table:
            draw(topic, table[topic]["entries"])
    (DOCS / "gallery.md").write_text(markdown(table), encoding="utf-8")


if __name__ == "__main__":
    main()
