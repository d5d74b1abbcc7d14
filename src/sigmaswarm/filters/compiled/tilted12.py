"""tilted12's extended filter; compare `filters.tilted` and `textbook.manifold.ErrorStateKalmanFilter`.

The attitude of the mean is the quaternion in rows ATT_W ... ATT_Z. Rows I, J and T of the mean are the error about
east, north and up. This error is 0 except just before `fold`, which rotates the quaternion by the error. All other rows
are those of planar8; K and L are the biases of gx and gy.

The transition matrix A changes seven states (see transition.py). A P A^T is computed in two parts: first the seven rows
of A P, mostly in scratch rows, then those of (A P) A^T.
"""

import math

from sigmaswarm.drives.odometer import WHEEL_AGE, WHEEL_NOISE, WHEEL_SPEED
from sigmaswarm.drives.timeline import AX, AY, AZ, DT, FIX_VAR_X, FIX_VAR_Y, FIX_X, FIX_Y, GX, GY, GZ, Q_SCALE
from sigmaswarm.filters.compiled.lanes import FAR, TINY, angle_of, kernel, sinc_cos, sincos
from sigmaswarm.filters.compiled.layout import C1, C2, FP, LANES, P, Q, R, at
from sigmaswarm.filters.tilted import GRAVITY, N

MOVED = (R.X, R.Y, R.U, R.V, R.T, R.I, R.J)
KEPT = (R.A, R.B, R.W, R.K, R.L)
"""MOVED: states that a step changes. KEPT: biases, which a step does not change."""


# Each group is one loop. Its columns share most inputs, so fewer numbers are loaded, and more operations are parallel.
COLUMNS = (R.X, R.Y, R.U, R.V), (R.T, R.I, R.J, R.A), (R.B, R.W, R.K, R.L)
"""Columns of A P. The columns of KEPT are last, since they overwrite rows that the other columns need. Columns of
states that A does not change may follow."""
ROWS = (R.X, R.Y), (R.U, R.V), (R.T, R.I, R.J)  # of (A P) A^T


def fp(i, j):
    """Return the row of (A P)[i, j], i in MOVED: a scratch row or, if j is not in MOVED, the row of P[i, j]."""
    return at(i, j) if j not in MOVED else FP + len(MOVED) * MOVED.index(i) + MOVED.index(j)


@kernel
def _turn_far(w):
    """Compute the quaternion of half the step's rotation for any angle.

    The result replaces that of `_half_turn` in lanes with a large angle.
    """
    for l in range(LANES):
        x, y, z = w.HALF_X, w.HALF_Y, w.HALF_Z
        angle = math.sqrt(x * x + y * y + z * z) + TINY
        sine, c = sincos(angle)
        k = sine / angle
        near = x * x + y * y + z * z < FAR
        w.TURN_W = w.TURN_W if near else c
        w.TURN_X = w.TURN_X if near else k * x
        w.TURN_Y = w.TURN_Y if near else k * y
        w.TURN_Z = w.TURN_Z if near else k * z


@kernel
def _half_turn(w, u):
    """Compute the quaternion of half the step's rotation, whose angle is small except in long IMU gaps."""
    gx, gy, gz, quarter = u[GX], u[GY], u[GZ], 0.25 * u[DT]
    far = 0
    for l in range(LANES):
        x, y, z = quarter * (gx - w.K), quarter * (gy - w.L), quarter * (gz - w.W)
        angle2 = x * x + y * y + z * z
        k, c = sinc_cos(angle2)
        w.TURN_W, w.TURN_X, w.TURN_Y, w.TURN_Z = c, k * x, k * y, k * z
        w.HALF_X, w.HALF_Y, w.HALF_Z = x, y, z
        far += not (angle2 < FAR)
    if far > 0:
        _turn_far(w)


@kernel
def _move(w, u):
    """Propagate the mean; compute the coefficients of the error transition, for the covariance."""
    dt, ax, ay, az = u[DT], u[AX], u[AY], u[AZ]
    h = 0.5 * dt
    for l in range(LANES):
        c, x, y, z = w.TURN_W, w.TURN_X, w.TURN_Y, w.TURN_Z
        q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
        m0 = q0 * c - q1 * x - q2 * y - q3 * z
        m1 = q0 * x + q1 * c + q2 * z - q3 * y
        m2 = q0 * y - q1 * z + q2 * c + q3 * x
        m3 = q0 * z + q1 * y - q2 * x + q3 * c
        q0 = m0 * c - m1 * x - m2 * y - m3 * z
        q1 = m0 * x + m1 * c + m2 * z - m3 * y
        q2 = m0 * y - m1 * z + m2 * c + m3 * x
        q3 = m0 * z + m1 * y - m2 * x + m3 * c
        one = 1.5 - 0.5 * (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)  # normalizes after rounding
        w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z = one * q0, one * q1, one * q2, one * q3
        d11, d12, d13 = 1.0 - 2.0 * (m2 * m2 + m3 * m3), 2.0 * (m1 * m2 - m0 * m3), 2.0 * (m1 * m3 + m0 * m2)
        d21, d22, d23 = 2.0 * (m1 * m2 + m0 * m3), 1.0 - 2.0 * (m1 * m1 + m3 * m3), 2.0 * (m2 * m3 - m0 * m1)
        d31, d32, d33 = 2.0 * (m1 * m3 - m0 * m2), 2.0 * (m2 * m3 + m0 * m1), 1.0 - 2.0 * (m1 * m1 + m2 * m2)
        fx, fy = ax - w.A, ay - w.B
        east, north = dt * (d11 * fx + d12 * fy + d13 * az), dt * (d21 * fx + d22 * fy + d23 * az)
        w.D11, w.D12, w.D13 = dt * d11, dt * d12, dt * d13
        w.D21, w.D22, w.D23 = dt * d21, dt * d22, dt * d23
        w.D31, w.D32, w.D33 = dt * d31, dt * d32, dt * d33
        w.EAST, w.NORTH = east, north
        w.X += dt * w.U + h * east
        w.Y += dt * w.V + h * north
        w.U += east
        w.V += north


def propagate(w, u, *, columns, coefficients, transition):
    """Compute A P A^T. ``columns`` contains `COLUMNS`, followed by the columns of the fix error, if any."""
    dt = u[DT]
    for group in columns:
        for l in range(LANES):
            f = tuple(w[row] for row in coefficients)
            for j in group:
                e = transition(f, dt, tuple(P[k, j] for k in range(N)))
                (
                    w[fp(R.X, j)], w[fp(R.Y, j)], w[fp(R.U, j)], w[fp(R.V, j)], w[fp(R.T, j)],
                    _, _, _, w[fp(R.I, j)], w[fp(R.J, j)], _, _,
                ) = e  # fmt: skip
    for group in ROWS:
        for l in range(LANES):
            f = tuple(w[row] for row in coefficients)
            for i in group:
                x, y, vx, vy, up, _, _, _, east, north, _, _ = transition(
                    f, dt, tuple(w[fp(i, k)] for k in range(N))
                )
                # Each pair in MOVED is computed once, in the column of the state that is later in MOVED.
                if i == R.X:
                    P[i, R.X] = x
                if i in (R.X, R.Y):
                    P[i, R.Y] = y
                if i in (R.X, R.Y, R.U):
                    P[i, R.U] = vx
                if i in (R.X, R.Y, R.U, R.V):
                    P[i, R.V] = vy
                if i not in (R.I, R.J):
                    P[i, R.T] = up
                if i != R.J:
                    P[i, R.I] = east
                P[i, R.J] = north


def predict_tilted12(w, u, *, propagate, linearize, add_curvature):
    """Compute a step of the process model; only the unscented filter uses ``linearize`` and ``add_curvature``."""
    _half_turn(w, u)
    _move(w, u)
    if linearize:
        linearize(w, u)
    propagate(w, u)
    if add_curvature:
        add_curvature(w, u)
    q_scale = u[Q_SCALE]
    for l in range(LANES):
        for i in range(N):
            P[i, i] += q_scale * Q[i]


@kernel
def fold(w):
    """Rotate the quaternion by the error in I, J and T, from the left; set the error to 0."""
    for l in range(LANES):
        x, y, z = 0.5 * w.I, 0.5 * w.J, 0.5 * w.T
        angle = math.sqrt(x * x + y * y + z * z) + TINY
        sine, c = sincos(angle)
        k = sine / angle
        x, y, z = k * x, k * y, k * z
        m0, m1, m2, m3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
        q0 = c * m0 - x * m1 - y * m2 - z * m3
        q1 = c * m1 + x * m0 + y * m3 - z * m2
        q2 = c * m2 - x * m3 + y * m0 + z * m1
        q3 = c * m3 + x * m2 - y * m1 + z * m0
        one = 1.5 - 0.5 * (q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z = one * q0, one * q1, one * q2, one * q3
        w.I, w.J, w.T = 0.0, 0.0, 0.0


@kernel
def settle(w):
    for l in range(LANES):
        q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
        w.HEADING = angle_of(2.0 * (q1 * q2 + q0 * q3), 1.0 - 2.0 * (q2 * q2 + q3 * q3))


def measure_fix_tilted(w, z, lever, *, n):
    """Compute nu, H P H^T, C and R of z = p + arm - latency v, where arm is the rotated lever arm.

    See `tilted.antenna`.
    """
    zx, zy, var_x, var_y = z[FIX_X], z[FIX_Y], z[FIX_VAR_X], z[FIX_VAR_Y]
    lever_x, lever_y, lever_z = lever[0], lever[1], lever[2]
    for l in range(LANES):
        q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
        # R lever = lever + 2 q x (q x lever + q0 lever), with q the vector part of the quaternion.
        tx = q2 * lever_z - q3 * lever_y + q0 * lever_x
        ty = q3 * lever_x - q1 * lever_z + q0 * lever_y
        tz = q1 * lever_y - q2 * lever_x + q0 * lever_z
        east = lever_x + 2.0 * (q2 * tz - q3 * ty)
        north = lever_y + 2.0 * (q3 * tx - q1 * tz)
        up = lever_z + 2.0 * (q1 * ty - q2 * tx)
        tau = w.LATENCY
        w.R1 = w.RX + w.ACCURACY * var_x
        w.R2 = w.RY + w.ACCURACY * var_y
        w.GEE, w.GEN, w.GNN = 0.0, 0.0, 0.0
        w.JEAST, w.JNORTH, w.LEVER_UP = -north, east, up
        w.N1 = zx - (w.X - tau * w.U + east)
        w.N2 = zy - (w.Y - tau * w.V + north)
    for l in range(LANES):
        tau, je, jn, up = w.LATENCY, w.JEAST, w.JNORTH, w.LEVER_UP
        for i in range(n):
            C1[i] = P[i, R.X] - tau * P[i, R.U] + je * P[i, R.T] + up * P[i, R.J]
            C2[i] = P[i, R.Y] - tau * P[i, R.V] + jn * P[i, R.T] - up * P[i, R.I]
        w.S11 = w.C1_X - tau * w.C1_U + je * w.C1_T + up * w.C1_J
        w.S12 = w.C1_Y - tau * w.C1_V + jn * w.C1_T - up * w.C1_I
        w.S22 = w.C2_Y - tau * w.C2_V + jn * w.C2_T - up * w.C2_I


def measure_heading_tilted(w, *, n):
    """Compute the prediction, C and H P H^T of z = yaw of the attitude.

    See `tilted.heading`.
    """
    for l in range(LANES):
        q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
        east, north = 1.0 - 2.0 * (q2 * q2 + q3 * q3), 2.0 * (q1 * q2 + q0 * q3)
        climb = 2.0 * (q1 * q3 - q0 * q2) / (east * east + north * north)
        hi, hj = -climb * east, -climb * north
        w.N1 = angle_of(north, east)
        for i in range(n):
            C1[i] = P[i, R.T] + hi * P[i, R.I] + hj * P[i, R.J]
        w.S11 = w.C1_T + hi * w.C1_I + hj * w.C1_J


def measure_along_tilted(w, u, wheels, *, n, lateral, bias):
    """Compute nu, C and S of the forward velocity, or of the velocity to the left at the rear axle.

    See `tilted.rear_axle` and `tilted.wheels`.
    """
    if lateral:
        shown = u[GZ]
    else:
        shown, speed, age, more = u[AX], wheels[WHEEL_SPEED], wheels[WHEEL_AGE], wheels[WHEEL_NOISE]
    for l in range(LANES):
        q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
        if lateral:
            e0, e1, e2 = 2.0 * (q1 * q2 - q0 * q3), 1.0 - 2.0 * (q1 * q1 + q3 * q3), 2.0 * (q2 * q3 + q0 * q1)
        else:
            e0, e1, e2 = 1.0 - 2.0 * (q2 * q2 + q3 * q3), 2.0 * (q1 * q2 + q0 * q3), 2.0 * (q1 * q3 - q0 * q2)
        c0, c1, c2 = 2.0 * (q1 * q3 + q0 * q2), 2.0 * (q2 * q3 - q0 * q1), 1.0 - 2.0 * (q1 * q1 + q2 * q2)
        vx, vy = w.U, w.V
        vz, climb = -(c0 * vx + c1 * vy) / c2, e2 / c2
        # e x v - climb c x v = (e - climb c) x v
        d0, d1 = e0 - climb * c0, e1 - climb * c1
        hi, hj, ht = d1 * vz, -d0 * vz, d0 * vy - d1 * vx
        if lateral:
            arm, noise = w.ARM, w.R_LATERAL
            w.N1 = arm * (shown - w[bias]) - (e0 * vx + e1 * vy + e2 * vz)
        else:
            arm, noise = w.ODOMETER_LATENCY + age, w.R_ODOMETER + more
            gained = shown - w[bias] - GRAVITY * e2
            w.N1 = w.ODOMETER_SCALE * speed + arm * gained - (e0 * vx + e1 * vy + e2 * vz)
            hi, hj = hi + arm * GRAVITY * e1, hj - arm * GRAVITY * e0
        for i in range(n):
            C1[i] = (
                d0 * P[i, R.U] + d1 * P[i, R.V] + arm * P[i, bias]
                + hi * P[i, R.I] + hj * P[i, R.J] + ht * P[i, R.T]
            )  # fmt: skip
        w.S11 = (
            d0 * w.C1_U + d1 * w.C1_V + arm * C1[bias]
            + hi * w.C1_I + hj * w.C1_J + ht * w.C1_T + noise
        )  # fmt: skip


TILTED_MEASUREMENTS = measure_fix_tilted, measure_heading_tilted, measure_along_tilted
