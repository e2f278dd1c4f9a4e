"""Options of `fit`."""

from __future__ import annotations

from dataclasses import dataclass

from implicit_warp.alignment import ALIGNMENTS
from implicit_warp.options import Options

PRECISIONS = ("float32", "float64")


@dataclass(frozen=True)
class FitOptions(Options):
    """Options of `fit`.

    Attributes:
        layers, resolution, frames, boundary: of the TutteNet.
        steps: at most so many optimisation steps.
        learning_rate: of Adam at its highest; it falls along a half cosine.
        gradient_weight: weight of the mesh gradients' error against the vertices'.
        landmark_weight: weight of the landmarks' error against the vertices'.
        height: length in the user's units that counts as 1.4 in the loss and the report; the
            longest side of the source's box if None. For a body, its height.
        align: affine map of the source that the net starts from: "none", "rigid" or "affine".
        vertex_goal, gradient_goal: stop when both errors, times 1000, are at most these; an
            error without a goal (None) need not be small, and without any there is no stop.
        seconds: stop after so long; the learning rate then falls with the time that has passed.
        tolerance: stop when the loss fell by less than this fraction over the last tenth of the
            steps; 0 never stops.
        precision: of the points while optimising; embeddings are always solved in float64.
        seed: of the symmetry-breaking start.
        device: where to compute; "cuda" where there is one.
    """

    layers: int = 24
    resolution: int = 11
    frames: str = "cubic"
    boundary: str = "free"
    steps: int = 3000
    learning_rate: float = 0.2
    gradient_weight: float = 0.1
    landmark_weight: float = 1.0
    height: float | None = None
    align: str = "rigid"
    vertex_goal: float | None = None
    gradient_goal: float | None = None
    seconds: float | None = None
    tolerance: float = 0.0
    precision: str = "float32"
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        self._check_counts("layers", "steps")
        self._check_seed(self.seed)
        self._check_numbers("gradient_weight", "landmark_weight", "tolerance")
        optional = ("height", "vertex_goal", "gradient_goal", "seconds")
        given = [name for name in optional if getattr(self, name) is not None]
        self._check_numbers("learning_rate", *given, positive=True)
        self._check_choice("align", ALIGNMENTS)
        self._check_choice("precision", PRECISIONS)
        self._check_device(self.device)
