"""Updates with velocity, heading and odometer, and with the motion constraints of a wheeled vehicle."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

import numpy as np

from sigmaswarm.drives.odometer import WHEEL_AGE, WHEEL_NOISE, WHEEL_SPEED
from sigmaswarm.drives.timeline import AX, FIX_THETA, FIX_VAR_THETA, FIX_VX, FIX_VY, GX, GY, GZ
from sigmaswarm.filters.compiled.lanes import sincos, spread_of
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, R, at
from sigmaswarm.filters.compiled.tilted12 import fold
from sigmaswarm.filters.compiled.updates import update_pair, update_scalar
from sigmaswarm.filters.schedule import HEADING_GATE, SLIP_GATE

TWO_PI = 2.0 * math.pi


def axis_of(bias):
    """Return the index in a step of the gyro axis whose bias is in row ``bias``."""
    return {R.W: GZ, R.K: GX, R.L: GY}[bias]


def update_velocity(w, z, *, n):
    """Update with the receiver's velocity over ground, m/s east and north."""
    for l in range(LANES):
        w[R.R1, l] = w[R.R_VELOCITY, l]
    take_velocity(w, z[FIX_VX], z[FIX_VY])


def update_standstill(w, u, *, n, gyro_biases, tilted):
    """Update at a standstill: the velocity is 0, and the gyro measures its biases if they are states.

    The measurements are linear, so sequential updates equal a joint update if the error is injected at the end.
    """
    for l in range(LANES):
        w[R.R1, l] = w[R.R_STANDSTILL, l]
    take_velocity(w, 0.0, 0.0)
    for row in gyro_biases:
        shown = u[axis_of(row)]
        for l in range(LANES):
            w[R.N1, l] = shown - w[row, l]
            w[R.S11, l] = w[at(row, row), l] + w[R.R_RATE, l]
            for i in range(n):
                w[C1 + i, l] = w[at(i, row), l]
        update_scalar(w)
    if tilted:
        fold(w)


def take_velocity(w, zu, zv, *, n):
    """Update with a measured velocity of variance R1 per axis.

    The covariances of the velocity states are computed as C S^-1 R, without cancellation: see `_keep_digits`.
    """
    for l in range(LANES):
        w[R.N1, l], w[R.N2, l] = zu - w[R.U, l], zv - w[R.V, l]
        s11, s12, s22 = w[R.UU, l] + w[R.R1, l], w[R.UV, l], w[R.VV, l] + w[R.R1, l]
        det = s11 * s22 - s12 * s12
        w[R.G11, l], w[R.G12, l], w[R.G22, l] = s22 / det, -s12 / det, s11 / det
        for i in range(n):
            w[C1 + i, l], w[C2 + i, l] = w[at(i, R.U), l], w[at(i, R.V), l]
    update_pair(w)
    for l in range(LANES):
        r, g11, g12, g22 = w[R.R1, l], w[R.G11, l], w[R.G12, l], w[R.G22, l]
        for i in range(n):
            w[at(i, R.U), l] = r * (w[C1 + i, l] * g11 + w[C2 + i, l] * g12)
            w[at(i, R.V), l] = r * (w[C1 + i, l] * g12 + w[C2 + i, l] * g22)


def measure_along_planar(w, u, wheels, *, n, bias, lateral):
    """Compute nu, S and C of a velocity R(theta)^T v in the body frame: lateral constraint or odometer.

    Lateral: 0 = left - arm (yaw rate - w), with arm from `models.lateral_arm`. Odometer: speed / scale = forward -
    delay (ax - b). R(theta)^T v has the closed form of planar8.py, rotated into the body frame, with t = R^T P[v,
    theta] and mu = (e R^T v - k J t)_along. The forward velocity is computed as the left velocity of a body that is
    rotated by 90 degrees; ``away`` is the forward velocity of this body.
    """
    if lateral:
        shown = u[GZ]
    else:
        shown, speed, age, more = u[AX], wheels[WHEEL_SPEED], wheels[WHEEL_AGE], wheels[WHEEL_NOISE]
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
    update_scalar(w)
    if tilted:
        fold(w)


def update_odometer(w, u, wheels, *, tilted, measure_odometer):
    """Update with the wheels' speed, unless the NIS shows slip.

    ``wheels`` is a row of `drives.events.Events.wheels`.
    """
    measure_odometer(w, u, wheels)
    for l in range(LANES):
        used = w[R.N1, l] * w[R.N1, l] <= SLIP_GATE * w[R.S11, l]
        w[R.S11, l] = w[R.S11, l] if used else math.inf
        w[R.N1, l] = w[R.N1, l] if used else 0.0
    update_scalar(w)
    if tilted:
        fold(w)


def measure_heading_planar(w, *, n):
    """Compute the prediction, C and H P H^T of z = theta, which is linear in the state."""
    for l in range(LANES):
        w[R.N1, l], w[R.S11, l] = w[R.T, l], w[R.TT, l]
        for i in range(n):
            w[C1 + i, l] = w[at(i, R.T), l]


def update_heading(w, u, z, *, tilted, measure_heading):
    """Update with a heading that is ``latency`` s old; increase S of an outlier.

    See `schedule.HEADING_GATE`.
    """
    shown, theta, stated = u[GZ], z[FIX_THETA], z[FIX_VAR_THETA]
    measure_heading(w)
    for l in range(LANES):
        off = theta + w[R.LATENCY, l] * shown - w[R.N1, l]
        off -= TWO_PI * np.floor(off / TWO_PI + 0.5)
        s, least = w[R.S11, l] + (w[R.R_HEADING, l] + stated), off * off / HEADING_GATE
        w[R.N1, l], w[R.S11, l] = off, s if s > least else least
    update_scalar(w)
    if tilted:
        fold(w)
