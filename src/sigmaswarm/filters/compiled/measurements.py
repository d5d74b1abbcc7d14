"""What the compiled filter absorbs: fixes, velocities, and what a car on its wheels can't do.

Each measurement fills, lane by lane, the innovation nu, its variance S and the covariances C = Cov(state, z); then
`_absorb_two` or `_absorb_one` does x += C S^-1 nu, P -= C S^-1 C^T. In an unscented filter nu, S and C come from sigma
points. Where z is linear in the state they are the Kalman filter's; where it turns something by the heading they have
a closed form, as in planar5.py and planar8.py.

Loops over states (i, j, row) are written out for the model's n by `unroll.unrolled`; `absorbers` gives the result.
"""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

import math

from sigmaswarm.filters.compiled.lanes import *
from sigmaswarm.filters.compiled.unroll import unrolled

MOST_REJECTED = 5
"""So many fixes in a row may the gate turn away; the next one is absorbed, or a filter that lost its way never finds
back."""


def at(i, j):
    """Row of P[i, j]."""
    low, high = min(i, j), max(i, j)
    return P0 + high * (high + 1) // 2 + low


def absorb_fix(w, zx, zy, lever_x, lever_y, since, *, n):
    """A position fix of the antenna; ``since`` is Q's scale since the last fix.

    What no lane needs is left out; what other lanes need does not change a bit.
    """
    fading, adapting = 0, 0
    for l in range(LANES):
        fading += w[FADING, l] >= 0.0
        adapting += w[FORGETTING, l] < 1.0
    _measure_fix(w, zx, zy, lever_x, lever_y)
    for l in range(LANES):
        inside = (_look(w, l) <= w[GATE, l]) | (w[REJECTED, l] >= MOST_REJECTED)
        w[USE, l] = 1.0 if inside else 0.0
        w[REJECTED, l] = 0.0 if inside else w[REJECTED, l] + 1.0
    if fading > 0:
        _fade(w)
    for l in range(LANES):
        rx, ry, use = w[RX, l], w[RY, l], w[USE, l]
        s11, s12, s22 = w[S11, l] + rx, w[S12, l], w[S22, l] + ry
        det = s11 * s22 - s12 * s12
        g11, g12, g22 = s22 / det, -s12 / det, s11 / det
        n1, n2 = w[N1, l], w[N2, l]
        e1, e2 = g11 * n1 + g12 * n2, g12 * n1 + g22 * n2
        w[OK, l] = w[OK, l] if (s11 > 0.0) & (det > 0.0) & (rx > 0.0) & (ry > 0.0) else 0.0
        w[G11, l], w[G12, l], w[G22, l] = use * g11, use * g12, use * g22
        # The residual after the update is R S^-1 nu; all of nu where the fix was turned away.
        r1, r2 = (rx * e1 if use > 0.0 else n1), (ry * e2 if use > 0.0 else n2)
        w[SQ_FIX, l] += r1 * r1 + r2 * r2
        w[GEE, l] += rx
        w[GNN, l] += ry
    if adapting > 0:
        _adapt(w, since)
    _absorb_two(w)
    _keep_digits(w)


def forecast_fix(w, zx, zy, lever_x, lever_y, *, n):
    """A fix that the filter does not get to see: only its forecast is scored."""
    _measure_fix(w, zx, zy, lever_x, lever_y)
    for l in range(LANES):
        _look(w, l)
        w[SQ_FORECAST, l] += w[N1, l] * w[N1, l] + w[N2, l] * w[N2, l]


@kernel
def _look(w, l):
    """Add what a fix says of the filter's own S, before it is absorbed; gives its NIS."""
    s11, s12, s22 = w[S11, l] + w[RX, l], w[S12, l], w[S22, l] + w[RY, l]
    det = s11 * s22 - s12 * s12
    n1, n2 = w[N1, l], w[N2, l]
    nis = (s22 * n1 * n1 - 2.0 * s12 * n1 * n2 + s11 * n2 * n2) / det
    w[V11, l], w[V12, l], w[V22, l] = s11, s12, s22
    w[NIS, l] += nis
    w[DET, l] *= det
    return nis


def _measure_fix(w, zx, zy, lever_x, lever_y, *, n):
    """z = p + R(theta) lever - latency v: nu, H P H^T and C.

    R(theta) lever turns with theta alone, so its sigma points have planar5's closed form.
    """
    for l in range(LANES):
        for row in (EAST, NORTH, JEAST, JNORTH, E):
            w[row, l] = 0.0
    if lever_x != 0.0 or lever_y != 0.0:
        _turn_lever(w, lever_x, lever_y)
    for l in range(LANES):
        tau, east, north, e = w[LATENCY, l], w[EAST, l], w[NORTH, l], w[E, l]
        je, jn = w[JEAST, l], w[JNORTH, l]
        along = w[SPREAD, l] * e * e
        w[GEE, l], w[GEN, l], w[GNN, l] = along * east * east, along * east * north, along * north * north
        w[N1, l] = zx - (w[X, l] - tau * w[U, l] + (1.0 + e) * east)
        w[N2, l] = zy - (w[Y, l] - tau * w[V, l] + (1.0 + e) * north)
        for i in range(n):
            w[C1 + i, l] = w[at(i, X), l] - tau * w[at(i, U), l] + je * w[at(i, T), l]
            w[C2 + i, l] = w[at(i, Y), l] - tau * w[at(i, V), l] + jn * w[at(i, T), l]
        w[S11, l] = w[C1 + X, l] - tau * w[C1 + U, l] + je * w[C1 + T, l] + w[GEE, l]
        w[S12, l] = w[C1 + Y, l] - tau * w[C1 + V, l] + jn * w[C1 + T, l] + w[GEN, l]
        w[S22, l] = w[C2 + Y, l] - tau * w[C2 + V, l] + jn * w[C2 + T, l] + w[GNN, l]


@kernel
def _turn_lever(w, lever_x, lever_y):
    """R(theta) lever, k J R(theta) lever, and e: what the heading and its spread make of the lever arm."""
    for l in range(LANES):
        second = w[SECOND, l]
        sin_t, cos_t = sincos(w[T, l])
        east, north = cos_t * lever_x - sin_t * lever_y, sin_t * lever_x + cos_t * lever_y
        d = w[GAMMA, l] * math.sqrt(w[TT, l]) + 1e-300
        sin_d, sin2_h = double_angle(0.5 * d)
        k = 1.0 + second * (sin_d / d - 1.0)
        w[EAST, l], w[NORTH, l], w[E, l] = east, north, -2.0 * second * w[INV_GAMMA2, l] * sin2_h
        w[JEAST, l], w[JNORTH, l] = -k * north, k * east


def _keep_digits(w, *, n):
    """The position's rows of P once more, from P+ H^T = C S^-1 R, which subtracts nothing large.

    P - C S^-1 C^T loses the digits of a variance that a fix shrinks a billionfold. H has 1 at the position, -latency at
    the velocity and k J R(theta) lever at the heading; R is what S holds beside H P H^T.
    """
    for l in range(LANES):
        used = w[G11, l] != 0.0
        tau, je, jn = w[LATENCY, l], w[JEAST, l], w[JNORTH, l]
        r1, r12, r2 = w[GEE, l], w[GEN, l], w[GNN, l]
        for j in (*range(2, n), 0, 1):
            gain_1 = w[C1 + j, l] * w[G11, l] + w[C2 + j, l] * w[G12, l]
            gain_2 = w[C1 + j, l] * w[G12, l] + w[C2 + j, l] * w[G22, l]
            x = gain_1 * r1 + gain_2 * r12 + tau * w[at(j, U), l] - je * w[at(j, T), l]
            y = gain_1 * r12 + gain_2 * r2 + tau * w[at(j, V), l] - jn * w[at(j, T), l]
            if j != Y:
                w[at(j, X), l] = x if used else w[at(j, X), l]
            w[at(j, Y), l] = y if used else w[at(j, Y), l]


def _fade(w, *, n):
    """Strong tracking: stretch P so far that the recent size of the innovations is explained (FADING < 0: off).

    After D. H. Zhou and P. M. Frank, Strong tracking filtering of nonlinear time-varying stochastic systems with
    coloured noise, Int. J. Control 65(2), 1996: the single fading factor, from the traces. Two things are not theirs.
    The innovations are averaged with weights rho and 1 - rho; theirs, rho and 1 over 1 + rho, hardly look back. And
    only what the fix sees of P is stretched, P + (factor - 1) C (H P H^T)^-1 C^T: what it can't see would grow on.
    """
    for l in range(LANES):
        rho = w[FADING, l]
        size = w[N1, l] * w[N1, l] + w[N2, l] * w[N2, l]
        recent = size if w[RECENT, l] < 0.0 else rho * w[RECENT, l] + (1.0 - rho) * size
        used = (rho >= 0.0) & (w[USE, l] > 0.0)
        w[RECENT, l] = recent if used else w[RECENT, l]
        s11, s12, s22 = w[S11, l] - w[GEE, l], w[S12, l] - w[GEN, l], w[S22, l] - w[GNN, l]  # H P H^T
        wanted = (recent - w[RX, l] - w[RY, l]) / (s11 + s22)
        factor = wanted if used & (wanted > 1.0) else 1.0
        more = (factor - 1.0) / (s11 * s22 - s12 * s12) if factor > 1.0 else 0.0
        for j in range(n):
            c1, c2 = w[C1 + j, l], w[C2 + j, l]
            gain_1, gain_2 = more * (s22 * c1 - s12 * c2), more * (s11 * c2 - s12 * c1)
            for i in range(j + 1):
                w[at(i, j), l] += gain_1 * w[C1 + i, l] + gain_2 * w[C2 + i, l]
        w[S11, l] += (factor - 1.0) * s11
        w[S12, l] += (factor - 1.0) * s12
        w[S22, l] += (factor - 1.0) * s22
        for row in (*range(C1, C1 + n), *range(C2, C2 + n)):
            w[row, l] *= factor


def _adapt(w, since, *, n):
    """Adapt Q and R to what a fix says, with weight 1 - FORGETTING (1: off).

    A. P. Sage and G. W. Husa, Adaptive filtering with unknown prior statistics, JACC 1969, in the steady state of
    their weights (1 - b) / (1 - b^(k+1)). R from the residual after the update, eps eps^T + H P+ H^T, positive by
    construction; Q from K nu nu^T K^T + P+ - (P- - Q), of which no negative value is taken. A second fix of the same
    moment (since = 0) says nothing of Q.
    """
    span = since if since > 0.0 else math.inf
    for l in range(LANES):
        g11, g12, g22 = w[G11, l], w[G12, l], w[G22, l]
        weight = 1.0 - w[FORGETTING, l] if g11 > 0.0 else 0.0  # a fix that was turned away teaches nothing
        e1, e2 = g11 * w[N1, l] + g12 * w[N2, l], g12 * w[N1, l] + g22 * w[N2, l]
        rx, ry = w[RX, l], w[RY, l]
        w[RX, l] = rx + weight * rx * rx * (e1 * e1 - g11)  # H P+ H^T = R - R S^-1 R
        w[RY, l] = ry + weight * ry * ry * (e2 * e2 - g22)
        for i in range(n):
            c1, c2 = w[C1 + i, l], w[C2 + i, l]
            moved = c1 * e1 + c2 * e2
            shrunk = c1 * (c1 * g11 + c2 * g12) + c2 * (c1 * g12 + c2 * g22)
            change = (moved * moved - shrunk) / span
            q = w[Q0 + i, l]
            w[Q0 + i, l] = q + weight * (change if change > -q else -q)


def absorb_velocity(w, zu, zv, *, n):
    """The receiver's velocity over ground, m/s east and north; linear in the state."""
    _take_velocity(w, zu, zv, R_VELOCITY)


def absorb_standstill(w, gz, *, n):
    """The car stands: it has no velocity, and all that the gyro shows is its bias (planar8)."""
    _take_velocity(w, 0.0, 0.0, R_STANDSTILL)
    if n > W:
        for l in range(LANES):
            w[N1, l] = gz - w[W, l]
            w[S11, l] = w[at(W, W), l] + w[R_RATE, l]
            for i in range(n):
                w[C1 + i, l] = w[at(i, W), l]
        _absorb_one(w)


def _take_velocity(w, zu, zv, variance, *, n):
    """Absorb a velocity; then its rows of P once more from P+ H^T = C S^-1 R, as in `_keep_digits`."""
    for l in range(LANES):
        w[N1, l], w[N2, l] = zu - w[U, l], zv - w[V, l]
        s11, s12, s22 = w[UU, l] + w[variance, l], w[UV, l], w[VV, l] + w[variance, l]
        det = s11 * s22 - s12 * s12
        w[G11, l], w[G12, l], w[G22, l] = s22 / det, -s12 / det, s11 / det
        for i in range(n):
            w[C1 + i, l], w[C2 + i, l] = w[at(i, U), l], w[at(i, V), l]
    _absorb_two(w)
    for l in range(LANES):
        r, g11, g12, g22 = w[variance, l], w[G11, l], w[G12, l], w[G22, l]
        for i in range(n):
            w[at(i, U), l] = r * (w[C1 + i, l] * g11 + w[C2 + i, l] * g12)
            w[at(i, V), l] = r * (w[C1 + i, l] * g12 + w[C2 + i, l] * g22)


def absorb_lateral(w, gz, *, n):
    """A car does not slide sideways at its rear axle: 0 = (R(theta)^T v)_left - rear_axle (yaw rate - w).

    R(theta)^T v is bilinear in heading and velocity: planar8.py's closed form, turned back into the body, with
    t = R^T P[v, theta] and mu = (e R^T v - k J t)_left.
    """
    for l in range(LANES):
        second, gamma, axle, tt = w[SECOND, l], w[GAMMA, l], w[REAR_AXLE, l], w[TT, l]
        s, c = sincos(w[T, l])
        d = gamma * math.sqrt(tt) + 1e-300
        sin_d, sin2_h = double_angle(0.5 * d)
        sin2_h = second * sin2_h
        e = -2.0 * w[INV_GAMMA2, l] * sin2_h
        k = 1.0 + second * (sin_d / d - 1.0)
        m = 2.0 * sin2_h * (gamma / d) * (gamma / d)
        forward, left = c * w[U, l] + s * w[V, l], c * w[V, l] - s * w[U, l]
        t_forward, t_left = c * w[UT, l] + s * w[VT, l], c * w[VT, l] - s * w[UT, l]
        mu = e * left - second * k * t_forward
        turn = k * forward + m * t_left
        variance = c * c * w[VV, l] - 2.0 * c * s * w[UV, l] + s * s * w[UU, l]
        variance += k * k * (tt * forward * forward - second * gamma * gamma * t_left * t_left)
        variance += w[SPREAD, l] * mu * mu - 2.0 * k * (1.0 - 2.0 * sin2_h) * forward * t_left
        w[N1, l] = axle * gz - left - mu
        for i in range(n):
            w[C1 + i, l] = c * w[at(i, V), l] - s * w[at(i, U), l] - turn * w[at(i, T), l]
        if n > W:  # the yaw rate has a bias, too
            w[N1, l] -= axle * w[W, l]
            variance += 2.0 * axle * w[C1 + W, l] + axle * axle * w[at(W, W), l]
            for i in range(n):
                w[C1 + i, l] += axle * w[at(i, W), l]
        w[S11, l] = variance + w[R_LATERAL, l]
    _absorb_one(w)


def _absorb_one(w, *, n):
    """x += C nu / S, P -= C C^T / S, for a scalar z; S, nu and C in rows S11, N1 and C1."""
    for l in range(LANES):
        g = 1.0 / w[S11, l]
        for j in range(n):
            gain = g * w[C1 + j, l]
            w[j, l] += gain * w[N1, l]
            for i in range(j + 1):
                w[at(i, j), l] -= gain * w[C1 + i, l]


def _absorb_two(w, *, n):
    """x += C G nu, P -= C G C^T, for z with two components; G = S^-1, or zero, in rows G11, G12, G22."""
    for l in range(LANES):
        g11, g12, g22 = w[G11, l], w[G12, l], w[G22, l]
        for j in range(n):
            gain_1, gain_2 = w[C1 + j, l] * g11 + w[C2 + j, l] * g12, w[C1 + j, l] * g12 + w[C2 + j, l] * g22
            w[j, l] += gain_1 * w[N1, l] + gain_2 * w[N2, l]
            for i in range(j + 1):
                w[at(i, j), l] -= gain_1 * w[C1 + i, l] + gain_2 * w[C2 + i, l]
        for i in range(n):
            w[OK, l] = w[OK, l] if w[at(i, i), l] > 0.0 else 0.0


def absorbers(n):
    """`forecast_fix` and the four `absorb_...` functions, compiled for a model of n states."""
    ready = {"n": n}
    for function in (_absorb_one, _absorb_two, _keep_digits, _measure_fix, _take_velocity, _fade, _adapt):
        ready[function.__name__] = kernel(unrolled(function, **ready))
    public = (absorb_fix, forecast_fix, absorb_velocity, absorb_standstill, absorb_lateral)
    return {function.__name__: kernel(unrolled(function, **ready)) for function in public}
