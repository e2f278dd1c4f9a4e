"""The figures of the paper (Sun et al., CVPR 2024), for the columns beside ours.

They are means over 200 pairs of SMPL bodies in poses of AMASS, which may not be passed on; times
are of the authors' machine.
"""

from __future__ import annotations

from dataclasses import dataclass

ACCURACY = (0.15, 4.4)
"""Vertex and gradient error, times 1000, of the paper's fits (Table 2)."""


@dataclass(frozen=True)
class PaperRow:
    """One method in Table 2: errors of fitting, times 1000, and seconds."""

    vertex: float
    gradient: float
    forward: float
    jacobian: float


TABLE_2 = {
    "tuttenet": PaperRow(0.15, 4.4, 0.09, 0.02),
    "realnvp": PaperRow(1.7, 12.5, 0.006, 136.0),
    "i_resnet": PaperRow(17.9, 40.2, 0.005, 39.0),
    "neural_ode": PaperRow(0.19, 2.6, 0.11, 0.19),
}

ABLATIONS = {
    "6 layers": (1.29, 12.5),
    "12 layers": (0.24, 6.1),
    "24 layers": (0.15, 4.4),
    "36 layers": (0.12, 3.2),
    "resolution 7": (0.22, 5.6),
    "resolution 11": (0.15, 4.4),
    "resolution 17": (0.11, 2.9),
    "resolution 25": (0.09, 2.1),
}
"""Vertex and gradient error of fitting (supplement, tables of layers and resolution)."""

LEARNING_ORIENTATIONS = {
    "tri-plane": (0.25, 8.9),
    "cubic": (0.21, 8.4),
    "free": (0.16, 7.7),
}
"""The paper varies orientations in its learning experiment only, where "free" is predicted."""
