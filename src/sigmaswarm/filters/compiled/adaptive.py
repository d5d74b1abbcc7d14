"""Parts of an update with a fix: adaptation of Q and R, weight of the fix, inflation of P, correlated fix error b.

The textbook forms are `textbook.adaptive` and `filters.kernels`. The last two states are b. The process of a model does
not depend on b, so a prediction multiplies the columns of b in P by the transition A of the model. The coefficients of
A are in scratch rows: see transition.py.
"""

import math

from sigmaswarm.drives.timeline import DT, FIX_VAR_X, FIX_VAR_Y
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, MOVE, P, Q, R
from sigmaswarm.filters.constants import ITERATIONS, LARGEST_RATIO, OUTLIERS, OUTLYING, SLOWER


def strong_tracking(w, *, n):
    """Strong tracking: inflate P until the trace of S is at least the recent mean of nu^T nu.

    FADING < 0 disables this part. Source: D. H. Zhou and P. M. Frank, Int. J. Control 65(2), 1996 (single fading
    factor, computed from traces), with two changes. The previous mean and the new nu^T nu have the weights rho = FADING
    and 1 - rho. With the weights of the source, rho / (1 + rho) and 1 / (1 + rho), the mean forgets too fast. Only the
    part of P that the fix observes is inflated, P + (factor - 1) C (H P H^T)^-1 C^T with C = Cov(state, z), since the
    unobserved part would grow without limit.
    """
    for l in range(LANES):
        rho = w.FADING
        size = w.N1 * w.N1 + w.N2 * w.N2
        recent = size if w.RECENT < 0.0 else rho * w.RECENT + (1.0 - rho) * size
        used = (rho >= 0.0) & (w.USE > 0.0)
        w.RECENT = recent if used else w.RECENT
        # H P H^T without the second-order terms of the sigma points
        s11, s12, s22 = w.S11 - w.GEE, w.S12 - w.GEN, w.S22 - w.GNN
        wanted = (recent - w.R1 - w.R2) / (s11 + s22)
        inflate_observed(w, l, s11, s12, s22, wanted if used & (wanted > 1.0) else 1.0)


def apply_fuzzy_rules(w, *, n):
    """Scale R and Q by fuzzy rules on the NIS of a fix.

    FUZZY < 0 disables the rules. See `textbook.adaptive.FuzzyNoise`.
    """
    for l in range(LANES):
        memory = w.FUZZY
        used = (memory >= 0.0) & (w.USE > 0.0)  # False for a rejected fix
        v11, v12, v22, n1, n2 = w.V11, w.V12, w.V22, w.N1, w.N2
        newest = 0.5 * (v22 * n1 * n1 - 2.0 * v12 * n1 * n2 + v11 * n2 * n2) / (v11 * v22 - v12 * v12)
        newest = newest if newest < LARGEST_RATIO else LARGEST_RATIO
        quick = w.QUICK + (1.0 - memory) * (newest - w.QUICK)
        slow = w.SLOW + (1.0 - memory) / SLOWER * (newest - w.SLOW)
        ratio = (quick - 1.0) / (quick + 1.0) / w.WIDTH_RATIO
        trend = (quick - slow) / (quick + slow) / w.WIDTH_TREND
        large = 0.0 if ratio < 0.0 else (1.0 if ratio > 1.0 else ratio)
        small = 0.0 if ratio > 0.0 else (1.0 if ratio < -1.0 else -ratio)
        rises = 0.0 if trend < 0.0 else (1.0 if trend > 1.0 else trend)
        right = 1.0 - small - large
        gain_r, gain_q = w.GAIN_R, w.GAIN_Q
        times_r = small / gain_r + right + large * gain_r
        times_q = small / gain_q + right + large * (rises + (1.0 - rises) * gain_q)
        more_r = times_r / w.TIMES_R if used else 1.0
        more_q = times_q / w.TIMES_Q if used else 1.0
        for row in (R.RX, R.RY, R.ACCURACY, R.R1, R.R2):
            w[row] *= more_r
        for i in range(n):
            Q[i] *= more_q
        w.QUICK = quick if used else w.QUICK
        w.SLOW = slow if used else w.SLOW
        w.TIMES_R *= more_r
        w.TIMES_Q *= more_q


def inflate_observed(w, l, s11, s12, s22, factor, *, n):
    """Add (factor - 1) C (H P H^T)^-1 C^T to P, and change H P H^T and C accordingly; ``factor`` is at least 1.

    ``s11``, ``s12`` and ``s22`` are H P H^T.
    """
    more = (factor - 1.0) / (s11 * s22 - s12 * s12) if factor > 1.0 else 0.0
    for j in range(n):
        c1, c2 = C1[j], C2[j]
        gain_1, gain_2 = more * (s22 * c1 - s12 * c2), more * (s11 * c2 - s12 * c1)
        for i in range(j + 1):
            P[i, j] += gain_1 * C1[i] + gain_2 * C2[i]
    w.S11 += (factor - 1.0) * s11
    w.S12 += (factor - 1.0) * s12
    w.S22 += (factor - 1.0) * s22
    for i in range(n):
        C1[i] *= factor
        C2[i] *= factor


def student_t_weight(w, since):
    """Compute the weight of a fix by Student's t, and divide the R of the fix by this weight.

    DOF = 0 disables the weights. `textbook.adaptive.StudentT` describes the method and the inflation of P after
    consecutive outliers. Let V = R / weight, S = H P H^T + V and e = S^-1 nu. After the update, the residual is r = V
    e, and H P+ H^T is A = V - V S^-1 V. Three iterations from a weight of 1 compute weight = (dof + 2) / (dof + r^T
    R^-1 r + tr R^-1 A).
    """
    recovering = 0
    for l in range(LANES):
        dof, rx, ry = w.DOF, w.R1, w.R2
        s11, s12, s22 = w.S11, w.S12, w.S22
        n1, n2 = w.N1, w.N2
        weight = 1.0
        for k in range(ITERATIONS):
            a, b = rx / weight, ry / weight
            det = (s11 + a) * (s22 + b) - s12 * s12
            g11, g12, g22 = (s22 + b) / det, -s12 / det, (s11 + a) / det
            e1, e2 = g11 * n1 + g12 * n2, g12 * n1 + g22 * n2
            gamma = (2.0 + a * (e1 * e1 - g11) + b * (e2 * e2 - g22)) / weight
            weight = (dof + 2.0) / (dof + gamma)
        used = dof > 0.0
        count = w.OUTLIERS + 1.0 if used & (weight < OUTLYING) else 0.0
        span = w.SPAN + since if count > 1.0 else 0.0
        recovers = (count >= OUTLIERS) & (span >= w.PATIENCE)
        seen = (s11 - w.GEE) + (s22 - w.GNN)  # tr H P H^T
        wanted = (n1 * n1 + n2 * n2 - rx - ry) / seen
        w.FACTOR = wanted if recovers & (wanted > 1.0) else 1.0
        weight = weight if used & (not recovers) else 1.0
        w.R1, w.R2 = rx / weight, ry / weight
        w.OUTLIERS = 0.0 if recovers else count
        w.SPAN = 0.0 if recovers else span
        recovering += recovers
    if recovering > 0:
        for l in range(LANES):
            s11, s12, s22 = w.S11 - w.GEE, w.S12 - w.GEN, w.S22 - w.GNN
            inflate_observed(w, l, s11, s12, s22, w.FACTOR)


def adapt(w, since, *, n):
    """Adapt Q and R to the innovation of a fix, with weight 1 - FORGETTING; FORGETTING = 1 disables this.

    See `textbook.adaptive.SageHusa`. The estimate of R is the diagonal of eps eps^T + H P+ H^T, positive by
    construction, with the residual eps after the update. The estimate of Q is the diagonal of Q + (K nu nu^T K^T + P+ -
    P-) / since, or 0 where this value is negative. A second fix at the same time (since = 0) contains no information
    about Q.
    """
    span = since if since > 0.0 else math.inf
    for l in range(LANES):
        g11, g12, g22 = w.G11, w.G12, w.G22
        weight = 1.0 - w.FORGETTING if g11 > 0.0 else 0.0  # 0 for a rejected fix
        e1, e2 = g11 * w.N1 + g12 * w.N2, g12 * w.N1 + g22 * w.N2
        rx, ry = w.RX, w.RY
        w.RX = rx + weight * rx * rx * (e1 * e1 - g11)  # H P+ H^T = R - R S^-1 R
        w.RY = ry + weight * ry * ry * (e2 * e2 - g22)
        for i in range(n):
            c1, c2 = C1[i], C2[i]
            moved = c1 * e1 + c2 * e2
            shrunk = c1 * (c1 * g11 + c2 * g12) + c2 * (c1 * g12 + c2 * g22)
            change = (moved * moved - shrunk) / span
            q = Q[i]
            Q[i] = q + weight * (change if change > -q else -q)


def carry_fix_error(w, u, *, n, biases):
    """Multiply the columns of the fix error in P by the transition A of a planar model.

    ``biases`` is True for planar8.
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
    """Compute phi, and the variance g s^2 (1 - phi^2) by which the fix error grows in ``since`` nominal steps."""
    var_x, var_y = z[FIX_VAR_X], z[FIX_VAR_Y]
    for l in range(LANES):
        phi = math.exp(-since * w.FIX_ERROR_RATE)
        gained = w.FIX_ERROR * (1.0 - phi * phi)
        w.PHI = phi
        w.GAINED_X = gained * (var_x if var_x > 0.0 else w.FIX_VAR)
        w.GAINED_Y = gained * (var_y if var_y > 0.0 else w.FIX_VAR)


def move_fix_error(w, *, n, noted):
    """Propagate the fix error from the last fix to the new fix.

    ``noted`` is the index of phi among the rows MOVE of `transition`, or 0 if phi is not logged.
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

    phi b is added to the prediction and changes nu, H P H^T and C. The variance that `age_fix_error` computes is added
    to H P H^T.
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
