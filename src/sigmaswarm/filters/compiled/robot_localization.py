"""The extended filter of robot_localization in ``two_d_mode``.

`models.robot_localization` contains the equations. The eight states are in planar8's rows: x, y, vx, vy (body), yaw,
ax, ay (body), yaw rate. F is a product of elementary matrices, one for each row of F that differs from the identity. R
is diagonal, so sequential updates with single states equal the joint update.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

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
from sigmaswarm.filters.compiled.layout import LANES, Q0, R, at
from sigmaswarm.filters.compiled.measurements import _add_likelihood, add_forecast
from sigmaswarm.filters.compiled.unroll import unrolled

USES_VY, USES_AY = LATERAL, STANDSTILL
"""Bits of a step: update with vy = 0 of a twist, and with the IMU's ay."""
R_GZ, R_AX, R_AY, R_VY = R.R_RATE, R.R_VELOCITY, R.R_STANDSTILL, R.R_LATERAL
GATE_GZ, GATE_AX = R.REAR_AXLE, R.TIRE_SLIP
"""Rows of the NIS from which gz and ax are rejected; this model has neither rear axle nor tire slip."""
_TWO_PI = 2 * math.pi


def _wrap(angle):
    return angle - _TWO_PI * np.floor(angle * (1 / _TWO_PI) + 0.5)


@kernel
def _predict(w, d, q):
    """Compute a step of ``d`` s by the equations of `models.robot_localization`; ``q`` Q is added to F P F^T."""
    h = 0.5 * d
    for l in range(LANES):
        s, c = sincos(w[R.T, l])
        a, b = d * (w[R.U, l] + h * w[R.A, l]), d * (w[R.V, l] + h * w[R.B, l])
        east, north = c * a - s * b, s * a + c * b
        cd, sd = c * d, s * d
        ch, sh = cd * h, sd * h
        w[R.X, l] += east
        w[R.Y, l] += north
        w[R.U, l] += d * w[R.A, l]
        w[R.V, l] += d * w[R.B, l]
        w[R.T, l] = _wrap(w[R.T, l] + d * w[R.W, l])
        before = cd * w[R.XU, l] - sd * w[R.XV, l] + ch * w[at(R.X, R.A), l] - sh * w[at(R.X, R.B), l]
        before = before - north * w[R.XT, l]
        for k in range(1, 8):
            moved = cd * w[at(R.U, k), l] - sd * w[at(R.V, k), l] - north * w[at(R.T, k), l]
            w[at(R.X, k), l] += moved + (ch * w[at(R.A, k), l] - sh * w[at(R.B, k), l])
        after = cd * w[R.XU, l] - sd * w[R.XV, l] + ch * w[at(R.X, R.A), l] - sh * w[at(R.X, R.B), l]
        w[R.XX, l] += before + (after - north * w[R.XT, l]) + q * w[Q0 + R.X, l]
        before = sd * w[R.YU, l] + cd * w[R.YV, l] + sh * w[at(R.Y, R.A), l] + ch * w[at(R.Y, R.B), l]
        before = before + east * w[R.YT, l]
        for k in (0, 2, 3, 4, 5, 6, 7):
            moved = sd * w[at(R.U, k), l] + cd * w[at(R.V, k), l] + east * w[at(R.T, k), l]
            w[at(R.Y, k), l] += moved + (sh * w[at(R.A, k), l] + ch * w[at(R.B, k), l])
        after = sd * w[R.YU, l] + cd * w[R.YV, l] + sh * w[at(R.Y, R.A), l] + ch * w[at(R.Y, R.B), l]
        w[R.YY, l] += before + (after + east * w[R.YT, l]) + q * w[Q0 + R.Y, l]
    for l in range(LANES):
        for i in (R.T, R.U, R.V):  # yaw by its rate, vx by ax, vy by ay
            old = w[at(i, RATES[i]), l]
            for k in range(8):
                if k != i:
                    w[at(i, k), l] += d * w[at(RATES[i], k), l]
            w[at(i, i), l] += d * (old + w[at(i, RATES[i]), l]) + q * w[Q0 + i, l]
        for i in (R.A, R.B, R.W):
            w[at(i, i), l] += q * w[Q0 + i, l]


RATES = {R.T: R.W, R.U: R.A, R.V: R.B}


def _correct(w, l, off, r, use, *, state):
    """Update with a measurement of one state: x += K nu, P -= p p^T / S; the state's column of P, p, becomes p R / S.

    ``off``: nu; ``r``: R; ``use``: 0 if the measurement is rejected, else 1.
    """
    one = use / (w[at(state, state), l] + r)
    nu = one * off
    for k in range(8):
        w[k, l] += w[at(k, state), l] * nu
    w[R.T, l] = _wrap(w[R.T, l])
    for i in range(8):
        if i != state:
            gain = one * w[at(i, state), l]
            for k in range(i + 1):
                if k != state:
                    w[at(i, k), l] = w[at(i, k), l] - gain * w[at(k, state), l]
    left = one * r if use > 0.0 else 1.0
    for k in range(8):
        w[at(k, state), l] = w[at(k, state), l] * left


def _update(w, z, *, state, noise, gate, correct):
    """Update with a measurement of one state; ``gate``: row of the NIS from which measurements are rejected, or 0."""
    for l in range(LANES):
        r, use, off = w[noise, l], 1.0, z - w[state, l]
        if state == R.T:
            off = _wrap(off)
        if gate:
            use = 1.0 if off * off < w[gate, l] * (w[at(state, state), l] + r) else 0.0
        correct(w, l, off, r, use)


def _updated(state, noise, gate=0):
    return kernel(_update, state=state, noise=noise, gate=gate, correct=unrolled(_correct, state=state))


_update_gz, _update_ax, _update_ay = (
    _updated(R.W, R_GZ, GATE_GZ),
    _updated(R.A, R_AX, GATE_AX),
    _updated(R.B, R_AY),
)
_update_vx, _update_vy, _update_yaw = _updated(R.U, R.R_ODOMETER), _updated(R.V, R_VY), _updated(R.T, R.R1)


@kernel
def _measure_fix(w, x, y, var_x, var_y, forward, left):
    """Compute nu, H P H^T and R of a fix; the antenna is ``forward`` and ``left`` of the IMU, m."""
    for l in range(LANES):
        s, c = sincos(w[R.T, l])
        w[R.N1, l] = x - (c * forward - s * left) - w[R.X, l]
        w[R.N2, l] = y - (s * forward + c * left) - w[R.Y, l]
        w[R.C1_X, l], w[R.C1_Y, l] = w[R.X, l], w[R.Y, l]
        w[R.S11, l], w[R.S12, l], w[R.S22, l] = w[R.XX, l], w[R.XY, l], w[R.YY, l]
        w[R.R1, l] = w[R.RX, l] + w[R.ACCURACY, l] * var_x
        w[R.R2, l] = w[R.RY, l] + w[R.ACCURACY, l] * var_y


@kernel
def _check_fix(w):
    """Add the likelihood of a fix to the sums; reject the fix if its NIS is not below GATE, the squared threshold."""
    for l in range(LANES):
        nis = _add_likelihood(w, l)
        det = w[R.V11, l] * w[R.V22, l] - w[R.V12, l] * w[R.V12, l]
        w[R.OK, l] = w[R.OK, l] if (det > 0.0) & (w[R.V11, l] > 0.0) else 0.0
        w[R.USE, l] = 1.0 if nis < w[R.GATE, l] else 0.0


BEFORE = {R.X: R.C1_X, R.Y: R.C1_Y}


def _update_axis(w, *, state, noise, innovation, correct):
    """Update with one axis of a fix in the lanes that accept the fix."""
    for l in range(LANES):
        off = w[innovation, l] - (w[state, l] - w[BEFORE[state], l])
        correct(w, l, off, w[noise, l], w[R.USE, l])


_update_x, _update_y = (
    kernel(_update_axis, state=i, noise=noise, innovation=nu, correct=unrolled(_correct, state=i))
    for i, noise, nu in ((R.X, R.R1, R.N1), (R.Y, R.R2, R.N2))
)


@kernel
def _add_residual(w):
    for l in range(LANES):
        e = w[R.N1, l] - (w[R.X, l] - w[R.C1_X, l])
        n = w[R.N2, l] - (w[R.Y, l] - w[R.C1_Y, l])
        w[R.SQ_FIX, l] += e * e + n * n


@kernel
def _add_forecast(w):
    for l in range(LANES):
        add_forecast(w, l)


@kernel
def _update_heading(w, theta, stated):
    for l in range(LANES):
        w[R.R1, l] = w[R.R_HEADING, l] + stated
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
