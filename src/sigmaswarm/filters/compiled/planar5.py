"""planar5's prediction in closed form; compare `models.planar5` and `textbook.UnscentedKalmanFilter`.

The process is linear in all states except theta: u' = u + dt g(theta), x' = x + (u + u') dt/2, theta' = theta + dt yaw
rate, with position x, velocity u, and g the acceleration in the local frame. Sigma points may use any square root of P;
here P is factored with theta as the first state. Then only the two sigma points of the first column change theta, by
+-d with d = gamma sigma_theta and gamma^2 = n + lambda = alpha^2 (n + kappa). All other points have the acceleration
of the center, g0 = g(theta). With J the rotation by 90 degrees, and s the state vector,

    g(theta +- d) = g0 cos d +- J g0 sin d
    e         = (cos d - 1) / gamma^2 = -(2 / gamma^2) sin^2(d/2)    (second form: without cancellation)
    k         = sin d / d
    mean of g = (1 + e) g0
    Cov(s, g) = k P[:, theta] (J g0)^T
    Cov(g)    = k^2 P[theta, theta] J g0 (J g0)^T  +  (alpha^2 (n + kappa - 1) + beta) e^2 g0 g0^T

The other covariances follow from linearity: Cov(., u') = Cov(., u) + dt Cov(., g), and so on; Q is added at the end.

The extended Kalman filter has no second-order terms: gamma = 0, so e = 0 and k = 1. In a step, the heading turns by the
same angle in all lanes, so rows COS and SIN are rotated. After an update, a start or a large turn, SIN_COS_VALID and
SIN_COS_VALID_ALL are 0, and the next step computes COS and SIN from the heading.
"""

from sigmaswarm.drives.timeline import AX, AY, DT, GZ, Q_SCALE
from sigmaswarm.filters.compiled.lanes import FAR, kernel, sinc_cos, sincos, spread_of
from sigmaswarm.filters.compiled.layout import LANES, R


@kernel
def _refresh_sin_cos(w):
    """Compute the cosine and sine of the heading if they are invalid."""
    for l in range(LANES):
        sin_t, cos_t = sincos(w.T)
        valid = w.SIN_COS_VALID > 0.0
        w.COS = w.COS if valid else cos_t
        w.SIN = w.SIN if valid else sin_t
        w.SIN_COS_VALID, w.SIN_COS_VALID_ALL = 1.0, 1.0


@kernel
def _invalidate_sin_cos(w):
    """Mark cosine and sine of the heading as invalid after a turn that is too large for `sinc_cos`."""
    for l in range(LANES):
        w.SIN_COS_VALID, w.SIN_COS_VALID_ALL = 0.0, 0.0


@kernel
def _turn(w, ax, ay, turn):
    """Compute the moments of the acceleration times dt for a Gaussian heading; then turn the heading.

    ``ax`` and ``ay`` are multiplied by dt.
    """
    for l in range(LANES):
        k_turn, cos_turn = sinc_cos(turn * turn)
        sin_turn = turn * k_turn
        sin_t, cos_t = w.SIN, w.COS
        w.COS, w.SIN = cos_turn * cos_t - sin_turn * sin_t, cos_turn * sin_t + sin_turn * cos_t
        w.T += turn
        a, b = cos_t * ax - sin_t * ay, sin_t * ax + cos_t * ay
        _, k, quarter_sin2 = spread_of(w.QUARTER_GAMMA, w.TT)
        e = w.SHORTENS * quarter_sin2
        w.EAST, w.NORTH, w.E, w.ALONG = a, b, e, w.SPREAD * e * e
        w.JEAST, w.JNORTH = -k * b, k * a


@kernel
def predict_planar5(w, u):
    """Compute a step of the process model; xu1, xu2 and xu3 are the element xu of P after its first to third change.

    The position moves for half a step with the velocity before the step, and for half a step with the velocity after
    it. There are two loops, since one loop would be too long for out-of-order execution.
    """
    dt, ax, ay, gz, q_scale = u[DT], u[AX], u[AY], u[GZ], u[Q_SCALE]
    if w[R.SIN_COS_VALID_ALL, 0] == 0.0:
        _refresh_sin_cos(w)
    turn = dt * gz
    _turn(w, dt * ax, dt * ay, turn)
    if not turn * turn < FAR:
        _invalidate_sin_cos(w)
    h = 0.5 * dt
    for l in range(LANES):
        u, v, tt = w.U, w.V, w.TT
        a, b, ke, kn = w.EAST, w.NORTH, w.JEAST, w.JNORTH  # dt g0; dt k J g0
        along_a, along_b = w.ALONG * a, w.ALONG * b
        u1, v1 = u + (a + w.E * a), v + (b + w.E * b)
        w.X += h * (u + u1)
        w.Y += h * (v + v1)
        w.U, w.V = u1, v1

        ut, vt, uu, uv, vv = w.UT, w.VT, w.UU, w.UV, w.VV
        xt, yt = w.XT + h * ut, w.YT + h * vt
        xu, xv, yu, yv = w.XU, w.XV, w.YU, w.YV
        xu1, xv1, yu1, yv1 = xu + h * uu, xv + h * uv, yu + h * uv, yv + h * vv
        ut1, vt1 = ut + ke * tt, vt + kn * tt
        uu1 = uu + ke * ut + ke * ut1 + along_a * a
        uv1 = uv + kn * ut + ke * vt1 + along_a * b
        vv1 = vv + kn * vt + kn * vt1 + along_b * b
        xu2, xv2, yu2, yv2 = xu1 + ke * xt, xv1 + kn * xt, yu1 + ke * yt, yv1 + kn * yt
        xu3, xv3, yu3, yv3 = xu2 + h * uu1, xv2 + h * uv1, yu2 + h * uv1, yv2 + h * vv1
        w.XX += h * ((xu + xu1) + (xu2 + xu3)) + q_scale * w.Q_X
        w.XY += h * ((xv + yu1) + (xv2 + yu3))
        w.YY += h * ((yv + yv1) + (yv2 + yv3)) + q_scale * w.Q_Y
        w.XU, w.XV, w.XT = xu3, xv3, xt + h * ut1
        w.YU, w.YV, w.YT = yu3, yv3, yt + h * vt1
        w.UU, w.UV, w.UT = uu1 + q_scale * w.Q_U, uv1, ut1
        w.VV, w.VT = vv1 + q_scale * w.Q_V, vt1
        w.TT = tt + q_scale * w.Q_T
