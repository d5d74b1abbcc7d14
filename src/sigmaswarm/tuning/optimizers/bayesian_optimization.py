"""Bayesian optimization: a Gaussian process of the costs selects the next points.

Expected improvement: J. Mockus, V. Tiesis and A. Zilinskas, 1978; D. R. Jones, M. Schonlau and W. J. Welch, J. Global
Optimization 13, 455-492, 1998. Batches: the kriging believer of D. Ginsbourger, R. Le Riche and L. Carraro, Kriging is
well-suited to parallelize optimization, 2010. The state consists of points, costs and generator; it contains no length
scales, since scikit-learn fits them for each batch.
"""

import threading
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.config import require_packages
from sigmaswarm.tuning.optimizers.asktell import AskTell, SobolSearch

MAX_POINTS = 200  # largest number n of costs in a fit; the time of a fit is proportional to n^3
NOISE = 1e-6  # variance of the noise of a cost, relative to the variance of all costs
MIN_VARIANCE = 1e-12  # smallest variance of a predicted cost, relative to the variance of all costs
N_BEST, NEAR_STD = 5, 0.02
"""Number of best points, and standard deviation of the candidates that are drawn near them, in widths of the bounds.

Half of the candidates are drawn near the best points.
"""
MIN_LENGTH_SCALE, MAX_LENGTH_SCALE = 0.2, 10.0  # smallest and largest length scale, in widths of the bounds
_LOCK = threading.Lock()
"""Lock for fits, since warning filters and thread limits apply to the whole process."""


class BayesianOptimization(AskTell):
    """Points with the highest expected improvement, after initial Sobol' points."""

    name = "bo"
    saved = ("points", "costs")
    batch: int = 1
    """Number of points that are evaluated between two fits of the Gaussian process.

    A larger batch needs less time for fits, but more evaluations to reach the same value of the objective.
    """
    candidates: int = 2000
    searches: int = 3
    """Number of local searches from the best candidates."""

    def _begin(self) -> Array:
        require_packages("bo")
        self.points, self.costs = np.empty((0, len(self.low))), np.empty(0)
        return SobolSearch(self.low, self.high, self.population, self.rng).ask()

    def _learn(self, costs: Array) -> None:
        self.points = np.concatenate([self.points, self.positions])
        self.costs = np.concatenate([self.costs, costs])

    def _next(self) -> Array:
        if not np.isfinite(self.costs).any():
            return self.rng.uniform(self.low, self.high, (self.batch, len(self.low)))
        chosen = self._remembered()
        points = (self.points[chosen] - self.low) / (self.high - self.low)
        found = next_points(
            points,
            normalized_costs(self.costs[chosen]),
            self.batch,
            (self.candidates, self.searches),
            self.rng,
        )
        return self.low + found * (self.high - self.low)

    def _remembered(self) -> NDArray[np.intp]:
        last = len(self.costs) - MAX_POINTS // 2
        if last <= MAX_POINTS // 2:
            return np.arange(len(self.costs))
        best = np.argsort(self.costs, kind="stable")[: MAX_POINTS // 2]
        return np.union1d(best, np.arange(last, len(self.costs)))


def normalized_costs(costs: Array) -> Array:
    """Transform costs, shape (n,), to log(1 + (cost - best) / (median - best)); at least one cost must be finite.

    A diverged filter may cost a thousand times as much as a good one. Without the transformation, the Gaussian process
    would be flat near the best point.
    """
    finite = np.isfinite(costs)
    filled = np.where(finite, costs, costs[finite].max())
    above = filled - filled.min()
    usual = np.median(above) or above.max() or 1.0
    return np.log1p(above / usual)


def next_points(
    points: Array, costs: Array, count: int, effort: tuple[int, int], rng: np.random.Generator
) -> Array:
    """Select ``count`` points with the highest expected improvement in the unit cube, shape (count, d).

    ``effort`` contains the numbers of candidates and of local searches.
    """
    # One thread, since the rounding depends on the number of threads. For small matrices, more threads are not faster.
    from threadpoolctl import threadpool_limits

    n = len(points)
    with _LOCK, threadpool_limits(1, "blas"):
        lengths = _fitted(points, costs)
        while len(points) < n + count:
            improvement = Improvement(lengths, points, costs)
            point = _highest(improvement, points[np.argsort(costs, kind="stable")[:N_BEST]], effort, rng)
            points = np.vstack([points, point])
            costs = np.append(costs, improvement.forecast(point))
    return points[n:]


def _fitted(points: Array, costs: Array) -> Array:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import Matern

    begin: Any = np.full(points.shape[1], 0.5)
    kernel: Any = Matern(begin, (MIN_LENGTH_SCALE, MAX_LENGTH_SCALE), nu=2.5)
    process: Any = GaussianProcessRegressor(kernel, alpha=NOISE, normalize_y=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the length of a parameter without influence is at its bound
        process.fit(points, costs)
    return np.array(process.kernel_.length_scale)


class Improvement:
    """Expected improvement over the lowest cost, in standard deviations of the costs, for points in the unit cube."""

    def __init__(self, lengths: Array, points: Array, costs: Array) -> None:
        from scipy.linalg import cho_factor, cho_solve  # 0.1 s to import
        from scipy.special import ndtr

        self._solved, self._below = cho_solve, ndtr
        self.lengths, self.points = lengths, points
        self.middle, self.scale = float(np.mean(costs)), float(np.std(costs)) or 1.0
        y = (costs - self.middle) / self.scale
        self.lowest = float(y.min())
        self.factor = cho_factor(self._kernel(points)[0] + NOISE * np.eye(len(points)), lower=True)
        self.weights = self._solved(self.factor, y)

    def _kernel(self, at: Array) -> tuple[Array, Array, Array]:
        """Return the Matern 5/2 kernel of m candidates and n points, and factors and offsets for its gradient."""
        offsets = (at[:, np.newaxis] - self.points) / self.lengths
        r = np.sqrt(5 * np.sum(offsets**2, axis=2))
        fading = np.exp(-r)
        return (1 + r + r**2 / 3) * fading, (1 + r) * fading, offsets

    def forecast(self, point: Array) -> float:
        return self.middle + self.scale * float(self._kernel(point[np.newaxis])[0][0] @ self.weights)

    def __call__(self, at: Array) -> Array:
        """Return the expected improvement, (m,), at candidates, shape (m, d) (Jones et al. 1998, equation 15)."""
        near = self._kernel(at)[0]
        variance = 1 - np.sum(near * self._solved(self.factor, near.T).T, axis=1)
        deviation = np.sqrt(np.maximum(variance, MIN_VARIANCE))
        z = (self.lowest - near @ self.weights) / deviation
        return deviation * (z * self._below(z) + _density(z))

    def negative_log_improvement(self, point: Array) -> tuple[float, Array]:
        """Return the negative logarithm of the expected improvement at a point, and its gradient, shape (d,)."""
        near, fading, offsets = (part[0] for part in self._kernel(point[np.newaxis]))
        slope = -5 / 3 * fading[:, np.newaxis] * offsets / self.lengths
        back = self._solved(self.factor, near)
        deviation = np.sqrt(max(1 - near @ back, MIN_VARIANCE))
        z = (self.lowest - near @ self.weights) / deviation
        gain = max(deviation * (z * self._below(z) + _density(z)), np.finfo(float).tiny)
        rise = -self._below(z) * (self.weights @ slope) - _density(z) * (back @ slope) / deviation
        return -float(np.log(gain)), -rise / gain


def _density(z: Array) -> Array:
    return np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)


def _highest(
    improvement: Improvement, best: Array, effort: tuple[int, int], rng: np.random.Generator
) -> Array:
    """Return the point with the highest expected improvement that local searches from the best candidates find.

    Half of the candidates are random; the other half are near the points of ``best``.
    """
    from scipy.optimize import minimize

    d, (candidates, searches) = best.shape[1], effort
    near = best[rng.integers(len(best), size=candidates // 2)] + NEAR_STD * rng.standard_normal(
        (candidates // 2, d)
    )
    tried = np.vstack([rng.random((candidates - candidates // 2, d)), np.clip(near, 0, 1)])
    ranked = np.argsort(-improvement(tried), kind="stable")
    ends = [tried[ranked[0]]]
    for start in ranked[:searches]:
        result: Any = minimize(
            improvement.negative_log_improvement,
            tried[start],
            jac=True,
            bounds=[(0, 1)] * d,
            method="L-BFGS-B",
        )
        ends.append(np.clip(result.x, 0, 1))
    return ends[int(np.argmax(improvement(np.array(ends))))]
