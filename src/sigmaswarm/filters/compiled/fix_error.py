"""Closed form of `filters.fix_error`: the correlated fix error b, in the last two states.

The model's process does not depend on b, so a prediction multiplies the columns of b in P by the model's transition A.
The coefficients of A are in scratch rows: see transition.py.
"""

import math

from sigmaswarm.drives.timeline import DT, FIX_VAR_X, FIX_VAR_Y
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, MOVE, P, R


def carry(w, u, *, n, biases):
    """Multiply the columns of the fix error in P by the transition A of a planar model.

    ``biases``: True for planar8.
    """
    dt = u[DT]
    h = 0.5 * dt
    for l in range(LANES):
        ke, kn = w.JEAST, w.JNORTH
        for j in range(n - 2, n):
            ub, vb, tb = P[R.U, j], P[R.V, j], P[R.T, j]
            u1, v1 = ub + ke * tb, vb + kn * tb
            if biases:
                ab, bb, c, s = P[R.A, j], P[R.B, j], w.COS, w.SIN
                u1, v1 = u1 - (c * ab - s * bb), v1 - (s * ab + c * bb)
                P[R.T, j] = tb - dt * P[R.W, j]
            P[R.X, j] += h * (ub + u1)
            P[R.Y, j] += h * (vb + v1)
            P[R.U, j], P[R.V, j] = u1, v1


def age_fix_error(w, z, since):
    """Compute phi, and the variance g s^2 (1 - phi^2) that the fix error gains in ``since`` nominal steps."""
    var_x, var_y = z[FIX_VAR_X], z[FIX_VAR_Y]
    for l in range(LANES):
        phi = math.exp(-since * w.FIX_ERROR_RATE)
        gained = w.FIX_ERROR * (1.0 - phi * phi)
        w.PHI = phi
        w.GAINED_X = gained * (var_x if var_x > 0.0 else w.FIX_VAR)
        w.GAINED_Y = gained * (var_y if var_y > 0.0 else w.FIX_VAR)


def move_fix_error(w, *, n, noted):
    """Propagate the fix error from the last fix to the new fix.

    ``noted``: index of phi among the rows MOVE of `step_log`; 0 if phi is not logged.
    """
    for l in range(LANES):
        phi = w.PHI
        for j in range(n - 2, n):
            w[j] *= phi
            for i in range(n):
                P[i, j] *= phi
            P[j, j] *= phi
        P[n - 2, n - 2] += w.GAINED_X
        P[n - 1, n - 1] += w.GAINED_Y
        if noted:
            MOVE[noted] = phi
        w.PHI, w.GAINED_X, w.GAINED_Y = 1.0, 0.0, 0.0


def observe_fix_error(w, *, n):
    """Add the predicted fix error to the measurement model of a fix.

    phi b enters nu, H P H^T and C; the variance that `age_fix_error` computes enters H P H^T.
    """
    for l in range(LANES):
        phi = w.PHI
        w.N1 -= phi * w[n - 2]
        w.N2 -= phi * w[n - 1]
        xx, xy, yy = P[n - 2, n - 2], P[n - 2, n - 1], P[n - 1, n - 1]
        w.S11 += phi * (2.0 * C1[n - 2] + phi * xx) + w.GAINED_X
        w.S12 += phi * (C1[n - 1] + C2[n - 2] + phi * xy)
        w.S22 += phi * (2.0 * C2[n - 1] + phi * yy) + w.GAINED_Y
        for i in range(n):
            C1[i] += phi * P[i, n - 2]
            C2[i] += phi * P[i, n - 1]
