"""Updates of mean and covariance; the caller has computed nu, S and C of the measurement in every lane."""

# pyright: basic, reportCallIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false

from sigmaswarm.filters.compiled.layout import C1, C2, LANES, R, at
from sigmaswarm.filters.compiled.tilted12 import fold


def update_scalar(w, *, n):
    """Update with a scalar z: x += C nu / S, P -= C C^T / S, with S, nu and C in S11, N1 and C1."""
    for l in range(LANES):
        w[R.SIN_COS_VALID, l], w[R.SIN_COS_VALID_ALL, l] = 0.0, 0.0
        g = 1.0 / w[R.S11, l]
        for j in range(n):
            gain = g * w[C1 + j, l]
            w[j, l] += gain * w[R.N1, l]
            for i in range(j + 1):
                w[at(i, j), l] -= gain * w[C1 + i, l]


def update_pair(w, *, n, tilted):
    """Update with a z of two components: x += C G nu, P -= C G C^T, with G = S^-1, or 0 for a rejected z."""
    for l in range(LANES):
        g11, g12, g22 = w[R.G11, l], w[R.G12, l], w[R.G22, l]
        w[R.SIN_COS_VALID, l], w[R.SIN_COS_VALID_ALL, l] = 0.0, 0.0
        for j in range(n):
            gain_1, gain_2 = w[C1 + j, l] * g11 + w[C2 + j, l] * g12, w[C1 + j, l] * g12 + w[C2 + j, l] * g22
            w[j, l] += gain_1 * w[R.N1, l] + gain_2 * w[R.N2, l]
            for i in range(j + 1):
                w[at(i, j), l] -= gain_1 * w[C1 + i, l] + gain_2 * w[C2 + i, l]
        for i in range(n):
            w[R.OK, l] = w[R.OK, l] if w[at(i, i), l] > 0.0 else 0.0
    if tilted:
        fold(w)
