"""Log of each step of the compiled filter for a smoother: the prediction before any update, and its transition A.

A is the Jacobian of an extended filter, or the statistical linearization Cov(s', s) P^-1 of an unscented filter. In
planar5.py and planar8.py this linearization is the Jacobian with k J g0 + m t in place of J g0. The prediction includes
the inflation by a fading factor or after a run of outliers.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import numpy as np

from sigmaswarm.filters.compiled.lanes import kernel
from sigmaswarm.filters.compiled.layout import LANES, MOVE, PRIOR, SLOPE, R, state_rows
from sigmaswarm.filters.compiled.tilted12_unscented import OUTPUTS
from sigmaswarm.filters.fix_error import FILTERS, UNSCENTED, own_name

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
"""Rows from which A is computed, by kernel, all proportional to the length of the step; phi of `fix_error` follows."""


def _moves_of(name):
    return MOVES[own_name(name)]


def logged_rows(name):
    """Return the logged rows: the state after the step, the prediction, the step's length, other numbers of A."""
    state, n_moves = state_rows(name), 1 + len(_moves_of(name)) + FILTERS[name].fix_error
    return np.array([*state, *(PRIOR + state), *range(MOVE, MOVE + n_moves)], dtype=np.intp)


def phi_place(model):
    """Return the index of phi among the rows MOVE; 0 for a model without phi."""
    return 1 + len(_moves_of(model)) if FILTERS[model].fix_error else 0


def _note_move(w, dt, *, places, moves, phi):
    for l in range(LANES):
        w[MOVE, l] = dt
        for i in places:  # A is the identity in a step of length 0
            w[MOVE + 1 + i, l] = w[moves[i], l] if dt > 0.0 else 0.0
        if phi:
            w[MOVE + phi, l] = 1.0  # except at a fix: see `move_fix_error`


def _note_prior(w, *, state):
    for l in range(LANES):
        for row in state:
            w[PRIOR + row, l] = w[row, l]


def note_move(name):
    return kernel(_note_move, places=range(len(_moves_of(name))), moves=_moves_of(name), phi=phi_place(name))


def note_prior(name):
    """Return the kernel that logs the prediction before a measurement, and again if P is inflated."""
    return kernel(_note_prior, state=tuple(int(row) for row in state_rows(name)))
