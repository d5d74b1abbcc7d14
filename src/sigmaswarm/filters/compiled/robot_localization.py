"""The extended Kalman filter of robot_localization in ``two_d_mode``.

`models.robot_localization` contains the equations. The eight states are in planar8's rows: x, y, vx, vy (body), yaw,
ax, ay (body), yaw rate. F is a product of elementary matrices, one for each row of F that differs from the identity. R
is diagonal, so sequential updates with single states equal the joint update.
"""

import math

import numpy as np

from sigmaswarm.drives.events import FIX, HEADING, HIDDEN, IMU, LATERAL, ODOMETER, STANDSTILL
from sigmaswarm.drives.odometer import WHEEL_SPEED
from sigmaswarm.drives.timeline import (
    AX,
    AY,
    DT,
    FIX_THETA,
    FIX_VAR_THETA,
    FIX_VAR_X,
    FIX_VAR_Y,
    FIX_X,
    FIX_Y,
    GZ,
    Q_SCALE,
)
from sigmaswarm.filters.compiled.lanes import kernel, sincos
from sigmaswarm.filters.compiled.layout import LANES, P, Q, R
from sigmaswarm.filters.compiled.measurements import add_forecast, add_likelihood
from sigmaswarm.filters.compiled.unroll import Generated

USES_VY, USES_AY = LATERAL, STANDSTILL
"""Bits of a step: update with vy = 0 from a twist message, and update with the IMU's ay."""
R_GZ, R_AX, R_AY, R_VY = R.R_RATE, R.R_VELOCITY, R.R_STANDSTILL, R.R_LATERAL
GATE_GZ, GATE_AX = R.REAR_AXLE, R.TIRE_SLIP
"""Rows of the NIS limits of gz and ax; the rows are named after constants that this model does not have."""
_TWO_PI = 2 * math.pi


def _wrap(angle):
    return angle - _TWO_PI * np.floor(angle * (1 / _TWO_PI) + 0.5)


@kernel
def _predict(w, d, q):
    """Compute a step of ``d`` s by the equations of `models.robot_localization`; ``q`` Q is added to F P F^T."""
    h = 0.5 * d
    for l in range(LANES):
        s, c = sincos(w.T)
        a, b = d * (w.U + h * w.A), d * (w.V + h * w.B)
        east, north = c * a - s * b, s * a + c * b
        cd, sd = c * d, s * d
        ch, sh = cd * h, sd * h
        w.X += east
        w.Y += north
        w.U += d * w.A
        w.V += d * w.B
        w.T = _wrap(w.T + d * w.W)
        before = cd * w.XU - sd * w.XV + ch * w.XA - sh * w.XB
        before = before - north * w.XT
        for k in range(1, 8):
            moved = cd * P[R.U, k] - sd * P[R.V, k] - north * P[R.T, k]
            P[R.X, k] += moved + (ch * P[R.A, k] - sh * P[R.B, k])
        after = cd * w.XU - sd * w.XV + ch * w.XA - sh * w.XB
        w.XX += before + (after - north * w.XT) + q * w.Q_X
        before = sd * w.YU + cd * w.YV + sh * w.YA + ch * w.YB
        before = before + east * w.YT
        for k in (0, 2, 3, 4, 5, 6, 7):
            moved = sd * P[R.U, k] + cd * P[R.V, k] + east * P[R.T, k]
            P[R.Y, k] += moved + (sh * P[R.A, k] + ch * P[R.B, k])
        after = sd * w.YU + cd * w.YV + sh * w.YA + ch * w.YB
        w.YY += before + (after + east * w.YT) + q * w.Q_Y
    for l in range(LANES):
        for i in (R.T, R.U, R.V):  # yaw by its rate, vx by ax, vy by ay
            old = P[i, RATES[i]]
            for k in range(8):
                if k != i:
                    P[i, k] += d * P[RATES[i], k]
            P[i, i] += d * (old + P[i, RATES[i]]) + q * Q[i]
        for i in (R.A, R.B, R.W):
            P[i, i] += q * Q[i]


RATES = {R.T: R.W, R.U: R.A, R.V: R.B}


def _correct(w, l, off, r, use, *, state):
    """Update with a measurement of one state: x += K nu, P -= p p^T / S; the state's column of P, p, becomes p R / S.

    ``off`` is nu and ``r`` is R. ``use`` is 0 if the measurement is rejected, otherwise 1.
    """
    one = use / (P[state, state] + r)
    nu = one * off
    for k in range(8):
        w[k] += P[k, state] * nu
    w.T = _wrap(w.T)
    for i in range(8):
        if i != state:
            gain = one * P[i, state]
            for k in range(i + 1):
                if k != state:
                    P[i, k] = P[i, k] - gain * P[k, state]
    left = one * r if use > 0.0 else 1.0
    for k in range(8):
        P[k, state] = P[k, state] * left


def _update(w, z, *, state, noise, gate, correct):
    """Update with a measurement of one state. ``gate`` is the row of the smallest rejected NIS, or 0 without a gate."""
    for l in range(LANES):
        r, use, off = w[noise], 1.0, z - w[state]
        if state == R.T:
            off = _wrap(off)
        if gate:
            use = 1.0 if off * off < w[gate] * (P[state, state] + r) else 0.0
        correct(w, l, off, r, use)


def _updated(state, noise, gate=0):
    return kernel(_update, state=state, noise=noise, gate=gate, correct=Generated(_correct, state=state))


_update_gz, _update_ax, _update_ay = (
    _updated(R.W, R_GZ, GATE_GZ),
    _updated(R.A, R_AX, GATE_AX),
    _updated(R.B, R_AY),
)
_update_vx, _update_vy, _update_yaw = _updated(R.U, R.R_ODOMETER), _updated(R.V, R_VY), _updated(R.T, R.R1)


@kernel
def _measure_fix(w, x, y, var_x, var_y, forward, left):
    """Compute nu, H P H^T and R of a fix. The antenna is ``forward`` and ``left`` of the IMU, m."""
    for l in range(LANES):
        s, c = sincos(w.T)
        w.N1 = x - (c * forward - s * left) - w.X
        w.N2 = y - (s * forward + c * left) - w.Y
        w.C1_X, w.C1_Y = w.X, w.Y
        w.S11, w.S12, w.S22 = w.XX, w.XY, w.YY
        w.R1 = w.RX + w.ACCURACY * var_x
        w.R2 = w.RY + w.ACCURACY * var_y


@kernel
def _check_fix(w):
    """Add the likelihood of a fix to the sums; reject the fix if its NIS is not below GATE, the squared threshold."""
    for l in range(LANES):
        nis = add_likelihood(w, l)
        det = w.V11 * w.V22 - w.V12 * w.V12
        w.OK = w.OK if (det > 0.0) & (w.V11 > 0.0) else 0.0
        w.USE = 1.0 if nis < w.GATE else 0.0


BEFORE = {R.X: R.C1_X, R.Y: R.C1_Y}


def _update_axis(w, *, state, noise, innovation, correct):
    """Update with one axis of a fix in the lanes that accept the fix."""
    for l in range(LANES):
        off = w[innovation] - (w[state] - w[BEFORE[state]])
        correct(w, l, off, w[noise], w.USE)


_update_x, _update_y = (
    kernel(_update_axis, state=i, noise=noise, innovation=nu, correct=Generated(_correct, state=i))
    for i, noise, nu in ((R.X, R.R1, R.N1), (R.Y, R.R2, R.N2))
)


@kernel
def _add_residual(w):
    for l in range(LANES):
        e = w.N1 - (w.X - w.C1_X)
        n = w.N2 - (w.Y - w.C1_Y)
        w.SQ_FIX += e * e + n * n


@kernel
def _add_forecast(w):
    for l in range(LANES):
        add_forecast(w, l)


@kernel
def _update_heading(w, theta, stated):
    for l in range(LANES):
        w.R1 = w.R_HEADING + stated
    _update_yaw(w, theta)


@kernel
def step(w, u, events, z, wheels, lever, since):
    """Predict to the end of a step; update with the IMU sample, the odometer and the fix."""
    d, gz, ax, ay = u[DT], u[GZ], u[AX], u[AY]
    if d > 0.0:
        _predict(w, d, u[Q_SCALE])
    if events & IMU:
        _update_gz(w, gz)
        _update_ax(w, ax)
        if events & USES_AY:
            _update_ay(w, ay)
        if events & USES_VY:
            _update_vy(w, 0.0)
    if events & ODOMETER:
        _update_vx(w, wheels[WHEEL_SPEED])
    if events & (FIX | HIDDEN):
        x, y, var_x, var_y = z[FIX_X], z[FIX_Y], z[FIX_VAR_X], z[FIX_VAR_Y]
        _measure_fix(w, x, y, var_x, var_y, lever[0], lever[1])
        if events & FIX:
            _check_fix(w)
            _update_x(w)
            _update_y(w)
            _add_residual(w)
            if events & HEADING:
                _update_heading(w, z[FIX_THETA], z[FIX_VAR_THETA])
        else:
            _add_forecast(w)
