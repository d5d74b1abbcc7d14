"""The mixture of a bank's filters: one mean and covariance."""

from dataclasses import dataclass

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.filters.compiled.live import ROUNDING
from sigmaswarm.filters.models import THETA
from sigmaswarm.filters.packing import state_estimate
from sigmaswarm.geodesy import wrap_angle


@dataclass(frozen=True, eq=False)
class Mixture:
    """Means (k, n) and covariances (k, n, n) of a mixture at k times.

    Headings are averaged as wrapped differences from the heading of the filter with the largest weight.
    """

    mean: Array
    covariance: Array

    @classmethod
    @np.errstate(all="ignore")  # failed filters have no weight
    def of(cls, states: Array, weights: Array, model: str) -> "Mixture":
        """Mix state rows (k, s, LANES) with weights (k, LANES); the result is NaN where all weights are 0."""
        mean, covariance = state_estimate(states, model)  # (k, LANES, n), (k, LANES, n, n)
        sound = np.isfinite(mean.sum(axis=2) + covariance.sum(axis=(2, 3)))
        weights = np.where(sound, weights, 0.0)
        total = weights.sum(axis=1, keepdims=True)
        weights = np.divide(weights, total, out=np.full_like(weights, np.nan), where=total > 0.0)
        leader = np.argmax(weights, axis=1)
        from_leader = mean - mean[np.arange(len(mean)), leader][:, np.newaxis]
        from_leader[:, :, THETA] = wrap_angle(from_leader[:, :, THETA])
        out = weights == 0.0  # including filters with NaN
        from_leader[out], covariance[out] = 0.0, 0.0
        middle = np.einsum("kl,kln->kn", weights, from_leader)
        off = from_leader - middle[:, np.newaxis]
        between = np.einsum("kl,kln,klm->knm", weights, off, off)
        together = np.einsum("kl,klnm->knm", weights, covariance) + between
        return cls(mean[np.arange(len(mean)), leader] + middle, together)


def is_definite(covariance: Array) -> bool:
    """Return True if a covariance (n, n) is finite and positive semidefinite, up to rounding."""
    variance = covariance.diagonal()
    if not (np.isfinite(covariance).all() and variance.min() >= 0.0):
        return False
    scale = np.sqrt(variance)
    scale[scale == 0.0] = 1.0
    correlations = covariance / scale / scale[:, np.newaxis]
    try:
        np.linalg.cholesky(correlations + ROUNDING * np.eye(len(scale)))
    except np.linalg.LinAlgError:
        return False
    return True
