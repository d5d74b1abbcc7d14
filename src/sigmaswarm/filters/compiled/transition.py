"""The transition A of a model's state error in a step, e' = A e, and the log of steps for a smoother.

A is the Jacobian of an extended filter, or the statistical linearization Cov(s', s) P^-1 of an unscented filter. The
latter is the Jacobian with k J g0 (planar5.py) or k J g0 + m t (planar8.py) in place of J g0; see also
tilted12_unscented.py. Smoothers and the prediction of tilted12 use A. The function of each model returns A e as a
tuple. Its argument ``f`` contains the values of the rows `COEFFICIENTS`, which include the factor ``dt``, the length of
the step.

The log of a step contains the state, the prediction and the coefficients of A. If a fading factor or a run of outliers
inflates P, the logged prediction includes this inflation.
"""

import numpy as np

from sigmaswarm.filters.compiled.lanes import kernel
from sigmaswarm.filters.compiled.layout import LANES, MOVE, PRIOR, SLOPE, R, state_rows
from sigmaswarm.filters.kernels import FILTERS, UNSCENTED, base_model_name
from sigmaswarm.filters.tilted import GRAVITY

COEFFICIENTS = {
    "planar5": (R.JEAST, R.JNORTH),
    "planar8": (R.JEAST, R.JNORTH, R.COS, R.SIN),
    "tilted12": (R.EAST, R.NORTH, R.D11, R.D12, R.D13, R.D21, R.D22, R.D23, R.D31, R.D32, R.D33),
    UNSCENTED: (
        R.D11,
        R.D12,
        R.D21,
        R.D22,
        *(SLOPE + 5 * column + output for output in (0, 1) for column in range(6)),
        *(SLOPE + 5 * column + output for output in (2, 3, 4) for column in range(3)),
    ),
}


def planar5(f, dt, e):
    je, jn = f
    x, y, vx, vy, theta = e
    vx1, vy1 = vx + je * theta, vy + jn * theta
    return x + 0.5 * dt * (vx + vx1), y + 0.5 * dt * (vy + vy1), vx1, vy1, theta


def planar8(f, dt, e):
    je, jn, c, s = f
    x, y, vx, vy, theta, ax, ay, wz = e
    vx1 = vx + je * theta - (c * ax - s * ay)
    vy1 = vy + jn * theta - (s * ax + c * ay)
    return x + 0.5 * dt * (vx + vx1), y + 0.5 * dt * (vy + vy1), vx1, vy1, theta - dt * wz, ax, ay, wz


def tilted12(f, dt, e):
    """Compute A e. ``r_east``, ``r_north`` and ``r_up`` are small rotations, in the rows of roll, pitch and heading."""
    a_east, a_north, d11, d12, d13, d21, d22, d23, d31, d32, d33 = f
    x, y, vx, vy, r_up, ax, ay, wz, r_east, r_north, wx, wy = e
    h, g = 0.5 * dt, GRAVITY * dt
    vx1 = vx + g * r_north - a_north * r_up - d11 * ax - d12 * ay
    vy1 = vy - g * r_east + a_east * r_up - d21 * ax - d22 * ay
    r_east1 = r_east - d11 * wx - d12 * wy - d13 * wz
    r_north1 = r_north - d21 * wx - d22 * wy - d23 * wz
    r_up1 = r_up - d31 * wx - d32 * wy - d33 * wz
    return x + h * (vx + vx1), y + h * (vy + vy1), vx1, vy1, r_up1, ax, ay, wz, r_east1, r_north1, wx, wy


def tilted12_unscented(f, dt, e):
    """Compute A e. ``f`` contains R dt, and the slopes H (tilted12_unscented.py) of velocity and rotation."""
    (
        d11, d12, d21, d22,
        vx_wz, vx_wx, vx_wy, vx_up, vx_east, vx_north, vy_wz, vy_wx, vy_wy, vy_up, vy_east, vy_north,
        east_wz, east_wx, east_wy, north_wz, north_wx, north_wy, up_wz, up_wx, up_wy,
    ) = f  # fmt: skip
    x, y, vx, vy, r_up, ax, ay, wz, r_east, r_north, wx, wy = e
    h, vx1, vy1 = 0.5 * dt, vx - d11 * ax - d12 * ay, vy - d21 * ax - d22 * ay
    vx1 += vx_wz * wz + vx_wx * wx + vx_wy * wy + vx_up * r_up + vx_east * r_east + vx_north * r_north
    vy1 += vy_wz * wz + vy_wx * wx + vy_wy * wy + vy_up * r_up + vy_east * r_east + vy_north * r_north
    r_east1 = r_east + east_wz * wz + east_wx * wx + east_wy * wy
    r_north1 = r_north + north_wz * wz + north_wx * wx + north_wy * wy
    r_up1 = r_up + up_wz * wz + up_wx * wx + up_wy * wy
    return x + h * (vx + vx1), y + h * (vy + vy1), vx1, vy1, r_up1, ax, ay, wz, r_east1, r_north1, wx, wy


TRANSITIONS = {"planar5": planar5, "planar8": planar8, "tilted12": tilted12, UNSCENTED: tilted12_unscented}


def _moves_of(name):
    return COEFFICIENTS[base_model_name(name)]


def logged_rows(name):
    """Return the logged rows: updated state, prediction, length of the step, coefficients of A, phi."""
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
            MOVE[phi] = 1.0  # at a fix, `move_fix_error` replaces this value


def _note_prior(w, *, state):
    for l in range(LANES):
        for row in state:
            PRIOR[row] = w[row]


def note_move(name):
    return kernel(_note_move, indices=range(len(_moves_of(name))), moves=_moves_of(name), phi=phi_index(name))


def note_prior(name):
    """Return the kernel that logs the prediction: before the updates, and again after a possible inflation of P."""
    return kernel(_note_prior, state=tuple(int(row) for row in state_rows(name)))
