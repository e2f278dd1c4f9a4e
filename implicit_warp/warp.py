"""The compiled form of a TutteNet: frozen, fast, saveable, and checked to be injective."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from implicit_warp import evaluate
from implicit_warp.errors import InputError
from implicit_warp.frames import refuse_non_rotations
from implicit_warp.layers import LayerStack, fuse_frames
from implicit_warp.maps import Map
from implicit_warp.square_mesh import SquareMesh, square_mesh

if TYPE_CHECKING:
    from implicit_warp.certificate import Certificate
    from implicit_warp.elastic_solve import SolveReport
    from implicit_warp.fitting import FitReport
    from implicit_warp.local_bounds import LocalBounds
    from implicit_warp.orientation import Decided


class Warp(Map):
    """K prismatic layers between two affine maps; nothing in it can be trained.

    The affine maps carry the user's units: a solve works in a unit domain and returns its result
    as ``after . layers . before``.

    Args:
        embeddings: (K, V, 2) image vertices of each layer's square mesh, V = N^2 + (N-1)^2; all
            else is brought to their device.
        frames: (K, 3, 3) rotations, columns: plane axes and normal.
        before, after: (3, 4) affine maps with positive determinant; the identity by default.
        report: how a solve or a fit arrived at this map, if one did.

    Raises:
        InputError: shapes that do not fit, or values that are not finite.
        NotInjective: a layer is not proved to be a homeomorphism.

    Guarantee: the exact map that the stored numbers define is a homeomorphism of R^3: orientations
    and determinants have been decided without rounding (`orientation` states the theorem, `certify`
    reports).  Non-guarantee: evaluation rounds, so that points within rounding of each other can
    get equal images.
    """

    def __init__(
        self,
        embeddings: Tensor,
        frames: Tensor,
        before: Tensor | None = None,
        after: Tensor | None = None,
        report: SolveReport | FitReport | None = None,
    ) -> None:
        self.embeddings = _frozen("embeddings", embeddings, (None, None, 2))
        device = self.embeddings.device
        self.frames = _frozen("frames", frames, (len(self.embeddings), 3, 3)).to(device)
        # Room for the frames of a float32 net; the transitions are inverted as they are.
        refuse_non_rotations("frames", self.frames, tolerance=1e-6)
        unit = torch.eye(3, 4, dtype=torch.float64)
        self.before = _frozen("before", unit if before is None else before, (3, 4)).to(device)
        self.after = _frozen("after", unit if after is None else after, (3, 4)).to(device)
        self.report = report
        self._stack = LayerStack(
            _mesh_of(self.embeddings),
            self.embeddings,
            fuse_frames(self.frames, self.before, self.after),
        )
        self._orientations = self._prove()

    @property
    def mesh(self) -> SquareMesh:
        """The rest mesh that all layers share."""
        return self._stack.mesh

    @property
    def n_layers(self) -> int:
        """K, the number of layers."""
        return len(self.embeddings)

    @property
    def resolution(self) -> int:
        """N, the number of vertices a side of each layer's mesh."""
        return self.mesh.resolution

    @property
    def stack(self) -> LayerStack:
        """The layers as the back ends evaluate them."""
        return self._stack

    def __repr__(self) -> str:
        return f"Warp(layers={self.n_layers}, resolution={self.resolution})"

    def to(self, device) -> Warp:
        """The same map with its tables on another device."""
        parts = (self.embeddings, self.frames, self.before, self.after)
        return Warp(*(part.to(device) for part in parts), report=self.report)

    @cached_property
    def smallest_area(self) -> float:
        """Twice the smallest oriented area over all layers, triangles and cones alike: the exact
        value, rounded once."""
        from implicit_warp.orientation import smallest_area

        return float(smallest_area(self.embeddings.cpu().numpy(), self.mesh))

    @cached_property
    def lipschitz(self) -> tuple[float, float]:
        """Lipschitz constants of f and of f^-1, as products of the layers' largest stretches.

        They hold on the whole of R^3 and grow with every layer, so they are far above what a
        typical pair of points sees.
        """
        from implicit_warp.layer_geometry import FORWARD, INVERSE, geometry

        return tuple(geometry(self._stack, way).lipschitz for way in (FORWARD, INVERSE))

    def _prove(self) -> Decided:
        """Prove the map injective, or raise; how the signs were found."""
        from implicit_warp.orientation import Decided, determinant_signs, prove_layers

        affine = torch.stack([self.before, self.after])[:, :, :3]
        matrices = torch.cat([self.frames, affine]).cpu().numpy()
        signs, of_matrices = determinant_signs(matrices)
        names = ["frames"] * self.n_layers + ["before", "after"]
        for name, sign, matrix in zip(names, signs, matrices, strict=True):
            if sign <= 0:
                raise InputError(
                    name,
                    matrix.tolist(),
                    f"its determinant {np.linalg.det(matrix):.3g} is not positive",
                    "affine parts must keep the orientation of space",
                )
        of_cells = prove_layers(self.embeddings.cpu().numpy(), self.mesh)
        return Decided(*(a + b for a, b in zip(of_matrices, of_cells, strict=True)))

    def _certify(self, box: np.ndarray | None) -> Certificate:
        from implicit_warp.certificate import Certificate, as_region
        from implicit_warp.layer_geometry import FORWARD, INVERSE, geometry

        largest = geometry(self._stack, FORWARD).largest
        smallest = 1.0 / geometry(self._stack, INVERSE).largest[::-1]
        return Certificate(
            repr(self),
            True,
            region=as_region(box),
            by_filter=self._orientations.by_filter,
            exactly=self._orientations.exactly,
            smallest_area=self.smallest_area,
            smallest_area_sign=1,
            singular_values=tuple(zip(smallest.tolist(), largest.tolist(), strict=True)),
            lipschitz=self.lipschitz,
        )

    def _local_bounds(self, boxes: np.ndarray) -> LocalBounds:
        return self._layered_bounds(boxes, inverse=False)

    def _local_bounds_of_inverse(self, boxes: np.ndarray) -> LocalBounds:
        return self._layered_bounds(boxes, inverse=True)

    def _layered_bounds(self, boxes: np.ndarray, inverse: bool) -> LocalBounds:
        from implicit_warp.layer_geometry import geometry
        from implicit_warp.local_lipschitz import layered_bounds

        return layered_bounds(geometry(self._stack, inverse), self.mesh.n_triangles, boxes)

    def _forward(self, points: Tensor) -> Tensor:
        return evaluate.forward(self._stack, points)

    def _forward_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return evaluate.forward_and_jacobian(self._stack, points)

    def _inverse(self, points: Tensor) -> Tensor:
        return evaluate.inverse(self._stack, points)

    def _inverse_and_jacobian(self, points: Tensor) -> tuple[Tensor, Tensor]:
        return evaluate.inverse_and_jacobian(self._stack, points)


def _frozen(argument: str, value: Tensor, shape: tuple[int | None, ...]) -> Tensor:
    # A copy that later training may use, wherever it is made.
    with torch.inference_mode(False):
        tensor = torch.as_tensor(value).detach().to(torch.float64).clone()
    fits = tensor.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, tensor.shape, strict=True)
    )
    if not fits or 0 in tensor.shape:
        wanted = tuple("?" if size is None else size for size in shape)
        raise InputError(
            argument, tuple(tensor.shape), f"the shape should be {wanted}", "check its origin"
        )
    if not bool(torch.isfinite(tensor).all()):
        raise InputError(
            argument,
            tuple(tensor.shape),
            "it holds NaN or infinite values",
            "the solve or the file is damaged",
        )
    return tensor


def _mesh_of(embeddings: Tensor) -> SquareMesh:
    vertices = embeddings.shape[1]
    # V = N^2 + (N - 1)^2
    resolution = round((1 + (2 * vertices - 1) ** 0.5) / 2)
    if resolution < 2 or resolution**2 + (resolution - 1) ** 2 != vertices:
        raise InputError(
            "embeddings",
            tuple(embeddings.shape),
            f"no square mesh has {vertices} vertices",
            "V must be N^2 + (N-1)^2",
        )
    return square_mesh(resolution)
