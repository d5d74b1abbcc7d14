"""A live filter's last seconds once more, with every step on tape for the smoother."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

from functools import cache

import numpy as np

from sigmaswarm.filters.compiled.lanes import LANES
from sigmaswarm.filters.compiled.layout import CONSTANT_ROWS, N_KEPT, state_rows
from sigmaswarm.filters.compiled.live import (
    N_ALL,
    N_HISTORY,
    S_CALM,
    S_MEANS,
    S_STEP,
    S_TIME,
    _bound,
    _record,
    _step_to,
    _take,
)
from sigmaswarm.filters.compiled.rows import new_rows
from sigmaswarm.filters.compiled.run import cached_by_sources
from sigmaswarm.filters.compiled.step import step_of
from sigmaswarm.filters.compiled.tape import taped_rows
from sigmaswarm.filters.compiled.unroll import unrolled

N_TAPED = N_ALL
"""Where, behind a live filter's belief, the number of steps on tape stands; the tape follows, step by step."""
TAPE = N_ALL + 1


def _taped_step(sources, *, step, kept, taped):
    def live_step(v, u, happens, z, wheels, lever, since):
        """As a live filter's step, and on tape."""
        if sources == "":  # never; so the name is closed over
            return
        w = new_rows()
        for r in kept:
            for l in range(LANES):
                w[r, l] = v[r]
        step(
            w, (u[0], u[1], u[2], u[3], u[4], u[5], u[6], u[7], u[8]), happens,
            (z[0], z[1], z[2], z[3], z[4], z[5]), (wheels[0], wheels[1], wheels[2]),
            (lever[0], lever[1], lever[2]), since,
        )  # fmt: skip
        for r in kept:
            v[r] = w[r, 0]
        at = TAPE + int(v[N_TAPED]) * len(taped)
        for r in range(len(taped)):
            v[at + r] = w[taped[r], 0]
        v[N_TAPED] += 1.0

    return live_step


def _again(sources, *, take):
    def again(v, counts, fixes, speeds, history, first):
        """Take the samples of the history again, from number ``first`` on; ``v`` is the belief before it."""
        if sources == "":
            return
        for number in range(first, counts[N_HISTORY]):
            record = _record(counts, history, number)
            take(
                v,
                counts,
                fixes,
                speeds,
                record[S_TIME],
                record[S_STEP],
                record[S_CALM] > 0.0,
                record[S_MEANS],
            )

    return again


@cache
def again_call(model):
    """``(v, counts, fixes, speeds, history, first)``: a live filter's samples again, on the tape behind ``v``."""
    kept = np.array([*state_rows(model), *range(CONSTANT_ROWS.start, N_KEPT)])
    make = unrolled(_taped_step, step=step_of(model, noted=True), kept=kept, taped=taped_rows(model))
    live_step = cached_by_sources(make, f"{model}, taped")
    take = _bound(_take, step_to=_bound(_step_to, live_step=live_step))
    return cached_by_sources(unrolled(_again, take=take), f"{model}, again", fastmath=False)
