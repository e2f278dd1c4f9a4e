"""The command ``implicit-warp``.

Exit codes: 0 good, 1 a mesh failed its check, 2 bad input, 3 a defect of this program, 130
interrupted (the best warp so far is on disk).
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

# OpenMP reads this when torch loads it.  By default waiting threads spin; torch and Numba each have
# their own, and on a busy machine they were seen to slow each other thirtyfold.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

import tyro
from tyro.conf import Positional, arg

from implicit_warp.errors import FileFormatError, InputError, MissingDependency, NotInjective

if TYPE_CHECKING:
    from implicit_warp.checking import CheckReport
    from implicit_warp.regression import Outcome, Results, Target

GOOD, BAD_MESH, BAD_INPUT, DEFECT, INTERRUPTED = 0, 1, 2, 3, 130

Out = Annotated[Path, arg(aliases=["-o"])]
Referee = Literal["manifold3d", "trimesh", "open3d", "pymeshlab"]


@dataclass(frozen=True, kw_only=True)
class _Common:
    threads: int | None = None
    """Threads of torch and of the kernels; all cores if not given."""


@dataclass(frozen=True, kw_only=True)
class Deform(_Common):
    """Bend a shape by handles: solve for an injective warp, extract the mesh, check the file.

    SHAPE is a Python script that defines `shape` (it is run: use only scripts you trust), or a
    closed mesh. The handle file says which regions stay and which move:

        [[handle]]
        region = "below(-0.6)"
        hold = true

        [[handle]]
        region = "above(0.6)"
        rotate = ["z", 60]

    Example: implicit-warp deform part.py --handles part.toml -o part.stl --picture part.png
    """

    shape: Positional[Path]
    """Field script (.py) or mesh file."""
    handles: Path
    """Handle file (.toml); its [solve] table may set options of the solve."""
    out: Out
    """The deformed mesh: .stl, .obj, .ply, .off, .glb or .3mf."""
    resolution: int = 192
    """Voxels along the longest side of the result's box."""
    warp: Path | None = None
    """Where to save the map (.safetensors); beside the mesh if not given."""
    report: Path | None = None
    """Also save all figures here (.json)."""
    picture: Path | None = None
    """Also save a picture before | after here (.png)."""
    steps: int | None = None
    """At most so many steps of the solve."""
    layers: int | None = None
    """Layers of the warp."""
    seed: int | None = None
    """Seed of every random choice."""
    referees: tuple[Referee, ...] = ("manifold3d",)
    """Libraries whose verdict on the mesh is asked for beside ours."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.elastic_solve import ElasticOptions
        from implicit_warp.handles import load_handles
        from implicit_warp.pipeline import deform_to_files
        from implicit_warp.shapes import load_shape

        warp_path = self.warp or self.out.with_suffix(".safetensors")
        shape = load_shape(self.shape)
        handles, solve = load_handles(self.handles)
        given = {"steps": self.steps, "layers": self.layers, "seed": self.seed}
        solve.update({name: value for name, value in given.items() if value is not None})
        outcome = deform_to_files(
            shape,
            handles,
            self.out,
            options=ElasticOptions.from_mapping(solve),
            resolution=self.resolution,
            warp_path=warp_path,
            report_path=self.report,
            picture_path=self.picture,
            referees=self.referees,
        )
        solved = outcome.warp.report
        _say(
            f"solve: {solved.status} after {solved.steps} steps, {solved.seconds:.1f} s; handle "
            f"error {solved.handle_error:.4g} ({100 * solved.handle_error_relative:.3f} % of the "
            f"diagonal), smallest det J {outcome.report['map'].get('smallest_determinant', 0):.3g}"
        )
        if outcome.verdict is None:
            _say(f"interrupted: no mesh was extracted, the best warp is in {warp_path}")
            return INTERRUPTED
        _say(str(outcome.verdict))
        return _verdict(outcome.verdict)


@dataclass(frozen=True, kw_only=True)
class Extract(_Common):
    """Turn a field script (or re-mesh a closed mesh) into a checked mesh.

    Example: implicit-warp extract part.py -o part.stl --resolution 256
    """

    shape: Positional[Path]
    """Field script (.py) or mesh file."""
    out: Out
    """The mesh: .stl, .obj, .ply, .off, .glb or .3mf."""
    resolution: int = 192
    """Voxels along the longest side of the shape's box."""
    at_wall: Literal["error", "close"] = "error"
    """What to do where the shape reaches the edge of its box: refuse, or close it there."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.extraction import extract
        from implicit_warp.files import refuse_target
        from implicit_warp.mesh_files import WRITABLE
        from implicit_warp.progress import progress_bar
        from implicit_warp.shapes import load_shape

        refuse_target(self.out, WRITABLE)
        shape = load_shape(self.shape)
        with progress_bar("extract") as update:
            mesh = extract(shape, self.resolution, at_wall=self.at_wall, progress=update)
        return _write_and_check(mesh, self.out)


@dataclass(frozen=True, kw_only=True)
class Apply(_Common):
    """Carry a mesh, a field script or points forward by a saved map.

    A mesh keeps its faces and moves its vertices: a coarse one can come out with
    self-intersections, and the check says so. --method exact cuts its faces along the creases of
    the map, so that the result is the exact image; --method adaptive divides them until they follow
    it within a tolerance, also for --inverse. A field script is pulled back and extracted. Points
    are a .npy file of shape (n, 3).

    Example: implicit-warp apply warp.safetensors scan.ply -o posed.ply --method exact
    """

    warp: Positional[Path]
    """Map file (.safetensors)."""
    thing: Positional[Path]
    """Mesh file, field script (.py) or points (.npy)."""
    out: Out
    """A mesh file, or .npy for points."""
    inverse: bool = False
    """Apply the inverse map."""
    method: Literal["vertices", "adaptive", "exact"] = "vertices"
    """For meshes: move vertices only, divide faces adaptively, or cut them exactly."""
    tolerance: float | None = None
    """For --method adaptive: distance from the image; by default 1/1000 of its diagonal."""
    resolution: int = 192
    """For field scripts: voxels along the longest side of the result's box."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.deformation import deform
        from implicit_warp.extraction import extract
        from implicit_warp.files import atomic_write, load, refuse_target
        from implicit_warp.mesh_files import WRITABLE, read_mesh
        from implicit_warp.shapes import load_shape

        suffix = self.thing.suffix.lower()
        refuse_target(self.out, (".npy",) if suffix == ".npy" else WRITABLE)
        if suffix in (".npy", ".py") and (self.method != "vertices" or self.tolerance is not None):
            raise InputError(
                "method",
                self.method,
                f"methods and tolerances are for meshes, and {self.thing} is none",
                "leave them out: points and fields are carried exactly",
            )
        map_ = load(self.warp)
        map_ = map_.inv if self.inverse else map_
        if suffix == ".npy":
            import numpy as np

            moved = map_(_read_points(self.thing))
            with atomic_write(self.out) as temporary, temporary.open("wb") as file:
                np.save(file, moved)
            _say(f"{self.out}: {len(moved)} points")
            return GOOD
        if suffix == ".py":
            mesh = extract(deform(load_shape(self.thing), map_), self.resolution)
        else:
            mesh = self._push_forward(read_mesh(self.thing), map_)
        return _write_and_check(mesh, self.out)

    def _push_forward(self, mesh, map_):
        from implicit_warp.progress import progress_bar
        from implicit_warp.push_forward import deform_mesh

        with progress_bar(self.method) as update:
            image, report = deform_mesh(
                mesh,
                map_,
                self.method,
                tolerance=self.tolerance,
                # Nearly all formats hold float32, in which small pieces would fall together.
                clean_for=None if self.method == "vertices" else "float32",
                progress=update,
            )
        _say(str(report))
        return image


@dataclass(frozen=True, kw_only=True)
class Check(_Common):
    """Check meshes: closed, manifold, oriented, not degenerate, free of self-intersections.

    FILES are meshes, folders (their meshes at any depth) and patterns such as "parts/**/*.stl".
    Each is checked on its own; one that cannot be read does not stop the others. The exit code is
    2 if any could not be read, else 1 if any failed, else 0.

    With --baseline, a file in the baseline passes as long as no count of defects grew: what is
    stored is tolerated. --max-self-intersections then holds for files that are not in it.

    Example: implicit-warp check parts --baseline counts.json --junit report.xml
    """

    files: Positional[tuple[Path, ...]]
    """Meshes, folders of meshes, or patterns."""
    max_self_intersections: int = 0
    """Pairs of faces that may intersect before a file fails."""
    baseline: Path | None = None
    """Stored counts (.json); paths in it are relative to its folder."""
    update: bool = False
    """Store the counts of this run in the baseline; then only unreadable files fail."""
    junit: Path | None = None
    """Also write the verdicts as JUnit XML here (.xml)."""
    evidence: Path | None = None
    """Folder for a picture and a coloured mesh of each file that fails: where its defects are."""
    json: bool = False
    """Print everything as JSON, and nothing else."""
    referees: tuple[Referee, ...] = ("manifold3d",)
    """Libraries whose verdict is asked for beside ours."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.files import atomic_write, refuse_target
        from implicit_warp.regression import Gate, Results, find_targets, junit_xml

        if not self.files:
            raise InputError("files", (), "there is nothing to check", "name one or more meshes")
        if self.junit is not None:
            refuse_target(self.junit, (".xml",))
        if self.baseline is not None and self.update:
            refuse_target(self.baseline, (".json",))
        self._refuse_evidence()
        gate = Gate.open(
            self.baseline,
            self.update,
            max_self_intersections=self.max_self_intersections,
            referees=self.referees,
            evidence=self.evidence,
        )
        results = Results(gate)
        self._check(results, find_targets(self.files, exclude=self.evidence))
        if self.update:
            results.store()
        if self.junit is not None:
            with atomic_write(self.junit) as temporary:
                temporary.write_bytes(junit_xml(results.outcomes, results.started))
        code = BAD_MESH if results.count("failed") else GOOD
        code = BAD_INPUT if results.count("unreadable") else code
        if self.json:
            _say(json.dumps(results.to_dict(code), indent=2))
        elif summary := results.summary():
            _say(_printable(summary))
        return code

    def _refuse_evidence(self) -> None:
        """Raise where the pictures cannot go, or would be taken for meshes to check."""
        folder = self.evidence
        if folder is None:
            return
        existing = next(p for p in (folder, *folder.absolute().parents) if p.exists())
        if not existing.is_dir() or not os.access(existing, os.W_OK):
            raise InputError(
                "evidence", str(folder), f"{existing} is no writable folder", "choose another one"
            )
        place = folder.resolve()
        for searched in filter(Path.is_dir, self.files):
            if place == searched.resolve() or place in searched.resolve().parents:
                raise InputError(
                    "evidence",
                    str(folder),
                    f"{searched} is searched for meshes, and would hold those of the evidence",
                    "choose a folder of its own, such as evidence/",
                )

    def _check(self, results: Results, targets: Sequence[Target]) -> None:
        """Check all, telling of each as it comes; after the last where a bar is in the way."""
        from implicit_warp.progress import progress_bar

        if not sys.stderr.isatty():
            for outcome in results.run(targets):
                self._tell(outcome, alone=len(targets) == 1)
            return
        with progress_bar("check", show=True) as update:
            update(0, len(targets), str(targets[0].path))
            for done, _ in enumerate(results.run(targets), 1):
                update(done, len(targets), "".join(str(t.path) for t in targets[done : done + 1]))
        for outcome in results.outcomes:
            self._tell(outcome, alone=len(targets) == 1)

    def _tell(self, outcome: Outcome, alone: bool) -> None:
        """A line for what passed among others, the whole report for the rest."""
        if outcome.facts is None:
            sys.stderr.write(f"implicit-warp: {outcome.error}\n")
            return
        if outcome.no_evidence:
            sys.stderr.write(f"implicit-warp: {outcome.path}: no picture: {outcome.no_evidence}\n")
        if self.json:
            return
        if outcome.failures or alone:
            _say(_printable(outcome.text))
        tolerated = not outcome.facts["ok"] and not outcome.failures
        verdict = outcome.status + (" with tolerated defects" if tolerated else "")
        _say(_printable(f"{outcome.path}: {verdict}, {outcome.seconds:.2f} s"))
        for path in outcome.evidence:
            _say(_printable(f"  see {path}"))


@dataclass(frozen=True, kw_only=True)
class Info(_Common):
    """Say what is in a map file or a mesh file.

    Example: implicit-warp info warp.safetensors
    """

    file: Positional[Path]
    """Map (.safetensors), mesh, or field script (.py)."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.certificate import certify
        from implicit_warp.files import load, read_metadata
        from implicit_warp.mesh_files import read_mesh
        from implicit_warp.shapes import load_shape
        from implicit_warp.warp import Warp

        suffix = self.file.suffix.lower()
        if suffix == ".safetensors":
            metadata, map_ = read_metadata(self.file), load(self.file)
            known = ("format", "format_version", "library_version", "units", "sha256")
            facts = {"map": repr(map_)} | {k: metadata[k] for k in known if k in metadata}
            facts["certificate"] = certify(map_)
            if isinstance(map_, Warp):
                facts |= {"layers": map_.n_layers, "resolution": map_.resolution}
                if map_.report is not None:
                    solved = map_.report.to_dict()
                    facts["solve"] = {k: solved[k] for k in ("status", "steps", "handle_error")}
        elif suffix == ".py":
            shape = load_shape(self.file)
            bounds = None if shape.bounds is None else shape.bounds.tolist()
            facts = {"shape": repr(shape), "bounds": bounds}
            facts |= {"exact": shape.exact, "lipschitz": shape.lipschitz}
        else:
            mesh = read_mesh(self.file)
            facts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
            facts["bounds"] = mesh.bounds.tolist()
        for name, value in facts.items():
            _say(f"{name}: {value}")
        return GOOD


@dataclass(frozen=True, kw_only=True)
class Bench(_Common):
    """Measure the speed goals, each beside the torch reference in the same run.

    Takes two to three minutes on two idle cores. Ratios count: absolute figures depend on the
    machine and its load, which is printed.

    Example: implicit-warp bench --json > bench.json
    """

    json: bool = False
    """Print JSON instead of a table."""
    device: str = "cpu"
    """cpu, or a CUDA device of torch."""
    quick: bool = False
    """Smaller calls and fewer rounds: under half a minute, and noisier."""
    memory_points: int = 10_000_000
    """Points of the call whose memory is measured; 10^8 need 2.4 GB for input and output."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.benchmark import Settings, run_benchmark
        from implicit_warp.progress import progress_bar

        make = Settings.quick if self.quick else Settings
        settings = make(device=self.device, memory_points=self.memory_points)
        with progress_bar("bench") as update:
            report = run_benchmark(settings, update)
        _say(json.dumps(report.to_dict(), indent=2) if self.json else report.table())
        return GOOD


COMMANDS = {
    "deform": Deform,
    "extract": Extract,
    "apply": Apply,
    "check": Check,
    "info": Info,
    "bench": Bench,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,
        prog="implicit-warp",
        description="Injective 3D warps of implicit fields: deform, extract, check, measure.",
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


def _write_and_check(mesh, path: Path) -> int:
    from implicit_warp.checking import check
    from implicit_warp.mesh_files import write_mesh

    write_mesh(mesh, path)
    report = check(path)
    _say(str(report))
    return _verdict(report)


def _verdict(report: CheckReport, allowed: int = 0) -> int:
    from implicit_warp.checking import BadMesh

    try:
        report.raise_if_bad(allowed)
    except BadMesh:
        return BAD_MESH
    return GOOD


def _read_points(path: Path):
    import numpy as np

    try:
        return np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(
            "thing", str(path), f"not a readable .npy file ({error})", "save it with numpy.save"
        ) from error


def _printable(text: str) -> str:
    """The text with what standard output cannot encode, as in odd file names, as escapes."""
    encoding = sys.stdout.encoding or "utf-8"
    return text.encode(encoding, "backslashreplace").decode(encoding)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")


if __name__ == "__main__":
    sys.exit(main())
