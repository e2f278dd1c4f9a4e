"""From a tape to arrays of numbers that compiled interpreters can run.

A tape is cut where it calls oracles: a `Stage` is a `Program` of arithmetic only, and the calls
that follow it. All arithmetic that can be done before a call is done in as early a stage as
possible, so a tape has one stage more than its longest chain of calls that feed one another, and
an expression without oracles is a single program.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from fields.evaluators.opcodes import CODES, CONSTANT
from fields.oracle import Oracle
from fields.tape import Instruction, Tape

Values = TypeVar("Values")

Integers = NDArray[np.int32]

COORDINATES = 3
"""The first inputs of every program are x, y and z."""


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Arithmetic in static single assignment form: every slot is written once.

    Slots 0 to `inputs` - 1 hold the inputs, x, y and z first; instruction i writes slot
    `inputs` + i.

    Attributes:
        inputs: how many.
        codes: `(m,)`, see `fields.evaluators.opcodes`.
        arguments: `(m, 3)`, the slots that an instruction reads; unused entries are 0.
        constants: `(m,)`, the value of a CONSTANT; 0 elsewhere.
        outputs: the slots whose values are wanted; inputs and constants are allowed.
    """

    inputs: int
    codes: Integers
    arguments: Integers
    constants: NDArray[np.float64]
    outputs: Integers


@dataclass(frozen=True, slots=True, eq=False)
class OracleCall:
    """One call between two stages.

    Attributes:
        oracle: what is called.
        arguments: the tape's slots that stand for its x, y and z.
        is_direct: are they x, y and z themselves?
        components: the tape's slots that hold its outputs, with their indices.
    """

    oracle: Oracle
    arguments: tuple[int, ...]
    is_direct: bool
    components: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """A program, and the calls that can be made once it has run.

    Attributes:
        program: its arithmetic.
        inputs: the tape's slots that it reads, besides x, y and z.
        outputs: the tape's slots that it hands to the calls and to later stages.
        calls: the calls; the last stage has none, and a single output.
    """

    program: Program
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    calls: tuple[OracleCall, ...]


def stages_of(tape: Tape) -> tuple[Stage, ...]:
    """The stages of a tape, in order; the output of the last is the tape's value."""
    instructions = tape.instructions
    levels: list[int] = []
    for instruction in instructions:
        level = max((levels[index] for index in instruction.arguments), default=0)
        levels.append(level + (instruction.kind == "component"))
    stages = range(levels[-1] + 1)
    members: list[list[int]] = [[] for _ in stages]
    calls: list[dict[int, list[tuple[int, int]]]] = [{} for _ in stages]
    outputs: list[set[int]] = [set() for _ in stages]
    outputs[-1].add(len(instructions) - 1)
    for slot, (instruction, level) in enumerate(zip(instructions, levels, strict=True)):
        if instruction.kind == "component":
            calls[level - 1][instruction.arguments[0]].append((slot, int(instruction.payload)))  # type: ignore[arg-type]
            continue
        if instruction.kind == "call":
            calls[level][slot] = []
            outputs[level].update(instruction.arguments)
        elif instruction.kind in CODES:
            members[level].append(slot)
        for index in instruction.arguments:
            if instructions[index].kind in CODES and levels[index] < level:
                outputs[levels[index]].add(index)
    result = []
    for stage in stages:
        exported = tuple(sorted(outputs[stage]))
        program, inputs = _program(instructions, members[stage], exported)
        made = tuple(_oracle_call(instructions, *item) for item in calls[stage].items())
        result.append(Stage(program, inputs, exported, made))
    return tuple(result)


def _oracle_call(
    instructions: tuple[Instruction, ...], slot: int, components: list[tuple[int, int]]
) -> OracleCall:
    arguments = instructions[slot].arguments
    sources = [(instructions[index].kind, instructions[index].payload) for index in arguments]
    is_direct = sources == [("coordinate", axis) for axis in range(COORDINATES)]
    return OracleCall(instructions[slot].payload, arguments, is_direct, tuple(components))  # type: ignore[arg-type]


def _program(
    instructions: tuple[Instruction, ...], members: list[int], outputs: tuple[int, ...]
) -> tuple[Program, tuple[int, ...]]:
    """The program of some of a tape's instructions, and the other slots of the tape it reads."""
    read = dict.fromkeys(index for slot in members for index in instructions[slot].arguments)
    read |= dict.fromkeys(outputs)
    own = set(members)
    given, fixed = [], []
    places: dict[int, int] = {}
    for slot in read:
        source = instructions[slot]
        if source.kind == "coordinate":
            places[slot] = int(source.payload)  # type: ignore[arg-type]
        elif source.kind == "constant":
            fixed.append(slot)
        elif slot not in own:
            given.append(slot)
    inputs = COORDINATES + len(given)
    for place, slot in enumerate([*given, *fixed, *members], start=COORDINATES):
        places[slot] = place
    size = len(fixed) + len(members)
    codes = np.full(size, CONSTANT, np.int32)
    arguments = np.zeros((size, 3), np.int32)
    constants = np.zeros(size)
    constants[: len(fixed)] = [instructions[slot].payload for slot in fixed]
    for row, slot in enumerate(members, start=len(fixed)):
        instruction = instructions[slot]
        codes[row] = CODES[instruction.kind]
        arguments[row, : len(instruction.arguments)] = [places[i] for i in instruction.arguments]
    wanted = np.array([places[slot] for slot in outputs], np.int32)
    return Program(inputs, codes, arguments, constants, wanted), tuple(given)


def run_stages(
    stages: tuple[Stage, ...],
    compute: Callable[[int, list[Values]], list[Values]],
    call: Callable[[OracleCall, list[Values]], list[Values]],
) -> Values:
    """The value of a tape, for any meaning of "value" (numbers, numbers and slopes, bounds).

    Args:
        stages: those of the tape.
        compute: runs the program of the stage with this index, given its inputs besides x, y
            and z.
        call: all outputs of an oracle, given what stands for its x, y and z.
    """
    values: dict[int, Values] = {}
    for index, stage in enumerate(stages):
        results = compute(index, [values[slot] for slot in stage.inputs])
        values.update(zip(stage.outputs, results, strict=True))
        for made in stage.calls:
            answers = call(made, [values[slot] for slot in made.arguments])
            values.update((slot, answers[output]) for slot, output in made.components)
    return values[stages[-1].outputs[0]]
