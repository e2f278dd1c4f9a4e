"""From an expression graph to a list of instructions, and their evaluation in torch.

A `Tape` is the form every evaluator reads: instructions in an order in which arguments
come first, each common subexpression once, substitutions carried out, and for each
instruction the slots that nobody reads afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias, final

import torch
from torch import Tensor

from fields.errors import InputError
from fields.expression import (
    OPERATIONS,
    Coordinates,
    Expression,
    X,
    Y,
    Z,
    apply,
    intern_node,
)
from fields.oracle import Oracle

if TYPE_CHECKING:
    from fields.evaluators.compiled import CompiledTape

_Key: TypeAlias = "tuple[Expression, Coordinates]"


def flatten(root: Expression) -> Expression:
    """The same function without "remap" nodes.

    Every pair (node, coordinates it is seen in) is visited once, coordinates being
    composed from the outside in. Takes time proportional to the size of the result
    plus the number of remaps.
    """
    done: dict[_Key, Expression] = {}
    start: _Key = (root, (X, Y, Z))
    pending = [start]
    while pending:
        key = pending[-1]
        node, frame = key
        if key in done:
            pending.pop()
            continue
        if node.kind == "coordinate":
            done[key] = frame[int(node.payload)]  # type: ignore[arg-type]
            continue
        # A remap is seen through the new frame only once that frame is known, so its
        # body (the first argument) waits for the three others.
        through = node.arguments[1:] if node.kind == "remap" else node.arguments
        needed: list[_Key] = [(argument, frame) for argument in through]
        missing = [other for other in needed if other not in done]
        if missing:
            pending.extend(missing)
        elif node.kind == "remap":
            x, y, z = (done[other] for other in needed)
            inner: _Key = (node.arguments[0], (x, y, z))
            if inner in done:
                done[key] = done[inner]
            else:
                pending.append(inner)
        else:
            done[key] = _rebuilt(node, tuple(done[other] for other in needed))
    return done[start]


def _rebuilt(node: Expression, arguments: tuple[Expression, ...]) -> Expression:
    if arguments == node.arguments:
        return node
    if node.kind in OPERATIONS:
        return apply(node.kind, *arguments)
    return intern_node(node.kind, node.payload, arguments)


def _ordered(root: Expression) -> list[Expression]:
    """The nodes below `root` and itself, each once, arguments before their users."""
    order: dict[Expression, None] = {}
    pending = [root]
    while pending:
        node = pending[-1]
        missing = [argument for argument in node.arguments if argument not in order]
        if node in order or not missing:
            order.setdefault(node)
            pending.pop()
        else:
            pending.extend(reversed(missing))
    return list(order)


def coordinates_used(root: Expression) -> set[int]:
    """The axes, 0 to 2, of the coordinates that an expression depends on by its formula."""
    return {int(node.payload) for node in _ordered(flatten(root)) if node.kind == "coordinate"}  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True)
class Instruction:
    """One step of a tape; its result goes to the slot with its own index.

    Attributes:
        kind: a row of `OPERATIONS`, "constant", "coordinate", "call" or "component".
        payload: the constant, the axis, the oracle or the index of the output.
        arguments: the slots it reads.
        expired: the slots that no later instruction reads.
    """

    kind: str
    payload: float | int | Oracle | None
    arguments: tuple[int, ...]
    expired: tuple[int, ...]


@final
class Tape:
    """The instructions that compute one scalar expression; the last one is its value."""

    __slots__ = ("_compiled", "calls_oracles", "instructions")

    instructions: tuple[Instruction, ...]
    calls_oracles: bool
    _compiled: CompiledTape | None

    def __init__(self, root: Expression) -> None:
        self._compiled = None
        nodes = _ordered(flatten(root))
        slots = {node: slot for slot, node in enumerate(nodes)}
        last_use = {
            slots[argument]: slot for slot, node in enumerate(nodes) for argument in node.arguments
        }
        expired: list[list[int]] = [[] for _ in nodes]
        for slot, user in last_use.items():
            expired[user].append(slot)
        self.instructions = tuple(
            Instruction(
                node.kind,
                node.payload,
                tuple(slots[argument] for argument in node.arguments),
                tuple(expired[slot]),
            )
            for slot, node in enumerate(nodes)
        )
        self.calls_oracles = any(node.kind == "call" for node in nodes)

    def __len__(self) -> int:
        return len(self.instructions)

    @property
    def compiled(self) -> CompiledTape:
        """The tape for the compiled evaluators; made, and numba loaded, on first use."""
        if self._compiled is None:
            from fields.evaluators.compiled import CompiledTape

            self._compiled = CompiledTape(self)
        return self._compiled

    def evaluate(self, points: Tensor) -> Tensor:
        """Values `(...)` at points `(..., 3)`, in their dtype and on their device.

        Points are not checked. Differentiable by autograd to any order that the oracles
        allow. Without autograd, an intermediate result is freed after its last use.

        Raises:
            InputError: an oracle returned something of the wrong shape, or values
                without a gradient although the points require one.
        """
        # One copy, so that each coordinate is contiguous for everything that follows.
        coordinates = points.movedim(-1, 0).contiguous()
        slots: list[Tensor | None] = [None] * len(self.instructions)
        for slot, instruction in enumerate(self.instructions):
            arguments = [slots[index] for index in instruction.arguments]
            if instruction.kind in OPERATIONS:
                slots[slot] = OPERATIONS[instruction.kind].torch(*arguments)
            elif instruction.kind == "constant":
                slots[slot] = points.new_full((), instruction.payload)
            elif instruction.kind == "coordinate":
                slots[slot] = coordinates[instruction.payload]
            elif instruction.kind == "call":
                where = self._call_points(instruction, arguments, points)
                slots[slot] = called(instruction.payload, where)
            else:
                slots[slot] = arguments[0][..., instruction.payload]
            for index in instruction.expired:
                slots[index] = None
            del arguments
        return slots[-1].expand(points.shape[:-1])

    def _call_points(
        self, instruction: Instruction, arguments: list[Tensor], points: Tensor
    ) -> Tensor:
        sources = [self.instructions[index] for index in instruction.arguments]
        if [(source.kind, source.payload) for source in sources] == _IDENTITY:
            return points
        shape = points.shape[:-1]
        return torch.stack([argument.expand(shape) for argument in arguments], dim=-1)


_IDENTITY = [("coordinate", 0), ("coordinate", 1), ("coordinate", 2)]


def called(oracle: Oracle, points: Tensor) -> Tensor:
    """The values of an oracle, checked.

    Raises:
        InputError: they have the wrong shape, or no gradient although the points require one.
    """
    values = oracle(points)
    expected = (*points.shape[:-1], oracle.outputs)
    if not isinstance(values, Tensor) or values.shape != expected:
        got = tuple(values.shape) if isinstance(values, Tensor) else type(values).__name__
        raise InputError(
            oracle.name,
            got,
            f"the function was given points of shape {tuple(points.shape)} and must return a "
            f"tensor of shape {expected}",
            "return one row of outputs for each point",
        )
    if torch.is_grad_enabled() and points.requires_grad and not values.requires_grad:
        raise InputError(
            oracle.name,
            oracle,
            "its values carry no gradient although the points require one",
            "write it with torch operations or as a torch.autograd.Function, "
            "or evaluate under torch.no_grad()",
        )
    return values
