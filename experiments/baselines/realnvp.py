"""RealNVP (Dinh et al., 2017): one coordinate a layer, scaled and shifted by the other two."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from experiments.baselines.method import Fitted
from experiments.baselines.module_map import ModuleMap
from experiments.baselines.training import train
from implicit_warp.errors import MissingDependency

LAYERS = 6


class RealNVP(nn.Module):
    """Six couplings of zuko; near the identity at first."""

    def __init__(self, width: int, seed: int) -> None:
        super().__init__()
        try:
            from zuko.flows.coupling import GeneralCouplingTransform
        except ImportError as error:
            raise MissingDependency(
                "zuko", "RealNVP", "Install it with `pip install 'implicit_warp[baselines]'`"
            ) from error
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.layers = nn.ModuleList(
                GeneralCouplingTransform(
                    3,
                    mask=torch.arange(3) != layer % 3,  # of the coordinates that stay
                    hidden_features=(width, width),
                    activation=nn.SiLU,
                )
                for layer in range(LAYERS)
            )
        with torch.no_grad():
            for layer in self.layers:
                for parameter in layer.hyper[-1].parameters():
                    parameter *= 0.01

    def forward(self, points: Tensor) -> Tensor:
        """(n, 3) images."""
        for layer in self.layers:
            points = layer()(points)
        return points

    def inverse(self, points: Tensor) -> Tensor:
        """(n, 3) preimages."""
        for layer in reversed(self.layers):
            points = layer().inv(points)
        return points


class RealNVPMap(ModuleMap):
    """A fitted RealNVP; its inverse is exact to rounding."""

    tolerance = 1e-9

    def _solve(self, points: Tensor) -> Tensor:
        return self.module.inverse(points)


def fit_realnvp(source, target, faces, *, height, seconds, seed=0, width: int = 32) -> Fitted:
    """The supplement's size, width 32."""
    return train(
        RealNVP(width, seed), RealNVPMap, source, target, faces,
        height=height, seconds=seconds, seed=seed, learning_rate=1e-2, parts=8,
    )  # fmt: skip


def fit_realnvp_64(source, target, faces, *, height, seconds, seed=0) -> Fitted:
    """Width 64: about as many parameters as the TutteNet has."""
    return fit_realnvp(source, target, faces, height=height, seconds=seconds, seed=seed, width=64)
