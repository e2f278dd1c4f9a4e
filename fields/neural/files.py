"""Networks on disk: `.safetensors`, plain numbers and text, never code.

Three kinds of file, told apart by "format" in their metadata: a network in its box, a family of
shapes, and the state of an unfinished fit. The first two carry a fingerprint (SHA-256) of all that
defines them, so that a damaged or edited file is refused instead of giving a slightly wrong shape.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from fields.errors import FileFormatError, InputError
from fields.whole_files import atomic_write, refuse_target

NEURAL = "implicit_warp.neural"
FAMILY = "implicit_warp.neural_family"
CHECKPOINT = "implicit_warp.neural_checkpoint"

_KINDS = {
    NEURAL: "a learned field",
    FAMILY: "a family of learned fields",
    CHECKPOINT: "a checkpoint of a fit",
    "implicit_warp.map": "a map",
}

DAMAGE = (AttributeError, InputError, KeyError, RuntimeError, TypeError, ValueError)
"""What making a network from a damaged description may raise."""

VERSION = "1"
SUFFIX = ".safetensors"


def format_of(path: str | Path) -> str | None:
    """What a `.safetensors` file says that it holds, without reading its numbers.

    Raises:
        InputError: there is no such file.
        FileFormatError: it is damaged, or of another kind altogether.
    """
    return _metadata(Path(path)).get("format")


def write(path: str | Path, kind: str, tensors: dict[str, Tensor], facts: dict[str, Any]) -> None:
    """Write a file whole, or not at all.

    Raises:
        InputError: it cannot be written there.
    """
    from safetensors.torch import save_file

    refuse_target(path, (SUFFIX,))
    # A copy each: tensors in a file share no memory.
    tensors = {name: tensor.detach().cpu().contiguous().clone() for name, tensor in tensors.items()}
    text = json.dumps(facts)
    metadata = {
        "format": kind,
        "format_version": VERSION,
        "facts": text,
        "sha256": _fingerprint(tensors, text),
    }
    with atomic_write(path) as temporary:
        save_file(tensors, temporary, metadata=metadata)


def read(path: str | Path, kind: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """The tensors and facts of a file of one kind.

    Raises:
        InputError: there is no such file.
        FileFormatError: damaged, altered, of another kind, or of another version.
    """
    from safetensors.torch import load_file

    path = Path(path)
    metadata = _metadata(path)
    found = metadata.get("format")
    if found != kind:
        other = _KINDS.get(str(found), f"of the unknown format {found!r}")
        raise FileFormatError(f"{path}: holds no {_KINDS[kind][2:]}; it is {other}")
    if metadata.get("format_version") != VERSION:
        raise FileFormatError(
            f"{path}: format version {metadata.get('format_version')!r}, but this library reads "
            f"{VERSION}. Install the version of implicit_warp that wrote it, or a newer one"
        )
    tensors, text = load_file(path), metadata.get("facts", "")
    if metadata.get("sha256") != _fingerprint(tensors, text):
        raise FileFormatError(
            f"{path}: it was altered or damaged since it was written; fit or save it again"
        )
    return tensors, json.loads(text)


def _metadata(path: Path) -> dict[str, str]:
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise InputError("path", str(path), "there is no such file", "check the path")
    try:
        with safe_open(path, framework="pt") as file:
            return file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise FileFormatError(
            f"{path}: not a readable .safetensors file ({error}). It may be truncated"
        ) from error


def _fingerprint(tensors: dict[str, Tensor], text: str) -> str:
    digest = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()
