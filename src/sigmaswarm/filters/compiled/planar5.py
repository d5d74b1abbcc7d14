"""planar5's prediction in closed form; read it beside `models.planar5` and `reference.UnscentedKalmanFilter`.

The process is linear in everything but theta: f(s) = A s + B g(theta), with A: x += vx dt, y += vy dt;
B: position += dt^2/2, velocity += dt; g the acceleration turned into the world. Any square root of P is right
for sigma points; take the one with theta first. Then only its first column (and its mirror image) moves
theta, by d = gamma sigma_theta with gamma^2 = n + lambda = alpha^2 (n + kappa), and all other sigma points
share the centre's g0 = g(theta). With g0' = dg/dtheta = g0 turned by 90 degrees,

    g(theta +- d) = g0 cos d +- g0' sin d,        w = 1 / (2 gamma^2) the weight of one sigma point,
    e         = 2 w (cos d - 1) = -(2 / gamma^2) sin^2(d/2)          (no difference of large numbers is left)
    k         = sin d / d
    mean of g = (1 + e) g0
    Cov(s, g) = k P[:, theta] g0'^T
    Cov(g)    = k^2 P[theta, theta] g0' g0'^T  +  (alpha^2 (n + kappa - 1) + beta) e^2 g0 g0^T

and P' = A P A^T + A Cov(s, g) B^T + B Cov(g, s) A^T + B Cov(g) B^T + Q.

An extended Kalman filter is the same with the second-order terms off: e = 0, k = 1 (constant SECOND = 0).
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

from sigmaswarm.filters.compiled.lanes import (
    GAMMA, INV_GAMMA2, LANES, Q0, SECOND, SPREAD, TT, UT, UU, UV, VT, VV,
    XT, XU, XV, XX, XY, YT, YU, YV, YY, T, U, V, X, Y, kernel, sincos,
)  # fmt: skip


@kernel
def predict_planar5(w, dt, ax, ay, gz, q_scale):
    """One step of the process model."""
    h = 0.5 * dt * dt
    for l in range(LANES):  # noqa: E741
        # The acceleration in the world at the mean heading: g0 = (a0, b0), g0' = (-b0, a0).
        sin_t, cos_t = sincos(w[T, l])
        a0 = cos_t * ax - sin_t * ay
        b0 = sin_t * ax + cos_t * ay

        # What the two sigma points that move theta by +-d do to mean and spread of the acceleration.
        second = w[SECOND, l]
        d = w[GAMMA, l] * math.sqrt(w[TT, l]) + 1e-300  # never 0/0; no change to any other d
        sin_h, cos_h = sincos(0.5 * d)
        e = -2.0 * second * w[INV_GAMMA2, l] * sin_h * sin_h
        k = 1.0 + second * (2.0 * sin_h * cos_h / d - 1.0)
        along = w[SPREAD, l] * e * e
        across = k * k * w[TT, l]
        ga = (1.0 + e) * a0
        gb = (1.0 + e) * b0
        caa = across * b0 * b0 + along * a0 * a0
        cab = (along - across) * a0 * b0
        cbb = across * a0 * a0 + along * b0 * b0
        p = -k * b0
        q = k * a0

        w[X, l] += dt * w[U, l] + h * ga
        w[Y, l] += dt * w[V, l] + h * gb
        w[U, l] += dt * ga
        w[V, l] += dt * gb
        w[T, l] += dt * gz

        # A P A^T, the cross terms with (p, q), B Cov(g) B^T, and Q.
        uu, uv, ut = w[UU, l], w[UV, l], w[UT, l]
        vv, vt, tt = w[VV, l], w[VT, l], w[TT, l]
        xu, xv, xt = w[XU, l] + dt * uu, w[XV, l] + dt * uv, w[XT, l] + dt * ut
        yu, yv, yt = w[YU, l] + dt * uv, w[YV, l] + dt * vv, w[YT, l] + dt * vt
        w[XX, l] += dt * (w[XU, l] + xu) + 2.0 * h * p * xt + h * h * caa + q_scale * w[Q0, l]
        w[XY, l] += dt * (w[XV, l] + yu) + h * (q * xt + p * yt) + h * h * cab
        w[YY, l] += dt * (w[YV, l] + yv) + 2.0 * h * q * yt + h * h * cbb + q_scale * w[Q0 + 1, l]
        w[XU, l] = xu + dt * p * xt + h * p * ut + h * dt * caa
        w[XV, l] = xv + dt * q * xt + h * p * vt + h * dt * cab
        w[YU, l] = yu + dt * p * yt + h * q * ut + h * dt * cab
        w[YV, l] = yv + dt * q * yt + h * q * vt + h * dt * cbb
        w[XT, l] = xt + h * p * tt
        w[YT, l] = yt + h * q * tt
        w[UU, l] = uu + 2.0 * dt * p * ut + dt * dt * caa + q_scale * w[Q0 + 2, l]
        w[UV, l] = uv + dt * (q * ut + p * vt) + dt * dt * cab
        w[VV, l] = vv + 2.0 * dt * q * vt + dt * dt * cbb + q_scale * w[Q0 + 3, l]
        w[UT, l] = ut + dt * p * tt
        w[VT, l] = vt + dt * q * tt
        w[TT, l] = tt + q_scale * w[Q0 + 4, l]
