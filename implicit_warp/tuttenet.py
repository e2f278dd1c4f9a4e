"""TutteNet: a learnable composition of prismatic layers (Sun et al., CVPR 2024)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from implicit_warp import embedding, evaluate
from implicit_warp.certificate import Certificate, no_certificate
from implicit_warp.errors import InputError, NotInjective
from implicit_warp.frames import make_frames, turn
from implicit_warp.layers import LayerStack, fuse_frames
from implicit_warp.maps import Map
from implicit_warp.square_mesh import SquareMesh, square_mesh

if TYPE_CHECKING:
    from implicit_warp.local_bounds import LocalBounds
    from implicit_warp.warp import Warp

BOUNDARIES = ("free", "fixed")
INITIALISATIONS = ("identity", "paper")


class TutteNet(Map, nn.Module):
    """An injective map of R^3 with unconstrained parameters.

    Each layer is a Tutte embedding of the square mesh in its frame's plane, extended by cones to
    the whole plane, and the identity along the frame's normal.  Any parameter values give a
    homeomorphism of R^3; parameters of zero give the identity.  Embeddings are solved in float64
    whatever the dtype of the points.

    Args:
        layers: number of prismatic layers K.
        resolution: vertices a side of each layer's mesh, N.
        frames: "triplane", "cubic", "free" (learned, from triplane) or rotations (K, 3, 3).
        boundary: "free" lets boundary vertices slide along the square, "fixed" holds them.
        init: "identity", or "paper" for normally distributed parameters.
        seed: of the random initialisation.

    Non-guarantees: gradients are of first order on the fast back ends (use
    ``back_end("torch")`` for higher ones); forward hooks of `torch.nn.Module` are not called.

    Attributes:
        theta_weights: (K, E) parameters of the directed edge weights.
        theta_boundary: (K, M) parameters of the boundary increments; absent when held fixed.
        theta_frames: (K, 3) rotation vectors of free frames; absent otherwise.

    Raises:
        InputError: an argument out of range or an unknown name.
    """

    def __init__(
        self,
        layers: int = 24,
        resolution: int = 11,
        frames="triplane",
        boundary: str = "free",
        *,
        init: str = "identity",
        seed: int = 0,
    ) -> None:
        super().__init__()
        if not isinstance(layers, (int, np.integer)) or layers < 1:
            raise InputError("layers", layers, "a net needs at least one layer", "pass e.g. 24")
        if boundary not in BOUNDARIES:
            raise InputError(
                "boundary", boundary, "no such boundary", f"use one of {', '.join(BOUNDARIES)}"
            )
        if init not in INITIALISATIONS:
            raise InputError(
                "init", init, "no such initialisation", f"use one of {', '.join(INITIALISATIONS)}"
            )
        self.mesh: SquareMesh = square_mesh(resolution)
        self.register_buffer("frames_at_start", make_frames(frames, layers))
        generator = torch.Generator().manual_seed(seed)

        def parameter(size: int, spread: float) -> nn.Parameter:
            values = torch.randn(layers, size, generator=generator, dtype=torch.float64)
            return nn.Parameter(spread * values)

        spread = 1.0 if init == "paper" else 0.0
        self.theta_weights = parameter(self.mesh.n_edges, spread)
        self.theta_boundary = parameter(self.mesh.n_cones, spread) if boundary == "free" else None
        self.theta_frames = (
            parameter(3, 0.0) if isinstance(frames, str) and frames == "free" else None
        )

    @property
    def n_layers(self) -> int:
        """K, the number of layers."""
        return len(self.theta_weights)

    @property
    def resolution(self) -> int:
        """N, the number of vertices a side of each layer's mesh."""
        return self.mesh.resolution

    def extra_repr(self) -> str:
        """What `repr` shows beside the class name."""
        return f"layers={self.n_layers}, resolution={self.resolution}"

    def frames(self) -> Tensor:
        """(K, 3, 3) the current frames."""
        if self.theta_frames is None:
            return self.frames_at_start
        return turn(self.frames_at_start, self.theta_frames)

    def embeddings(self) -> Tensor:
        """(K, V, 2) the vertices of every layer's image; differentiable."""
        weights = embedding.edge_weights(self.theta_weights)
        theta = self.theta_boundary
        if theta is None:
            theta = weights.new_zeros(self.n_layers, self.mesh.n_cones)
        return embedding.embed(weights, embedding.boundary_positions(theta, self.mesh), self.mesh)

    def stack(self, before: Tensor | None = None, after: Tensor | None = None) -> LayerStack:
        """The layers as evaluated, optionally between two affine maps (3, 4); differentiable."""
        stack = LayerStack(self.mesh, self.embeddings(), fuse_frames(self.frames(), before, after))
        if not bool(
            torch.isfinite(stack.embeddings.detach().sum() + stack.transitions.detach().sum())
        ):
            raise InputError(
                "parameters",
                "NaN or infinite",
                "the layers cannot be solved, so the optimisation has diverged",
                "go back to an earlier state, and lower the learning rate",
            )
        return stack

    def freeze(self) -> Warp:
        """The compiled form: tables only, fast, saveable, checked to be injective."""
        from implicit_warp.warp import Warp

        with torch.no_grad():
            return Warp(self.embeddings(), self.frames())

    def _certify(self, box: np.ndarray | None) -> Certificate:
        try:
            return replace(self.freeze()._certify(box), map=repr(self))
        except (InputError, NotInjective) as error:
            return no_certificate(self, str(error), box)

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        return self.freeze()._local_bounds(boxes)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return self.freeze()._local_bounds_of_inverse(boxes)

    def _forward(self, points: Tensor) -> Tensor:
        return evaluate.forward(self.stack(), points)

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return evaluate.forward_and_jacobian(self.stack(), points)

    def _inverse(self, points: Tensor) -> Tensor:
        return evaluate.inverse(self.stack(), points)

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return evaluate.inverse_and_jacobian(self.stack(), points)
