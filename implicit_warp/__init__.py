"""Injective 3D warps of implicit fields and meshes.

    import fields as sdf, implicit_warp as iw

    shape = sdf.sphere(1) & sdf.box(1.5)
    handles = [iw.hold(sdf.below(-0.6)), iw.move(sdf.above(0.6), rotate=("z", 60))]
    warp = iw.elastic(shape, handles)
    mesh = iw.extract(iw.deform(shape, warp), resolution=256)
    iw.check(mesh).raise_if_bad()
    mesh.export("twisted.stl")

Names are loaded on first use: importing the package brings in neither Open3D nor pymeshlab,
trimesh or scikit-image.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOME = {
    "Affine": "affine",
    "BadMesh": "checking",
    "Bend": "bend",
    "Certificate": "certificate",
    "CheckReport": "checking",
    "ColorScale": "color_scales",
    "Composition": "maps",
    "Distortion": "distortion",
    "ElasticOptions": "elastic_solve",
    "FileFormatError": "errors",
    "FitOptions": "fitting",
    "FitReport": "fitting",
    "Handle": "handles",
    "InputError": "errors",
    "Look": "films",
    "Map": "maps",
    "MissingDependency": "errors",
    "Morph": "morph",
    "NotInjective": "errors",
    "PushForwardReport": "push_forward",
    "Shear": "shear",
    "RedistanceReport": "distance_grid",
    "Slice": "slices",
    "SolveReport": "elastic_solve",
    "Taper": "axial",
    "TutteNet": "tuttenet",
    "Twist": "axial",
    "Warp": "warp",
    "animation": "films",
    "back_end": "evaluate",
    "certify": "certificate",
    "check": "checking",
    "color_scale": "color_scales",
    "contours": "slices",
    "deform": "deformation",
    "deform_mesh": "push_forward",
    "elastic": "elastic_solve",
    "elastic_energy": "energy",
    "extract": "extraction",
    "fit": "fitting",
    "handle_distance": "distortion",
    "hold": "handles",
    "layer_picture": "layer_pictures",
    "load": "files",
    "load_handles": "handles",
    "measure_distortion": "distortion",
    "mesh_section": "cross_sections",
    "move": "handles",
    "redistance": "distance_grid",
    "redistance_report": "distance_grid",
    "rigid_motion": "affine",
    "save": "files",
    "save_contours": "slices",
    "save_handles": "handles",
    "set_threads": "threads",
    "slice_plot": "slice_picture",
    "slice_values": "slices",
    "turntable": "films",
    "write_film": "film_files",
}

__all__ = [*sorted(_HOME), "__version__"]

if TYPE_CHECKING:
    from implicit_warp.affine import Affine, rigid_motion
    from implicit_warp.axial import Taper, Twist
    from implicit_warp.bend import Bend
    from implicit_warp.certificate import Certificate, certify
    from implicit_warp.checking import BadMesh, CheckReport, check
    from implicit_warp.color_scales import ColorScale, color_scale
    from implicit_warp.cross_sections import mesh_section
    from implicit_warp.deformation import deform
    from implicit_warp.distance_grid import RedistanceReport, redistance, redistance_report
    from implicit_warp.distortion import Distortion, handle_distance, measure_distortion
    from implicit_warp.elastic_solve import ElasticOptions, SolveReport, elastic
    from implicit_warp.energy import elastic_energy
    from implicit_warp.errors import FileFormatError, InputError, MissingDependency, NotInjective
    from implicit_warp.evaluate import back_end
    from implicit_warp.extraction import extract
    from implicit_warp.files import load, save
    from implicit_warp.film_files import write_film
    from implicit_warp.films import Look, animation, turntable
    from implicit_warp.fitting import FitOptions, FitReport, fit
    from implicit_warp.handles import Handle, hold, load_handles, move, save_handles
    from implicit_warp.layer_pictures import layer_picture
    from implicit_warp.maps import Composition, Map
    from implicit_warp.morph import Morph
    from implicit_warp.push_forward import PushForwardReport, deform_mesh
    from implicit_warp.shear import Shear
    from implicit_warp.slice_picture import slice_plot
    from implicit_warp.slices import Slice, contours, save_contours, slice_values
    from implicit_warp.threads import set_threads
    from implicit_warp.tuttenet import TutteNet
    from implicit_warp.warp import Warp


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
