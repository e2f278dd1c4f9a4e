"""Random expressions from the table of operations, for tests that hold for all of them."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import torch

from fields.errors import InputError
from fields.expression import OPERATIONS, Expression, X, Y, Z, apply, call, constant, remap
from fields.oracle import FunctionOracle
from fields.tape import Tape, called

LIMIT = 1e6
"""Expressions with larger values at the probes are not drawn: they say little."""

PROBES = torch.from_numpy(np.random.default_rng(5).uniform(-2, 2, (64, 3)))


def _swirl(points: torch.Tensor) -> torch.Tensor:
    """Two outputs that change by at most 1.5 a unit of distance."""
    x, y, z = points.unbind(-1)
    return torch.stack([torch.sin(x) + 0.5 * y, 0.5 * torch.cos(y - z)], dim=-1)


ORACLES = [
    FunctionOracle(_swirl, "swirl", outputs=2, lipschitz=1.5),
    FunctionOracle(lambda p: p.norm(dim=-1), "norm", lipschitz=1.0),
]


def random_expression(
    rng: np.random.Generator, size: int, *, oracles: bool = False, smooth: bool = False
) -> Expression:
    """A graph of about so many operations, with shared parts, remaps and constants.

    Args:
        rng: the source of chance.
        size: operations.
        oracles: with calls of functions now and then.
        smooth: without operations that are discontinuous.
    """
    names = [name for name in OPERATIONS if not (smooth and name in ("floor", "where_negative"))]
    nodes: list[Expression] = [X, Y, Z]
    while len(nodes) < 3 + size:
        # Recent nodes first, so that the graph is deep, but old ones too, so that it shares.
        back = np.minimum(rng.geometric(0.25, 4), len(nodes))
        picked = [nodes[-int(i)] for i in back]
        if rng.random() < 0.3:
            picked[int(rng.integers(3))] = constant(float(np.round(rng.normal() * 2, 3)))
        kind = rng.random()
        if kind < 0.08:
            node = remap(picked[0], (picked[1], picked[2], picked[3]))
        elif oracles and kind < 0.2:
            outputs = call(ORACLES[int(rng.integers(len(ORACLES)))], tuple(picked[:3]))
            node = outputs[int(rng.integers(len(outputs)))]
        else:
            name = str(rng.choice(names))
            try:
                node = apply(name, *picked[: OPERATIONS[name].arity])
            except InputError:  # a constant that is not finite
                continue
        if node not in nodes and node.kind != "constant" and _is_tame(node):
            nodes.append(node)
    return nodes[-1]


def _is_tame(node: Expression) -> bool:
    try:
        tape = Tape(node)
    except InputError:  # a remap made an argument constant, and its result is not finite
        return False
    constants = [i.payload for i in tape.instructions if i.kind == "constant"]
    if max(map(abs, constants), default=0) > 1e30:  # no constant of float32, or nearly none
        return False
    values = tape.evaluate(PROBES)
    return bool(values.isfinite().all() and (values.abs() < LIMIT).all())


def all_finite(root: Expression, points: torch.Tensor) -> np.ndarray:
    """Where no intermediate result is NaN or infinite in the points' dtype, `(...)`."""
    slots: list[torch.Tensor] = []
    finite = torch.ones(points.shape[:-1], dtype=torch.bool)
    for instruction in Tape(root).instructions:
        given = [slots[index] for index in instruction.arguments]
        if instruction.kind == "constant":
            slots.append(points.new_tensor(instruction.payload))
        elif instruction.kind == "coordinate":
            slots.append(points[..., instruction.payload])
        elif instruction.kind == "call":
            where = torch.stack([item.expand(finite.shape) for item in given], dim=-1)
            slots.append(called(instruction.payload, where))
            continue
        elif instruction.kind == "component":
            slots.append(given[0][..., instruction.payload])
        else:
            slots.append(OPERATIONS[instruction.kind].torch(*given))
        finite &= slots[-1].isfinite()
    return finite.numpy()


def exact_value(root: Expression, point: np.ndarray) -> mpmath.mpf:
    """The value of an expression without oracles in 60 digits, from the meanings alone."""
    with mpmath.workdps(60):
        slots: list[mpmath.mpf] = []
        for instruction in Tape(root).instructions:
            given = [slots[index] for index in instruction.arguments]
            if instruction.kind == "constant":
                slots.append(mpmath.mpf(instruction.payload))
            elif instruction.kind == "coordinate":
                slots.append(mpmath.mpf(float(point[instruction.payload])))
            else:
                slots.append(EXACTLY[instruction.kind](*given))
        return slots[-1]


EXACTLY = {
    "negative": lambda a: -a,
    "absolute": abs,
    "square": lambda a: a * a,
    "sqrt": lambda a: mpmath.sqrt(a) if a > 0 else mpmath.mpf(0),
    "sin": mpmath.sin,
    "cos": mpmath.cos,
    "floor": mpmath.floor,
    "exp": mpmath.exp,
    "log": lambda a: mpmath.log(max(a, mpmath.mpf(float(np.finfo(np.float64).tiny)))),
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "minimum": min,
    "maximum": max,
    "atan2": lambda y, x: mpmath.atan2(y, x) if x or y else mpmath.mpf(0),
    "power": lambda a, b: mpmath.power(a, b) if a > 0 else mpmath.mpf(0),
    "where_negative": lambda c, a, b: a if c < 0 else b,
}


def random_boxes(rng: np.random.Generator, n: int, dtype: type) -> np.ndarray:
    """Boxes `(n, 2, 3)` of all sizes from points to 4, with sides that are numbers of a dtype."""
    centres = rng.uniform(-2, 2, (n, 3))
    halves = 10 ** rng.uniform(-6, math.log10(2), (n, 1)) * rng.uniform(0, 1, (n, 3))
    halves[rng.random((n, 3)) < 0.1] = 0
    return np.stack([centres - halves, centres + halves], axis=1).astype(dtype).astype(np.float64)


def points_in(rng: np.random.Generator, boxes: np.ndarray, count: int, dtype: type) -> np.ndarray:
    """Points `(n, count, 3)` of a dtype in boxes, corners among them."""
    low, high = boxes[:, None, 0], boxes[:, None, 1]
    share = rng.uniform(0, 1, (len(boxes), count, 3))
    share[rng.random(share.shape) < 0.2] = 0
    share[rng.random(share.shape) < 0.2] = 1
    return np.clip(low + share * (high - low), low, high).astype(dtype)
