"""The compiled UKF for planar5: many parameter sets (lanes) at once, in closed form.

Everything that is compiled lives in this one file: Numba's cache does not notice when a helper in another
file changes. Read it beside `reference.py`, which says the same in the textbook's words.

**The closed form.** The process is linear in everything but theta: f(s) = A s + B g(theta), with
A: x += vx dt, y += vy dt; B: position += dt^2/2, velocity += dt; g the acceleration turned into the world.
Any square root of P is right for sigma points; take the one with theta first. Then only its first column
(and its mirror image) moves theta, by d = gamma sigma_theta with gamma^2 = n + lambda = alpha^2 (n + kappa),
and all other sigma points share the centre's g0 = g(theta). With g0' = dg/dtheta = g0 turned by 90 degrees,

    g(theta +- d) = g0 cos d +- g0' sin d,        w = 1 / (2 gamma^2) the weight of one sigma point,
    e     = 2 w (cos d - 1) = -(2 / gamma^2) sin^2(d/2)            (no difference of large numbers is left)
    mean of g          = (1 + e) g0
    Cov(s, g)          = (sin d / d) P[:, theta] g0'^T
    Cov(g)             = sin^2(d) / gamma^2  g0' g0'^T  +  (alpha^2 (n + kappa - 1) + beta) e^2  g0 g0^T

and P' = A P A^T + A Cov(s, g) B^T + B Cov(g, s) A^T + B Cov(g) B^T + Q. The position fix is linear in the
state, so its unscented update is the Kalman update exactly.

**Lanes.** Arrays are (row, lane) with LANES parameter sets side by side, so that each loop over lanes becomes
vector instructions. All rows of one run live in one local array: with a single base pointer the compiler can
rule out that writing one row changes another. A failing lane turns to NaN or loses its OK flag; nothing
branches on it, so the other lanes neither wait nor change.
"""

# Numba has types of its own, which a type checker for Python does not know.
# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

import numpy as np
from numba import njit

LANES = 16
"""Parameter sets side by side; a compile-time constant, two AVX-512 or four AVX2 vectors."""

# Rows of the state: the mean, then the upper triangle of the covariance (u, v are the velocities vx, vy).
X, Y, U, V, T = range(5)
XX, XY, XU, XV, XT, YY, YU, YV, YT, UU, UV, UT, VV, VT, TT = range(5, 20)
N_STATE = 20

# Rows of the constants of a parameter set.
GAMMA, INV_GAMMA2, SPREAD, QX, QY, QU, QV, QT, RX, RY = range(10)
N_CONSTANTS = 10

# Rows of the sums that a run returns.
SQ_POSITION, SQ_HEADING, SQ_FIX, NIS, LOG_DET, DET, OK = range(7)
N_SUMS = 7

# Columns of a step, and its flags: what happens at its end.
DT, AX, AY, GZ, Q_SCALE = range(5)
FIX = 1  # a fix is absorbed
IMU = 2  # it is an IMU sample's time: estimates are recorded and scored

# Columns of a target: a moment of truth inside an IMU interval.
WEIGHT, TRUE_X, TRUE_Y, TRUE_THETA, SCORES_HEADING = range(5)

_TWO_PI = 2 * math.pi
_DETERMINANTS_PER_LOG = 8  # their product stays far inside the range of a double

# NaN and inf must keep their meaning, so the flags are named instead of fastmath=True. The check for division
# by zero of error_model="python" would be an early exit, which no vectorized loop may have.
_FLAGS = {"contract", "reassoc", "nsz", "arcp"}


def _inline(function):
    return njit(function, inline="always", error_model="numpy")


@_inline
def _sincos(x):
    """Sine and cosine without branches or library calls.

    The error is about 3e-16 + 4e-17 |x|, below half a unit in the last place of the angle itself. Cody-Waite
    reduction to [-pi/4, pi/4], then the minimax polynomials of fdlibm (k_sin.c, k_cos.c).
    """
    n = math.floor(x * (2 / math.pi) + 0.5)
    r = ((x - n * 1.5707963267341256) - n * 6.077100506303966e-11) - n * 2.0222662487959506e-21
    z = r * r
    sin = r + r * z * (
        -1.66666666666666324348e-01
        + z
        * (
            8.33333333332248946124e-03
            + z
            * (
                -1.98412698298579493134e-04
                + z
                * (
                    2.75573137070700676789e-06
                    + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)
                )
            )
        )
    )
    cos = (
        1.0
        - 0.5 * z
        + z
        * z
        * (
            4.16666666666666019037e-02
            + z
            * (
                -1.38888888888741095749e-03
                + z
                * (
                    2.48015872894767294178e-05
                    + z
                    * (
                        -2.75573143513906633035e-07
                        + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)
                    )
                )
            )
        )
    )
    quadrant = n - 4.0 * math.floor(n * 0.25)
    odd = (quadrant == 1.0) | (quadrant == 3.0)
    s = cos if odd else sin
    c = sin if odd else cos
    s = -s if quadrant >= 2.0 else s
    c = -c if (quadrant == 1.0) | (quadrant == 2.0) else c
    return s, c


@_inline
def _predict(state, constants, dt, ax, ay, gz, q_scale):
    """One step of the process model, in closed form (see the top of this file)."""
    h = 0.5 * dt * dt
    for l in range(LANES):  # noqa: E741
        # The acceleration in the world at the mean heading: g0 = (a0, b0), g0' = (-b0, a0).
        sin_t, cos_t = _sincos(state[T, l])
        a0 = cos_t * ax - sin_t * ay
        b0 = sin_t * ax + cos_t * ay

        # What the two sigma points that move theta by +-d do to mean and spread of the acceleration.
        d = constants[GAMMA, l] * math.sqrt(state[TT, l]) + 1e-300  # never 0/0; no change to any other d
        sin_h, cos_h = _sincos(0.5 * d)
        sin_d = 2.0 * sin_h * cos_h
        e = -2.0 * constants[INV_GAMMA2, l] * sin_h * sin_h
        along = constants[SPREAD, l] * e * e
        across = constants[INV_GAMMA2, l] * sin_d * sin_d
        ga = (1.0 + e) * a0
        gb = (1.0 + e) * b0
        caa = across * b0 * b0 + along * a0 * a0
        cab = (along - across) * a0 * b0
        cbb = across * a0 * a0 + along * b0 * b0
        p = -(sin_d / d) * b0
        q = (sin_d / d) * a0

        state[X, l] += dt * state[U, l] + h * ga
        state[Y, l] += dt * state[V, l] + h * gb
        state[U, l] += dt * ga
        state[V, l] += dt * gb
        state[T, l] += dt * gz

        # A P A^T, the cross terms with (p, q), B Cov(g) B^T, and Q.
        uu, uv, ut = state[UU, l], state[UV, l], state[UT, l]
        vv, vt, tt = state[VV, l], state[VT, l], state[TT, l]
        xu = state[XU, l] + dt * uu
        xv = state[XV, l] + dt * uv
        xt = state[XT, l] + dt * ut
        yu = state[YU, l] + dt * uv
        yv = state[YV, l] + dt * vv
        yt = state[YT, l] + dt * vt
        state[XX, l] += dt * (state[XU, l] + xu) + 2.0 * h * p * xt + h * h * caa + q_scale * constants[QX, l]
        state[XY, l] += dt * (state[XV, l] + yu) + h * (q * xt + p * yt) + h * h * cab
        state[YY, l] += dt * (state[YV, l] + yv) + 2.0 * h * q * yt + h * h * cbb + q_scale * constants[QY, l]
        state[XU, l] = xu + dt * p * xt + h * p * ut + h * dt * caa
        state[XV, l] = xv + dt * q * xt + h * p * vt + h * dt * cab
        state[YU, l] = yu + dt * p * yt + h * q * ut + h * dt * cab
        state[YV, l] = yv + dt * q * yt + h * q * vt + h * dt * cbb
        state[XT, l] = xt + h * p * tt
        state[YT, l] = yt + h * q * tt
        state[UU, l] = uu + 2.0 * dt * p * ut + dt * dt * caa + q_scale * constants[QU, l]
        state[UV, l] = uv + dt * (q * ut + p * vt) + dt * dt * cab
        state[VV, l] = vv + 2.0 * dt * q * vt + dt * dt * cbb + q_scale * constants[QV, l]
        state[UT, l] = ut + dt * p * tt
        state[VT, l] = vt + dt * q * tt
        state[TT, l] = tt + q_scale * constants[QT, l]


@_inline
def _absorb(state, constants, sums, zx, zy):
    """The Kalman update with a position fix.

    The position's rows of P - K S K^T equal K R; so written, nothing large is subtracted.
    """
    for l in range(LANES):  # noqa: E741
        rx, ry = constants[RX, l], constants[RY, l]
        xx, xy, yy = state[XX, l], state[XY, l], state[YY, l]
        sxx, syy = xx + rx, yy + ry
        det = sxx * syy - xy * xy
        ixx, ixy, iyy = syy / det, -xy / det, sxx / det  # S^-1
        nx = zx - state[X, l]
        ny = zy - state[Y, l]
        ex = ixx * nx + ixy * ny  # S^-1 nu
        ey = ixy * nx + iyy * ny
        sums[NIS, l] += nx * ex + ny * ey
        sums[DET, l] *= det
        sums[SQ_FIX, l] += (rx * ex) ** 2 + (
            ry * ey
        ) ** 2  # the residual z - H x after the update is R S^-1 nu

        xu, yu, xv, yv, xt, yt = (
            state[XU, l],
            state[YU, l],
            state[XV, l],
            state[YV, l],
            state[XT, l],
            state[YT, l],
        )
        state[X, l] += xx * ex + xy * ey
        state[Y, l] += xy * ex + yy * ey
        state[U, l] += xu * ex + yu * ey
        state[V, l] += xv * ex + yv * ey
        state[T, l] += xt * ex + yt * ey

        kux, kuy = xu * ixx + yu * ixy, xu * ixy + yu * iyy  # rows of the gain
        kvx, kvy = xv * ixx + yv * ixy, xv * ixy + yv * iyy
        ktx, kty = xt * ixx + yt * ixy, xt * ixy + yt * iyy
        new_xx = (xx * ixx + xy * ixy) * rx
        new_xy = (xx * ixy + xy * iyy) * ry
        new_yy = (xy * ixy + yy * iyy) * ry
        uu = state[UU, l] - kux * xu - kuy * yu
        uv = state[UV, l] - kux * xv - kuy * yv
        ut = state[UT, l] - kux * xt - kuy * yt
        vv = state[VV, l] - kvx * xv - kvy * yv
        vt = state[VT, l] - kvx * xt - kvy * yt
        tt = state[TT, l] - ktx * xt - kty * yt
        state[XX, l], state[XY, l], state[YY, l] = new_xx, new_xy, new_yy
        state[XU, l], state[YU, l] = kux * rx, kuy * ry
        state[XV, l], state[YV, l] = kvx * rx, kvy * ry
        state[XT, l], state[YT, l] = ktx * rx, kty * ry
        state[UU, l], state[UV, l], state[UT, l] = uu, uv, ut
        state[VV, l], state[VT, l], state[TT, l] = vv, vt, tt

        # With R > 0 the posterior is positive definite just if the prior is; in exact arithmetic it can be
        # read off S and the pivots of what remains. A NaN fails every comparison.
        pivot = vv - uv * uv / uu
        rest = vt - uv * ut / uu
        last = tt - ut * ut / uu - rest * rest / pivot
        good = (
            (sxx > 0.0)
            & (det > 0.0)
            & (xx > 0.0)
            & (yy > 0.0)
            & (xx * yy - xy * xy > 0.0)
            & (rx > 0.0)
            & (ry > 0.0)
            & (uu > 0.0)
            & (pivot > 0.0)
            & (last > 0.0)
        )
        sums[OK, l] = sums[OK, l] if good else 0.0


@_inline
def _take_logarithm(sums):
    """Move the product of the last det S into the sum of their logarithms (a slow call: once in a while)."""
    for l in range(LANES):  # noqa: E741
        sums[LOG_DET, l] += math.log(sums[DET, l])
        sums[DET, l] = 1.0


@_inline
def _score(state, sums, before, weight, true_x, true_y, true_theta, scores_heading):
    """Add the squared errors at a moment of truth; the estimate is linear between two IMU samples."""
    for l in range(LANES):  # noqa: E741
        x = before[0, l] + weight * (state[X, l] - before[0, l])
        y = before[1, l] + weight * (state[Y, l] - before[1, l])
        turn = state[T, l] - before[2, l]
        turn -= _TWO_PI * math.floor(turn / _TWO_PI + 0.5)
        wrong = before[2, l] + weight * turn - true_theta
        wrong -= _TWO_PI * math.floor(wrong / _TWO_PI + 0.5)
        sums[SQ_POSITION, l] += (x - true_x) ** 2 + (y - true_y) ** 2
        sums[SQ_HEADING, l] += scores_heading * wrong * wrong


@njit(error_model="numpy", fastmath=_FLAGS, nogil=True, cache=True)
def run_lanes(steps, flags, fixes, targets, target_end, initial, constants, sums_out, final_out, record):
    """Run LANES filters over one time line.

    Parameters
    ----------
    steps : (k, 5) dt (s), ax, ay (m/s2), gz (rad/s), and the scale of Q, of each step
    flags : (k,) int64, FIX and IMU bits of each step
    fixes : (f, 2) m east, north, in the order in which steps absorb them
    targets : (m, 5) see WEIGHT ... SCORES_HEADING
    target_end : (k,) int64, how many targets lie before the end of each step (constant where flags lack IMU)
    initial : (N_STATE, LANES)
    constants : (N_CONSTANTS, LANES)
    sums_out : (N_SUMS, LANES), written
    final_out : (N_STATE, LANES), written: the state at the end
    record : (n, N_STATE + 1, r), written: state and OK flag of the first r lanes at each IMU sample; n = 0: none
    """
    work = np.empty((N_STATE + N_CONSTANTS + N_SUMS + 3, LANES))
    state = work[:N_STATE]
    const = work[N_STATE : N_STATE + N_CONSTANTS]
    sums = work[N_STATE + N_CONSTANTS : N_STATE + N_CONSTANTS + N_SUMS]
    before = work[N_STATE + N_CONSTANTS + N_SUMS :]
    for l in range(LANES):  # noqa: E741
        for row in range(N_STATE):
            state[row, l] = initial[row, l]
        for row in range(N_CONSTANTS):
            const[row, l] = constants[row, l]
        for row in range(N_SUMS):
            sums[row, l] = 0.0
        sums[DET, l] = 1.0
        # With Q >= 0 and R > 0 nothing but rounding can make P indefinite; a NaN fails every comparison.
        good = (const[RX, l] > 0.0) & (const[RY, l] > 0.0)
        for row in range(QX, QT + 1):
            good &= const[row, l] >= 0.0
        sums[OK, l] = 1.0 if good else 0.0

    n_fixes = 0
    n_targets = 0
    n_recorded = 0
    interval_starts = True
    for k in range(steps.shape[0]):
        if interval_starts:
            for l in range(LANES):  # noqa: E741
                before[0, l] = state[X, l]
                before[1, l] = state[Y, l]
                before[2, l] = state[T, l]
        _predict(state, const, steps[k, DT], steps[k, AX], steps[k, AY], steps[k, GZ], steps[k, Q_SCALE])
        if flags[k] & FIX:
            _absorb(state, const, sums, fixes[n_fixes, 0], fixes[n_fixes, 1])
            n_fixes += 1
            if n_fixes % _DETERMINANTS_PER_LOG == 0:
                _take_logarithm(sums)
        interval_starts = (flags[k] & IMU) != 0
        while n_targets < target_end[k]:
            t = targets[n_targets]
            _score(state, sums, before, t[WEIGHT], t[TRUE_X], t[TRUE_Y], t[TRUE_THETA], t[SCORES_HEADING])
            n_targets += 1
        if interval_starts and record.shape[0] > 0:
            for row in range(N_STATE):
                for l in range(record.shape[2]):  # noqa: E741
                    record[n_recorded, row, l] = state[row, l]
            for l in range(record.shape[2]):  # noqa: E741
                record[n_recorded, N_STATE, l] = sums[OK, l]
            n_recorded += 1

    _take_logarithm(sums)
    for l in range(LANES):  # noqa: E741
        total = 0.0
        for row in range(N_STATE):
            final_out[row, l] = state[row, l]
            total += state[row, l]
        for row in range(N_SUMS):
            sums_out[row, l] = sums[row, l]
        # Between fixes nothing looks at P; a variance that went negative since the last one shows here.
        least = min(state[XX, l], state[YY, l], state[UU, l], state[VV, l], state[TT, l])
        # Not math.isfinite: Numba writes it as x - x == x - x, which "reassoc" folds to true.
        if not abs(total) < math.inf or not least > 0.0:
            sums_out[OK, l] = 0.0
