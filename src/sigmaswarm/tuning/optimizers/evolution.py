"""Evolutionary algorithms on real numbers: a genetic algorithm, differential evolution and CMA-ES."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import AskTell

CROSSOVER, CROSSOVER_INDEX, MUTATION_INDEX = 0.9, 15.0, 20.0
"""Probability of crossover, and indices eta of crossover and mutation; higher indices cause smaller changes."""


class _Evolution(AskTell):
    """Base of optimizers with a population: ``members`` (n, d), and their costs (n,)."""

    saved = ("members", "member_costs")

    def _begin(self) -> Array:
        self.members = super()._begin()
        self.member_costs = np.full(self.population, np.inf)
        return self.members.copy()


class GeneticAlgorithm(_Evolution):
    """Tournaments, simulated binary crossover, polynomial mutation, elitism.

    K. Deb and R. B. Agrawal, Complex Systems 9, 115-148, 1995; bounded crossover and mutation: K. Deb, Comput. Methods
    Appl. Mech. Engrg. 186, 311-338, 2000.
    """

    name = "ga"
    crossover: float = CROSSOVER
    crossover_index: float = CROSSOVER_INDEX
    """Index eta_c of the crossover."""
    mutation_index: float = MUTATION_INDEX
    """Index eta_m of the mutation."""

    def _learn(self, costs: Array) -> None:
        if np.isinf(self.member_costs).all():  # the first generation
            self.members, self.member_costs = self.positions.copy(), costs
            return
        points = np.concatenate([self.members, self.positions])
        costs_of_points = np.concatenate([self.member_costs, costs])
        survivors = np.argsort(costs_of_points, kind="stable")[: len(costs)]
        self.members, self.member_costs = points[survivors], costs_of_points[survivors]

    def _next(self) -> Array:
        children = self._bred(len(self.members))
        for _ in range(10):  # a copy of a member would waste an evaluation
            copies = np.any(np.all(children[:, np.newaxis] == self.members, axis=2), axis=1)
            if not copies.any():
                break
            children[copies] = self._bred(int(copies.sum()))
        return children

    def _bred(self, n: int) -> Array:
        bounds, members, costs = (self.low, self.high), self.members, self.member_costs
        chance, eta = self.crossover, self.crossover_index
        children = offspring(members, costs, n, bounds, self.rng, crossover=chance, eta=eta)
        return mutated(children, bounds, self.rng, eta=self.mutation_index)


def offspring(
    parents: Array,
    costs: Array,
    n: int,
    bounds: tuple[Array, Array],
    rng: np.random.Generator,
    *,
    crossover: float = CROSSOVER,
    eta: float = CROSSOVER_INDEX,
) -> Array:
    """Return children, shape (n, d), of parents that won tournaments of two.

    ``parents``, shape (m, d), have ``costs``, shape (m,). ``bounds`` are the lower and upper bounds, shape (d,).
    """
    pairs = (n + 1) // 2
    # Winners of the same round are paired, so that a member is rarely paired with itself.
    first, second = parents[_winners(costs, 2 * pairs, rng).reshape(pairs, 2).T]
    low, high = np.minimum(first, second), np.maximum(first, second)
    u = rng.random(first.shape)
    left = 0.5 * (low + high - _children_distance(u, low - bounds[0], high - low, eta))
    right = 0.5 * (low + high + _children_distance(u, bounds[1] - high, high - low, eta))
    swap = rng.random(first.shape) < 0.5
    crossed = (rng.random(first.shape) < 0.5) & (rng.random((pairs, 1)) < crossover)
    one = np.where(crossed, np.where(swap, right, left), first)
    other = np.where(crossed, np.where(swap, left, right), second)
    return np.concatenate([one, other])[:n]


def _winners(costs: Array, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Select the winners of ``n`` tournaments of two; all members take part almost equally often."""
    m = len(costs)
    rounds = np.tile(np.arange(m), (-(-2 * n // m), 1))
    one, other = rng.permuted(rounds, axis=1).ravel()[: 2 * n].reshape(n, 2).T
    return np.where(costs[one] <= costs[other], one, other)


def _children_distance(u: Array, room: Array, distance: Array, eta: float) -> Array:
    """Return the distance between two children: beta times the distance between their parents."""
    alpha = 2 - (1 + 2 * room / np.maximum(distance, 1e-200)) ** -(eta + 1)
    ua = u * alpha
    beta = np.where(ua <= 1, ua, 1 / (2 - np.minimum(ua, 2 - 1e-15))) ** (1 / (eta + 1))
    return beta * distance


def mutated(
    points: Array, bounds: tuple[Array, Array], rng: np.random.Generator, eta: float = MUTATION_INDEX
) -> Array:
    """Mutate each coordinate of points, shape (n, d), with probability 1 / d."""
    low, width = bounds[0], bounds[1] - bounds[0]
    u = rng.random(points.shape)
    below = (points - low) / width
    down = (2 * u + (1 - 2 * u) * (1 - below) ** (eta + 1)) ** (1 / (eta + 1)) - 1
    up = 1 - (2 * (1 - u) + (2 * u - 1) * below ** (eta + 1)) ** (1 / (eta + 1))
    chosen = rng.random(points.shape) < 1 / points.shape[1]
    return np.where(chosen, points + np.where(u < 0.5, down, up) * width, points)


class DifferentialEvolution(_Evolution):
    """Differential evolution: R. Storn and K. Price, J. Global Optimization 11, 341-359, 1997.

    The schemes are rand/1/bin and best/1/bin, with a scale factor that is drawn in every generation (dither).
    """

    name = "de"
    base: Literal["best", "rand"] = "best"
    """Base vector: the best member, or a random member."""
    scale: tuple[float, float] = (0.5, 1.0)
    """Range of the scale factor F."""
    crossover: float = 0.7
    """CR, the probability that a coordinate comes from the mutant."""

    def _learn(self, costs: Array) -> None:
        better = costs <= self.member_costs
        self.members[better] = self.positions[better]
        self.member_costs[better] = costs[better]

    def _next(self) -> Array:
        n, d = self.members.shape
        x, factor = self.members, self.rng.uniform(*self.scale)
        r1, r2, r3 = self._others()
        start = x[r3] if self.base == "rand" else x[np.argmin(self.member_costs)]
        mutants = start + factor * (x[r1] - x[r2])
        crossed = self.rng.random((n, d)) < self.crossover
        crossed[np.arange(n), self.rng.integers(d, size=n)] = True  # at least one coordinate is the mutant's
        return self._redrawn(np.where(crossed, mutants, x))

    def _others(self) -> list[NDArray[np.intp]]:
        """Return, for each member, the indices of three other members, distinct if there are four or more members."""
        n = len(self.members)
        order = self.rng.random((n, n))
        np.fill_diagonal(order, 2.0)  # the member itself comes last
        ranked = np.argsort(order, axis=1)
        return [ranked[:, k % n] for k in range(3)]


INITIAL_STEP = 0.3  # in widths of the bounds, as the source of `CmaEs` recommends
MIN_WIDTH, MAX_WIDTH, MAX_CONDITION = 1e-12, 10.0, 1e14
"""Limits of the largest standard deviation, in widths of the bounds, and of the covariance's condition number.

If a limit is exceeded, the search restarts.
"""


class CmaEs(AskTell):
    """CMA-ES: a normal distribution that adapts to the costs of its samples.

    N. Hansen, The CMA evolution strategy: a tutorial, arXiv:1604.00772v2, 2023; numbers in comments refer to equations
    in this tutorial. CMA-ES libraries are not used, since they can save their state only as pickles.

    A sample outside the bounds is drawn once more. If the second sample is also outside, its cost is the cost of its
    projection on the bounds plus a penalty. The penalty is that of N. Hansen et al., IEEE Trans. Evolutionary
    Computation 13, 180-197, 2009, with a constant weight. Repeated drawing until all samples are inside would keep the
    search away from an optimum on a bound.
    """

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
