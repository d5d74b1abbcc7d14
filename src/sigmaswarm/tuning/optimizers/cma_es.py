"""CMA-ES: a normal distribution that adapts to the costs of its samples.

N. Hansen, The CMA evolution strategy: a tutorial, arXiv:1604.00772v2, 2023; numbers in comments refer to equations in
this tutorial. CMA-ES libraries are not used, since they can save their state only as pickles.

A sample outside the bounds is drawn once more. If the second sample is also outside, its cost is the cost of its
projection on the bounds plus a penalty. The penalty is that of N. Hansen et al., IEEE Trans. Evolutionary Computation
13, 180-197, 2009, with a constant weight. Repeated drawing until all samples are inside would keep the search away from
an optimum on a bound.
"""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import AskTell

INITIAL_STEP = 0.3  # in widths of the bounds, as the tutorial recommends
MIN_WIDTH, MAX_WIDTH, MAX_CONDITION = 1e-12, 10.0, 1e14
"""Limits of the largest standard deviation, in widths of the bounds, and of the covariance's condition number.

If a limit is exceeded, the search restarts.
"""


class CmaEs(AskTell):
    name = "cma-es"
    saved = ("mean", "step", "covariance", "step_path", "path", "generation", "samples")
    step: float = INITIAL_STEP
    """Initial standard deviation, in widths of the bounds."""

    def _begin(self) -> Array:
        self.first_step, self.width = self.step, self.high - self.low
        self._constants(self.population, len(self.low))
        self._restart(np.full(len(self.low), 0.5))
        return self._next()

    def begin_near(self, point: Array) -> None:
        self._restart((point - self.low) / self.width)
        self.positions = np.clip(self._next(), self.low, self.high)

    def _constants(self, n: int, d: int) -> None:
        raw = np.log((n + 1) / 2) - np.log(np.arange(1, n + 1))  # (49)
        better, worse = raw[: n // 2], raw[n // 2 :]
        mu = np.sum(better) ** 2 / np.sum(better**2)
        mu_worse = np.sum(worse) ** 2 / np.sum(worse**2)
        self.c_path = (4 + mu / d) / (d + 4 + 2 * mu / d)  # (56)
        self.c_one = 2 / ((d + 1.3) ** 2 + mu)  # (57)
        self.c_mu = min(1 - self.c_one, 2 * (0.25 + mu + 1 / mu - 2) / ((d + 2) ** 2 + mu))  # (58)
        negative = min(
            1 + self.c_one / self.c_mu,  # (50)
            1 + 2 * mu_worse / (mu + 2),  # (51)
            (1 - self.c_one - self.c_mu) / (d * self.c_mu),  # (52)
        )
        worse_weights = negative * worse / np.sum(np.abs(worse))
        self.weights = np.concatenate([better / np.sum(better), worse_weights])  # (53)
        self.c_step = (mu + 2) / (d + mu + 5)  # (55)
        self.damping = 1 + 2 * max(0.0, np.sqrt((mu - 1) / (d + 1)) - 1) + self.c_step
        self.mu_eff = mu
        self.expected_length = np.sqrt(d) * (1 - 1 / (4 * d) + 1 / (21 * d**2))  # length of a normal vector

    def _restart(self, mean: Array) -> None:
        d = len(mean)
        self.mean, self.step, self.covariance = mean, self.first_step, np.eye(d)
        self.step_path, self.path, self.generation = np.zeros(d), np.zeros(d), 0

    def _next(self) -> Array:
        variances, axes = np.linalg.eigh(self.covariance)
        width = self.step * np.sqrt(max(variances[-1], 0.0))
        if not MIN_WIDTH < width < MAX_WIDTH or variances[0] * MAX_CONDITION < variances[-1]:
            self._restart(self.rng.random(len(self.mean)))
            variances, axes = np.linalg.eigh(self.covariance)
        self.samples = self._drawn(self.population, variances, axes)
        outside = np.any((self.samples < 0) | (self.samples > 1), axis=1)
        self.samples[outside] = self._drawn(int(outside.sum()), variances, axes)
        return self.low + self.samples * self.width

    def _drawn(self, n: int, variances: Array, axes: Array) -> Array:
        z = self.rng.standard_normal((n, len(self.mean)))  # (38)
        return self.mean + self.step * (z * np.sqrt(variances)) @ axes.T  # (39, 40)

    def _penalized(self, costs: Array) -> Array:
        """Add to each cost a penalty for the distance by which its sample lies outside the bounds.

        The penalty is the squared distance, divided by the variance of the samples, times the interquartile range of
        the costs.
        """
        outside = np.mean((self.samples - np.clip(self.samples, 0.0, 1.0)) ** 2, axis=1)
        lower, upper = np.percentile(costs[np.isfinite(costs)], [25, 75])
        return costs + (upper - lower) * outside / (self.step**2 * np.mean(np.diag(self.covariance)))

    def _learn(self, costs: Array) -> None:
        if costs.min() == costs.max():  # a plateau has no information: restart elsewhere
            self._restart(self.rng.random(len(self.mean)))
            return
        n, d = self.positions.shape
        mu = n // 2
        order = np.argsort(self._penalized(costs), kind="stable")
        y = (self.samples[order] - self.mean) / self.step
        shift = self.weights[:mu] @ y[:mu]  # (41)
        variances, axes = np.linalg.eigh(self.covariance)
        whitening = (axes / np.sqrt(variances)) @ axes.T  # C^(-1/2)
        self.mean = self.mean + self.step * shift  # (42)
        keep = 1 - self.c_step
        self.step_path = keep * self.step_path + np.sqrt(self.c_step * (2 - self.c_step) * self.mu_eff) * (
            whitening @ shift
        )  # (43)
        length = np.linalg.norm(self.step_path)
        self.generation += 1
        steady = (
            length / np.sqrt(1 - keep ** (2 * self.generation)) < (1.4 + 2 / (d + 1)) * self.expected_length
        )
        self.path = (1 - self.c_path) * self.path + steady * np.sqrt(
            self.c_path * (2 - self.c_path) * self.mu_eff
        ) * shift  # (45)
        lengths = np.sum((y @ whitening) ** 2, axis=1)
        weights = np.where(self.weights >= 0, self.weights, self.weights * d / (lengths + 1e-300))  # (46)
        lost = (1 - steady) * self.c_path * (2 - self.c_path)
        self.covariance = (
            (1 + self.c_one * lost - self.c_one - self.c_mu * np.sum(self.weights)) * self.covariance
            + self.c_one * np.outer(self.path, self.path)
            + self.c_mu * (y.T * weights) @ y
        )  # (47)
        growth = np.exp(self.c_step / self.damping * (length / self.expected_length - 1))
        self.step = float(self.step * growth)  # (44)
