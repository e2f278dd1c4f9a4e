"""The class of all fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fields import arguments, notation
from fields.base import made
from fields.errors import InputError
from fields.expression import Expression, X, Y, Z, call, remap
from fields.methods.combinations import Combinations
from fields.methods.copies import Copies
from fields.methods.deformations import Deformations
from fields.methods.evaluation import Evaluation
from fields.methods.motions import Motions
from fields.methods.solids import Solids
from fields.methods.thickness import Thickness
from fields.notation import Call, History, Opaque
from fields.operations import Body
from fields.oracle import FunctionOracle, Oracle
from fields.tags import EVERYWHERE, Tags


@final
class Field(Combinations, Copies, Deformations, Evaluation, Motions, Solids, Thickness):
    """A scalar function on R^3 whose zero set is a surface; negative inside.

    Immutable. Made by the primitives (`fields.sphere` and so on), combined with `|`
    (union), `&` (intersection), `-` (difference), `^` (symmetric difference) and `~`
    (complement), and by the methods below, each of
    which is also a function of the package (`fields.translate(a, v)` is
    `a.translate(v)`). Calling the class itself wraps an expression of `fields.expression`.

    Args:
        expression: the formula.
        exact: is it a true signed distance to its zero set, everywhere? It is the
            caller's word; with it, `lipschitz` is 1.
        lipschitz: a bound on the norm of the gradient, or None if none is known.
        bounds: a box `(2, 3)`, rows minimum and maximum, that holds the zero set and
            the inside; None if there is none or it is not known.

    Raises:
        InputError: an argument is not of the kind described.
    """

    __slots__ = ()

    def __init__(
        self,
        expression: Expression,
        *,
        exact: bool = False,
        lipschitz: float | None = None,
        bounds: ArrayLike | None = None,
    ) -> None:
        if not isinstance(expression, Expression):
            raise InputError(
                "expression",
                expression,
                "a field is made of an Expression",
                "build it from fields.expression.X, Y and Z, or use fields.from_function",
            )
        self._body = Body(expression, _stated_tags(exact, lipschitz, bounds))
        self._tape = None
        self.history = Opaque("expression")

    # --- facts ---

    @property
    def expression(self) -> Expression:
        """The formula, a node of the expression graph."""
        return self._body.expression

    @property
    def exact(self) -> bool:
        """Is every value the true signed Euclidean distance to the zero set?

        False means "not known to be": a union or offset may be exact in part.
        """
        return self._body.tags.exact

    @property
    def lipschitz(self) -> float | None:
        """A bound on the norm of the gradient; None if none is known."""
        return self._body.tags.lipschitz

    @property
    def bounds(self) -> NDArray[np.float64] | None:
        """A box that holds the zero set and the inside; None if unbounded or unknown.

        Shape `(2, 3)`, rows minimum and maximum, in world units, a fresh copy.
        Conservative up to float64 rounding, not tight: CSG bounds are made of its
        parts' boxes. Where the boxes of an intersection do not meet, the result is
        empty and its box has zero width on some axis.
        """
        bounds = self._body.tags.bounds
        return None if bounds is None else bounds.copy()

    def __repr__(self) -> str:
        return notation.written(self)

    def __copy__(self) -> Field:
        return self

    def __deepcopy__(self, memo: object) -> Field:
        return self

    # --- under a map ---

    def remap(
        self,
        function: Callable[[Tensor], Tensor] | Oracle,
        *,
        lipschitz: float | None = None,
        bounds: ArrayLike | None = None,
        growth: float | None = None,
        name: str | None = None,
    ) -> Field:
        """This field with its points replaced: p -> a(function(p)).

        To carry a shape forward by an injective map f, pass the inverse of f.

        Args:
            function: maps a tensor of points `(..., 3)` to points `(..., 3)`.
            lipschitz: the Lipschitz bound of the *result*, such as that of this field
                times that of the function; None if unknown.
            bounds: a box `(2, 3)` of the *result*, or None.
            growth: a number g such that the result is at most t only within g * t of the
                bounds, for every t >= 0; it keeps bounds through offsets, shells and
                smooth unions. For an exact field and a map f, the Lipschitz bound of f.
            name: shown by `repr`; the function's own name if None.

        Returns:
            A field that is not exact.

        Raises:
            InputError: an argument is not of the kind described. On evaluation: the
                function returned another shape, or no gradient where one was asked for.
        """
        oracle = _as_oracle(function, name, outputs=3)
        tags = _stated_tags(False, lipschitz, bounds, growth)
        x, y, z = call(oracle, (X, Y, Z))
        body = Body(remap(self.expression, (x, y, z)), tags)
        return make_field(body, Call("remap", (self,), (Opaque(oracle.name),)))


# --- making fields --------------------------------------------------------------------


def make_field(body: Body, history: History) -> Field:
    """A field from a body and a record of how it was made (for use in this package)."""
    return made(Field, body, history)


def from_function(
    function: Callable[[Tensor], Tensor] | Oracle,
    *,
    exact: bool = False,
    lipschitz: float | None = None,
    bounds: ArrayLike | None = None,
    name: str | None = None,
) -> Field:
    """A field from any torch function, such as a learned signed distance.

    Args:
        function: maps a tensor of points `(..., 3)` to values `(...)` or `(..., 1)`,
            negative inside; differentiable by autograd if gradients are wanted.
        exact: is it a true signed distance, everywhere? The caller's word.
        lipschitz: a bound on the norm of its gradient, or None.
        bounds: a box `(2, 3)` that holds its zero set and inside, or None.
        name: shown by `repr`; the function's own name if None.

    Raises:
        InputError: an argument is not of the kind described. On evaluation: the function
            returned another shape, or no gradient where one was asked for.
    """
    tags = _stated_tags(exact, lipschitz, bounds)
    oracle = _as_oracle(function, name, outputs=1, lipschitz=tags.lipschitz)
    (value,) = call(oracle, (X, Y, Z))
    return make_field(Body(value, tags), Opaque(oracle.name))


def _as_oracle(
    function: Callable[[Tensor], Tensor] | Oracle,
    name: str | None,
    outputs: int,
    lipschitz: float | None = None,
) -> Oracle:
    if not callable(function):
        raise InputError(
            "function", function, "it cannot be called", "pass a function of a tensor of points"
        )
    if name is None:
        name = getattr(function, "name", None) or getattr(function, "__name__", "function")
    if isinstance(function, Oracle) and function.outputs == outputs and function.name == name:
        return function
    return FunctionOracle(function, str(name), outputs, lipschitz)


def _stated_tags(
    exact: bool,
    lipschitz: float | None,
    bounds: ArrayLike | None,
    growth: float | None = None,
) -> Tags:
    extent = EVERYWHERE if bounds is None else arguments.box_bounds("bounds", bounds)
    if exact:
        return Tags.of_distance(extent)
    return Tags(
        exact=False,
        lipschitz=None if lipschitz is None else arguments.not_negative("lipschitz", lipschitz),
        extent=extent,
        growth=None if growth is None else arguments.positive("growth", growth),
    )
