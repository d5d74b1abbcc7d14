"""Adaptive parts of an update with a fix: adaptation of Q and R, weight of the fix, and inflation of P.

The textbook form is `textbook.adaptive`.
"""

import math

from sigmaswarm.filters.compiled.layout import C1, C2, LANES, P, Q, R
from sigmaswarm.filters.fuzzy import LARGEST_RATIO, SLOWER
from sigmaswarm.filters.student import ITERATIONS, OUTLIERS, OUTLYING


def strong_tracking(w, *, n):
    """Strong tracking: inflate P until the trace of S is at least the recent mean of nu^T nu.

    FADING < 0: off. Source: D. H. Zhou and P. M. Frank, Int. J. Control 65(2), 1996 (single fading factor, computed
    from traces), with two changes. The previous mean and the new nu^T nu have the weights rho = FADING and 1 - rho.
    With the paper's weights, rho / (1 + rho) and 1 / (1 + rho), the mean forgets too fast. Only the part of P that the
    fix observes is inflated, P + (factor - 1) C (H P H^T)^-1 C^T with C = Cov(state, z), since the unobserved part
    would grow without limit.
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

    FUZZY < 0: off. See `filters.fuzzy`.
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

    DOF = 0: off. See `textbook.adaptive.StudentT`, also for the inflation of P after consecutive outliers. Let V = R /
    weight, S = H P H^T + V and e = S^-1 nu. After the update, the residual is r = V e, and H P+ H^T is A = V - V S^-1
    V. Three iterations from a weight of 1 compute weight = (dof + 2) / (dof + r^T R^-1 r + tr R^-1 A).
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
    """Adapt Q and R to the innovation of a fix, with weight 1 - FORGETTING; FORGETTING = 1: off.

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
