"""Values, gradients, bounds and shaders of fields."""

from __future__ import annotations

from typing import overload

import numpy as np
import torch
from numpy.typing import ArrayLike, DTypeLike, NDArray
from torch import Tensor

from fields import arguments
from fields.base import FieldBase
from fields.evaluators.choice import runs_compiled
from fields.evaluators.enclosures import bounds_on_boxes
from fields.evaluators.shader import shader_text


class Evaluation(FieldBase):
    """Methods of `fields.Field`."""

    __slots__ = ()

    @overload
    def __call__(self, points: Tensor) -> Tensor: ...
    @overload
    def __call__(self, points: ArrayLike) -> NDArray[np.floating]: ...
    def __call__(self, points: ArrayLike | Tensor) -> NDArray[np.floating] | Tensor:
        """Values at points.

        Args:
            points: `(..., 3)`. A tensor gives a tensor in the same dtype and on the same
                device, with gradients; anything else is read by numpy and gives an array,
                float32 for float32 and float64 otherwise.

        Returns:
            `(...)`, negative inside, in the units of the points if the field is exact.

        Raises:
            InputError: the shape does not end in 3, the dtype is not real, or a point
                is NaN or infinite.
        """
        checked = arguments.points_tensor("points", points)
        if isinstance(points, Tensor):
            return self.evaluate(checked)
        with torch.no_grad():
            return self.evaluate(checked).contiguous().numpy()[()]

    def evaluate(self, points: Tensor) -> Tensor:
        """Values `(...)` at a floating tensor of points `(..., 3)`, without checks.

        For inner loops: NaN points give NaN values, and wrong shapes fail somewhere
        inside. The result may share its memory between points if the field is constant.

        Many points on the CPU are computed by compiled loops if no gradient can be wanted:
        the points do not require one, and the field either calls no oracle or gradients are
        switched off (an oracle may have parameters of its own). `fields.back_end` overrules
        the choice. Values differ from torch's by rounding, and only if the formula has
        elementary functions such as `sin`, or where torch itself is not reproducible.
        """
        tape = self.tape
        keep_graph = torch.is_grad_enabled() and (points.requires_grad or tape.calls_oracles)
        if runs_compiled(tape, points, keep_graph=keep_graph):
            return tape.compiled.values(points)
        return tape.evaluate(points)

    @overload
    def gradient(self, points: Tensor) -> Tensor: ...
    @overload
    def gradient(self, points: ArrayLike) -> NDArray[np.floating]: ...
    def gradient(self, points: ArrayLike | Tensor) -> NDArray[np.floating] | Tensor:
        """The gradient at points, by automatic differentiation.

        Always finite. Where the field has a crease the result is one of the directions
        in between; where it has none at all (the centre of a sphere) it is zero. The
        table in `fields.expression` has the choices.

        Args:
            points: `(..., 3)` as for a call. If it is a tensor that requires a gradient,
                the result can be differentiated again.

        Returns:
            `(..., 3)`.

        Raises:
            InputError: as for a call; or an oracle does not support gradients.
        """
        return self.value_and_gradient(points)[1]

    @overload
    def value_and_gradient(self, points: Tensor) -> tuple[Tensor, Tensor]: ...
    @overload
    def value_and_gradient(
        self, points: ArrayLike
    ) -> tuple[NDArray[np.floating], NDArray[np.floating]]: ...
    def value_and_gradient(
        self, points: ArrayLike | Tensor
    ) -> tuple[NDArray[np.floating] | Tensor, NDArray[np.floating] | Tensor]:
        """Values `(...)` and gradients `(..., 3)` at points, which share most of their work.

        As `gradient`, which is the second of the two.
        """
        checked = arguments.points_tensor("points", points)
        keep_graph = checked.requires_grad and torch.is_grad_enabled()
        if runs_compiled(self.tape, checked, keep_graph=keep_graph):
            values, gradients = self.tape.compiled.values_and_gradients(checked)
        else:
            values, gradients = self._differentiated(checked, keep_graph)
        if isinstance(points, Tensor):
            return values, gradients
        return values.contiguous().numpy()[()], gradients.numpy()

    def _differentiated(self, points: Tensor, keep_graph: bool) -> tuple[Tensor, Tensor]:
        """Values and gradients by torch's reverse mode."""
        with torch.enable_grad():
            at = points if keep_graph else points.detach().requires_grad_()
            values = self.tape.evaluate(at)
            if values.requires_grad:
                (gradients,) = torch.autograd.grad(
                    values, at, torch.ones_like(values), create_graph=keep_graph
                )
            else:
                gradients = torch.zeros_like(at)
        return values if keep_graph else values.detach(), gradients

    def enclose(self, boxes: ArrayLike, dtype: DTypeLike = np.float64) -> NDArray[np.float64]:
        """What the values can be on boxes: rigorous lower and upper bounds.

        By interval arithmetic over the formula, rounding included. The bounds hold for the
        exact formula in real numbers and also for every value that `evaluate` computes in
        the dtype at points of the box (of that dtype): where they exclude a number, no sample
        can be on its other side.

        If the field has a Lipschitz bound, the value at each box's centre gives a second pair,
        and the tighter ones are returned. Computed values are then taken to be within 1024
        epsilon of the dtype of exact ones, relative to the largest coordinate or value on the
        box, unless the intervals prove that they are nearer.

        Args:
            boxes: `(..., 2, 3)`, rows minimum and maximum; sides may be infinite.
            dtype: float32 or float64, in which the field will be evaluated.

        Returns:
            `(..., 2)`; infinite where nothing is known, as for an oracle that cannot
            enclose in a field without Lipschitz bound. Nothing is said of points where an
            intermediate result is NaN or overflows.

        Raises:
            InputError: the boxes are not of that shape, are NaN or have sides the wrong way
                round; the dtype is another.
        """
        return bounds_on_boxes(self.tape, self._body.tags.lipschitz, boxes, dtype)[..., :2]

    def rounding(self, boxes: ArrayLike, dtype: DTypeLike = np.float32) -> NDArray[np.float64]:
        """How far computed values can be from the exact formula's on boxes: a rigorous bound.

        For a field that calls oracles it rests on their own rounding being within 64 epsilon
        of the dtype, relative to their largest argument or output.

        Args:
            boxes: `(..., 2, 3)` as for `enclose`.
            dtype: float32 or float64, in which the field is evaluated.

        Returns:
            `(...)`, in field units, for points of the dtype within each box.

        Raises:
            InputError: as for `enclose`.
        """
        return bounds_on_boxes(self.tape, None, boxes, dtype)[..., 2]

    def to_glsl(self, name: str = "field", dialect: str = "glsl") -> str:
        """The field as the text of a shader function, for viewers that march rays.

        Args:
            name: of the function.
            dialect: "glsl", for `float name(vec3 p)`, or "wgsl", for
                `fn name(p: vec3<f32>) -> f32`.

        Returns:
            Text that needs nothing else, in float32, with the conventions of
            `fields.expression` at the edges of its operations.

        Raises:
            InputError: the field calls an oracle (a mesh, a network, a map), whose formula
                is not known, or has a constant that float32 cannot hold; the name or the
                dialect is none.
        """
        return shader_text(self.tape, name, dialect)
