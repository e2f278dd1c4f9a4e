"""The field's four standard deformation tests (Botsch and Sorkine 2008), solved and checked.

A bar twisted by 135 degrees, a cylinder bent by 120, a plate lifted in the middle, a cactus whose
arm is bent by 70.

    python examples/standard/run.py --out out/standard            # all four
    python examples/standard/run.py bar plate --resolution 256
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from implicit_warp.cli import main

HERE = Path(__file__).parent
NAMES = ("bar", "cylinder", "plate", "cactus")


def run(name: str, out: Path, *options: str) -> int:
    """Write NAME.stl, NAME.png, NAME.safetensors and NAME.json; 0 if the mesh is clean."""
    out.mkdir(parents=True, exist_ok=True)
    files = {
        "--handles": HERE / f"{name}.toml",
        "--out": out / f"{name}.stl",
        "--warp": out / f"{name}.safetensors",
        "--picture": out / f"{name}.png",
        "--report": out / f"{name}.json",
    }
    named = [str(word) for pair in files.items() for word in pair]
    return main(["deform", str(HERE / f"{name}.py"), *named, *options])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/standard"))
    arguments, rest = parser.parse_known_args()
    names = [word for word in rest if word in NAMES] or NAMES
    options = [word for word in rest if word not in NAMES]
    sys.exit(max(run(name, arguments.out, *options) for name in names))
