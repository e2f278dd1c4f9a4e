"""Networks as maps."""

from __future__ import annotations

from abc import abstractmethod

import torch
from torch import Tensor, nn

from implicit_warp.maps import Map


class ModuleMap(Map):
    """A network whose every output depends on one point only, as a map.

    Attributes:
        module: the network, in evaluation from now on.
        tolerance: largest |f^-1(f(x)) - x| that its inverse promises, in its own units, in float64
            and for points within twice the unit ball.
    """

    tolerance: float = 1e-9

    def __init__(self, module: nn.Module) -> None:
        self.module = module.double().eval().requires_grad_(False)

    @abstractmethod
    def _solve(self, points: Tensor) -> Tensor:
        """The preimages of float64 points (n, 3)."""

    def _forward(self, points: Tensor) -> Tensor:
        return self.module(points.double()).to(points.dtype)

    def _inverse(self, points: Tensor) -> Tensor:
        return self._solve(points.double()).to(points.dtype)

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        graph = torch.is_grad_enabled() and points.requires_grad
        with torch.enable_grad():
            x = points.double() if graph else points.detach().double().requires_grad_()
            y = self.module(x)
            rows = [
                torch.autograd.grad(y[:, i].sum(), x, retain_graph=True, create_graph=graph)[0]
                for i in range(3)
            ]
        jacobian = torch.stack(rows, dim=1)
        if not graph:
            y = y.detach()
        return y.to(points.dtype), jacobian.to(points.dtype)

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        preimages = self._inverse(points)
        jacobian = self._forward_and_jacobian(preimages)[1]
        return preimages, torch.linalg.inv(jacobian)
