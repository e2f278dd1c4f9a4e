"""Every exception of the package, in one place.

All but `NotInjective` are defined by `fields`, which knows nothing of this package; they are
re-exported here so that users catch them under one roof.
"""

from __future__ import annotations

from fields.errors import FileFormatError, InputError, MissingDependency

__all__ = ["FileFormatError", "InputError", "MissingDependency", "NotInjective"]


class NotInjective(RuntimeError):  # noqa: N818 - it says what is the case, not what failed
    """A map failed its own proof.

    Attributes:
        layer: index of the layer, counted from the first one applied.
        cell: index of the triangle or cone in that layer; None if the whole boundary is at fault.
        kind: "triangle", "cone" or "boundary".
    """

    def __init__(self, layer: int, cell: int | None, kind: str, cause: str) -> None:
        self.layer, self.cell, self.kind = layer, cell, kind
        where = f"layer {layer}, {kind}" if cell is None else f"layer {layer}, {kind} {cell}"
        super().__init__(
            f"{where}: {cause}, so the map folds there. The stored vertices are damaged, or their "
            "parameters went far beyond what float64 resolves: solve again with more layer "
            "regularisation."
        )
