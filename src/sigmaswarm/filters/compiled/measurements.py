"""Updates of the compiled filter with fixes; `vehicle` contains the other updates.

For each measurement, a kernel computes nu, S and C = Cov(state, z) in every lane. Then `update_pair` or `update_scalar`
computes x += C S^-1 nu and P -= C S^-1 C^T. In an unscented filter, nu, S and C are moments of sigma points. If z is
linear in the state, these moments equal those of the Kalman filter. If z contains a vector rotated by the heading, the
moments have a closed form, as in planar5.py and planar8.py.
"""

import math

from sigmaswarm.drives.timeline import FIX_VAR_X, FIX_VAR_Y, FIX_X, FIX_Y
from sigmaswarm.filters.compiled.adaptive import (
    adapt,
    age_fix_error,
    apply_fuzzy_rules,
    inflate_observed,
    move_fix_error,
    observe_fix_error,
    strong_tracking,
    student_t_weight,
)
from sigmaswarm.filters.compiled.lanes import kernel, sincos, spread_of
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, SLOPE, P, R
from sigmaswarm.filters.compiled.tilted12 import TILTED_MEASUREMENTS
from sigmaswarm.filters.compiled.tilted12_unscented import UNSCENTED_MEASUREMENTS
from sigmaswarm.filters.compiled.unroll import unrolled
from sigmaswarm.filters.compiled.vehicle import (
    measure_along_planar,
    measure_heading_planar,
    take_velocity,
    update_heading,
    update_lateral,
    update_odometer,
    update_pair,
    update_scalar,
    update_standstill,
    update_velocity,
)
from sigmaswarm.filters.constants import (
    FORECAST_DOF,
    FORECAST_SCALE,
    INNOVATION_SCALE,
    LARGEST_TAIL,
    MOST_REJECTED,
)
from sigmaswarm.filters.kernels import FILTERS, UNSCENTED


def update_fix(w, z, lever, since, *, stores_innovation, gated, adaptive, fix_error, note_prior):
    """Update with a position fix of the antenna.

    ``z`` is a row of `Timeline.fixes`; ``since`` is the time since the last fix, in nominal steps. Parts that no lane
    uses are skipped.
    """
    fading, adapting, fuzzy, robust = 0, 0, 0, 0
    for l in range(LANES):
        fading += w.FADING >= 0.0
        adapting += w.FORGETTING < 1.0
        fuzzy += w.FUZZY >= 0.0
        robust += w.DOF > 0.0
    if fix_error:
        age_fix_error(w, z, since)
        move_fix_error(w)
    _measure_fix(w, z, lever)
    if fix_error:
        observe_fix_error(w)
    if stores_innovation:
        for l in range(LANES):
            nis = add_likelihood(w, l)
            if gated:
                inside = (nis <= w.GATE) | (w.REJECTED >= MOST_REJECTED)
                w.USE = 1.0 if inside else 0.0
                w.REJECTED = 0.0 if inside else w.REJECTED + 1.0
    if adaptive and fading > 0:
        strong_tracking(w)
    if adaptive and fuzzy > 0:
        apply_fuzzy_rules(w)
    if robust > 0:
        student_t_weight(w, since)
    if note_prior:  # P may have been inflated
        note_prior(w)
    for l in range(LANES):
        rx, ry, use = w.R1, w.R2, w.USE
        s11, s12, s22 = w.S11 + rx, w.S12, w.S22 + ry
        det = s11 * s22 - s12 * s12
        g11, g12, g22 = s22 / det, -s12 / det, s11 / det
        n1, n2 = w.N1, w.N2
        e1, e2 = g11 * n1 + g12 * n2, g12 * n1 + g22 * n2
        w.OK = w.OK if (s11 > 0.0) & (det > 0.0) & (rx > 0.0) & (ry > 0.0) else 0.0
        w.G11, w.G12, w.G22 = use * g11, use * g12, use * g22
        r1, r2 = (rx * e1 if use > 0.0 else n1), (ry * e2 if use > 0.0 else n2)
        # The residual after an update is R S^-1 nu; after a rejection it is nu.
        w.SQ_FIX += r1 * r1 + r2 * r2
        w.GEE += rx
        w.GNN += ry
    if adaptive and adapting > 0:
        adapt(w, since)
    update_pair(w)
    _keep_digits(w)


def forecast_fix(w, z, lever, since, *, n, fix_error):
    """Score the prediction of a hidden fix, without an update."""
    _measure_fix(w, z, lever)
    if fix_error:
        age_fix_error(w, z, since)
        observe_fix_error(w)
    for l in range(LANES):
        add_forecast(w, l)


@kernel
def add_forecast(w, l):
    """Add the squared innovation of a hidden fix, and its likelihoods, to the sums."""
    nis = add_likelihood(w, l)
    w.SQ_FORECAST += w.N1 * w.N1 + w.N2 * w.N2
    det = w.V11 * w.V22 - w.V12 * w.V12
    tail = math.log(1.0 + nis * (1.0 / FORECAST_SCALE))
    w.FORECAST_T += 0.5 * math.log(det) + 0.5 * (FORECAST_DOF + 2.0) * tail


@kernel
def add_likelihood(w, l):
    """Add the NIS and the likelihood of a fix to the sums, before the update. Return the NIS.

    The kernel of `run` adds the logarithms of DET and TAIL to the sums.
    """
    s11, s12, s22 = w.S11 + w.R1, w.S12, w.S22 + w.R2
    det = s11 * s22 - s12 * s12
    n1, n2 = w.N1, w.N2
    nis = (s22 * n1 * n1 - 2.0 * s12 * n1 * n2 + s11 * n2 * n2) / det
    w.V11, w.V12, w.V22 = s11, s12, s22
    w.NU1, w.NU2 = n1, n2
    w.NIS += nis
    w.DET *= det
    tail = 1.0 + nis * (1.0 / INNOVATION_SCALE)
    w.TAIL *= tail if tail < LARGEST_TAIL else LARGEST_TAIL
    return nis


def _measure_fix(w, z, lever, *, n):
    """Compute nu, H P H^T, C and R of z = p + arm - latency v, where arm is the rotated lever arm.

    The moments of arm have the closed form of planar5.
    """
    zx, zy, var_x, var_y = z[FIX_X], z[FIX_Y], z[FIX_VAR_X], z[FIX_VAR_Y]
    lever_x, lever_y = lever[0], lever[1]
    for l in range(LANES):
        w.R1 = w.RX + w.ACCURACY * var_x
        w.R2 = w.RY + w.ACCURACY * var_y
        for row in (R.EAST, R.NORTH, R.JEAST, R.JNORTH, R.E):
            w[row] = 0.0
    if lever_x != 0.0 or lever_y != 0.0:
        _turn_lever(w, lever_x, lever_y)
    for l in range(LANES):
        tau, east, north, e = w.LATENCY, w.EAST, w.NORTH, w.E
        je, jn = w.JEAST, w.JNORTH
        along = w.SPREAD * e * e
        w.GEE, w.GEN, w.GNN = along * east * east, along * east * north, along * north * north
        w.N1 = zx - (w.X - tau * w.U + (1.0 + e) * east)
        w.N2 = zy - (w.Y - tau * w.V + (1.0 + e) * north)
        for i in range(n):
            C1[i] = P[i, R.X] - tau * P[i, R.U] + je * P[i, R.T]
            C2[i] = P[i, R.Y] - tau * P[i, R.V] + jn * P[i, R.T]
        w.S11 = w.C1_X - tau * w.C1_U + je * w.C1_T + w.GEE
        w.S12 = w.C1_Y - tau * w.C1_V + jn * w.C1_T + w.GEN
        w.S22 = w.C2_Y - tau * w.C2_V + jn * w.C2_T + w.GNN


@kernel
def _turn_lever(w, lever_x, lever_y):
    """Compute the rotated lever arm, its derivative with respect to theta times k, and e.

    `planar5` defines k and e.
    """
    for l in range(LANES):
        sin_t, cos_t = sincos(w.T)
        east, north = cos_t * lever_x - sin_t * lever_y, sin_t * lever_x + cos_t * lever_y
        _, k, quarter_sin2 = spread_of(w.QUARTER_GAMMA, w.TT)
        w.EAST, w.NORTH, w.E = east, north, w.SHORTENS * quarter_sin2
        w.JEAST, w.JNORTH = -k * north, k * east


def _keep_digits(w, *, n, tilted, unscented, fix_error):
    """Recompute the position's variances and covariances from P+ H^T = C S^-1 R, which avoids cancellation.

    P - C S^-1 C^T loses nine digits of a variance that a fix reduces by a factor of a billion. H is 1 for the position
    and for the correlated fix error, -latency for the velocity, and k J arm for the heading (`planar5` defines k and
    J). R includes the second-order terms of S.
    """
    for l in range(LANES):
        used = w.G11 != 0.0
        if unscented == 0:
            tau, je, jn = w.LATENCY, w.JEAST, w.JNORTH
        else:
            tau, je, jn = w.LATENCY, SLOPE[0, 0], SLOPE[0, 1]
        r1, r12, r2 = w.GEE, w.GEN, w.GNN
        # The position comes last, since its elements depend on its new covariances with the other states.
        for j in (*range(2, n), 0, 1):
            gain_1 = C1[j] * w.G11 + C2[j] * w.G12
            gain_2 = C1[j] * w.G12 + C2[j] * w.G22
            x = gain_1 * r1 + gain_2 * r12 + tau * P[j, R.U] - je * P[j, R.T]
            y = gain_1 * r12 + gain_2 * r2 + tau * P[j, R.V] - jn * P[j, R.T]
            if unscented:
                x -= SLOPE[1, 0] * P[j, R.I] + SLOPE[2, 0] * P[j, R.J]
                y -= SLOPE[1, 1] * P[j, R.I] + SLOPE[2, 1] * P[j, R.J]
            elif tilted:
                x -= w.LEVER_UP * P[j, R.J]
                y += w.LEVER_UP * P[j, R.I]
            if fix_error:
                x -= P[j, n - 2]
                y -= P[j, n - 1]
            if j != R.Y:
                P[j, R.X] = x if used else P[j, R.X]
            P[j, R.Y] = y if used else P[j, R.Y]


UPDATES = (
    update_fix,
    forecast_fix,
    update_velocity,
    update_standstill,
    update_lateral,
    update_odometer,
    update_heading,
)


def measurement_kernels(name: str, note_prior=None, noted=0):
    """Return the functions in `UPDATES` as kernels for the filter ``name``: a dict by function name.

    For ``note_prior`` see `transition`, for ``noted`` see `move_fix_error`.
    """
    model, n, unscented = FILTERS[name], len(FILTERS[name].states), int(name == UNSCENTED)
    ready = {
        "note_prior": note_prior,
        "n": n,
        "stores_innovation": 1,
        "gated": 1,
        "gyro_biases": tuple(model.gyro_axes.values()),
        "adaptive": int(name in ("planar5", "planar8", UNSCENTED)),
        "tilted": int(model.tilts),
        "unscented": unscented,
        "fix_error": int(model.fix_error),
        "noted": noted,
    }
    parts = (update_scalar, update_pair, _keep_digits, take_velocity, student_t_weight)
    parts += (strong_tracking, apply_fuzzy_rules, adapt) if ready["adaptive"] else ()
    parts += (age_fix_error, move_fix_error, observe_fix_error) if model.fix_error else ()
    if unscented:
        ready |= UNSCENTED_MEASUREMENTS
    else:
        planar = _measure_fix, measure_heading_planar, measure_along_planar
        fix, heading, along = TILTED_MEASUREMENTS if model.tilts else planar
        ready["_measure_fix"], ready["measure_heading"] = kernel(fix, n=n), kernel(heading, n=n)
        for what, lateral, bias in (("measure_lateral", 1, R.W), ("measure_odometer", 0, R.A)):
            ready[what] = kernel(along, n=n, lateral=lateral, bias=bias if model.sensors else -1)
    ready["inflate_observed"] = unrolled(inflate_observed, **ready)
    for function in parts:
        ready[function.__name__] = kernel(function, **ready)
    return {function.__name__: kernel(function, **ready) for function in UPDATES}
