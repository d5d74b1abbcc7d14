"""planar5's prediction in closed form; compare `models.planar5` and `textbook.UnscentedKalmanFilter`.

The process is linear in all states except theta: u' = u + dt g(theta), x' = x + (u + u') dt/2, theta' = theta + dt yaw
rate, with position x, velocity u, and g the acceleration in the local frame. Sigma points may use any square root of P;
here theta is the first state of the root. Then only the two sigma points of the first column change theta, by +-d with
d = gamma sigma_theta and gamma^2 = n + lambda = alpha^2 (n + kappa). All other points have the acceleration of the
center, g0 = g(theta). With J a turn by 90 degrees, and s the state,

    g(theta +- d) = g0 cos d +- J g0 sin d
    e         = (cos d - 1) / gamma^2 = -(2 / gamma^2) sin^2(d/2)    (second form: without cancellation)
    k         = sin d / d
    mean of g = (1 + e) g0
    Cov(s, g) = k P[:, theta] (J g0)^T
    Cov(g)    = k^2 P[theta, theta] J g0 (J g0)^T  +  (alpha^2 (n + kappa - 1) + beta) e^2 g0 g0^T

The other covariances are those of sums: Cov(., u') = Cov(., u) + dt Cov(., g), and so on; Q is added at the end.

The extended Kalman filter has no second-order terms: gamma = 0, so e = 0 and k = 1. In a step, the heading turns by the
same angle in all lanes, so rows COS and SIN are rotated. After an update, a start or a large turn, SIN_COS_VALID and
SIN_COS_VALID_ALL are 0, and the next step computes COS and SIN from the heading.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

from sigmaswarm.drives.timeline import AX, AY, DT, GZ, Q_SCALE
from sigmaswarm.filters.compiled.lanes import FAR, kernel, sinc_cos, sincos, spread_of
from sigmaswarm.filters.compiled.layout import LANES, R


@kernel
def _refresh_sin_cos(w):
    """Compute cosine and sine of the heading if they are invalid."""
    for l in range(LANES):
        sin_t, cos_t = sincos(w[R.T, l])
        valid = w[R.SIN_COS_VALID, l] > 0.0
        w[R.COS, l] = w[R.COS, l] if valid else cos_t
        w[R.SIN, l] = w[R.SIN, l] if valid else sin_t
        w[R.SIN_COS_VALID, l], w[R.SIN_COS_VALID_ALL, l] = 1.0, 1.0


@kernel
def _invalidate_sin_cos(w):
    """Mark cosine and sine of the heading as invalid after a turn that is too large for `sinc_cos`."""
    for l in range(LANES):
        w[R.SIN_COS_VALID, l], w[R.SIN_COS_VALID_ALL, l] = 0.0, 0.0


@kernel
def _turn(w, ax, ay, turn):
    """Compute the moments of the acceleration times dt for a Gaussian heading; then turn the heading.

    ``ax`` and ``ay`` are multiplied by dt.
    """
    for l in range(LANES):
        k_turn, cos_turn = sinc_cos(turn * turn)
        sin_turn = turn * k_turn
        sin_t, cos_t = w[R.SIN, l], w[R.COS, l]
        w[R.COS, l], w[R.SIN, l] = cos_turn * cos_t - sin_turn * sin_t, cos_turn * sin_t + sin_turn * cos_t
        w[R.T, l] += turn
        a, b = cos_t * ax - sin_t * ay, sin_t * ax + cos_t * ay
        _, k, quarter_sin2 = spread_of(w[R.QUARTER_GAMMA, l], w[R.TT, l])
        e = w[R.SHORTENS, l] * quarter_sin2
        w[R.EAST, l], w[R.NORTH, l], w[R.E, l], w[R.ALONG, l] = a, b, e, w[R.SPREAD, l] * e * e
        w[R.JEAST, l], w[R.JNORTH, l] = -k * b, k * a


@kernel
def predict_planar5(w, u):
    """Compute a step of the process model; a number at the end of a name counts the changes of an element of P.

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
        u, v, tt = w[R.U, l], w[R.V, l], w[R.TT, l]
        a, b, ke, kn = w[R.EAST, l], w[R.NORTH, l], w[R.JEAST, l], w[R.JNORTH, l]  # dt g0; dt k J g0
        along_a, along_b = w[R.ALONG, l] * a, w[R.ALONG, l] * b
        u1, v1 = u + (a + w[R.E, l] * a), v + (b + w[R.E, l] * b)
        w[R.X, l] += h * (u + u1)
        w[R.Y, l] += h * (v + v1)
        w[R.U, l], w[R.V, l] = u1, v1

        ut, vt, uu, uv, vv = w[R.UT, l], w[R.VT, l], w[R.UU, l], w[R.UV, l], w[R.VV, l]
        xt, yt = w[R.XT, l] + h * ut, w[R.YT, l] + h * vt
        xu, xv, yu, yv = w[R.XU, l], w[R.XV, l], w[R.YU, l], w[R.YV, l]
        xu1, xv1, yu1, yv1 = xu + h * uu, xv + h * uv, yu + h * uv, yv + h * vv
        ut1, vt1 = ut + ke * tt, vt + kn * tt
        uu1 = uu + ke * ut + ke * ut1 + along_a * a
        uv1 = uv + kn * ut + ke * vt1 + along_a * b
        vv1 = vv + kn * vt + kn * vt1 + along_b * b
        xu2, xv2, yu2, yv2 = xu1 + ke * xt, xv1 + kn * xt, yu1 + ke * yt, yv1 + kn * yt
        xu3, xv3, yu3, yv3 = xu2 + h * uu1, xv2 + h * uv1, yu2 + h * uv1, yv2 + h * vv1
        w[R.XX, l] += h * ((xu + xu1) + (xu2 + xu3)) + q_scale * w[R.Q_X, l]
        w[R.XY, l] += h * ((xv + yu1) + (xv2 + yu3))
        w[R.YY, l] += h * ((yv + yv1) + (yv2 + yv3)) + q_scale * w[R.Q_Y, l]
        w[R.XU, l], w[R.XV, l], w[R.XT, l] = xu3, xv3, xt + h * ut1
        w[R.YU, l], w[R.YV, l], w[R.YT, l] = yu3, yv3, yt + h * vt1
        w[R.UU, l], w[R.UV, l], w[R.UT, l] = uu1 + q_scale * w[R.Q_U, l], uv1, ut1
        w[R.VV, l], w[R.VT, l] = vv1 + q_scale * w[R.Q_V, l], vt1
        w[R.TT, l] = tt + q_scale * w[R.Q_T, l]
