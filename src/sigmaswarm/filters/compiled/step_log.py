"""Log of each step of the compiled filter for a smoother: the state, the prediction and the coefficients of A.

A is the state transition matrix of the step: see transition.py. If a fading factor or a run of outliers inflates P, the
prediction includes this inflation.
"""

import numpy as np

from sigmaswarm.filters.compiled.lanes import kernel
from sigmaswarm.filters.compiled.layout import LANES, MOVE, PRIOR, state_rows
from sigmaswarm.filters.compiled.transition import COEFFICIENTS
from sigmaswarm.filters.kernels import FILTERS, base_model_name


def _moves_of(name):
    return COEFFICIENTS[base_model_name(name)]


def logged_rows(name):
    """Return the logged rows: updated state, prediction, length of the step, coefficients of A, phi of `fix_error`."""
    state, n_moves = state_rows(name), 1 + len(_moves_of(name)) + FILTERS[name].fix_error
    return np.array([*state, *(PRIOR + state), *range(MOVE, MOVE + n_moves)], dtype=np.intp)


def phi_index(model):
    """Return the index of phi among the rows MOVE; 0 for a model without phi."""
    return 1 + len(_moves_of(model)) if FILTERS[model].fix_error else 0


def _note_move(w, dt, *, indices, moves, phi):
    for l in range(LANES):
        MOVE[0] = dt
        for i in indices:  # A is the identity in a step of length 0
            MOVE[1 + i] = w[moves[i]] if dt > 0.0 else 0.0
        if phi:
            MOVE[phi] = 1.0  # at a fix, `move_fix_error` replaces it


def _note_prior(w, *, state):
    for l in range(LANES):
        for row in state:
            PRIOR[row] = w[row]


def note_move(name):
    return kernel(_note_move, indices=range(len(_moves_of(name))), moves=_moves_of(name), phi=phi_index(name))


def note_prior(name):
    """Return the kernel that logs the prediction: before the updates, and again after a possible inflation of P."""
    return kernel(_note_prior, state=tuple(int(row) for row in state_rows(name)))
