"""Short runs of numbers as vectors in Numba kernels: rows of six, a cell's affine map of the plane
each, and runs of four of a banded matrix.

A row (a00, a01, a10, a11, d0, d1) is one vector of four and one of two.  Written number by number,
a kernel loads six scalars, multiplies them one by one and stores two results, and LLVM does not
join them: the rows of neighbouring points lie apart, and those of one point are mixed.  As vectors
that is two loads, two multiply-adds of pairs and one store, so images come as pairs (u, v), and
2x2 parts as fours.  A map of 24 layers was measured to take 30 % less time.

Nothing here checks an index: where these functions are used, cells come from location, which gives
none that is not there, and rows of a matrix are padded.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.errors import NumbaTypeError
from numba.extending import intrinsic

from fields.jit import REORDERING, inlined

_FREE = tuple(sorted(REORDERING))
"""Instructions made here do not inherit the freedoms of the kernel that they are in."""

_I32 = ir.IntType(32)


@inlined
def apply_cells(table, at, x, y, uv, linear, m, keep):
    """Each point's own cell applied to it: see `apply_cell`."""
    for i in range(m):
        apply_cell(table, at[i], x, y, uv, linear, i, keep)


@inlined
def apply_cell(table, cell, x, y, uv, linear, i, keep):
    """Pair i of uv = the cell's map of (x[i], y[i]); its 2x2 part goes to four i of linear."""
    a = np.intp(cell) * 6
    if keep:
        apply_row_and_keep(table, a, x[i], y[i], uv, 2 * i, linear, 4 * i)
    else:
        apply_row(table, a, x[i], y[i], uv, 2 * i)


@intrinsic
def apply_row(typing, table, a, x, y, out, o):
    """out[o:o + 2] = the map in table[a:a + 6] at (x, y)."""
    _check(table, out)

    def codegen(context, builder, signature, args):
        code = _Code(context, builder, signature, args)
        _, image = _linear_and_image(code, builder, *args[2:4])
        return code.store(4, image)

    return types.void(table, types.intp, x, y, out, types.intp), codegen


@intrinsic
def apply_row_and_keep(typing, table, a, x, y, out, o, linear, b):
    """The same, and linear[b:b + 4] = the linear part in table[a:a + 4].

    One function, because what is stored might be the table, for all that LLVM knows: as two, the
    row would be loaded twice.
    """
    _check(table, out, linear)

    def codegen(context, builder, signature, args):
        code = _Code(context, builder, signature, args)
        four, image = _linear_and_image(code, builder, *args[2:4])
        code.store(6, four)
        return code.store(4, image)

    return types.void(table, types.intp, x, y, out, types.intp, linear, types.intp), codegen


def _linear_and_image(code: _Code, builder, x, y):
    """The linear part of the row that the first arguments name, and its map of (x, y)."""
    four, two = code.load(0, 4), code.load(0, 2, skip=4)
    by_x = builder.fmul(code.pick(four, 0, 2), code.pair(x, x), flags=_FREE)
    by_y = builder.fmul(code.pick(four, 1, 3), code.pair(y, y), flags=_FREE)
    return four, builder.fadd(builder.fadd(by_x, two, flags=_FREE), by_y, flags=_FREE)


@intrinsic
def add_to_row(typing, table, a, linear, o, x, y):
    """table[a:a + 6] += (linear[o:o + 4], x, y)."""
    _check(table, linear)

    def codegen(context, builder, signature, args):
        code = _Code(context, builder, signature, args)
        four = builder.fadd(code.load(0, 4), code.load(2, 4))
        two = builder.fadd(code.load(0, 2, skip=4), code.pair(args[4], args[5]))
        code.store(0, four)
        return code.store(0, two, skip=4)

    return types.void(table, types.intp, linear, types.intp, x, y), codegen


@intrinsic
def subtract_four(typing, out, o, factor, table, a):
    """out[o:o + 4] -= factor * table[a:a + 4]; both may be parts of one array."""
    _check(out, table)

    def codegen(context, builder, signature, args):
        code = _Code(context, builder, signature, args)
        factors = code.spread(code.pair(args[2], args[2]), 4)
        product = builder.fmul(factors, code.load(3, 4), flags=_FREE)
        return code.store(0, builder.fsub(code.load(0, 4), product, flags=_FREE))

    return types.void(out, types.intp, out.dtype, table, types.intp), codegen


def _check(*arrays: types.Type) -> None:
    for array in arrays:
        if not isinstance(array, types.Array) or array.ndim != 1 or array.layout != "C":
            raise NumbaTypeError(f"a contiguous array of one dimension is needed, not {array}")
    if len({array.dtype for array in arrays}) > 1:
        raise NumbaTypeError(f"arrays of one type are needed, not {arrays}")


class _Code:
    """Writes vector instructions; `which` argument is an array, the one after it where to start."""

    def __init__(self, context, builder, signature, args) -> None:
        self._context, self._builder = context, builder
        self._types, self._args = signature.args, args
        self._number = context.get_data_type(signature.args[0].dtype)
        self._bytes = signature.args[0].dtype.bitwidth // 8

    def load(self, which: int, count: int, skip: int = 0):
        """So many numbers of an array, from `skip` after its start."""
        value = self._builder.load(self._address(which, ir.VectorType(self._number, count), skip))
        value.align = self._bytes  # rows begin anywhere
        return value

    def store(self, which: int, value, skip: int = 0):
        """Write a vector to an array, from `skip` after its start."""
        stored = self._builder.store(value, self._address(which, value.type, skip))
        stored.align = self._bytes
        return self._context.get_dummy_value()

    def pick(self, vector, first: int, second: int):
        """Two numbers of a vector."""
        return self._builder.shuffle_vector(
            vector, ir.Constant(vector.type, ir.Undefined), _lanes(first, second)
        )

    def pair(self, first, second):
        """Two numbers as a vector."""
        empty = ir.Constant(ir.VectorType(self._number, 2), ir.Undefined)
        begun = self._builder.insert_element(empty, first, _I32(0))
        return self._builder.insert_element(begun, second, _I32(1))

    def spread(self, vector, count: int):
        """The first number of a vector, so many times."""
        return self._builder.shuffle_vector(
            vector, ir.Constant(vector.type, ir.Undefined), _lanes(*[0] * count)
        )

    def _address(self, which: int, vector: ir.VectorType, skip: int):
        builder, start = self._builder, self._args[which + 1]
        array = self._context.make_array(self._types[which])(
            self._context, builder, self._args[which]
        )
        place = builder.gep(array.data, [builder.add(start, ir.Constant(start.type, skip))])
        return builder.bitcast(place, vector.as_pointer())


def _lanes(*lanes: int) -> ir.Constant:
    return ir.Constant(ir.VectorType(_I32, len(lanes)), list(lanes))
