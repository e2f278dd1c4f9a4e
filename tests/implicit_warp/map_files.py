"""Map files that somebody else has changed."""

from __future__ import annotations

from safetensors import safe_open
from safetensors.torch import save_file


def rewrite(path, change):
    """Let `change(metadata, tensors)` edit a saved map in place."""
    with safe_open(path, framework="pt") as file:
        metadata = dict(file.metadata())
        tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
    change(metadata, tensors)
    save_file(tensors, path, metadata=metadata)
