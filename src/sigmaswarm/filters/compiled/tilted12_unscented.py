"""tilted12's unscented filter; compare `filters.tilted` and `textbook.manifold.ManifoldUnscentedKalmanFilter`.

Sigma points are errors added to the mean; a rotation vector e is added as exp([e]x) R. Every square root L of P is
valid. Here the states that do not enter linearly come first: see `tilted.STEP_FIRST` and `MEASURED_FIRST`. The later
columns do not change these first states, and all other states enter linearly. Only the first columns need points:

- For a step, the first columns are the gyro's biases and the attitude. The columns of the attitude follow those of the
  biases and do not change the biases. The points of the attitude rotate like the center, so their errors do not change,
  and the rotation of their acceleration has a closed form.
- For a fix, the first columns are the attitude, which rotates the lever arm; this rotation also has a closed form.
- For the other measurements, the first columns are the attitude, which rotates the velocity or the forward axis.

A function of the state is a linear part plus r, where r is 0 at the center and at the points of the later columns. Let
r+ and r- be the values of r at the two points of one of the first columns, L_c, and gamma^2 = alpha^2 (n + kappa). The
slope is h = (r+ - r-) / (2 gamma), the curvature t = (r+ + r-) / (2 gamma^2). Then the sums over the sigma points are

    mean of r  = mu = sum of t
    Cov(s, r)  = sum of L_c h^T = P[:, first] H,   with L_first^T H = h
    Cov(r)     = H^T P[first, first] H + gamma^2 (sum of t t^T) + (beta - alpha^2) mu mu^T

The rotated vector is exp(+-gamma [L_c]x) a = a +- k gamma L_c x a + q gamma^2 L_c x (L_c x a), with the angle d = gamma
|L_c|, k = sin d / d and q = (1 - cos d) / d^2. The linear part plus H replaces the Jacobian of `tilted12`, and the last
two terms of Cov(r) are added to the covariance. H is stored in rows SLOPE, mu in SHIFT, and these two terms in EXTRA.
"""

import math

import numpy as np

from sigmaswarm.drives.odometer import WHEEL_AGE, WHEEL_NOISE, WHEEL_SPEED
from sigmaswarm.drives.timeline import AX, AY, AZ, DT, FIX_VAR_X, FIX_VAR_Y, FIX_X, FIX_Y, GZ
from sigmaswarm.filters.compiled.lanes import FAR, TINY, angle_of, kernel, sinc_cos, sincos, spread_of
from sigmaswarm.filters.compiled.layout import BEND, C1, C2, EXTRA, LANES, PIVOT, ROOT, SHIFT, SLOPE, P, R
from sigmaswarm.filters.compiled.tilted12 import fold
from sigmaswarm.filters.compiled.unroll import Generated
from sigmaswarm.filters.tilted import GRAVITY, MEASURED_FIRST, STEP_FIRST, N

ADDED, POSITION = (R.U, R.V, R.I, R.J, R.T), (R.X, R.Y)
"""States whose step is nonlinear, in the order of the step's outputs, and the states that integrate the first two."""


def _root(w, *, order, columns):
    """Compute the first columns of the square root of P with the states in ``order``; the root is lower triangular."""
    for l in range(LANES):
        for j in range(columns):
            for i in range(j, len(order)):
                rest = P[order[i], order[j]]
                for k in range(j):
                    rest -= ROOT[i, k] * ROOT[j, k]
                if i == j:
                    pivot = math.sqrt(rest)
                    one = 1.0 / pivot
                    ROOT[j, j], PIVOT[j] = pivot, one
                else:
                    ROOT[i, j] = one * rest
            for i in range(j):
                ROOT[i, j] = 0.0


def _linearize(w, *, columns):
    """Replace the slopes by H; compute mu and EXTRA.

    ``columns`` is the number of columns with points for each output.
    """
    for l in range(LANES):
        gamma2 = 16.0 * w.QUARTER_GAMMA * w.QUARTER_GAMMA
        spread = w.SPREAD - gamma2  # beta - alpha^2
        for k in range(len(columns)):
            shift = 0.0
            for j in range(columns[k] - 1, -1, -1):
                slope = SLOPE[j, k]
                for i in range(j + 1, columns[k]):
                    slope -= ROOT[i, j] * SLOPE[i, k]
                SLOPE[j, k] = PIVOT[j] * slope
                shift += BEND[j, k]
            SHIFT[k] = shift
        for i in range(len(columns)):
            for k in range(i, len(columns)):
                extra = 0.0
                for j in range(min(columns[i], columns[k])):
                    extra += BEND[j, i] * BEND[j, k]
                EXTRA[i, k] = gamma2 * extra + spread * SHIFT[i] * SHIFT[k]


# ---- Vectors, as tuples of numbers ----


def cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _square(a):
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2]


def _scaled(k, a):
    return k * a[0], k * a[1], k * a[2]


def _added(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _less(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def _first_of(w, l, j):
    """Return the vector in column j of the root: gyro bias in a step, rotation in a measurement."""
    return ROOT[1, j], ROOT[2, j], ROOT[0, j]


# ---- Prediction ----


@kernel
def _turn_of(w, l, j):
    """Return the rotation vector in column j of the root of a step."""
    return ROOT[4, j], ROOT[5, j], ROOT[3, j]


@kernel
def _product(scalar, vector, w, l):
    """Return the product of the quaternion in rows POINT and another quaternion, as scalar and vector."""
    p0, p1, p2, p3 = w.POINT_W, w.POINT_X, w.POINT_Y, w.POINT_Z
    a0, (a1, a2, a3) = scalar, vector
    return p0 * a0 - p1 * a1 - p2 * a2 - p3 * a3, (
        p0 * a1 + p1 * a0 + p2 * a3 - p3 * a2,
        p0 * a2 - p1 * a3 + p2 * a0 + p3 * a1,
        p0 * a3 + p1 * a2 - p2 * a1 + p3 * a0,
    )


@kernel
def _turned(a, w, l):
    """Rotate a vector from the body frame at the middle of the step into the local frame, and multiply it by dt."""
    x, y, z = a
    return (
        w.D11 * x + w.D12 * y + w.D13 * z,
        w.D21 * x + w.D22 * y + w.D23 * z,
        w.D31 * x + w.D32 * y + w.D33 * z,
    )


@kernel
def _turned_level(x, y, w, l):
    """Compute `_turned` of the vector (x, y, 0)."""
    return (
        w.D11 * x + w.D12 * y,
        w.D21 * x + w.D22 * y,
        w.D31 * x + w.D32 * y,
    )


def _sinc_cos_far(z):
    angle = math.sqrt(z) + TINY
    sine, cos = sincos(angle)
    return sine / angle, cos


def _rotation_vector(scalar, vector, near):
    """Return the rotation vector of a quaternion whose vector part has a norm below 1/2. Source: arcsine of fdlibm."""
    z = _square(vector)
    p = z * (1.66666666666666657415e-01 + z * (-3.25565818622400915405e-01 + z * 2.01212532134862925881e-01))
    z3 = z * z * z
    p += (
        z3
        * z
        * (-4.00555345006794114027e-02 + z * (7.91534994289814532176e-04 + z * 3.47933107596021167570e-05))
    )
    q = 1.0 + z * (-2.40339491173441421878e00 + z * 2.02094576023350569471e00)
    q += z3 * (-6.88283971605453293030e-01 + z * 7.70381505559019352791e-02)
    return _scaled(2.0 + 2.0 * p / q, vector)


def _rotation_vector_far(scalar, vector, near):
    """Return, of all rotation vectors of a quaternion, the nearest to ``near``."""
    (q1, q2, q3), (x, y, z) = vector, near
    length = math.sqrt(_square(vector)) + TINY
    sine = -length if q1 * x + q2 * y + q3 * z < 0.0 else length
    half = angle_of(sine, scalar)
    length = 0.5 * math.sqrt(_square(near))
    half += (2.0 * math.pi) * np.floor((length - half) * (0.5 / math.pi) + 0.5)
    return _scaled(2.0 * half / sine, vector)


def _point(w, l, j, sign, quarter, per_dt, *, sinc_cos, rotation_vector):
    """Return r of two outputs at a point of column j: acceleration times dt (east, north), and error after the step."""
    step = 4.0 * sign * w.QUARTER_GAMMA
    b = _scaled(quarter * step, _first_of(w, l, j))
    # Quaternions of half the turn: v, and v0 of the center. Vector parts: p + c of v0^-1 v, and p - c of v v0^-1.
    half = _less((w.HALF_X, w.HALF_Y, w.HALF_Z), b)
    k, d = sinc_cos(_square(half))
    v = _scaled(k, half)
    d0, v0 = w.TURN_W, (w.TURN_X, w.TURN_Y, w.TURN_Z)
    p, c = _less(_scaled(d0, v), _scaled(d, v0)), _scaled(k, cross(v0, b))
    (x, y, z), (x0, y0, z0) = v, v0
    m0 = d * d0 + x * x0 + y * y0 + z * z0
    m = _turned(_scaled(per_dt, _added(p, c)), w, l)
    q = _turned(_scaled(2.0 * per_dt, _added(_scaled(m0, p), cross(c, p))), w, l)
    m0, m = _product(m0, m, w, l)
    q0, q = _product(1.0 - 2.0 * _square(p), q, w, l)
    error = _scaled(step, _turn_of(w, l, j))
    east, north, up = _less(rotation_vector(q0, q, error), error)
    # With the rotation M of the quaternion (m0, m): (M - 1) a = 2 m x (m x a + m0 a)
    force = _turned_level(step * ROOT[6, j], step * ROOT[7, j], w, l)
    a = _less((w.EAST, w.NORTH, w.UPWARD), force)
    a0, a1, _ = cross(m, _added(cross(m, a), _scaled(m0, a)))
    return 2.0 * a0, 2.0 * a1, east, north, up


@kernel
def _store_near(w, l, j, k, a, b, one, two):
    """Store the slope and curvature of an output, from its values at the two points."""
    SLOPE[j, k], BEND[j, k] = one * (a - b), two * (a + b)


@kernel
def _store_far(w, l, j, k, a, b, one, two):
    """Store the slope and curvature of an output, only in lanes with a large angle."""
    far = w.POINT_FAR > 0.0
    SLOPE[j, k] = one * (a - b) if far else SLOPE[j, k]
    BEND[j, k] = two * (a + b) if far else BEND[j, k]


def _draw(w, u, *, point, sinc_cos, store):
    """Compute the slopes and curvatures of the first three columns of the root, each from its two points."""
    quarter, per_dt = 0.25 * u[DT], 1.0 / u[DT]
    for j in range(3):
        for l in range(LANES):
            gamma = 4.0 * w.QUARTER_GAMMA
            x, y, z = _turn_of(w, l, j)
            sinc, c = sinc_cos(0.25 * gamma * gamma * (x * x + y * y + z * z))
            half = 0.5 * gamma * sinc
            w.POINT_W, w.POINT_X, w.POINT_Y, w.POINT_Z = c, half * x, half * y, half * z
            a = point(w, l, j, 1.0, quarter, per_dt)
            w.POINT_X, w.POINT_Y, w.POINT_Z = -half * x, -half * y, -half * z
            b = point(w, l, j, -1.0, quarter, per_dt)
            one = 0.5 / gamma
            two = one / gamma
            for k in range(5):
                store(w, l, j, k, a[k], b[k], one, two)


def _drawing(sinc_cos, rotation_vector, store):
    point = Generated(_point, sinc_cos=sinc_cos, rotation_vector=rotation_vector)
    return kernel(_draw, point=point, sinc_cos=sinc_cos, store=store)


_draw_near = _drawing(sinc_cos, _rotation_vector, _store_near)
_draw_far = _drawing(_sinc_cos_far, _rotation_vector_far, _store_far)
_root_of_step = kernel(_root, order=(*STEP_FIRST, R.A, R.B), columns=6)
_linearize_step = kernel(_linearize, columns=(6, 6, 3, 3, 3))


@kernel
def _turn_acceleration(w):
    for l in range(LANES):
        a = w.EAST, w.NORTH, w.UPWARD
        gamma2 = 16.0 * w.QUARTER_GAMMA * w.QUARTER_GAMMA
        for j in range(3, 6):
            turn = _turn_of(w, l, j)
            quarter, k, quarter_sin2 = spread_of(w.QUARTER_GAMMA, _square(turn))
            q = 0.5 * quarter_sin2 / (quarter * quarter)
            c = cross(turn, a)
            d = cross(turn, _turned_level(-ROOT[6, j], -ROOT[7, j], w, l))
            e, f = cross(turn, c), cross(turn, d)
            for i in range(2):
                SLOPE[j, i], BEND[j, i] = k * c[i] + gamma2 * q * f[i], q * e[i] + k * d[i]


@kernel
def linearize(w, u):
    """Compute H, mu and EXTRA of a step; add mu to the mean."""
    _root_of_step(w)
    ax, ay, az, h, quarter = u[AX], u[AY], u[AZ], 0.5 * u[DT], 0.25 * u[DT]
    far = 0
    for l in range(LANES):
        gamma2 = 16.0 * w.QUARTER_GAMMA * w.QUARTER_GAMMA
        x, y, z = w.HALF_X, w.HALF_Y, w.HALF_Z
        turn = gamma2 * (w.TT + w.II + w.JJ)
        rate = gamma2 * quarter * quarter * (w.WW + w.KK + w.LL)
        near = (turn < 0.8) & (rate < 6e-4) & (x * x + y * y + z * z < 0.5 * FAR)
        w.POINT_FAR = 0.0 if near else 1.0
        far += not near
        w.UPWARD = w.D31 * (ax - w.A) + w.D32 * (ay - w.B) + w.D33 * az
    _draw_near(w, u)
    if far > 0:
        _draw_far(w, u)
    _turn_acceleration(w)
    _linearize_step(w)
    for l in range(LANES):
        w.X += h * SHIFT[0]
        w.Y += h * SHIFT[1]
        w.U += SHIFT[0]
        w.V += SHIFT[1]
        w.I, w.J, w.T = SHIFT[2], SHIFT[3], SHIFT[4]
    fold(w)


@kernel
def add_curvature(w, u):
    """Add EXTRA, the last two terms of Cov(r), to the predicted covariance."""
    h = 0.5 * u[DT]
    for l in range(LANES):
        for i in range(len(ADDED)):
            for j in range(i, len(ADDED)):
                P[ADDED[i], ADDED[j]] += EXTRA[i, j]
        for i in range(2):
            for j in range(i, len(ADDED)):
                P[POSITION[i], ADDED[j]] += h * EXTRA[i, j]
        w.YU += h * EXTRA[0, 1]
        w.XX += h * h * EXTRA[0, 0]
        w.XY += h * h * EXTRA[0, 1]
        w.YY += h * h * EXTRA[1, 1]


# ---- Measurements ----

_root_of_rotation = kernel(_root, order=MEASURED_FIRST, columns=3)
_root_with_velocity = kernel(_root, order=(*MEASURED_FIRST, R.U, R.V), columns=3)
_linearize_fix = kernel(_linearize, columns=(3, 3))
_linearize_along = kernel(_linearize, columns=(3,))


@kernel
def _forward(w, l):
    q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
    return 1.0 - 2.0 * (q2 * q2 + q3 * q3), 2.0 * (q1 * q2 + q0 * q3), 2.0 * (q1 * q3 - q0 * q2)


@kernel
def _left(w, l):
    q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
    return 2.0 * (q1 * q2 - q0 * q3), 1.0 - 2.0 * (q1 * q1 + q3 * q3), 2.0 * (q2 * q3 + q0 * q1)


@kernel
def _up(w, l):
    q0, q1, q2, q3 = w.ATT_W, w.ATT_X, w.ATT_Y, w.ATT_Z
    return 2.0 * (q1 * q3 + q0 * q2), 2.0 * (q2 * q3 - q0 * q1), 1.0 - 2.0 * (q1 * q1 + q2 * q2)


@kernel
def measure_fix_unscented(w, z, lever):
    """Compute nu, H P H^T, C and R of z = p + arm - latency v, like `tilted12.measure_fix_tilted`."""
    zx, zy, var_x, var_y = z[FIX_X], z[FIX_Y], z[FIX_VAR_X], z[FIX_VAR_Y]
    lever_x, lever_y, lever_z = lever[0], lever[1], lever[2]
    _root_of_rotation(w)
    for l in range(LANES):
        arm, q = (lever_x, lever_y, lever_z), (w.ATT_X, w.ATT_Y, w.ATT_Z)
        arm = _added(arm, _scaled(2.0, cross(q, _added(cross(q, arm), _scaled(w.ATT_W, arm)))))
        east, north, _ = arm
        tau = w.LATENCY
        w.R1 = w.RX + w.ACCURACY * var_x
        w.R2 = w.RY + w.ACCURACY * var_y
        w.N1 = zx - (w.X - tau * w.U + east)
        w.N2 = zy - (w.Y - tau * w.V + north)
        for j in range(3):
            turn = _first_of(w, l, j)
            c = cross(turn, arm)
            quarter, k, quarter_sin2 = spread_of(w.QUARTER_GAMMA, _square(turn))
            q = 0.5 * quarter_sin2 / (quarter * quarter)
            d = cross(turn, c)
            for i in range(2):
                SLOPE[j, i], BEND[j, i] = k * c[i], q * d[i]
    _linearize_fix(w)
    for l in range(LANES):
        tau = w.LATENCY
        w.N1 -= SHIFT[0]
        w.N2 -= SHIFT[1]
        w.GEE, w.GEN, w.GNN = EXTRA[0, 0], EXTRA[0, 1], EXTRA[1, 1]
        for i in range(N):
            east, north = P[i, R.X] - tau * P[i, R.U], P[i, R.Y] - tau * P[i, R.V]
            for k in range(3):
                p = P[i, MEASURED_FIRST[k]]
                east += SLOPE[k, 0] * p
                north += SLOPE[k, 1] * p
            C1[i], C2[i] = east, north
        s11 = w.C1_X - tau * w.C1_U + w.GEE
        s12 = w.C1_Y - tau * w.C1_V + w.GEN
        s22 = w.C2_Y - tau * w.C2_V + w.GNN
        for k in range(3):
            s11 += SLOPE[k, 0] * C1[MEASURED_FIRST[k]]
            s12 += SLOPE[k, 1] * C1[MEASURED_FIRST[k]]
            s22 += SLOPE[k, 1] * C2[MEASURED_FIRST[k]]
        w.S11, w.S12, w.S22 = s11, s12, s22


@kernel
def measure_heading_unscented(w):
    """Compute the prediction, C and H P H^T of z = yaw; the sigma points rotate the forward axis."""
    _root_of_rotation(w)
    for l in range(LANES):
        e = _forward(w, l)
        e0, e1, _ = e
        gamma = 4.0 * w.QUARTER_GAMMA
        for j in range(3):
            turn = _first_of(w, l, j)
            quarter, k, quarter_sin2 = spread_of(w.QUARTER_GAMMA, _square(turn))
            q = 0.5 * gamma * gamma * quarter_sin2 / (quarter * quarter)
            g, o = gamma * k, cross(turn, e)
            (o0, o1, _), (t0, t1, _) = o, _scaled(q, cross(turn, o))
            odd, even = 0.0, 0.0
            for i in (1, -1):
                f0, f1 = t0 + i * (g * o0), t1 + i * (g * o1)  # change of the axis
                turned = angle_of(e0 * f1 - e1 * f0, e0 * (e0 + f0) + e1 * (e1 + f1))
                odd, even = odd + i * turned, even + turned
            SLOPE[j, 0] = odd * 0.5 / gamma
            BEND[j, 0] = even * 0.5 / (gamma * gamma)
        w.N1 = angle_of(e1, e0)
    _linearize_along(w)
    for l in range(LANES):
        h0, h1, h2 = SLOPE[0, 0], SLOPE[1, 0], SLOPE[2, 0]
        w.N1 += SHIFT[0]
        for i in range(N):
            C1[i] = h0 * P[i, R.T] + h1 * P[i, R.I] + h2 * P[i, R.J]
        w.S11 = EXTRA[0, 0] + h0 * w.C1_T + h1 * w.C1_I + h2 * w.C1_J


def _measure_along(w, u, wheels, *, lateral, bias, axis):
    """Compute nu, C and S of `tilted.wheels` (forward velocity) or `tilted.rear_axle` (velocity to the left)."""
    if lateral:
        shown = u[GZ]
    else:
        shown, speed, age, more = u[AX], wheels[WHEEL_SPEED], wheels[WHEEL_AGE], wheels[WHEEL_NOISE]
    _root_with_velocity(w)
    for l in range(LANES):
        e, c = axis(w, l), _up(w, l)
        (e0, e1, e2), (c0, c1, c2) = e, c
        vx, vy, climb = w.U, w.V, e2 / c2
        d0, d1 = e0 - climb * c0, e1 - climb * c1  # derivative with respect to the horizontal velocity
        if lateral:
            arm, noise = w.ARM, w.R_LATERAL
            w.N1 = arm * (shown - w[bias]) - (d0 * vx + d1 * vy)
        else:
            arm, noise = w.ODOMETER_LATENCY + age, w.R_ODOMETER + more
            gained = shown - w[bias] - GRAVITY * e2
            w.N1 = w.ODOMETER_SCALE * speed + arm * gained - (d0 * vx + d1 * vy)
        gamma = 4.0 * w.QUARTER_GAMMA
        for j in range(3):
            turn = _first_of(w, l, j)
            quarter, k, quarter_sin2 = spread_of(w.QUARTER_GAMMA, _square(turn))
            q = 0.5 * gamma * gamma * quarter_sin2 / (quarter * quarter)
            g, oe, oc = gamma * k, cross(turn, e), cross(turn, c)
            te, tc = _scaled(q, cross(turn, oe)), _scaled(q, cross(turn, oc))
            u1, v1 = gamma * ROOT[3, j], gamma * ROOT[4, j]
            odd, even = 0.0, 0.0
            for i in (1, -1):
                f0, f1, f2 = _added(te, _scaled(i, _scaled(g, oe)))  # changes of the axes
                a0, a1, a2 = _added(tc, _scaled(i, _scaled(g, oc)))
                other = c2 + a2
                steeper = (f2 * c2 - e2 * a2) / (c2 * other)
                steep = climb + steeper
                rest = (f0 - steep * a0 - steeper * c0) * (vx + i * u1)
                rest += (f1 - steep * a1 - steeper * c1) * (vy + i * v1)
                if lateral == 0:
                    rest += arm * GRAVITY * f2
                odd, even = odd + i * rest, even + rest
            SLOPE[j, 0] = odd * 0.5 / gamma
            BEND[j, 0] = even * 0.5 / (gamma * gamma)
        w.EAST, w.NORTH, w.ALONG, w.E = d0, d1, arm, noise
    _linearize_along(w)
    for l in range(LANES):
        d0, d1, arm = w.EAST, w.NORTH, w.ALONG
        h0, h1, h2 = SLOPE[0, 0], SLOPE[1, 0], SLOPE[2, 0]
        w.N1 -= SHIFT[0]
        for i in range(N):
            C1[i] = (
                d0 * P[i, R.U] + d1 * P[i, R.V] + arm * P[i, bias]
                + h0 * P[i, R.T] + h1 * P[i, R.I] + h2 * P[i, R.J]
            )  # fmt: skip
        w.S11 = (
            d0 * w.C1_U + d1 * w.C1_V + arm * C1[bias] + EXTRA[0, 0] + w.E
            + h0 * w.C1_T + h1 * w.C1_I + h2 * w.C1_J
        )  # fmt: skip


UNSCENTED_MEASUREMENTS = {
    "_measure_fix": measure_fix_unscented,
    "measure_heading": measure_heading_unscented,
    "measure_lateral": kernel(_measure_along, lateral=1, bias=R.W, axis=_left),
    "measure_odometer": kernel(_measure_along, lateral=0, bias=R.A, axis=_forward),
}
