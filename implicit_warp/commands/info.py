"""The command ``implicit-warp info``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from implicit_warp.commands.common import (
    GOOD,
    Common,
    say,
)

if TYPE_CHECKING:
    from fields import Field


@dataclass(frozen=True, kw_only=True)
class Info(Common):
    """Say what is in a map file, a learned field or a mesh file.

    Example: implicit-warp info warp.safetensors
    """

    file: Positional[Path]
    """Map or learned field (.safetensors), mesh, or field script (.py)."""

    def run(self) -> int:
        """Carry out the command; returns the exit code."""
        from implicit_warp.mesh_files import read_mesh
        from implicit_warp.shapes import load_shape

        suffix = self.file.suffix.lower()
        if suffix == ".safetensors":
            facts = _facts_of_numbers(self.file)
        elif suffix == ".py":
            facts = _facts_of_field(load_shape(self.file))
        else:
            mesh = read_mesh(self.file)
            facts = {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
            facts["bounds"] = mesh.bounds.tolist()
        for name, value in facts.items():
            say(f"{name}: {value}")
        return GOOD


def _facts_of_numbers(path: Path) -> dict[str, Any]:
    """Of a `.safetensors` file, by what it says it is; a map if it says nothing known."""
    from fields.neural import files

    kind = files.format_of(path)
    if kind == files.NEURAL:
        return _facts_of_learned(path)
    if kind == files.FAMILY:
        from fields import Family

        family = Family.load(path)
        return {"family": repr(family), "box": family.box.tolist()}
    if kind == files.CHECKPOINT:
        _, facts = files.read(path, kind)
        record, options = facts["record"], facts["of"]["options"]
        return {"checkpoint": f"{record['step']} of {options['steps']} steps of a fit"}
    return _facts_of_map(path)


def _facts_of_learned(path: Path) -> dict[str, Any]:
    from fields import load_neural
    from fields.neural.leaf import neural_leaf, summary
    from fields.neural.storing import facts_of

    shape = load_neural(path)
    learned = facts_of(path)
    facts = {"learned field": summary(neural_leaf(shape).network)}
    facts |= _facts_of_field(shape) | {"architecture": learned["architecture"]}
    report = learned["report"]
    if report is not None:
        facts["fit"] = {key: report[key] for key in ("status", "steps", "seconds")}
        facts["accuracy"] = report["accuracy"]
    return facts


def _facts_of_field(shape: Field) -> dict[str, Any]:
    bounds = None if shape.bounds is None else shape.bounds.tolist()
    facts = {"shape": repr(shape), "bounds": bounds}
    return facts | {"exact": shape.exact, "lipschitz": shape.lipschitz}


def _facts_of_map(path: Path) -> dict[str, Any]:
    from implicit_warp.certificate import certify
    from implicit_warp.files import load, read_metadata
    from implicit_warp.warp import Warp

    metadata, map_ = read_metadata(path), load(path)
    known = ("format", "format_version", "library_version", "units", "sha256")
    facts = {"map": repr(map_)} | {k: metadata[k] for k in known if k in metadata}
    facts["certificate"] = certify(map_)
    if isinstance(map_, Warp):
        facts |= {"layers": map_.n_layers, "resolution": map_.resolution}
        if map_.report is not None:
            solved = map_.report.to_dict()
            keys = ("status", "steps", "handle_error", "vertex_error", "gradient_error")
            facts["solve"] = {k: solved[k] for k in keys if solved.get(k) is not None}
    return facts
