"""Closed form of `filters.fix_error`: the correlated fix error b, in the last two states.

The model's process does not depend on b, so a prediction multiplies the columns of b in P by the model's transition A.
The coefficients of A are in scratch rows: see transition.py.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

from sigmaswarm.drives.timeline import DT, FIX_VAR_X, FIX_VAR_Y
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, MOVE, R, at


def carry(w, u, *, n, biases):
    """Multiply the columns of the fix error in P by the transition A of a planar model.

    ``biases``: True for planar8.
    """
    dt = u[DT]
    h = 0.5 * dt
    for l in range(LANES):
        ke, kn = w[R.JEAST, l], w[R.JNORTH, l]
        for j in range(n - 2, n):
            ub, vb, tb = w[at(R.U, j), l], w[at(R.V, j), l], w[at(R.T, j), l]
            u1, v1 = ub + ke * tb, vb + kn * tb
            if biases:
                ab, bb, c, s = w[at(R.A, j), l], w[at(R.B, j), l], w[R.COS, l], w[R.SIN, l]
                u1, v1 = u1 - (c * ab - s * bb), v1 - (s * ab + c * bb)
                w[at(R.T, j), l] = tb - dt * w[at(R.W, j), l]
            w[at(R.X, j), l] += h * (ub + u1)
            w[at(R.Y, j), l] += h * (vb + v1)
            w[at(R.U, j), l], w[at(R.V, j), l] = u1, v1


def age_fix_error(w, z, since):
    """Compute phi, and the variance g s^2 (1 - phi^2) that the fix error gains in ``since`` nominal steps."""
    var_x, var_y = z[FIX_VAR_X], z[FIX_VAR_Y]
    for l in range(LANES):
        phi = math.exp(-since * w[R.FIX_ERROR_RATE, l])
        gained = w[R.FIX_ERROR, l] * (1.0 - phi * phi)
        w[R.PHI, l] = phi
        w[R.GAINED_X, l] = gained * (var_x if var_x > 0.0 else w[R.FIX_VAR, l])
        w[R.GAINED_Y, l] = gained * (var_y if var_y > 0.0 else w[R.FIX_VAR, l])


def move_fix_error(w, *, n, noted):
    """Propagate the fix error from the last fix to the new fix.

    ``noted``: index of phi among the rows MOVE of `step_log`; 0: phi is not logged.
    """
    for l in range(LANES):
        phi = w[R.PHI, l]
        for j in range(n - 2, n):
            w[j, l] *= phi
            for i in range(n):
                w[at(i, j), l] *= phi
            w[at(j, j), l] *= phi
        w[at(n - 2, n - 2), l] += w[R.GAINED_X, l]
        w[at(n - 1, n - 1), l] += w[R.GAINED_Y, l]
        if noted:
            w[MOVE + noted, l] = phi
        w[R.PHI, l], w[R.GAINED_X, l], w[R.GAINED_Y, l] = 1.0, 0.0, 0.0


def observe_fix_error(w, *, n):
    """Include phi times the fix error, and the gained variance, in nu, H P H^T and C of a fix."""
    for l in range(LANES):
        phi = w[R.PHI, l]
        w[R.N1, l] -= phi * w[n - 2, l]
        w[R.N2, l] -= phi * w[n - 1, l]
        xx, xy, yy = w[at(n - 2, n - 2), l], w[at(n - 2, n - 1), l], w[at(n - 1, n - 1), l]
        w[R.S11, l] += phi * (2.0 * w[C1 + n - 2, l] + phi * xx) + w[R.GAINED_X, l]
        w[R.S12, l] += phi * (w[C1 + n - 1, l] + w[C2 + n - 2, l] + phi * xy)
        w[R.S22, l] += phi * (2.0 * w[C2 + n - 1, l] + phi * yy) + w[R.GAINED_Y, l]
        for i in range(n):
            w[C1 + i, l] += phi * w[at(i, n - 2), l]
            w[C2 + i, l] += phi * w[at(i, n - 1), l]
