"""Memory of runs and live filters for compiled code.

The array of a run is on the stack, aligned to a cache line. In Numba, the arrays of `np.empty` start at multiples of 32
bytes. With AVX-512, each load and store may then access two cache lines, and a run takes 14% longer. The memory of a
live filter is passed as one address: passing eight arrays takes longer than a step.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import config, float64, int64, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from sigmaswarm.filters.compiled.layout import BLOCKS, LANES, N_ROWS

CACHE_LINE = 64  # bytes; also the width of the widest vectors


def array_at(context, builder, kind, data, shape, strides):
    """Return an array of doubles at the address ``data``, in the code generator of an intrinsic.

    Strides are in bytes.
    """
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


new_rows = (lambda _: np.empty((N_ROWS, LANES))) if config.DISABLE_JIT else _on_the_stack
"""``new_rows(lanes)`` returns an uninitialized array of rows on the stack of the calling kernel.

The type of this array has ``lanes`` columns, but its memory has LANES columns: w[r, LANES + k] is stored at w[N_ROWS +
r, k]. Without compilation, the array always has LANES columns.
"""

_ARRAYS = (types.Array(float64, 1, "C"), types.Array(int64, 1, "C"), *(types.Array(float64, 2, "C"),) * 6)


class LiveArrays(NamedTuple):
    filter_state: NDArray[np.float64]
    counts: NDArray[np.int64]
    calm: NDArray[np.float64]
    fixes: NDArray[np.float64]
    speeds: NDArray[np.float64]
    history: NDArray[np.float64]
    checkpoints: NDArray[np.float64]
    lately: NDArray[np.float64]
    step: Any = None  # the address of a `SingleStep`


_KIND = types.NamedTuple((*_ARRAYS, int64), LiveArrays)


class Memory:
    """The arrays of a live filter (see `live`) and its step.

    ``handle``, the argument of `memory_at`, is valid while this object exists. ``arrays.filter_state`` is a copy of the
    given array.
    """

    def __init__(self, step: Any, given: LiveArrays) -> None:
        self.step = step
        self.arrays = given._replace(filter_state=_aligned(given.filter_state), step=step.address)
        self._table = None if config.DISABLE_JIT else np.array(_numbers(self.arrays))
        self.handle: Any = self.arrays if self._table is None else int(self._table.ctypes.data)

    def __reduce__(self):
        return Memory, (self.step, self.arrays._replace(step=None))


def _aligned(numbers):
    """Return a copy aligned to a cache line, as vector instructions require."""
    room = np.empty(len(numbers) + CACHE_LINE // 8)
    first = (-room.ctypes.data // 8) % (CACHE_LINE // 8)
    copy = room[first : first + len(numbers)]
    copy[:] = numbers
    return copy


def _numbers(arrays):
    return [*(n for array in arrays[:-1] for n in (array.ctypes.data, *array.shape)), arrays.step]


@intrinsic
def _at(typing_context, handle):
    def generate(context, builder, signature, arguments):
        size = ir.IntType(64)
        table = builder.inttoptr(arguments[0], size.as_pointer())
        numbers = iter(range(1 + sum(1 + kind.ndim for kind in _ARRAYS)))

        def number():
            return builder.load(builder.gep(table, [size(next(numbers))]))

        parts = []
        for kind in _ARRAYS:
            data = builder.inttoptr(number(), context.get_data_type(kind.dtype).as_pointer())
            shape = [number() for _ in range(kind.ndim)]
            strides = [size(8)] if kind.ndim == 1 else [builder.mul(shape[1], size(8)), size(8)]
            parts.append(array_at(context, builder, kind, data, shape, strides))
        return context.make_tuple(builder, _KIND, [*parts, number()])

    return _KIND(int64), generate


memory_at = (lambda handle: handle) if config.DISABLE_JIT else _at
"""For compiled code: ``memory_at(handle)`` returns the `LiveArrays` of a `Memory`."""
