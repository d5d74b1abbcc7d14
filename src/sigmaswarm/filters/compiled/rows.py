"""Allocation of the array of a run on the stack, aligned to a cache line.

In Numba, the arrays of `np.empty` start at multiples of 32 bytes. With AVX-512, each load and store may then access two
cache lines, and a run takes a seventh longer.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import config
from numba.extending import intrinsic

from sigmaswarm.filters.compiled.layout import BLOCKS, LANES, N_ROWS

CACHE_LINE = 64  # bytes; also the width of the widest vectors


def array_at(context, builder, kind, data, shape, strides):
    """Return an array of doubles in given memory, for the generator of an intrinsic; strides in bytes."""
    array = context.make_array(kind)(context, builder)
    size = ir.IntType(64)(8)
    context.populate_array(array, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
    return array._getvalue()


@intrinsic
def _on_the_stack(typing_context, lanes):
    kind = types.Array(types.float64, 2, "A")

    def generate(context, builder, signature, arguments):
        size = ir.IntType(64)
        with builder.goto_entry_block():  # `cgutils.alloca_once` would also write zeros
            data = builder.alloca(ir.ArrayType(ir.DoubleType(), BLOCKS * N_ROWS * LANES))
        data.align = CACHE_LINE
        data = builder.bitcast(data, ir.DoubleType().as_pointer())
        shape = [size(BLOCKS * N_ROWS), arguments[0]]
        return array_at(context, builder, kind, data, shape, [size(8 * LANES), size(8)])

    return kind(types.int64), generate


def _in_python(lanes):
    return np.empty((N_ROWS, LANES))


new_rows = _in_python if config.DISABLE_JIT else _on_the_stack
"""``new_rows(lanes)`` returns an uninitialized array of rows on the stack of the calling kernel.

Its type has ``lanes`` columns, but its memory has LANES columns: w[r, LANES + k] is stored at w[N_ROWS + r, k]. Without
compilation, the array always has LANES columns.
"""
