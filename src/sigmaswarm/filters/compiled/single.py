"""One step of one filter as a separate function, which other compiled code calls by its address.

If the step were not separate, Numba would inline it into the functions of a live filter, and compile these functions
for each model.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, float64, int64, types
from numba.extending import intrinsic

from sigmaswarm.compilation import address_of, call_once
from sigmaswarm.filters.compiled.lanes import exchange_control
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, N_KEPT, WIDEST, R, state_rows
from sigmaswarm.filters.compiled.memory import new_rows
from sigmaswarm.filters.compiled.run import named_by_sources
from sigmaswarm.filters.compiled.step import step_of
from sigmaswarm.filters.compiled.transition import logged_rows

_NUMBERS = types.CPointer(float64)
SIGNATURE = types.void(_NUMBERS, _NUMBERS, int64, _NUMBERS, _NUMBERS, _NUMBERS, float64)


def _one_step(v, u, events, z, wheels, lever, since, *, step, kept, step_log, logged):
    control = exchange_control(-1)
    w = new_rows(WIDEST)
    for r in kept:
        for lane in range(w.shape[1]):
            w[r, lane] = v[r]
    for lane in range(w.shape[1]):
        w[R.SIN_COS_VALID_ALL, lane] = v[R.SIN_COS_VALID]  # all lanes are equal
    step(
        w, tuple(u[k] for k in range(9)), events, tuple(z[k] for k in range(8)),
        tuple(wheels[k] for k in range(3)), tuple(lever[k] for k in range(3)), since,
    )  # fmt: skip
    for r in kept:
        v[r] = w[r, 0]
    exchange_control(control)
    if step_log >= 0:
        at = step_log + 1 + int(v[step_log]) * len(logged)
        for r in range(len(logged)):
            v[at + r] = w[logged[r], 0]
        v[step_log] += 1.0


@dataclass(frozen=True, eq=False)
class SingleStep:
    """The compiled step of a model in this process; a copy in another process looks up its own address.

    ``address`` is the first argument of `take_step`; without compilation it is a function. ``made_by`` contains the
    function that creates this object, and its arguments.
    """

    address: Any
    made_by: tuple[Any, ...]

    def __reduce__(self):
        return self.made_by[0], self.made_by[1:]


@call_once
def single_step(model, step_log=-1):
    """Return the compiled step of a model.

    ``step_log`` is the index in ``v`` of the number of logged steps. The values of `logged_rows` for each logged step
    follow this number. If ``step_log`` is negative, no steps are logged.
    """
    noted = step_log >= 0
    kept = np.array([*state_rows(model), *range(CONSTANT_ROWS.start, N_KEPT)])

    def known():
        step = step_of(model, noted=noted)
        return {"step": step, "kept": kept, "step_log": step_log, "logged": logged_rows(model)}

    function = named_by_sources(_one_step, f"{model}, log {step_log}" if noted else model, known)
    return SingleStep(address_of(function, SIGNATURE, error_model="numpy"), (single_step, model, step_log))


@intrinsic
def _call(typing_context, step, v, u, events, z, wheels, lever, since):
    def generate(context, builder, signature, arguments):
        for kind in (v, u, z, wheels, lever):
            if not (isinstance(kind, types.Array) and kind.dtype == types.float64 and kind.layout == "C"):
                raise TypeError(f"a step needs contiguous arrays of doubles, not {kind}")
        values = [
            context.make_array(kind)(context, builder, value).data if isinstance(kind, types.Array) else value
            for kind, value in zip(signature.args, arguments, strict=True)
        ]
        function = ir.FunctionType(ir.IntType(8).as_pointer(), [value.type for value in values[1:]])
        builder.call(builder.inttoptr(values[0], function.as_pointer()), values[1:])
        return context.get_dummy_value()

    return types.void(int64, v, u, int64, z, wheels, lever, float64), generate


take_step = (lambda step, *arguments: step(*arguments)) if config.DISABLE_JIT else _call
"""For compiled code: ``take_step(step, v, u, events, z, wheels, lever, since)`` computes one step of one filter.

``step`` is `SingleStep.address`; ``v`` (N_KEPT or more,) is the filter, which changes in place. For the other arguments
see `step._step`; ``u``, ``z``, ``wheels`` and ``lever`` are arrays (9,), (8,), (3,) and (3,).
"""
