"""Extended precision: arithmetic of the oracles, and errors of a filter in double precision.

On x86, ``numpy.longdouble`` has 64 bits of mantissa. LAPACK does not support it, so factors and inverses are computed
in loops. Leading axes are parameter sets.
"""

import numpy as np

Extended = np.longdouble
PI = Extended("3.14159265358979323846264338327950288")
THETA = 4


def wrap(angle: np.ndarray) -> np.ndarray:
    """Wrap to [-pi, pi); an angle in this range keeps its bits."""
    return angle - 2 * PI * np.floor(angle / (2 * PI) + Extended(0.5))


def cholesky(p: np.ndarray) -> np.ndarray:
    """Return the lower Cholesky factor of (s, n, n), computed column by column."""
    n = p.shape[-1]
    factor = np.zeros_like(p)
    for j in range(n):
        rest = p[:, j:, j] - np.einsum("sik,sk->si", factor[:, j:, :j], factor[:, j, :j])
        factor[:, j:, j] = rest / np.sqrt(rest[:, :1])
    return factor


def whiten(p: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return L^-1 B for P = L L^T (s, n, n) and B (s, n, m). Its square B^T P^-1 B is exactly symmetric."""
    factor, x = cholesky(p), b.astype(Extended)
    for i in range(p.shape[-1]):
        x[:, i] = (x[:, i] - np.einsum("sk,skm->sm", factor[:, i, :i], x[:, :i])) / factor[:, i, i, None]
    return x


def transposed(a: np.ndarray) -> np.ndarray:
    return a.swapaxes(-1, -2)


def diagonal(a: np.ndarray) -> np.ndarray:
    return np.diagonal(a, axis1=-2, axis2=-1)


def mean_error(mean: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the largest difference of two means (..., n), relative to max(1, |x_i|) of ``other``; heading wrapped."""
    difference = np.asarray(mean, dtype=Extended) - other
    difference[..., THETA] = wrap(difference[..., THETA])
    return np.max(np.abs(difference) / np.maximum(1, np.abs(other)), axis=-1).astype(float)


def covariance_error(covariance: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the largest difference of two covariances (..., n, n), relative to sqrt(P_ii P_jj) of ``other``."""
    std = np.sqrt(diagonal(other))
    scale = std[..., :, None] * std[..., None, :]
    difference = np.asarray(covariance, dtype=Extended) - other
    return np.max(np.abs(difference) / scale, axis=(-2, -1)).astype(float)
