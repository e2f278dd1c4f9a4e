"""NeuralODE (Chen et al., 2018): points carried along by the flow of a network.

Differentiated through the solver's steps.  A flow is injective as an exact solution; the solver
keeps to it within its tolerance, so forward and backward integration differ by about that much.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from experiments.baselines.method import Fitted
from experiments.baselines.module_map import ModuleMap
from experiments.baselines.training import train
from implicit_warp.errors import MissingDependency

WIDTH, TOLERANCE = 120, 1e-4


class Velocity(nn.Module):
    """Four linear layers from place and time to a velocity."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.net = nn.Sequential(
            nn.Linear(4, width), nn.Tanh(), nn.Linear(width, width), nn.Tanh(),
            nn.Linear(width, width), nn.Tanh(), nn.Linear(width, 3),
        )  # fmt: skip
        with torch.no_grad():
            self.net[-1].weight *= 0.01
            self.net[-1].bias.zero_()

    def forward(self, time: Tensor, points: Tensor) -> Tensor:
        """(n, 3) at a time."""
        times = time.to(points).expand(len(points), 1)
        return self.net(torch.cat([points, times], 1))


class Flow(nn.Module):
    """The flow of the velocity from time 0 to 1, by Dormand and Prince's adaptive method."""

    def __init__(self, width: int, seed: int) -> None:
        super().__init__()
        try:
            from torchdiffeq import odeint
        except ImportError as error:
            raise MissingDependency(
                "torchdiffeq",
                "the NeuralODE",
                "Install it with `pip install 'implicit_warp[baselines]'`",
            ) from error
        self._odeint = odeint
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.velocity = Velocity(width)

    def _carried(self, points: Tensor, start: float, end: float) -> Tensor:
        if not len(points):
            return points
        times = torch.tensor([start, end], dtype=points.dtype, device=points.device)
        options = {"method": "dopri5", "rtol": TOLERANCE, "atol": TOLERANCE}
        return self._odeint(self.velocity, points, times, **options)[1]

    def forward(self, points: Tensor) -> Tensor:
        """(n, 3) images."""
        return self._carried(points, 0.0, 1.0)

    def inverse(self, points: Tensor) -> Tensor:
        """(n, 3) preimages, to the solver's tolerance."""
        return self._carried(points, 1.0, 0.0)


class FlowMap(ModuleMap):
    """A fitted flow.

    The solver holds its tolerance in the mean square over all points of a call, and the flow
    magnifies errors on its way: single points come back to a hundredth or so, not to 1e-4.
    """

    tolerance = 0.05

    def _solve(self, points: Tensor) -> Tensor:
        return self.module.inverse(points)


def fit_neural_ode(source, target, faces, *, height, seconds, seed=0) -> Fitted:
    """The supplement's size and tolerances."""
    return train(
        Flow(WIDTH, seed), FlowMap, source, target, faces,
        height=height, seconds=seconds, seed=seed, learning_rate=5e-3, parts=8,
    )  # fmt: skip
