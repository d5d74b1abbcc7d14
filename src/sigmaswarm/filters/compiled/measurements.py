"""Updates of the compiled filter: fixes, velocities, and the constraints of a car on its wheels.

For each measurement, a kernel computes nu, S and C = Cov(state, z) in every lane. Then `_update_two` or `_update_one`
computes x += C S^-1 nu and P -= C S^-1 C^T. In an unscented filter nu, S and C are the moments of sigma points. For z
linear in the state, they equal those of the Kalman filter. For z rotated by the heading, they have a closed form, as in
planar5.py and planar8.py.

Loops over states (i, j, row) are unrolled for the model's n by `unroll.unrolled`.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

import numpy as np

from sigmaswarm.drives.odometer import AGE, MORE, SPEED
from sigmaswarm.drives.timeline import (
    AX,
    FIX_THETA,
    FIX_U,
    FIX_V,
    FIX_VAR_THETA,
    FIX_VAR_X,
    FIX_VAR_Y,
    FIX_X,
    FIX_Y,
    GX,
    GY,
    GZ,
)
from sigmaswarm.filters.compiled.fix_error import age_fix_error, move_fix_error, see_fix_error
from sigmaswarm.filters.compiled.lanes import kernel, sincos, spread_of
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, Q0, SLOPE, R, at
from sigmaswarm.filters.compiled.tilted12 import (
    ALONG,
    fold,
    measure_along_tilted,
    measure_fix_tilted,
    measure_heading_tilted,
)
from sigmaswarm.filters.compiled.tilted12_unscented import (
    OUTPUTS,
    measure_fix_unscented,
    measure_heading_unscented,
    measure_lateral_unscented,
    measure_odometer_unscented,
)
from sigmaswarm.filters.compiled.unroll import unrolled
from sigmaswarm.filters.fix_error import FILTERS, UNSCENTED
from sigmaswarm.filters.fuzzy import LARGEST_RATIO, SLOWER
from sigmaswarm.filters.schedule import HEADING_GATE, MOST_REJECTED, SLIP_GATE
from sigmaswarm.filters.student import (
    FORECAST_DOF,
    FORECAST_SCALE,
    INNOVATION_SCALE,
    ITERATIONS,
    LARGEST_TAIL,
    OUTLIERS,
    OUTLYING,
)

TWO_PI = 2.0 * math.pi


def axis_of(bias):
    """Return the index, in a step's numbers, of the gyro axis of a bias."""
    return {R.W: GZ, R.K: GX, R.L: GY}[bias]


def update_fix(w, z, lever, since, *, stores_innovation, gated, adaptive, fix_error, note_prior):
    """Update with a position fix of the antenna.

    ``z`` is a row of `Timeline.fixes`, ``since`` the scale of Q since the last fix. Parts that no lane uses are
    skipped.
    """
    fading, adapting, fuzzy, robust = 0, 0, 0, 0
    for l in range(LANES):
        fading += w[R.FADING, l] >= 0.0
        adapting += w[R.FORGETTING, l] < 1.0
        fuzzy += w[R.FUZZY, l] >= 0.0
        robust += w[R.DOF, l] > 0.0
    if fix_error:
        age_fix_error(w, z, since)
        move_fix_error(w)
    _measure_fix(w, z, lever)
    if fix_error:
        see_fix_error(w)
    if stores_innovation:
        for l in range(LANES):
            nis = _add_likelihood(w, l)
            if gated:
                inside = (nis <= w[R.GATE, l]) | (w[R.REJECTED, l] >= MOST_REJECTED)
                w[R.USE, l] = 1.0 if inside else 0.0
                w[R.REJECTED, l] = 0.0 if inside else w[R.REJECTED, l] + 1.0
    if adaptive and fading > 0:
        _strong_tracking(w)
    if adaptive and fuzzy > 0:
        _apply_fuzzy_rules(w)
    if robust > 0:
        _student_t_weight(w, since)
    if note_prior:  # P may have been inflated
        note_prior(w)
    for l in range(LANES):
        rx, ry, use = w[R.R1, l], w[R.R2, l], w[R.USE, l]
        s11, s12, s22 = w[R.S11, l] + rx, w[R.S12, l], w[R.S22, l] + ry
        det = s11 * s22 - s12 * s12
        g11, g12, g22 = s22 / det, -s12 / det, s11 / det
        n1, n2 = w[R.N1, l], w[R.N2, l]
        e1, e2 = g11 * n1 + g12 * n2, g12 * n1 + g22 * n2
        w[R.OK, l] = w[R.OK, l] if (s11 > 0.0) & (det > 0.0) & (rx > 0.0) & (ry > 0.0) else 0.0
        w[R.G11, l], w[R.G12, l], w[R.G22, l] = use * g11, use * g12, use * g22
        r1, r2 = (rx * e1 if use > 0.0 else n1), (ry * e2 if use > 0.0 else n2)
        # The residual after an update is R S^-1 nu; after a rejection it is nu.
        w[R.SQ_FIX, l] += r1 * r1 + r2 * r2
        w[R.GEE, l] += rx
        w[R.GNN, l] += ry
    if adaptive and adapting > 0:
        _adapt(w, since)
    _update_two(w)
    _keep_digits(w)


def forecast_fix(w, z, lever, since, *, n, fix_error):
    """Score the prediction of a hidden fix, without an update."""
    _measure_fix(w, z, lever)
    if fix_error:
        age_fix_error(w, z, since)
        see_fix_error(w)
    for l in range(LANES):
        nis = _add_likelihood(w, l)
        w[R.SQ_FORECAST, l] += w[R.N1, l] * w[R.N1, l] + w[R.N2, l] * w[R.N2, l]
        det = w[R.V11, l] * w[R.V22, l] - w[R.V12, l] * w[R.V12, l]
        tail = math.log(1.0 + nis * (1.0 / FORECAST_SCALE))
        w[R.FORECAST_T, l] += 0.5 * math.log(det) + 0.5 * (FORECAST_DOF + 2.0) * tail


def _add_likelihood(w, l):
    """Add the NIS and the likelihood of a fix to the sums, before the update; return the NIS."""
    s11, s12, s22 = w[R.S11, l] + w[R.R1, l], w[R.S12, l], w[R.S22, l] + w[R.R2, l]
    det = s11 * s22 - s12 * s12
    n1, n2 = w[R.N1, l], w[R.N2, l]
    nis = (s22 * n1 * n1 - 2.0 * s12 * n1 * n2 + s11 * n2 * n2) / det
    w[R.V11, l], w[R.V12, l], w[R.V22, l] = s11, s12, s22
    w[R.NU1, l], w[R.NU2, l] = n1, n2
    w[R.NIS, l] += nis
    w[R.DET, l] *= det
    tail = 1.0 + nis * (1.0 / INNOVATION_SCALE)
    w[R.TAIL, l] *= tail if tail < LARGEST_TAIL else LARGEST_TAIL
    return nis


def _measure_fix(w, z, lever, *, n):
    """Compute nu, H P H^T, C and R of z = p + R(theta) lever - latency v.

    The sigma points of R(theta) lever have the closed form of planar5.
    """
    zx, zy, var_x, var_y = z[FIX_X], z[FIX_Y], z[FIX_VAR_X], z[FIX_VAR_Y]
    lever_x, lever_y = lever[0], lever[1]
    for l in range(LANES):
        w[R.R1, l] = w[R.RX, l] + w[R.ACCURACY, l] * var_x
        w[R.R2, l] = w[R.RY, l] + w[R.ACCURACY, l] * var_y
        for row in (R.EAST, R.NORTH, R.JEAST, R.JNORTH, R.E):
            w[row, l] = 0.0
    if lever_x != 0.0 or lever_y != 0.0:
        _turn_lever(w, lever_x, lever_y)
    for l in range(LANES):
        tau, east, north, e = w[R.LATENCY, l], w[R.EAST, l], w[R.NORTH, l], w[R.E, l]
        je, jn = w[R.JEAST, l], w[R.JNORTH, l]
        along = w[R.SPREAD, l] * e * e
        w[R.GEE, l], w[R.GEN, l], w[R.GNN, l] = (
            along * east * east,
            along * east * north,
            along * north * north,
        )
        w[R.N1, l] = zx - (w[R.X, l] - tau * w[R.U, l] + (1.0 + e) * east)
        w[R.N2, l] = zy - (w[R.Y, l] - tau * w[R.V, l] + (1.0 + e) * north)
        for i in range(n):
            w[C1 + i, l] = w[at(i, R.X), l] - tau * w[at(i, R.U), l] + je * w[at(i, R.T), l]
            w[C2 + i, l] = w[at(i, R.Y), l] - tau * w[at(i, R.V), l] + jn * w[at(i, R.T), l]
        w[R.S11, l] = w[C1 + R.X, l] - tau * w[C1 + R.U, l] + je * w[C1 + R.T, l] + w[R.GEE, l]
        w[R.S12, l] = w[C1 + R.Y, l] - tau * w[C1 + R.V, l] + jn * w[C1 + R.T, l] + w[R.GEN, l]
        w[R.S22, l] = w[C2 + R.Y, l] - tau * w[C2 + R.V, l] + jn * w[C2 + R.T, l] + w[R.GNN, l]


@kernel
def _turn_lever(w, lever_x, lever_y):
    """Compute R(theta) lever, k J R(theta) lever, and e, for the mean heading and its variance."""
    for l in range(LANES):
        sin_t, cos_t = sincos(w[R.T, l])
        east, north = cos_t * lever_x - sin_t * lever_y, sin_t * lever_x + cos_t * lever_y
        _, k, quarter_sin2 = spread_of(w[R.QUARTER_GAMMA, l], w[R.TT, l])
        w[R.EAST, l], w[R.NORTH, l], w[R.E, l] = east, north, w[R.SHORTENS, l] * quarter_sin2
        w[R.JEAST, l], w[R.JNORTH, l] = -k * north, k * east


def _keep_digits(w, *, n, tilted, unscented, fix_error):
    """Recompute the position's variances and covariances from P+ H^T = C S^-1 R, without differences of large numbers.

    P - C S^-1 C^T loses all digits of a variance that a fix reduces by a factor of a billion. H is 1 at the position
    and at the correlated fix error, -latency at the velocity and k J R(theta) lever at the heading. R is S - H P H^T.
    """
    for l in range(LANES):
        used = w[R.G11, l] != 0.0
        if unscented == 0:
            tau, je, jn = w[R.LATENCY, l], w[R.JEAST, l], w[R.JNORTH, l]
        else:
            tau, je, jn = w[R.LATENCY, l], w[SLOPE, l], w[SLOPE + 1, l]
        r1, r12, r2 = w[R.GEE, l], w[R.GEN, l], w[R.GNN, l]
        # The position comes last, since its rows need the other states' covariances.
        for j in (*range(2, n), 0, 1):
            gain_1 = w[C1 + j, l] * w[R.G11, l] + w[C2 + j, l] * w[R.G12, l]
            gain_2 = w[C1 + j, l] * w[R.G12, l] + w[C2 + j, l] * w[R.G22, l]
            x = gain_1 * r1 + gain_2 * r12 + tau * w[at(j, R.U), l] - je * w[at(j, R.T), l]
            y = gain_1 * r12 + gain_2 * r2 + tau * w[at(j, R.V), l] - jn * w[at(j, R.T), l]
            if unscented:
                x -= w[SLOPE + OUTPUTS, l] * w[at(j, R.I), l] + w[SLOPE + OUTPUTS * 2, l] * w[at(j, R.J), l]
                y -= (
                    w[SLOPE + OUTPUTS + 1, l] * w[at(j, R.I), l]
                    + w[SLOPE + OUTPUTS * 2 + 1, l] * w[at(j, R.J), l]
                )
            elif tilted:
                x -= w[R.LEVER_UP, l] * w[at(j, R.J), l]
                y += w[R.LEVER_UP, l] * w[at(j, R.I), l]
            if fix_error:
                x -= w[at(j, n - 2), l]
                y -= w[at(j, n - 1), l]
            if j != R.Y:
                w[at(j, R.X), l] = x if used else w[at(j, R.X), l]
            w[at(j, R.Y), l] = y if used else w[at(j, R.Y), l]


def _strong_tracking(w, *, n):
    """Strong tracking: inflate P until the trace of S is at least the recent mean of nu^T nu.

    FADING < 0: off. The single fading factor, from traces, of D. H. Zhou and P. M. Frank, Int. J. Control 65(2), 1996,
    with two changes. The weights of the averaged innovations are rho and 1 - rho, since the paper's weights, rho / (1 +
    rho) and 1 / (1 + rho), forget too fast. Only the part of P that the fix observes is inflated, P + (factor - 1) C (H
    P H^T)^-1 C^T, since the rest would grow without limit.
    """
    for l in range(LANES):
        rho = w[R.FADING, l]
        size = w[R.N1, l] * w[R.N1, l] + w[R.N2, l] * w[R.N2, l]
        recent = size if w[R.RECENT, l] < 0.0 else rho * w[R.RECENT, l] + (1.0 - rho) * size
        used = (rho >= 0.0) & (w[R.USE, l] > 0.0)
        w[R.RECENT, l] = recent if used else w[R.RECENT, l]
        s11, s12, s22 = (
            w[R.S11, l] - w[R.GEE, l],
            w[R.S12, l] - w[R.GEN, l],
            w[R.S22, l] - w[R.GNN, l],
        )  # H P H^T
        wanted = (recent - w[R.R1, l] - w[R.R2, l]) / (s11 + s22)
        _inflate_observed(w, l, s11, s12, s22, wanted if used & (wanted > 1.0) else 1.0)


def _apply_fuzzy_rules(w, *, n):
    """Scale R and Q by fuzzy rules on a fix's NIS.

    FUZZY < 0: off. See `filters.fuzzy`.
    """
    for l in range(LANES):
        memory = w[R.FUZZY, l]
        used = (memory >= 0.0) & (w[R.USE, l] > 0.0)  # False for a rejected fix
        v11, v12, v22, n1, n2 = w[R.V11, l], w[R.V12, l], w[R.V22, l], w[R.N1, l], w[R.N2, l]
        newest = 0.5 * (v22 * n1 * n1 - 2.0 * v12 * n1 * n2 + v11 * n2 * n2) / (v11 * v22 - v12 * v12)
        newest = newest if newest < LARGEST_RATIO else LARGEST_RATIO
        quick = w[R.QUICK, l] + (1.0 - memory) * (newest - w[R.QUICK, l])
        slow = w[R.SLOW, l] + (1.0 - memory) / SLOWER * (newest - w[R.SLOW, l])
        ratio = (quick - 1.0) / (quick + 1.0) / w[R.WIDTH_RATIO, l]
        trend = (quick - slow) / (quick + slow) / w[R.WIDTH_TREND, l]
        large = 0.0 if ratio < 0.0 else (1.0 if ratio > 1.0 else ratio)
        small = 0.0 if ratio > 0.0 else (1.0 if ratio < -1.0 else -ratio)
        rises = 0.0 if trend < 0.0 else (1.0 if trend > 1.0 else trend)
        right = 1.0 - small - large
        gain_r, gain_q = w[R.GAIN_R, l], w[R.GAIN_Q, l]
        times_r = small / gain_r + right + large * gain_r
        times_q = small / gain_q + right + large * (rises + (1.0 - rises) * gain_q)
        more_r = times_r / w[R.TIMES_R, l] if used else 1.0
        more_q = times_q / w[R.TIMES_Q, l] if used else 1.0
        for row in (R.RX, R.RY, R.ACCURACY, R.R1, R.R2):
            w[row, l] *= more_r
        for i in range(n):
            w[Q0 + i, l] *= more_q
        w[R.QUICK, l] = quick if used else w[R.QUICK, l]
        w[R.SLOW, l] = slow if used else w[R.SLOW, l]
        w[R.TIMES_R, l] *= more_r
        w[R.TIMES_Q, l] *= more_q


def _inflate_observed(w, l, s11, s12, s22, factor, *, n):
    """Compute P + (factor - 1) C (H P H^T)^-1 C^T, and update S and C; a factor of 1 changes nothing.

    ``s11``, ``s12`` and ``s22`` are H P H^T.
    """
    more = (factor - 1.0) / (s11 * s22 - s12 * s12) if factor > 1.0 else 0.0
    for j in range(n):
        c1, c2 = w[C1 + j, l], w[C2 + j, l]
        gain_1, gain_2 = more * (s22 * c1 - s12 * c2), more * (s11 * c2 - s12 * c1)
        for i in range(j + 1):
            w[at(i, j), l] += gain_1 * w[C1 + i, l] + gain_2 * w[C2 + i, l]
    w[R.S11, l] += (factor - 1.0) * s11
    w[R.S12, l] += (factor - 1.0) * s12
    w[R.S22, l] += (factor - 1.0) * s22
    for i in range(n):
        w[C1 + i, l] *= factor
        w[C2 + i, l] *= factor


def _student_t_weight(w, since):
    """Compute the Student's t weight w of a fix, and divide its R by w.

    DOF = 0: off. R. Piche, S. Sarkka and J. Hartikainen, Recursive outlier-robust filtering and smoothing for nonlinear
    systems using the multivariate Student-t distribution, MLSP 2012. With S = H P H^T + R / w and e = S^-1 nu, the
    residual after the update is r = R / w e. Its covariance is A = R / w - R / w S^-1 R / w. Three iterations from
    w = 1 compute w = (dof + 2) / (dof + r^T R^-1 r + tr R^-1 A).

    A filter with a wrong state would treat all fixes as outliers. So the fix that ends a long run of outliers gets
    weight 1, and the part of P that it observes is inflated until it explains the innovation.
    """
    recovering = 0
    for l in range(LANES):
        dof, rx, ry = w[R.DOF, l], w[R.R1, l], w[R.R2, l]
        s11, s12, s22 = w[R.S11, l], w[R.S12, l], w[R.S22, l]
        n1, n2 = w[R.N1, l], w[R.N2, l]
        weight = 1.0
        for k in range(ITERATIONS):  # noqa: B007 (loops over k are unrolled)
            a, b = rx / weight, ry / weight
            det = (s11 + a) * (s22 + b) - s12 * s12
            g11, g12, g22 = (s22 + b) / det, -s12 / det, (s11 + a) / det
            e1, e2 = g11 * n1 + g12 * n2, g12 * n1 + g22 * n2
            gamma = (2.0 + a * (e1 * e1 - g11) + b * (e2 * e2 - g22)) / weight
            weight = (dof + 2.0) / (dof + gamma)
        used = dof > 0.0
        count = w[R.OUTLIERS, l] + 1.0 if used & (weight < OUTLYING) else 0.0
        span = w[R.SPAN, l] + since if count > 1.0 else 0.0
        recovers = (count >= OUTLIERS) & (span >= w[R.PATIENCE, l])
        seen = (s11 - w[R.GEE, l]) + (s22 - w[R.GNN, l])  # tr H P H^T
        wanted = (n1 * n1 + n2 * n2 - rx - ry) / seen
        w[R.FACTOR, l] = wanted if recovers & (wanted > 1.0) else 1.0
        weight = weight if used & (not recovers) else 1.0
        w[R.R1, l], w[R.R2, l] = rx / weight, ry / weight
        w[R.OUTLIERS, l] = 0.0 if recovers else count
        w[R.SPAN, l] = 0.0 if recovers else span
        recovering += recovers
    if recovering > 0:
        for l in range(LANES):
            s11, s12, s22 = w[R.S11, l] - w[R.GEE, l], w[R.S12, l] - w[R.GEN, l], w[R.S22, l] - w[R.GNN, l]
            _inflate_observed(w, l, s11, s12, s22, w[R.FACTOR, l])


def _adapt(w, since, *, n):
    """Adapt Q and R to the innovation of a fix, with weight 1 - FORGETTING (1: off).

    A. P. Sage and G. W. Husa, Adaptive filtering with unknown prior statistics, JACC 1969, with the limit of their
    weights (1 - b) / (1 - b^(k+1)) for large k. The estimate of R is eps eps^T + H P+ H^T, positive by construction,
    with the residual eps after the update. The estimate of Q is K nu nu^T K^T + P+ - (P- - Q); negative values are not
    used. A second fix at the same time (since = 0) has no information on Q.
    """
    span = since if since > 0.0 else math.inf
    for l in range(LANES):
        g11, g12, g22 = w[R.G11, l], w[R.G12, l], w[R.G22, l]
        weight = 1.0 - w[R.FORGETTING, l] if g11 > 0.0 else 0.0  # 0 for a rejected fix
        e1, e2 = g11 * w[R.N1, l] + g12 * w[R.N2, l], g12 * w[R.N1, l] + g22 * w[R.N2, l]
        rx, ry = w[R.RX, l], w[R.RY, l]
        w[R.RX, l] = rx + weight * rx * rx * (e1 * e1 - g11)  # H P+ H^T = R - R S^-1 R
        w[R.RY, l] = ry + weight * ry * ry * (e2 * e2 - g22)
        for i in range(n):
            c1, c2 = w[C1 + i, l], w[C2 + i, l]
            moved = c1 * e1 + c2 * e2
            shrunk = c1 * (c1 * g11 + c2 * g12) + c2 * (c1 * g12 + c2 * g22)
            change = (moved * moved - shrunk) / span
            q = w[Q0 + i, l]
            w[Q0 + i, l] = q + weight * (change if change > -q else -q)


def update_velocity(w, z, *, n):
    """Update with the receiver's velocity over ground, m/s east and north."""
    for l in range(LANES):
        w[R.R1, l] = w[R.R_VELOCITY, l]
    _take_velocity(w, z[FIX_U], z[FIX_V])


def update_standstill(w, u, *, n, gyro_biases, tilted):
    """Update at a standstill: the velocity is 0, and the gyro measures its biases if they are states.

    The measurements are linear, so sequential updates equal a joint update if the error is injected at the end.
    """
    for l in range(LANES):
        w[R.R1, l] = w[R.R_STANDSTILL, l]
    _take_velocity(w, 0.0, 0.0)
    for row in gyro_biases:
        shown = u[axis_of(row)]
        for l in range(LANES):
            w[R.N1, l] = shown - w[row, l]
            w[R.S11, l] = w[at(row, row), l] + w[R.R_RATE, l]
            for i in range(n):
                w[C1 + i, l] = w[at(i, row), l]
        _update_one(w)
    if tilted:
        fold(w)


def _take_velocity(w, zu, zv, *, n):
    """Update with a velocity of variance R1; compute its covariances without differences of large numbers.

    Compare `_keep_digits`.
    """
    for l in range(LANES):
        w[R.N1, l], w[R.N2, l] = zu - w[R.U, l], zv - w[R.V, l]
        s11, s12, s22 = w[R.UU, l] + w[R.R1, l], w[R.UV, l], w[R.VV, l] + w[R.R1, l]
        det = s11 * s22 - s12 * s12
        w[R.G11, l], w[R.G12, l], w[R.G22, l] = s22 / det, -s12 / det, s11 / det
        for i in range(n):
            w[C1 + i, l], w[C2 + i, l] = w[at(i, R.U), l], w[at(i, R.V), l]
    _update_two(w)
    for l in range(LANES):
        r, g11, g12, g22 = w[R.R1, l], w[R.G11, l], w[R.G12, l], w[R.G22, l]
        for i in range(n):
            w[at(i, R.U), l] = r * (w[C1 + i, l] * g11 + w[C2 + i, l] * g12)
            w[at(i, R.V), l] = r * (w[C1 + i, l] * g12 + w[C2 + i, l] * g22)


def _measure_along(w, u, wheels, *, n, bias, lateral):
    """Compute nu, S and C of the velocity R(theta)^T v to the left or forward.

    To the left: 0 = left - arm (yaw rate - w), with `models.lateral_arm`. Forward: speed / scale = forward - delay
    (ax - b), with the wheels' speed. R(theta)^T v has the closed form of planar8.py, rotated back into the body frame,
    with t = R^T P[v, theta] and mu = (e R^T v - k J t)_along. The forward velocity is computed as the left velocity of
    a body that is rotated by 90 degrees, whose forward velocity is ``away``.
    """
    if lateral:
        shown = u[GZ]
    else:
        shown, speed, age, more = u[AX], wheels[SPEED], wheels[AGE], wheels[MORE]
    for l in range(LANES):
        second, quarter_gamma = w[R.SECOND, l], w[R.QUARTER_GAMMA, l]
        if lateral:  # noqa: SIM108 (known at compilation)
            arm = w[R.ARM, l]
        else:
            arm = w[R.ODOMETER_LATENCY, l] + age
        tt = w[R.TT, l]
        s, c = sincos(w[R.T, l])
        quarter_d, k, quarter_sin2 = spread_of(quarter_gamma, tt)
        g2, sin2_h = 16.0 * quarter_gamma * quarter_gamma, 4.0 * quarter_sin2
        e = w[R.SHORTENS, l] * quarter_sin2
        m = 2.0 * sin2_h * (quarter_gamma / quarter_d) * (quarter_gamma / quarter_d)
        forward, left = c * w[R.U, l] + s * w[R.V, l], c * w[R.V, l] - s * w[R.U, l]
        t_forward, t_left = c * w[R.UT, l] + s * w[R.VT, l], c * w[R.VT, l] - s * w[R.UT, l]
        if lateral:
            along, away, t_along, t_away = left, forward, t_left, t_forward
        else:
            along, away, t_along, t_away = forward, -left, t_forward, -t_left
        mu = e * along - second * k * t_away
        turn = k * away + m * t_along
        if lateral:
            variance = c * c * w[R.VV, l] - 2.0 * c * s * w[R.UV, l] + s * s * w[R.UU, l]
        else:
            variance = c * c * w[R.UU, l] + 2.0 * c * s * w[R.UV, l] + s * s * w[R.VV, l]
        variance += k * k * (tt * away * away - g2 * t_along * t_along)
        variance += w[R.SPREAD, l] * mu * mu - 2.0 * k * (1.0 - 2.0 * sin2_h) * away * t_along
        w[R.N1, l] = arm * shown - along - mu
        if lateral == 0:
            w[R.N1, l] += w[R.ODOMETER_SCALE, l] * speed
        for i in range(n):
            if lateral:
                w[C1 + i, l] = c * w[at(i, R.V), l] - s * w[at(i, R.U), l] - turn * w[at(i, R.T), l]
            else:
                w[C1 + i, l] = c * w[at(i, R.U), l] + s * w[at(i, R.V), l] - turn * w[at(i, R.T), l]
        if bias >= 0:  # the IMU's reading has a bias
            w[R.N1, l] -= arm * w[bias, l]
            variance += 2.0 * arm * w[C1 + bias, l] + arm * arm * w[at(bias, bias), l]
            for i in range(n):
                w[C1 + i, l] += arm * w[at(i, bias), l]
        if lateral:
            w[R.S11, l] = variance + w[R.R_LATERAL, l]
        else:
            w[R.S11, l] = variance + (w[R.R_ODOMETER, l] + more)


def update_lateral(w, u, *, tilted, measure_lateral):
    """Update with the lateral constraint at the rear axle, with tire slip.

    See `models.lateral_arm`.
    """
    for l in range(LANES):
        speed2 = w[R.U, l] * w[R.U, l] + w[R.V, l] * w[R.V, l]
        w[R.ARM, l] = w[R.REAR_AXLE, l] - w[R.TIRE_SLIP, l] * speed2
    measure_lateral(w, u, (0.0, 0.0, 0.0))
    _update_one(w)
    if tilted:
        fold(w)


def update_odometer(w, u, wheels, *, tilted, measure_odometer):
    """Update with the wheels' speed, unless the NIS shows slip.

    ``wheels`` is a row of `drives.odometer.Wheels`.
    """
    measure_odometer(w, u, wheels)
    for l in range(LANES):
        used = w[R.N1, l] * w[R.N1, l] <= SLIP_GATE * w[R.S11, l]
        w[R.S11, l] = w[R.S11, l] if used else math.inf
        w[R.N1, l] = w[R.N1, l] if used else 0.0
    _update_one(w)
    if tilted:
        fold(w)


def _measure_heading(w, *, n):
    """Compute the prediction, C and H P H^T of z = theta, which is linear in the state."""
    for l in range(LANES):
        w[R.N1, l], w[R.S11, l] = w[R.T, l], w[R.TT, l]
        for i in range(n):
            w[C1 + i, l] = w[at(i, R.T), l]


def update_heading(w, u, z, *, tilted, measure_heading):
    """Update with the heading ``latency`` ago; increase the variance of an outlier.

    See `schedule.HEADING_GATE`.
    """
    shown, theta, stated = u[GZ], z[FIX_THETA], z[FIX_VAR_THETA]
    measure_heading(w)
    for l in range(LANES):
        off = theta + w[R.LATENCY, l] * shown - w[R.N1, l]
        off -= TWO_PI * np.floor(off / TWO_PI + 0.5)
        s, least = w[R.S11, l] + (w[R.R_HEADING, l] + stated), off * off / HEADING_GATE
        w[R.N1, l], w[R.S11, l] = off, s if s > least else least
    _update_one(w)
    if tilted:
        fold(w)


def _update_one(w, *, n):
    """Update with a scalar z: x += C nu / S, P -= C C^T / S, with S, nu and C in S11, N1 and C1."""
    for l in range(LANES):
        w[R.SIN_COS_VALID, l], w[R.SIN_COS_VALID_ALL, l] = 0.0, 0.0
        g = 1.0 / w[R.S11, l]
        for j in range(n):
            gain = g * w[C1 + j, l]
            w[j, l] += gain * w[R.N1, l]
            for i in range(j + 1):
                w[at(i, j), l] -= gain * w[C1 + i, l]


def _update_two(w, *, n, tilted):
    """Update with a z of two components: x += C G nu, P -= C G C^T, with G = S^-1 (0: rejected) in G11, G12, G22."""
    for l in range(LANES):
        g11, g12, g22 = w[R.G11, l], w[R.G12, l], w[R.G22, l]
        w[R.SIN_COS_VALID, l], w[R.SIN_COS_VALID_ALL, l] = 0.0, 0.0
        for j in range(n):
            gain_1, gain_2 = w[C1 + j, l] * g11 + w[C2 + j, l] * g12, w[C1 + j, l] * g12 + w[C2 + j, l] * g22
            w[j, l] += gain_1 * w[R.N1, l] + gain_2 * w[R.N2, l]
            for i in range(j + 1):
                w[at(i, j), l] -= gain_1 * w[C1 + i, l] + gain_2 * w[C2 + i, l]
        for i in range(n):
            w[R.OK, l] = w[R.OK, l] if w[at(i, i), l] > 0.0 else 0.0
    if tilted:
        fold(w)


def measurement_kernels(name: str, note_prior=None, noted=0):
    """Return `forecast_fix` and the six ``update_`` functions of a kernel.

    ``note_prior``: see `step_log`; ``noted``: see `move_fix_error`.
    """
    model, unscented = FILTERS[name], int(name == UNSCENTED)
    ready = {
        "note_prior": note_prior,
        "n": len(model.states),
        "stores_innovation": 1,
        "gated": 1,
        "gyro_biases": tuple(model.gyro_axes.values()),
        "adaptive": int(name in ("planar5", "planar8", UNSCENTED)),
        "tilted": int(model.tilts is not None),
        "unscented": unscented,
        "fix_error": int(model.fix_error),
        "noted": noted,
    }
    parts = (_update_one, _update_two, _keep_digits, _take_velocity, _student_t_weight)
    parts += (_strong_tracking, _apply_fuzzy_rules, _adapt) if ready["adaptive"] else ()
    parts += (age_fix_error, move_fix_error, see_fix_error) if model.fix_error else ()
    parts += () if ready["tilted"] else (_measure_fix,)
    ready["measure_heading"] = kernel(_measure_heading, n=ready["n"])
    if unscented:
        ready["_measure_fix"] = measure_fix_unscented
        ready["measure_heading"] = measure_heading_unscented
        ready["measure_lateral"], ready["measure_odometer"] = (
            measure_lateral_unscented,
            measure_odometer_unscented,
        )
    elif ready["tilted"]:
        ready["_measure_fix"] = kernel(measure_fix_tilted, n=ready["n"])
        ready["measure_heading"] = kernel(measure_heading_tilted, n=ready["n"])
        along = {"n": ready["n"], **ALONG["lateral"]}, {"n": ready["n"], **ALONG["odometer"]}
        ready["measure_lateral"], ready["measure_odometer"] = (
            kernel(measure_along_tilted, **known) for known in along
        )
    else:
        for name, bias in (("lateral", model.gyro_bias), ("odometer", model.accel_bias)):
            known = {"n": ready["n"], "bias": -1 if bias is None else bias, "lateral": int(name == "lateral")}
            ready[f"measure_{name}"] = kernel(_measure_along, **known)
    ready["_inflate_observed"] = unrolled(_inflate_observed, **ready)
    for function in parts:
        ready[function.__name__] = kernel(function, **ready)
    public = (
        *(update_fix, forecast_fix, update_velocity, update_standstill),
        *(update_lateral, update_odometer, update_heading),
    )
    return {function.__name__: kernel(function, **ready) for function in public}
