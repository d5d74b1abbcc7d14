"""planar8's prediction in closed form: planar5 with the IMU's biases as random walks.

f(s) = A s + B R(theta) (a - b), theta += (yaw rate - w) dt, with b the accelerometer's biases and w the gyro's. It is
bilinear in theta and b. Take the square root of P with theta first again: its first column moves theta by d and b along
with it; with theta held, the other columns move b only, and there the process is linear. Write a0 for the mean
specific force less bias, turned into the world; J for a turn by 90 degrees; t = R P[b, theta]; gamma, d, e and k as in
planar5, and m = (1 - cos d) / P[theta, theta]. Adding up the sigma points gives

    mean of g   = a0 + mu,    mu = e a0 - k J t
    Cov(s, g)   = P[:, theta] (k J a0 + m t)^T - P[:, b] R^T
    Cov(g)      = R P[b, b] R^T + k^2 (P[theta, theta] J a0 (J a0)^T - gamma^2 t t^T)
                  - k cos d (J a0 t^T + t (J a0)^T) + (alpha^2 (n + kappa - 1) + beta) mu mu^T

and P' as in planar5. The second-order terms off (SECOND = 0): mu = 0, m = 0, k = cos d = 1, no gamma^2 term; the
extended Kalman filter.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

from sigmaswarm.filters.compiled.lanes import (
    AA, AB, AW, BB, BW, GAMMA, INV_GAMMA2, LANES, Q0, SECOND, SPREAD, TA, TB, TT, TW, UA, UB, UT, UU, UV, UW,
    VA, VB, VT, VV, VW, WW, XA, XB, XT, XU, XV, XW, XX, XY, YA, YB, YT, YU, YV, YW, YY,
    A, B, T, U, V, W, X, Y, kernel, sincos,
)  # fmt: skip


@kernel
def predict_planar8(w, dt, ax, ay, gz, q_scale):
    """One step of the process model."""
    h = 0.5 * dt * dt
    for l in range(LANES):  # noqa: E741
        s, c = sincos(w[T, l])
        a0 = c * (ax - w[A, l]) - s * (ay - w[B, l])
        b0 = s * (ax - w[A, l]) + c * (ay - w[B, l])

        second, gamma, tt = w[SECOND, l], w[GAMMA, l], w[TT, l]
        d = gamma * math.sqrt(tt) + 1e-300
        sin_h, cos_h = sincos(0.5 * d)
        sin_h = second * sin_h
        e = -2.0 * w[INV_GAMMA2, l] * sin_h * sin_h
        cos_d = 1.0 - 2.0 * sin_h * sin_h
        k = 1.0 + second * (2.0 * sin_h * cos_h / d - 1.0)
        m = 2.0 * (gamma * sin_h / d) * (gamma * sin_h / d)

        ta, tb = w[TA, l], w[TB, l]
        te, tn = c * ta - s * tb, s * ta + c * tb  # t = R P[b, theta]
        mu_e, mu_n = e * a0 + second * k * tn, e * b0 - second * k * te
        ga, gb = a0 + mu_e, b0 + mu_n
        ke, kn = m * te - k * b0, m * tn + k * a0  # k J a0 + m t

        # Rows of A P, as far as they are needed: position has moved on, theta not yet.
        xa, xb = w[XA, l] + dt * w[UA, l], w[XB, l] + dt * w[UB, l]
        ya, yb = w[YA, l] + dt * w[VA, l], w[YB, l] + dt * w[VB, l]
        xw, yw = w[XW, l] + dt * w[UW, l], w[YW, l] + dt * w[VW, l]
        ua, ub, uw = w[UA, l], w[UB, l], w[UW, l]
        va, vb, vw = w[VA, l], w[VB, l], w[VW, l]
        aa, ab, bb = w[AA, l], w[AB, l], w[BB, l]
        aw, bw, ww, tw = w[AW, l], w[BW, l], w[WW, l], w[TW, l]
        ut, vt = w[UT, l], w[VT, l]
        xt, yt = w[XT, l] + dt * ut, w[YT, l] + dt * vt
        uu, uv, vv = w[UU, l], w[UV, l], w[VV, l]
        xu, xv = w[XU, l] + dt * uu, w[XV, l] + dt * uv
        yu, yv = w[YU, l] + dt * uv, w[YV, l] + dt * vv

        # A Cov(s, g), one row a state, columns east and north.
        xe, xn = xt * ke - (c * xa - s * xb), xt * kn - (s * xa + c * xb)
        ye, yn = yt * ke - (c * ya - s * yb), yt * kn - (s * ya + c * yb)
        ue, un = ut * ke - (c * ua - s * ub), ut * kn - (s * ua + c * ub)
        ve, vn = vt * ke - (c * va - s * vb), vt * kn - (s * va + c * vb)
        ae, an = ta * ke - (c * aa - s * ab), ta * kn - (s * aa + c * ab)
        be, bn = tb * ke - (c * ab - s * bb), tb * kn - (s * ab + c * bb)
        we, wn = tw * ke - (c * aw - s * bw), tw * kn - (s * aw + c * bw)
        oe, on = tt * ke - te - dt * we, tt * kn - tn - dt * wn  # of theta, which moves on by -w dt

        # Cov(g)
        je, jn = -b0, a0  # J a0
        k2, kc, spread, g2 = k * k, k * cos_d, w[SPREAD, l], second * gamma * gamma
        left_e, left_n = c * aa - s * ab, c * ab - s * bb  # rows of R P[b, b]
        right_e, right_n = s * aa + c * ab, s * ab + c * bb
        gee = (c * left_e - s * left_n) + k2 * (tt * je * je - g2 * te * te) - 2.0 * kc * je * te + spread * mu_e * mu_e
        gen = (s * left_e + c * left_n) + k2 * (tt * je * jn - g2 * te * tn) - kc * (je * tn + jn * te)
        gen += spread * mu_e * mu_n
        gnn = (s * right_e + c * right_n) + k2 * (tt * jn * jn - g2 * tn * tn) - 2.0 * kc * jn * tn
        gnn += spread * mu_n * mu_n

        w[X, l] += dt * w[U, l] + h * ga
        w[Y, l] += dt * w[V, l] + h * gb
        w[U, l] += dt * ga
        w[V, l] += dt * gb
        w[T, l] += dt * (gz - w[W, l])

        w[XX, l] += dt * (w[XU, l] + xu) + 2.0 * h * xe + h * h * gee + q_scale * w[Q0, l]
        w[XY, l] += dt * (w[XV, l] + yu) + h * (xn + ye) + h * h * gen
        w[YY, l] += dt * (w[YV, l] + yv) + 2.0 * h * yn + h * h * gnn + q_scale * w[Q0 + 1, l]
        w[XU, l] = xu + dt * xe + h * ue + h * dt * gee
        w[XV, l] = xv + dt * xn + h * ve + h * dt * gen
        w[YU, l] = yu + dt * ye + h * un + h * dt * gen
        w[YV, l] = yv + dt * yn + h * vn + h * dt * gnn
        w[UU, l] = uu + 2.0 * dt * ue + dt * dt * gee + q_scale * w[Q0 + 2, l]
        w[UV, l] = uv + dt * (un + ve) + dt * dt * gen
        w[VV, l] = vv + 2.0 * dt * vn + dt * dt * gnn + q_scale * w[Q0 + 3, l]
        w[XT, l] = xt - dt * xw + h * oe
        w[YT, l] = yt - dt * yw + h * on
        w[UT, l] = ut - dt * uw + dt * oe
        w[VT, l] = vt - dt * vw + dt * on
        w[TT, l] = tt - 2.0 * dt * tw + dt * dt * ww + q_scale * w[Q0 + 4, l]
        w[XA, l], w[XB, l], w[XW, l] = xa + h * ae, xb + h * be, xw + h * we
        w[YA, l], w[YB, l], w[YW, l] = ya + h * an, yb + h * bn, yw + h * wn
        w[UA, l], w[UB, l], w[UW, l] = ua + dt * ae, ub + dt * be, uw + dt * we
        w[VA, l], w[VB, l], w[VW, l] = va + dt * an, vb + dt * bn, vw + dt * wn
        w[TA, l], w[TB, l], w[TW, l] = ta - dt * aw, tb - dt * bw, tw - dt * ww
        w[AA, l] = aa + q_scale * w[Q0 + 5, l]
        w[BB, l] = bb + q_scale * w[Q0 + 6, l]
        w[WW, l] = ww + q_scale * w[Q0 + 7, l]
