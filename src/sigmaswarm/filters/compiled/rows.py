"""The array that a run works on, on the stack and at the start of a cache line.

Numba's `np.empty` starts at any multiple of 32 bytes, so that with AVX-512 every load and store may lie across two
cache lines: the whole run then takes a seventh longer, or not, as chance has it.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false, reportAttributeAccessIssue=false

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import config
from numba.extending import intrinsic

from sigmaswarm.filters.compiled.layout import BLOCKS, LANES, N_ROWS

CACHE_LINE = 64
"""Bytes; also the width of the widest vectors."""


def _on_the_stack(blocks):
    kind = types.Array(types.float64, 2, "A")

    def call(typing_context, lanes):
        def generate(context, builder, signature, arguments):
            size = ir.IntType(64)
            with builder.goto_entry_block():  # by hand: Numba's own would fill it with zeros at each call
                data = builder.alloca(ir.ArrayType(ir.DoubleType(), blocks * N_ROWS * LANES))
            data.align = CACHE_LINE
            array = context.make_array(kind)(context, builder)
            context.populate_array(
                array,
                data=builder.bitcast(data, ir.DoubleType().as_pointer()),
                shape=[size(blocks * N_ROWS), arguments[0]],
                strides=[size(8 * LANES), size(8)],
                itemsize=size(8),
                meminfo=None,
            )
            return array._getvalue()

        return kind(types.int64), generate

    return intrinsic(call)


def _in_python(lanes):
    return np.empty((N_ROWS, LANES))


new_rows = _in_python if config.DISABLE_JIT else _on_the_stack(1)
"""``(lanes)``: an array of rows, not yet written; it lives as long as the kernel that asked for it.

Lanes are LANES or WIDEST; always LANES where nothing is compiled.
"""

new_blocks = _in_python if config.DISABLE_JIT else _on_the_stack(BLOCKS)
"""The same of up to BLOCKS times LANES: it is said to have as many columns, but lane LANES + k of row r is the k-th of
row N_ROWS + r.
"""
