"""Make the pictures of the README and the documents from the examples.

python docs/make_pictures.py              # all; a few minutes
python docs/make_pictures.py demo bar     # some
"""

from __future__ import annotations

import argparse
import runpy
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent
EXAMPLES = DOCS.parent / "examples"
WIDTH = 1280
"""Pictures are drawn at 1920 pixels and reduced, which leaves no jagged edges."""


def make(name: str, folder: Path) -> None:
    """Solve one example and put its picture into docs/pictures."""
    if name == "learned":
        code = runpy.run_path(str(EXAMPLES / "learned/run.py"))["run"](folder)
        picture = folder / "learned.png"
    elif name == "demo":
        code = runpy.run_path(str(EXAMPLES / "demo/run.py"))["run"](folder, "--resolution", "256")
        picture = folder / "part.png"
    elif name == "section":
        picture = folder / "section.png"
        code = _section(folder, picture)
    else:
        run = runpy.run_path(str(EXAMPLES / "standard/run.py"))["run"]
        code = run(name, folder, "--resolution", "256")
        picture = folder / f"{name}.png"
    if code:
        sys.exit(f"{name}: exit code {code}")
    _reduce(picture, DOCS / "pictures" / f"{name}.png")


def _section(folder: Path, picture: Path) -> int:
    """The demo's part cut in its middle, at rest and warped."""
    from implicit_warp.cli import main

    demo = EXAMPLES / "demo"
    code = runpy.run_path(str(demo / "run.py"))["run"](folder, "--resolution", "64")
    arguments = ["slice", f"{demo}/part.py", "-o", str(picture), "--plane", "y=0"]
    arguments += ["--warp", f"{folder}/warp.safetensors", "--handles", f"{demo}/handles.toml"]
    return code or main(arguments)


def _reduce(source: Path, target: Path) -> None:
    from PIL import Image

    with Image.open(source) as image:
        height = round(image.height * WIDTH / image.width)
        image.resize((WIDTH, height), Image.Resampling.LANCZOS).save(target, optimize=True)


if __name__ == "__main__":
    names = ("demo", "section", "bar", "cylinder", "plate", "cactus", "learned")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*names, []])
    with tempfile.TemporaryDirectory() as temporary:
        for name in parser.parse_args().names or names:
            make(name, Path(temporary))
