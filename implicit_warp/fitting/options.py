"""Options of `fit`."""

from __future__ import annotations

from dataclasses import dataclass

from implicit_warp.alignment import ALIGNMENTS
from implicit_warp.options import Options

PRECISIONS = ("float32", "float64")
SCHEDULES = ("cosine", "constant")


@dataclass(frozen=True)
class FitOptions(Options):
    """Options of `fit`.

    Attributes:
        layers, resolution, frames, boundary, init: of the TutteNet.
        steps: at most so many optimisation steps.
        learning_rate: of Adam at its highest.
        schedule: "cosine", a half cosine down to nothing, or "constant".
        memory: of Adam for squares, its second beta.  The usual 0.999 remembers the steep first
            steps for as long as a fit takes, and lets a sudden slope take steps of many rates.
        boundary_rate: learning rate of the boundary's parameters against the weights': an
            increment moves every boundary vertex behind it, so that many small steps the same way
            add up to a turn of the square.
        relapse: a loss so many times the best one takes the best state up again, at a lower
            learning rate; None waits until it is no number.  One step too far in many layers at
            once can throw a fit back to where it takes hundreds of steps to return from, and a rate
            that is too high for a pair shows itself by relapses.
        gradient_weight: weight of the mesh gradients' error against the vertices'.
        landmark_weight: weight of the landmarks' error against the vertices'.
        height: length in the user's units that counts as 1.4 in the loss and the report; the
            longest side of the source's box if None. For a body, its height.
        align: affine map of the source that the net starts from: "none", "rigid" or "affine".
        radius: of source and target in the domain of the net, whose square layers reach to 1.
            Small, and few cells are used; large, and the ends lie in the cones around the squares.
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
    init: str = "identity"
    steps: int = 1000
    learning_rate: float = 0.15
    schedule: str = "cosine"
    memory: float = 0.95
    boundary_rate: float = 0.1
    relapse: float | None = 5.0
    gradient_weight: float = 0.1
    landmark_weight: float = 1.0
    height: float | None = None
    align: str = "rigid"
    radius: float = 1.2
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
        optional = ("height", "vertex_goal", "gradient_goal", "seconds", "relapse")
        given = [name for name in optional if getattr(self, name) is not None]
        self._check_numbers("learning_rate", "radius", "boundary_rate", *given, positive=True)
        self._check_numbers("memory")
        if self.memory >= 1.0:
            self._refuse("memory", "not below 1", "0.95 and 0.999 are usual")
        if self.relapse is not None and self.relapse <= 1.0:
            self._refuse("relapse", "every step would be one", "pass e.g. 5, or None")
        self._check_choice("schedule", SCHEDULES)
        self._check_choice("align", ALIGNMENTS)
        self._check_choice("precision", PRECISIONS)
        self._check_device(self.device)
