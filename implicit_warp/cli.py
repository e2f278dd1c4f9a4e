"""The command ``implicit-warp``.

Exit codes: 0 good, 1 a mesh failed its check, 2 bad input, 3 a defect of this program, 130
interrupted (the best warp so far is on disk).
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

# OpenMP reads this when torch loads it.  By default waiting threads spin; torch and Numba each have
# their own, and on a busy machine they were seen to slow each other thirtyfold.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import tyro

from implicit_warp.commands.apply import Apply
from implicit_warp.commands.bench import Bench
from implicit_warp.commands.check import Check
from implicit_warp.commands.common import BAD_INPUT, DEFECT, INTERRUPTED
from implicit_warp.commands.deform import Deform
from implicit_warp.commands.extract import Extract
from implicit_warp.commands.fit import Fit
from implicit_warp.commands.info import Info
from implicit_warp.commands.learn_sdf import LearnSdf
from implicit_warp.commands.render import Render
from implicit_warp.commands.slice import Slice
from implicit_warp.commands.view import View
from implicit_warp.errors import FileFormatError, InputError, MissingDependency, NotInjective

COMMANDS = {
    "deform": Deform,
    "fit": Fit,
    "extract": Extract,
    "slice": Slice,
    "render": Render,
    "view": View,
    "apply": Apply,
    "check": Check,
    "learn-sdf": LearnSdf,
    "info": Info,
    "bench": Bench,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="implicit-warp",
        description="Injective 3D warps of implicit fields: deform, fit, extract, check, measure.",
        args=arguments,
    )
    try:
        if command.threads is not None:
            from implicit_warp.threads import set_threads

            set_threads(command.threads)
        return command.run()
    except (InputError, FileFormatError, NotInjective, MissingDependency) as error:
        sys.stderr.write(f"implicit-warp: {error}\n")
        return BAD_INPUT
    except KeyboardInterrupt:
        sys.stderr.write("implicit-warp: interrupted\n")
        return INTERRUPTED
    except Exception:  # noqa: BLE001 - a defect must not look like a verdict, exit code 1
        traceback.print_exc()
        return DEFECT


if __name__ == "__main__":
    sys.exit(main())
