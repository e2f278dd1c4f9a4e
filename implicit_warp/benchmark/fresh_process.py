"""Measurements that need a process of their own: imports, the first call, peak memory.

Each program is a few lines run by a fresh interpreter, which prints one JSON value.  Nothing of
this package is imported before the program's own clock starts.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

IMPORT = """
start = time.perf_counter()
import torch
torch_seconds = time.perf_counter() - start
start = time.perf_counter()
import implicit_warp
print(json.dumps([time.perf_counter() - start, torch_seconds]))
"""
"""Seconds to import implicit_warp after torch, and seconds to import torch."""

FIRST_CALL = """
import torch
import implicit_warp as iw
points = torch.zeros(1000, 3, device=job["device"])
start = time.perf_counter()
with iw.back_end(job["back_end"]):
    warp = iw.load(job["warp"])
    warp = warp.to(job["device"]) if job["device"] != "cpu" else warp
    warp(points).cpu()
print(json.dumps(time.perf_counter() - start))
"""
"""Seconds to load a warp from its file and map its first points, the back end's loading included.
"""

PEAK_MEMORY = """
import resource
import torch
import implicit_warp as iw

def peak():
    if job["device"] != "cpu":
        return torch.cuda.max_memory_allocated(job["device"])
    try:
        # The kernel's own mark of this process. The one that getrusage reports starts, on Linux,
        # at the peak of the process that started this one.
        with open("/proc/self/status") as status:
            return 1024 * next(int(l.split()[1]) for l in status if l.startswith("VmHWM"))
    except (OSError, StopIteration):
        unit = 1 if sys.platform == "darwin" else 1024
        return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

with iw.back_end(job["back_end"]):
    warp = iw.load(job["warp"])
    warp = warp.to(job["device"]) if job["device"] != "cpu" else warp
    points = torch.rand(job["points"], 3, device=job["device"]).mul_(2).sub_(1)
    warp(points[:1000])
    # A result's worth of memory, touched and given back: what the peak rises by afterwards is what
    # the call needs beyond its input and its output.
    room = torch.ones_like(points)
    del room
    before = peak()
    image = warp(points)
    print(json.dumps(peak() - before))
"""
"""Bytes by which one call on many points raises the peak beyond its input and its output."""

_PREAMBLE = "import json, sys, time\njob = json.loads(sys.argv[1])\n"


def run_fresh(program: str, job: dict[str, Any], threads: int) -> Any:
    """Run one of the programs in a fresh interpreter; returns the value it prints.

    Args:
        program: one of the texts above.
        job: plain values that the program reads as `job`.
        threads: of every numeric library.

    Raises:
        RuntimeError: the program failed; the message holds its last words.
    """
    environment = dict(os.environ)
    root = str(Path(__file__).resolve().parents[2])
    environment["PYTHONPATH"] = os.pathsep.join(
        [root, *filter(None, [environment.get("PYTHONPATH")])]
    )
    for variable in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS"):
        environment[variable] = str(threads)
    result = subprocess.run(
        [sys.executable, "-c", _PREAMBLE + program, json.dumps(job)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode:
        raise RuntimeError(f"a measuring process failed:\n{result.stderr[-2000:]}")
    return json.loads(result.stdout.splitlines()[-1])
