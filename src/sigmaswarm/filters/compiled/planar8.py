"""planar8's prediction in closed form: planar5 with the IMU's biases as random walks.

u' = u + dt R(theta) (a - b), theta' = theta + dt (yaw rate - w), with the accelerometer's biases b and the gyro's bias
w. Only R(theta) (a - b) is nonlinear. The square root of P again begins with theta: its first column changes theta by
d, and also b. The other columns leave theta fixed, so the process is linear for them. At the mean, R = R(theta) and g0
= R (a - b). J, gamma, d, e and k are as in planar5, t = R P[b, theta] and m = (1 - cos d) / P[theta, theta]. The sums
over the sigma points are

    mean of g   = g0 + mu,    mu = e g0 - k J t
    Cov(s, g)   = P[:, theta] (k J g0 + m t)^T - P[:, b] R^T
    Cov(g)      = R P[b, b] R^T + k^2 (P[theta, theta] J g0 (J g0)^T - gamma^2 t t^T)
                  - k cos d (J g0 t^T + t (J g0)^T) + (alpha^2 (n + kappa - 1) + beta) mu mu^T

The extended Kalman filter has no second-order terms: gamma = SECOND = 0, so mu = 0, m = 0 and k = cos d = 1.
"""

from sigmaswarm.drives.timeline import AX, AY, DT, GZ, Q_SCALE
from sigmaswarm.filters.compiled.lanes import kernel, sincos, spread_of
from sigmaswarm.filters.compiled.layout import LANES


@kernel
def _turn(w, dt, ax, ay):
    """Compute the acceleration times dt and its covariances, from heading and biases."""
    for l in range(LANES):
        sin_t, cos_t = sincos(w.T)
        s, c = dt * sin_t, dt * cos_t  # all vectors below are multiplied by dt
        fx, fy = ax - w.A, ay - w.B
        a, b = c * fx - s * fy, s * fx + c * fy
        second, quarter_gamma, tt = w.SECOND, w.QUARTER_GAMMA, w.TT
        quarter_d, k, quarter_sin2 = spread_of(quarter_gamma, tt)
        g2, sin2_h = 16.0 * quarter_gamma * quarter_gamma, 4.0 * quarter_sin2
        e = w.SHORTENS * quarter_sin2
        m = 2.0 * sin2_h * (quarter_gamma / quarter_d) * (quarter_gamma / quarter_d)
        te, tn = c * w.TA - s * w.TB, s * w.TA + c * w.TB
        mu_e, mu_n = e * a + second * k * tn, e * b - second * k * te
        w.COS, w.SIN, w.EAST, w.NORTH = c, s, a, b
        w.MU_EAST, w.MU_NORTH = mu_e, mu_n
        w.JEAST, w.JNORTH = m * te - k * b, m * tn + k * a

        aa, ab, bb = w.AA, w.AB, w.BB
        ea, eb, na, nb = c * aa - s * ab, c * ab - s * bb, s * aa + c * ab, s * ab + c * bb  # R P[b, b]
        k2, kc, spread = k * k, k * (1.0 - 2.0 * sin2_h), w.SPREAD
        w.GEE = c * ea - s * eb + k2 * (tt * b * b - g2 * te * te) + 2.0 * kc * b * te + spread * mu_e * mu_e
        w.GEN = (
            s * ea + c * eb - k2 * (tt * a * b + g2 * te * tn) + kc * (b * tn - a * te) + spread * mu_e * mu_n
        )
        w.GNN = s * na + c * nb + k2 * (tt * a * a - g2 * tn * tn) - 2.0 * kc * a * tn + spread * mu_n * mu_n


@kernel
def predict_planar8(w, u):
    """Compute a step of the process model."""
    dt, ax, ay, gz, q_scale = u[DT], u[AX], u[AY], u[GZ], u[Q_SCALE]
    _turn(w, dt, ax, ay)
    h = 0.5 * dt
    for l in range(LANES):
        c, s, ke, kn = w.COS, w.SIN, w.JEAST, w.JNORTH  # dt R; dt (k J g0 + m t)
        xt, yt, ut, vt, tt = w.XT, w.YT, w.UT, w.VT, w.TT
        xa, ya, ua, va, ta, aa = w.XA, w.YA, w.UA, w.VA, w.TA, w.AA
        xb, yb, ub, vb, tb, ab, bb = w.XB, w.YB, w.UB, w.VB, w.TB, w.AB, w.BB
        xw, yw, uw, vw, tw, aw, bw, ww = w.XW, w.YW, w.UW, w.VW, w.TW, w.AW, w.BW, w.WW
        xu, yu, uu, xv, yv, uv, vv = w.XU, w.YU, w.UU, w.XV, w.YV, w.UV, w.VV

        u, v = w.U, w.V
        u1, v1 = u + (w.EAST + w.MU_EAST), v + (w.NORTH + w.MU_NORTH)
        w.X += h * (u + u1)
        w.Y += h * (v + v1)
        w.U, w.V = u1, v1
        w.T += dt * (gz - w.W)

        # xu1 is Cov(x, u'), x1u is Cov(x', u), x1u1 is Cov(x', u'), and so on; t1 is theta'.
        xu1, xv1 = xu + ke * xt - (c * xa - s * xb), xv + kn * xt - (s * xa + c * xb)
        yu1, yv1 = yu + ke * yt - (c * ya - s * yb), yv + kn * yt - (s * ya + c * yb)
        uu1, uv1 = uu + ke * ut - (c * ua - s * ub), uv + kn * ut - (s * ua + c * ub)
        vu1, vv1 = uv + ke * vt - (c * va - s * vb), vv + kn * vt - (s * va + c * vb)
        u1t, v1t = ut + ke * tt - (c * ta - s * tb), vt + kn * tt - (s * ta + c * tb)
        u1a, v1a = ua + ke * ta - (c * aa - s * ab), va + kn * ta - (s * aa + c * ab)
        u1b, v1b = ub + ke * tb - (c * ab - s * bb), vb + kn * tb - (s * ab + c * bb)
        u1w, v1w = uw + ke * tw - (c * aw - s * bw), vw + kn * tw - (s * aw + c * bw)
        u1u1 = uu1 + (uu1 - uu) + w.GEE
        u1v1 = uv1 + (vu1 - uv) + w.GEN
        v1v1 = vv1 + (vv1 - vv) + w.GNN
        u1t1, v1t1 = u1t - dt * u1w, v1t - dt * v1w
        x1u, y1u, y1v = xu + h * (uu + uu1), yu + h * (uv + uv1), yv + h * (vv + vv1)
        x1u1, x1v1 = xu1 + h * (uu1 + u1u1), xv1 + h * (uv1 + u1v1)
        y1u1, y1v1 = yu1 + h * (vu1 + u1v1), yv1 + h * (vv1 + v1v1)

        w.XX += h * ((xu + xu1) + (x1u + x1u1)) + q_scale * w.Q_X
        w.XY += h * ((xv + xv1) + (y1u + y1u1))
        w.YY += h * ((yv + yv1) + (y1v + y1v1)) + q_scale * w.Q_Y
        w.XU, w.XV, w.YU, w.YV = x1u1, x1v1, y1u1, y1v1
        w.UU, w.UV, w.VV = u1u1 + q_scale * w.Q_U, u1v1, v1v1 + q_scale * w.Q_V
        w.XT = xt - dt * xw + h * ((ut - dt * uw) + u1t1)
        w.YT = yt - dt * yw + h * ((vt - dt * vw) + v1t1)
        w.UT, w.VT = u1t1, v1t1
        w.TT = tt - dt * (2.0 * tw - dt * ww) + q_scale * w.Q_T
        w.XA, w.XB, w.XW = xa + h * (ua + u1a), xb + h * (ub + u1b), xw + h * (uw + u1w)
        w.YA, w.YB, w.YW = ya + h * (va + v1a), yb + h * (vb + v1b), yw + h * (vw + v1w)
        w.UA, w.UB, w.UW, w.VA, w.VB, w.VW = u1a, u1b, u1w, v1a, v1b, v1w
        w.TA, w.TB, w.TW = ta - dt * aw, tb - dt * bw, tw - dt * ww
        w.AA = aa + q_scale * w.Q_A
        w.BB = bb + q_scale * w.Q_B
        w.WW = ww + q_scale * w.Q_W
