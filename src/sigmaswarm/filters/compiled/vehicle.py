"""Updates of mean and covariance with velocity, heading, odometer, and the motion constraints of a wheeled vehicle.

Before it calls `update_scalar` or `update_pair`, the caller computes nu, S (or G) and C of the measurement in every
lane.
"""

import math

import numpy as np

from sigmaswarm.drives.odometer import WHEEL_AGE, WHEEL_NOISE, WHEEL_SPEED
from sigmaswarm.drives.timeline import AX, FIX_THETA, FIX_VAR_THETA, FIX_VX, FIX_VY, GX, GY, GZ
from sigmaswarm.filters.compiled.lanes import sincos, spread_of
from sigmaswarm.filters.compiled.layout import C1, C2, LANES, P, R
from sigmaswarm.filters.compiled.tilted12 import fold
from sigmaswarm.filters.constants import HEADING_GATE, SLIP_GATE

TWO_PI = 2.0 * math.pi


def update_scalar(w, *, n):
    """Update x and P with a scalar measurement: x += C nu / S, P -= C C^T / S. S11, N1 and C1 contain S, nu and C."""
    for l in range(LANES):
        w.SIN_COS_VALID, w.SIN_COS_VALID_ALL = 0.0, 0.0
        g = 1.0 / w.S11
        for j in range(n):
            gain = g * C1[j]
            w[j] += gain * w.N1
            for i in range(j + 1):
                P[i, j] -= gain * C1[i]


def update_pair(w, *, n, tilted):
    """Update with a z of two components: x += C G nu, P -= C G C^T, with G = S^-1, or 0 for a rejected z."""
    for l in range(LANES):
        g11, g12, g22 = w.G11, w.G12, w.G22
        w.SIN_COS_VALID, w.SIN_COS_VALID_ALL = 0.0, 0.0
        for j in range(n):
            gain_1, gain_2 = C1[j] * g11 + C2[j] * g12, C1[j] * g12 + C2[j] * g22
            w[j] += gain_1 * w.N1 + gain_2 * w.N2
            for i in range(j + 1):
                P[i, j] -= gain_1 * C1[i] + gain_2 * C2[i]
        for i in range(n):
            w.OK = w.OK if P[i, i] > 0.0 else 0.0
    if tilted:
        fold(w)


def axis_of(bias):
    """Return the index, among the numbers of a step, of the gyro axis whose bias is in row ``bias``."""
    return {R.W: GZ, R.K: GX, R.L: GY}[bias]


def update_velocity(w, z, *, n):
    """Update with the receiver's velocity over ground, m/s east and north."""
    for l in range(LANES):
        w.R1 = w.R_VELOCITY
    take_velocity(w, z[FIX_VX], z[FIX_VY])


def update_standstill(w, u, *, n, gyro_biases, tilted):
    """Update at a standstill: the velocity is 0, and the gyro measures its biases if they are states.

    The measurements are linear, so sequential updates equal a joint update if the error is injected at the end.
    """
    for l in range(LANES):
        w.R1 = w.R_STANDSTILL
    take_velocity(w, 0.0, 0.0)
    for row in gyro_biases:
        shown = u[axis_of(row)]
        for l in range(LANES):
            w.N1 = shown - w[row]
            w.S11 = P[row, row] + w.R_RATE
            for i in range(n):
                C1[i] = P[i, row]
        update_scalar(w)
    if tilted:
        fold(w)


def take_velocity(w, zu, zv, *, n):
    """Update with a measured velocity of variance R1 per axis.

    The covariances of the velocity states are computed as C S^-1 R, without cancellation: see `_keep_digits`.
    """
    for l in range(LANES):
        w.N1, w.N2 = zu - w.U, zv - w.V
        s11, s12, s22 = w.UU + w.R1, w.UV, w.VV + w.R1
        det = s11 * s22 - s12 * s12
        w.G11, w.G12, w.G22 = s22 / det, -s12 / det, s11 / det
        for i in range(n):
            C1[i], C2[i] = P[i, R.U], P[i, R.V]
    update_pair(w)
    for l in range(LANES):
        r, g11, g12, g22 = w.R1, w.G11, w.G12, w.G22
        for i in range(n):
            P[i, R.U] = r * (C1[i] * g11 + C2[i] * g12)
            P[i, R.V] = r * (C1[i] * g12 + C2[i] * g22)


def measure_along_planar(w, u, wheels, *, n, bias, lateral):
    """Compute nu, S and C for a measured velocity in the body frame: lateral constraint or odometer.

    Lateral: 0 = left - arm (yaw rate - w), with arm from `models.lateral_arm` and the gyro's bias w. Odometer: speed /
    scale = forward - delay (ax - b), with the accelerometer's bias b. R(theta)^T v has the closed form of planar8.py,
    rotated into the body frame, with t = R^T P[v, theta] and mu = (e R^T v - k J t)_along. The forward velocity is
    computed as the left velocity of a body that is rotated clockwise by 90 degrees; ``away`` is the forward velocity of
    the rotated body.
    """
    if lateral:
        shown = u[GZ]
    else:
        shown, speed, age, more = u[AX], wheels[WHEEL_SPEED], wheels[WHEEL_AGE], wheels[WHEEL_NOISE]
    for l in range(LANES):
        second, quarter_gamma = w.SECOND, w.QUARTER_GAMMA
        if lateral:  # noqa: SIM108 (known at compilation)
            arm = w.ARM
        else:
            arm = w.ODOMETER_LATENCY + age
        tt = w.TT
        s, c = sincos(w.T)
        quarter_d, k, quarter_sin2 = spread_of(quarter_gamma, tt)
        g2, sin2_h = 16.0 * quarter_gamma * quarter_gamma, 4.0 * quarter_sin2
        e = w.SHORTENS * quarter_sin2
        m = 2.0 * sin2_h * (quarter_gamma / quarter_d) * (quarter_gamma / quarter_d)
        forward, left = c * w.U + s * w.V, c * w.V - s * w.U
        t_forward, t_left = c * w.UT + s * w.VT, c * w.VT - s * w.UT
        if lateral:
            along, away, t_along, t_away = left, forward, t_left, t_forward
        else:
            along, away, t_along, t_away = forward, -left, t_forward, -t_left
        mu = e * along - second * k * t_away
        turn = k * away + m * t_along
        if lateral:
            variance = c * c * w.VV - 2.0 * c * s * w.UV + s * s * w.UU
        else:
            variance = c * c * w.UU + 2.0 * c * s * w.UV + s * s * w.VV
        variance += k * k * (tt * away * away - g2 * t_along * t_along)
        variance += w.SPREAD * mu * mu - 2.0 * k * (1.0 - 2.0 * sin2_h) * away * t_along
        w.N1 = arm * shown - along - mu
        if lateral == 0:
            w.N1 += w.ODOMETER_SCALE * speed
        for i in range(n):
            if lateral:
                C1[i] = c * P[i, R.V] - s * P[i, R.U] - turn * P[i, R.T]
            else:
                C1[i] = c * P[i, R.U] + s * P[i, R.V] - turn * P[i, R.T]
        if bias >= 0:  # the IMU's reading has a bias
            w.N1 -= arm * w[bias]
            variance += 2.0 * arm * C1[bias] + arm * arm * P[bias, bias]
            for i in range(n):
                C1[i] += arm * P[i, bias]
        if lateral:
            w.S11 = variance + w.R_LATERAL
        else:
            w.S11 = variance + (w.R_ODOMETER + more)


def update_lateral(w, u, *, tilted, measure_lateral):
    """Update with the lateral constraint at the rear axle, with tire slip.

    See `models.lateral_arm`.
    """
    for l in range(LANES):
        speed2 = w.U * w.U + w.V * w.V
        w.ARM = w.REAR_AXLE - w.TIRE_SLIP * speed2
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
        used = w.N1 * w.N1 <= SLIP_GATE * w.S11
        w.S11 = w.S11 if used else math.inf
        w.N1 = w.N1 if used else 0.0
    update_scalar(w)
    if tilted:
        fold(w)


def measure_heading_planar(w, *, n):
    """Compute the prediction, C and H P H^T of z = theta, which is linear in the state."""
    for l in range(LANES):
        w.N1, w.S11 = w.T, w.TT
        for i in range(n):
            C1[i] = P[i, R.T]


def update_heading(w, u, z, *, tilted, measure_heading):
    """Update with a heading that is ``latency`` s old; S is increased for an outlier.

    See `constants.HEADING_GATE`.
    """
    shown, theta, stated = u[GZ], z[FIX_THETA], z[FIX_VAR_THETA]
    measure_heading(w)
    for l in range(LANES):
        off = theta + w.LATENCY * shown - w.N1
        off -= TWO_PI * np.floor(off / TWO_PI + 0.5)
        s, least = w.S11 + (w.R_HEADING + stated), off * off / HEADING_GATE
        w.N1, w.S11 = off, s if s > least else least
    update_scalar(w)
    if tilted:
        fold(w)
