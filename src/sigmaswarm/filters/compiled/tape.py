"""What a step of the compiled filter leaves for a smoother: the prediction before it absorbed anything, and its cause.

A smoother need not know what is measured. Of each step it takes three things: the state behind it; the prediction
(mean and covariance, with Q, gaps, fading factor and the inflation after a run of outliers); and the covariance of the
state before with the state after, P A^T. A is the transition: of an extended filter the Jacobian, of an unscented one
its statistical linearization, Cov(s', s) P^-1. In planar5.py's and planar8.py's closed form that is the Jacobian with
k J g0 + m t in place of J g0. The few numbers that make A are noted here, in rows MOVE; `smoothing` reads them.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import numpy as np

from sigmaswarm.filters.compiled.lanes import kernel
from sigmaswarm.filters.compiled.layout import LANES, MOVE, PRIOR, SLOPE, UNSCENTED, R, state_rows
from sigmaswarm.filters.compiled.tilted12_unscented import OUTPUTS

MOVES = {
    "planar5": (R.JEAST, R.JNORTH),
    "planar8": (R.JEAST, R.JNORTH, R.COS, R.SIN),
    "tilted12": (
        *(R.EAST, R.NORTH),
        *(R.D11, R.D12, R.D13, R.D21, R.D22, R.D23, R.D31, R.D32, R.D33),
    ),
    UNSCENTED: (
        *(R.D11, R.D12, R.D21, R.D22),
        *(SLOPE + OUTPUTS * column + output for output in (0, 1) for column in range(6)),
        *(SLOPE + OUTPUTS * column + output for output in (2, 3, 4) for column in range(3)),
    ),
}
"""By kernel: the rows that make A beside the step's length, all in proportion to it."""


def taped_rows(name):
    """The rows of a step on tape: the state behind it, the prediction, the step's length and what else makes A."""
    state = state_rows(name)
    return np.array([*state, *(PRIOR + state), *range(MOVE, MOVE + 1 + len(MOVES[name]))], dtype=np.intp)


def _note_move(w, dt, *, places, moves):
    for l in range(LANES):
        w[MOVE, l] = dt
        for i in places:  # a step of no length predicts nothing: A is one
            w[MOVE + 1 + i, l] = w[moves[i], l] if dt > 0.0 else 0.0


def _note_prior(w, *, state):
    for l in range(LANES):
        for row in state:
            w[PRIOR + row, l] = w[row, l]


def note_move(name):
    """The kernel that notes what makes A, right after a prediction."""
    return kernel(_note_move, places=range(len(MOVES[name])), moves=MOVES[name])


def note_prior(name):
    """The kernel that notes the prediction: before a measurement, and again where P is stretched for one."""
    return kernel(_note_prior, state=tuple(int(row) for row in state_rows(name)))
