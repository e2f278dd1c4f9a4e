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
    if name == "bend":
        _bend(folder, DOCS / "pictures/bend.gif")
        return
    if name == "learned":
        code = runpy.run_path(str(EXAMPLES / "learned/run.py"))["run"](folder)
        picture = folder / "learned.png"
    elif name == "demo":
        code = runpy.run_path(str(EXAMPLES / "demo/run.py"))["run"](folder, "--resolution", "256")
        picture = folder / "part.png"
    elif name == "section":
        picture = folder / "section.png"
        code = _section(folder, picture)
    elif name == "layers":
        picture = folder / "layers.png"
        code = _demo_render(folder, "--layers", str(picture))
    elif name == "distortion":
        picture = folder / "distortion.png"
        code = _distortion(folder, picture)
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


def _demo_render(folder: Path, *options: str) -> int:
    """The demo's part under its warp, drawn by `implicit-warp render`."""
    from implicit_warp.cli import main

    demo, warp = EXAMPLES / "demo", folder / "warp.safetensors"
    if not warp.exists():
        code = runpy.run_path(str(demo / "run.py"))["run"](folder, "--resolution", "64")
        if code:
            return code
    return main(["render", f"{demo}/part.py", "--warp", str(warp), *options])


def _distortion(folder: Path, picture: Path) -> int:
    """A twisted bar by its stretch, and the bent part cut open, by its elastic energy."""
    import numpy as np
    from PIL import Image

    from implicit_warp.cli import main

    left, right, size = folder / "left.png", folder / "right.png", ("--size", "960x800")
    run = runpy.run_path(str(EXAMPLES / "standard/run.py"))["run"]
    code = run("bar", folder, "--resolution", "64")
    bar = ("--warp", f"{folder}/bar.safetensors", "--color", "stretch", "--resolution", "200")
    code = code or main(["render", f"{EXAMPLES}/standard/bar.py", *bar, "-o", str(left), *size])
    cut = ("--section", "y=0", "--color", "energy")
    code = code or _demo_render(folder, "-o", str(right), *cut, *size)
    if not code:
        halves = [np.asarray(Image.open(half)) for half in (left, right)]
        Image.fromarray(np.concatenate(halves, axis=1)).save(picture)
    return code


def _bend(folder: Path, film: Path) -> None:
    """The demo's part on its way from rest to bent and back."""
    handles = ("--handles", f"{EXAMPLES}/demo/handles.toml")
    look = ("--size", "480x360", "--seconds", "3.2", "--fps", "15")
    code = _demo_render(folder, *handles, "--animate", str(film), *look)
    if code:
        sys.exit(f"bend: exit code {code}")


def _reduce(source: Path, target: Path) -> None:
    from PIL import Image

    with Image.open(source) as image:
        height = round(image.height * WIDTH / image.width)
        small = image.convert("RGB").resize((WIDTH, height), Image.Resampling.LANCZOS)
        if target.stem == "layers":  # few colours and many lines: a palette is a third as large
            small = small.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=2, dither=0)
        small.save(target, optimize=True)


if __name__ == "__main__":
    names = ("demo", "section", "bar", "cylinder", "plate", "cactus", "learned")
    names += ("layers", "distortion", "bend")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*names, []])
    with tempfile.TemporaryDirectory() as temporary:
        for name in parser.parse_args().names or names:
            make(name, Path(temporary))
