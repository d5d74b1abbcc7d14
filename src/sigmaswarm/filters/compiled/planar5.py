"""planar5's prediction in closed form; read it beside `models.planar5` and `textbook.UnscentedKalmanFilter`.

The process is linear in all but theta: u' = u + dt g(theta), x' = x + (u + u') dt/2, theta' = theta + dt yaw rate,
with g the acceleration turned into the world. Any square root of P is right for sigma points; take the one with theta
first. Then only its first column (and its mirror image) moves theta, by d = gamma sigma_theta with gamma^2 = n + lambda
= alpha^2 (n + kappa), and all other sigma points share the centre's g0 = g(theta). With J a turn by 90 degrees,

    g(theta +- d) = g0 cos d +- J g0 sin d,       w = 1 / (2 gamma^2) the weight of one sigma point,
    e         = 2 w (cos d - 1) = -(2 / gamma^2) sin^2(d/2)          (no difference of large numbers is left)
    k         = sin d / d
    mean of g = (1 + e) g0
    Cov(s, g) = k P[:, theta] (J g0)^T
    Cov(g)    = k^2 P[theta, theta] J g0 (J g0)^T  +  (alpha^2 (n + kappa - 1) + beta) e^2 g0 g0^T

The rest is the covariance of sums: Cov(., u') = Cov(., u) + dt Cov(., g), and so on; Q is added at the end.

An extended Kalman filter is the same with the second-order terms off: e = 0, k = 1 (constant SECOND = 0).
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

from sigmaswarm.drives.timeline import AX, AY, DT, GZ, Q_SCALE
from sigmaswarm.filters.compiled.lanes import double_angle, kernel, sincos
from sigmaswarm.filters.compiled.layout import LANES, R


@kernel
def _turn(w, ax, ay):
    """What the mean heading and its spread do to the acceleration times dt."""
    for l in range(LANES):
        sin_t, cos_t = sincos(w[R.T, l])
        a, b = cos_t * ax - sin_t * ay, sin_t * ax + cos_t * ay
        second = w[R.SECOND, l]
        d = w[R.GAMMA, l] * math.sqrt(w[R.TT, l]) + 1e-300  # never 0/0; no change to any other d
        sin_d, sin2_h = double_angle(0.5 * d)
        e = -2.0 * second * w[R.INV_GAMMA2, l] * sin2_h
        k = 1.0 + second * (sin_d / d - 1.0)
        w[R.EAST, l], w[R.NORTH, l], w[R.E, l], w[R.ALONG, l] = a, b, e, w[R.SPREAD, l] * e * e
        w[R.JEAST, l], w[R.JNORTH, l] = -k * b, k * a


@kernel
def predict_planar5(w, u):
    """One step of the process model, in two loops: a processor can't look ahead over one so long."""
    dt, ax, ay, gz, q_scale = u[DT], u[AX], u[AY], u[GZ], u[Q_SCALE]
    _turn(w, dt * ax, dt * ay)
    h = 0.5 * dt
    for l in range(LANES):
        # dt g0; dt k J g0, so Cov(s, dt g) / P[s, t]
        a, b, ke, kn = w[R.EAST, l], w[R.NORTH, l], w[R.JEAST, l], w[R.JNORTH, l]
        xu, xv, xt = w[R.XU, l], w[R.XV, l], w[R.XT, l]
        yu, yv, yt = w[R.YU, l], w[R.YV, l], w[R.YT, l]
        uu, uv, ut = w[R.UU, l], w[R.UV, l], w[R.UT, l]
        vv, vt, tt = w[R.VV, l], w[R.VT, l], w[R.TT, l]

        u, v = w[R.U, l], w[R.V, l]
        u1, v1 = u + (a + w[R.E, l] * a), v + (b + w[R.E, l] * b)
        w[R.X, l] += h * (u + u1)
        w[R.Y, l] += h * (v + v1)
        w[R.U, l], w[R.V, l] = u1, v1
        w[R.T, l] += dt * gz

        # xu1 is Cov(x, u'), x1u is Cov(x', u), x1u1 is Cov(x', u'), and so on.
        xu1, xv1 = xu + ke * xt, xv + kn * xt
        yu1, yv1 = yu + ke * yt, yv + kn * yt
        uu1, uv1 = uu + ke * ut, uv + kn * ut
        vu1, vv1 = uv + ke * vt, vv + kn * vt
        u1t, v1t = ut + ke * tt, vt + kn * tt
        u1u1 = uu1 + ke * u1t + w[R.ALONG, l] * a * a
        u1v1 = uv1 + ke * v1t + w[R.ALONG, l] * a * b
        v1v1 = vv1 + kn * v1t + w[R.ALONG, l] * b * b
        x1u, y1u, y1v = xu + h * (uu + uu1), yu + h * (uv + uv1), yv + h * (vv + vv1)
        x1u1, x1v1 = xu1 + h * (uu1 + u1u1), xv1 + h * (uv1 + u1v1)
        y1u1, y1v1 = yu1 + h * (vu1 + u1v1), yv1 + h * (vv1 + v1v1)
        w[R.XX, l] += h * ((xu + xu1) + (x1u + x1u1)) + q_scale * w[R.Q_X, l]
        w[R.XY, l] += h * ((xv + xv1) + (y1u + y1u1))
        w[R.YY, l] += h * ((yv + yv1) + (y1v + y1v1)) + q_scale * w[R.Q_Y, l]
        w[R.XU, l], w[R.XV, l], w[R.XT, l] = x1u1, x1v1, xt + h * (ut + u1t)
        w[R.YU, l], w[R.YV, l], w[R.YT, l] = y1u1, y1v1, yt + h * (vt + v1t)
        w[R.UU, l], w[R.UV, l], w[R.UT, l] = u1u1 + q_scale * w[R.Q_U, l], u1v1, u1t
        w[R.VV, l], w[R.VT, l] = v1v1 + q_scale * w[R.Q_V, l], v1t
        w[R.TT, l] = tt + q_scale * w[R.Q_T, l]
