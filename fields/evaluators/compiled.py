"""A tape made ready for the compiled interpreters, and runs of it on the CPU.

Points are taken in chunks of `CHUNK`, so what an evaluation needs besides points and results is
constant. Oracles are called with one chunk at a time, in torch, between the programs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fields.evaluators.intervals import bounds_of
from fields.evaluators.program import COORDINATES, OracleCall, Program, Stage, run_stages, stages_of
from fields.evaluators.registers import WIDTH, assign_registers
from fields.evaluators.slopes import slopes_at
from fields.evaluators.threads import in_parts
from fields.evaluators.values import values_at
from fields.oracle import Boxes, DifferentiatedOracle, Oracle
from fields.tape import Tape, called

Array = NDArray[np.floating]

CHUNK = 1 << 18
"""Points that are evaluated at a time."""

PART, BOXES = 1 << 15, 1 << 8
"""Points, and boxes, that a thread takes at a time: a call costs as much as 3000 points."""

ORACLE = 64.0
"""What is allowed for an oracle's own rounding, in units of the dtype's epsilon."""


@dataclass(frozen=True, slots=True, eq=False)
class Machine:
    """A program with registers: the arguments of `values_at`, and how many of them there are."""

    rows: NDArray[np.int32]
    numbers: NDArray[np.float64]
    registers: int
    places: NDArray[np.int32]


def machine(program: Program) -> Machine:
    """Assign registers to a program."""
    size = len(program.codes)
    rows, numbers = np.zeros((size, WIDTH), np.int32), np.zeros(size)
    places = np.zeros(len(program.outputs), np.int32)
    count, registers = assign_registers(
        program.inputs,
        program.codes,
        program.arguments,
        program.constants,
        program.outputs,
        rows,
        numbers,
        places,
    )
    return Machine(rows[:count], numbers[:count], registers, places)


@final
class CompiledTape:
    """A tape as programs with registers.

    Attributes:
        stages: its programs, with the calls of oracles between them.
        machines: each program with registers.
    """

    __slots__ = ("machines", "stages")

    def __init__(self, tape: Tape) -> None:
        self.stages: tuple[Stage, ...] = stages_of(tape)
        self.machines: tuple[Machine, ...] = tuple(machine(stage.program) for stage in self.stages)

    @torch.no_grad()
    def values(self, points: Tensor) -> Tensor:
        """Values `(...)` at float32 or float64 points `(..., 3)` on the CPU, without a graph."""
        # By numpy: copies by torch would wake its own threads, which then spin beside ours.
        flat = points.detach().numpy().reshape(-1, COORDINATES)
        if len(self.stages) == 1 and flat.flags.c_contiguous:  # nothing is made but the results
            return torch.from_numpy(self._values(flat).reshape(points.shape[:-1]))
        result = np.empty(len(flat), flat.dtype)
        for start in range(0, len(flat), CHUNK):
            part = np.ascontiguousarray(flat[start : start + CHUNK])
            result[start : start + CHUNK] = self._values(part)
        return torch.from_numpy(result.reshape(points.shape[:-1]))

    def _values(self, array: Array) -> Array:

        def compute(index: int, inputs: list[Array]) -> list[Array]:
            given = np.column_stack([array, *inputs]) if inputs else array
            stage = self.machines[index]
            found = np.empty((len(array), len(stage.places)), array.dtype)
            numbers = stage.numbers.astype(array.dtype)

            def part(start: int, stop: int) -> None:
                values_at(
                    stage.rows,
                    numbers,
                    stage.registers,
                    stage.places,
                    given[start:stop],
                    found[start:stop],
                )

            in_parts(part, len(array), PART)
            return list(found.T)

        def call(made: OracleCall, arguments: list[Array]) -> list[Array]:
            where = torch.from_numpy(array if made.is_direct else np.column_stack(arguments))
            return list(_numpy(called(made.oracle, where), array.dtype).T)

        return run_stages(self.stages, compute, call)

    def values_and_gradients(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Values `(...)` and gradients `(..., 3)`, by forward differentiation; no graph."""
        flat = points.detach().numpy().reshape(-1, COORDINATES)
        values = np.empty(len(flat), flat.dtype)
        gradients = np.empty((len(flat), COORDINATES), flat.dtype)
        for start in range(0, len(flat), CHUNK):
            found = self._slopes(np.ascontiguousarray(flat[start : start + CHUNK]))
            values[start : start + CHUNK] = found[:, 0]
            gradients[start : start + CHUNK] = found[:, 1:]
        return (
            torch.from_numpy(values.reshape(points.shape[:-1])),
            torch.from_numpy(gradients.reshape(points.shape)),
        )

    def _slopes(self, array: Array) -> Array:
        """`(n, 4)`: value and derivatives."""

        def compute(index: int, inputs: list[Array]) -> list[Array]:
            given = np.empty((len(array), 4, len(inputs)), array.dtype)
            for column, item in enumerate(inputs):
                given[..., column] = item
            stage = self.machines[index]
            found = np.empty((len(array), 4, len(stage.places)), array.dtype)
            numbers = stage.numbers.astype(array.dtype)

            def part(start: int, stop: int) -> None:
                slopes_at(
                    stage.rows,
                    numbers,
                    stage.registers,
                    stage.places,
                    array[start:stop],
                    given[start:stop],
                    found[start:stop],
                )

            in_parts(part, len(array), PART)
            return list(np.moveaxis(found, -1, 0))

        def call(made: OracleCall, arguments: list[Array]) -> list[Array]:
            inner = np.stack(arguments, axis=-1)  # (n, 4, 3)
            outputs, jacobian = _differentiated(made.oracle, torch.tensor(inner[:, 0]))
            values = _numpy(outputs, array.dtype)
            chained = np.einsum("noj,nij->noi", _numpy(jacobian, array.dtype), inner[:, 1:])
            results = np.concatenate([values[..., None], chained], axis=-1)
            return list(np.moveaxis(results, 1, 0))

        return run_stages(self.stages, compute, call)

    def bounds(self, boxes: Boxes, dtype: np.dtype) -> NDArray[np.float64]:
        """`(n, 3)`: low, high and error on boxes `(n, 2, 3)`; see `fields.evaluators.intervals`."""
        limits = np.finfo(dtype)
        least, rounding = float(limits.tiny), float(limits.eps)
        coordinates = np.zeros((len(boxes), COORDINATES, 3))
        coordinates[..., 0], coordinates[..., 1] = boxes[:, 0], boxes[:, 1]

        def compute(index: int, inputs: list[NDArray[np.float64]]) -> list[NDArray[np.float64]]:
            program = self.stages[index].program
            given = np.stack([*np.moveaxis(coordinates, 1, 0), *inputs], axis=1)
            found = np.empty((len(boxes), len(program.outputs), 3))
            rounded = program.constants.astype(dtype).astype(np.float64)

            def part(start: int, stop: int) -> None:
                bounds_of(
                    program.inputs,
                    program.codes,
                    program.arguments,
                    program.constants,
                    rounded,
                    program.outputs,
                    least,
                    rounding,
                    given[start:stop],
                    found[start:stop],
                )

            in_parts(part, len(boxes), BOXES)
            return list(np.moveaxis(found, 1, 0))

        def call(
            made: OracleCall, arguments: list[NDArray[np.float64]]
        ) -> list[NDArray[np.float64]]:
            return _oracle_bounds(made, np.stack(arguments, axis=1), rounding)

        return run_stages(self.stages, compute, call)


def _differentiated(oracle: Oracle, points: Tensor) -> tuple[Tensor, Tensor]:
    """An oracle's values `(n, outputs)` and Jacobians `(n, outputs, 3)`."""
    if isinstance(oracle, DifferentiatedOracle):
        with torch.no_grad():
            return oracle.value_and_jacobian(points)
    with torch.enable_grad():
        where = points.requires_grad_()
        outputs = called(oracle, where)
        rows = [
            torch.autograd.grad(outputs[:, k].sum(), where, retain_graph=True)[0]
            for k in range(oracle.outputs)
        ]
    return outputs.detach(), torch.stack(rows, dim=1)


def _oracle_bounds(
    made: OracleCall, arguments: NDArray[np.float64], rounding: float
) -> list[NDArray[np.float64]]:
    """Bounds `(n, 3)` of each output of an oracle, for bounds `(n, 3, 3)` of its arguments.

    Its bounds on the box of the arguments hold for arguments as they are computed. Its values in
    the dtype are taken to be within `ORACLE` units of rounding, relative to the largest output or
    argument, of exact ones. If the arguments are inexact, all that is known is that both are
    within the bounds.
    """
    boxes = np.ascontiguousarray(np.moveaxis(arguments[..., :2], -1, 1))
    bounds = np.empty((len(boxes), made.oracle.outputs, 2))
    bounds[:] = (-np.inf, np.inf)
    finite = np.isfinite(boxes).all(axis=(1, 2))
    with np.errstate(over="ignore", invalid="ignore"):  # boxes may be as large as numbers get
        known = made.oracle.enclose(boxes[finite])
    if known is not None:
        bounds[finite] = np.where(np.isnan(known), (-np.inf, np.inf), known)
    size = np.maximum(np.abs(bounds).max(axis=(1, 2)), np.abs(boxes).max(axis=(1, 2)))[:, None]
    slack = np.where(np.isfinite(size), ORACLE * rounding * size, 0.0)
    low, high = bounds[..., 0] - slack, bounds[..., 1] + slack
    exact = (arguments[..., 2] == 0).all(axis=1, keepdims=True)
    with np.errstate(invalid="ignore"):
        error = np.where(exact & np.isfinite(size), slack, high - low)
    return list(np.moveaxis(np.stack([low, high, error], axis=-1), 1, 0))


def _numpy(values: Tensor, dtype: np.dtype) -> Array:
    return values.detach().cpu().numpy().astype(dtype, copy=False)
