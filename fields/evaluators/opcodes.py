"""Numbers for the rows of `fields.expression.OPERATIONS`, as compiled interpreters read them.

The numbers are positions in that table, so it stays the only list of operations; the names below
are for the interpreters, which compare with constants.
"""

from __future__ import annotations

from fields.expression import OPERATIONS

CODES: dict[str, int] = {name: code for code, name in enumerate(OPERATIONS)}

CONSTANT = len(CODES)
"""Not an operation: the instruction whose result is its constant."""

ARITIES: tuple[int, ...] = (*(operation.arity for operation in OPERATIONS.values()), 0)
"""Arguments of an instruction, by code."""

NEGATIVE = CODES["negative"]
ABSOLUTE = CODES["absolute"]
SQUARE = CODES["square"]
SQRT = CODES["sqrt"]
SIN = CODES["sin"]
COS = CODES["cos"]
FLOOR = CODES["floor"]
EXP = CODES["exp"]
LOG = CODES["log"]
ADD = CODES["add"]
SUBTRACT = CODES["subtract"]
MULTIPLY = CODES["multiply"]
DIVIDE = CODES["divide"]
MINIMUM = CODES["minimum"]
MAXIMUM = CODES["maximum"]
ATAN2 = CODES["atan2"]
POWER = CODES["power"]
WHERE_NEGATIVE = CODES["where_negative"]
