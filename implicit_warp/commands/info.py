"""The command ``implicit-warp info``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from implicit_warp.commands.common import (
    GOOD,
    Common,
    say,
)

if TYPE_CHECKING:
    pass


@dataclass(frozen=True, kw_only=True)
class Info(Common):
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
                    keys = ("status", "steps", "handle_error", "vertex_error", "gradient_error")
                    facts["solve"] = {k: solved[k] for k in keys if solved.get(k) is not None}
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
            say(f"{name}: {value}")
        return GOOD
