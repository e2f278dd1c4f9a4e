"""Maps on disk (`.safetensors`).

A map file holds float64 tensors, bit for bit, and string metadata: what it is, the format's
version, the library's version, the units, the map's certificate.  Nothing in it is executed when it
is read; the certificate is proved anew and compared with the stored one.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from fields.whole_files import atomic_write as atomic_write  # the packages' one door to files
from fields.whole_files import refuse_target as refuse_target
from implicit_warp.affine import Affine
from implicit_warp.axial import AxialMap, Taper, Twist
from implicit_warp.bend import Bend
from implicit_warp.certificate import certify, disagreement
from implicit_warp.errors import FileFormatError, InputError, NotInjective
from implicit_warp.frames import refuse_non_rotations
from implicit_warp.maps import Composition, Inverse, Map
from implicit_warp.shear import Shear
from implicit_warp.tuttenet import TutteNet
from implicit_warp.warp import Warp

if TYPE_CHECKING:
    from implicit_warp.elastic_solve import SolveReport
    from implicit_warp.fitting import FitReport

FORMAT = "implicit_warp.map"
FORMAT_VERSION = 1


def save(map_: Map, path: str | Path, *, units: str = "") -> None:
    """Write a map to a `.safetensors` file, with its certificate and a fingerprint of its numbers.

    Args:
        map_: a `TutteNet` (its parameters), a `Warp` (its tables), an `Affine`, `Twist`, `Taper`,
            `Shear` or `Bend`, or a composition or inverse of these.
        path: where to; written under a temporary name and renamed.
        units: a note on the units of the map's domain, such as "mm".

    Raises:
        InputError: the map is of another kind, or the path cannot be written.
    """
    from safetensors.torch import save_file

    import implicit_warp

    tensors: dict[str, torch.Tensor] = {}
    structure = _describe(map_, tensors)
    metadata = {
        "format": FORMAT,
        "format_version": str(FORMAT_VERSION),
        "library_version": implicit_warp.__version__,
        "units": units,
        "structure": json.dumps(structure),
        "certificate": json.dumps(certify(map_).to_dict()),
    }
    metadata["sha256"] = _digest(tensors, metadata)
    with atomic_write(path) as temporary:
        save_file(tensors, temporary, metadata=metadata)


def load(path: str | Path) -> Map:
    """Read a map that `save` wrote.

    Raises:
        InputError: there is no such file.
        FileFormatError: not a map file, truncated, altered since it was saved, or written by a
            newer version.
        NotInjective: the stored layers fail their proof, which is made anew.
    """
    tensors, metadata = _read(path)
    try:
        for name, tensor in tensors.items():
            if not bool(torch.isfinite(tensor).all()):
                raise InputError(name, tuple(tensor.shape), "NaN or infinite values", "save anew")
        map_ = _rebuild(json.loads(metadata["structure"]), tensors)
        _refuse_altered(path, metadata, tensors, map_)
    except (NotInjective, FileFormatError):
        raise
    except _DAMAGE as error:
        raise FileFormatError(f"{path}: the map's description is damaged ({error})") from error
    return map_


_DAMAGE = (
    AttributeError,
    IndexError,
    InputError,
    KeyError,
    RecursionError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""What rebuilding a map from a damaged description may raise."""


def read_metadata(path: str | Path) -> dict[str, str]:
    """The string metadata of a map file: format, version, units, structure, certificate."""
    return _read(path)[1]


def read_tensors(path: str | Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    """The tensors and the string metadata of any `.safetensors` file.

    Raises:
        InputError: there is no such file.
        FileFormatError: it is truncated, or of another format.
    """
    from safetensors import SafetensorError, safe_open

    path = Path(path)
    if not path.is_file():
        raise InputError("path", str(path), "there is no such file", "check the path")
    try:
        with safe_open(path, framework="pt") as file:
            return {key: file.get_tensor(key) for key in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise FileFormatError(
            f"{path}: not a readable .safetensors file ({error}). It may be truncated; "
            "write it again"
        ) from error


def _read(path: str | Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    tensors, metadata = read_tensors(path)
    if metadata.get("format") != FORMAT:
        raise FileFormatError(
            f"{path}: holds no map (its format is {metadata.get('format')!r}, not {FORMAT!r}). "
            "Maps are written by implicit_warp.save or 'implicit-warp deform'"
        )
    version = metadata.get("format_version", "")
    if version != str(FORMAT_VERSION):
        raise FileFormatError(
            f"{path}: format version {version!r}, but this library reads {FORMAT_VERSION}. "
            "Install the version of implicit_warp that wrote it "
            f"({metadata.get('library_version', 'unknown')}) or a newer one"
        )
    return tensors, metadata


def _describe(map_: Map, tensors: dict[str, torch.Tensor]) -> dict[str, Any]:
    """A JSON description of the map; its tensors go into the dictionary under fresh names."""

    def store(**parts: torch.Tensor | None) -> dict[str, str]:
        names = {}
        for key, tensor in parts.items():
            if tensor is not None:
                names[key] = f"{len(tensors)}.{key}"
                # A copy: one map may stand twice in a composition, and files share no memory.
                tensors[names[key]] = tensor.detach().cpu().contiguous().clone()
        return names

    if isinstance(map_, Warp):
        names = store(
            embeddings=map_.embeddings, frames=map_.frames, before=map_.before, after=map_.after
        )
        report = None if map_.report is None else map_.report.to_dict()
        kind = type(map_.report).__name__
        return {"kind": "warp", "tensors": names, "report": report, "report_kind": kind}
    if isinstance(map_, TutteNet):
        names = store(
            frames_at_start=map_.frames_at_start,
            theta_weights=map_.theta_weights,
            theta_boundary=map_.theta_boundary,
            theta_frames=map_.theta_frames,
        )
        return {"kind": "tuttenet", "tensors": names, "resolution": map_.resolution}
    if isinstance(map_, Affine):
        return {"kind": "affine", "tensors": store(matrix=map_.matrix)}
    if isinstance(map_, AxialMap):
        names = store(frame=map_.frame, origin=map_.origin)
        numbers = {key: getattr(map_, key) for key in _AXIAL[type(map_)]}
        kind = type(map_).__name__.lower()
        return {"kind": kind, "tensors": names, "numbers": numbers}
    if isinstance(map_, Composition):
        return {"kind": "composition", "maps": [_describe(m, tensors) for m in map_.maps]}
    if isinstance(map_, Inverse):
        return {"kind": "inverse", "map": _describe(map_.inv, tensors)}
    raise InputError(
        "map_",
        type(map_).__name__,
        "maps of this kind have no file format",
        "save a TutteNet, Warp, Affine, Twist, Taper, Shear, Bend, or a composition of them",
    )


def _rebuild(structure: dict[str, Any], tensors: dict[str, torch.Tensor]) -> Map:
    kind = structure["kind"]
    if kind == "composition":
        return Composition(_rebuild(part, tensors) for part in structure["maps"])
    if kind == "inverse":
        return _rebuild(structure["map"], tensors).inv
    parts = {key: tensors[name] for key, name in structure["tensors"].items()}
    if kind == "affine":
        return Affine(parts["matrix"][:, :3].numpy(), parts["matrix"][:, 3].numpy())
    if kind == "warp":
        return Warp(**parts, report=_report(structure))
    if kind == "tuttenet":
        start = parts.pop("frames_at_start")
        net = TutteNet(
            layers=len(start),
            resolution=structure["resolution"],
            frames=start.numpy(),
            boundary="free" if "theta_boundary" in parts else "fixed",
        )
        if "theta_frames" in parts:
            net.theta_frames = torch.nn.Parameter(torch.zeros_like(parts["theta_frames"]))
        net.load_state_dict({"frames_at_start": start, **parts})
        return net
    for axial in _AXIAL:
        if kind == axial.__name__.lower():
            frame, numbers = parts["frame"], structure["numbers"]
            refuse_non_rotations("frame", frame[None])
            map_ = axial(**numbers, origin=parts["origin"].tolist())
            map_.frame = frame  # bit for bit, which making it from an axis again would not be
            return map_
    raise FileFormatError(f"unknown kind of map {kind!r}")


def _report(structure: dict[str, Any]) -> SolveReport | FitReport | None:
    if structure.get("report") is None:
        return None
    from implicit_warp.elastic_solve import SolveReport
    from implicit_warp.fitting import FitReport

    # Files written before there were fits do not say whose report it is.
    fitted = structure.get("report_kind") == FitReport.__name__
    return (FitReport if fitted else SolveReport).from_dict(structure["report"])


_AXIAL: dict[type[AxialMap], tuple[str, ...]] = {
    Twist: ("degrees", "between"),
    Taper: ("factors", "between"),
    Bend: ("degrees", "between"),
    Shear: ("slope", "between"),
}
"""The arguments of the axial maps beside their frame and origin."""


def _digest(tensors: dict[str, torch.Tensor], metadata: dict[str, str]) -> str:
    """A fingerprint of everything that defines a saved map; its certificate is compared apart."""
    said = [metadata.get(key) for key in ("units", "structure")]
    digest = hashlib.sha256(json.dumps(said).encode())
    for name in sorted(tensors):
        tensor = tensors[name].contiguous()
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


def _refuse_altered(path, metadata: dict[str, str], tensors: dict, map_: Map) -> None:
    """Compare what the file says of its map with what the map is; old files say nothing."""
    written = metadata.get("sha256")
    if (written is None) != ("certificate" not in metadata):
        raise FileFormatError(
            f"{path}: the file was altered: its certificate and its fingerprint are written "
            "together, and one is missing. Write it again with implicit_warp.save"
        )
    if written is not None:
        if written != _digest(tensors, metadata):
            raise FileFormatError(
                f"{path}: the file was altered: its numbers are not those that were certified when "
                "it was written. Write it again with implicit_warp.save"
            )
        stored = json.loads(metadata["certificate"])
        if not isinstance(stored, dict):
            raise FileFormatError(f"{path}: its certificate is damaged; save the map again")
        difference = disagreement(stored, certify(map_))
        if difference is not None:
            raise FileFormatError(
                f"{path}: the file was altered: in its certificate, {difference}. "
                "Write it again with implicit_warp.save"
            )
