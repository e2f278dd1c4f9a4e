"""The main job on a real part: bend it by handles, write the mesh, the proof and the picture.

python examples/demo/run.py --out out/demo
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from implicit_warp.cli import main

HERE = Path(__file__).parent


def run(out: Path, *options: str) -> int:
    """Write part.stl, part.png, warp.safetensors and report.json; 0 if the mesh is clean."""
    out.mkdir(parents=True, exist_ok=True)
    files = {
        "--handles": HERE / "handles.toml",
        "--out": out / "part.stl",
        "--warp": out / "warp.safetensors",
        "--picture": out / "part.png",
        "--report": out / "report.json",
    }
    named = [str(word) for pair in files.items() for word in pair]
    return main(["deform", str(HERE / "part.py"), *named, *options])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/demo"))
    arguments, options = parser.parse_known_args()
    code = run(arguments.out, *options)
    if code == 0:
        print(f"See {arguments.out}/part.png")
    sys.exit(code)
