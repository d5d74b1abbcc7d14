"""Evolutionary algorithms on real numbers: a genetic algorithm, and differential evolution."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import AskTell

CROSSOVER, CROSSOVER_INDEX, MUTATION_INDEX = 0.9, 15.0, 20.0
"""Probability of crossover, and indices eta of crossover and mutation; higher indices cause smaller changes."""


class GeneticAlgorithm(AskTell):
    """Tournaments, simulated binary crossover, polynomial mutation, elitism.

    K. Deb and R. B. Agrawal, Complex Systems 9, 115-148, 1995; bounded crossover and mutation: K. Deb, Comput. Methods
    Appl. Mech. Engrg. 186, 311-338, 2000.
    """

    name = "ga"
    saved = ("members", "member_costs")
    crossover: float = CROSSOVER
    crossover_index: float = CROSSOVER_INDEX
    """Index eta_c of the crossover."""
    mutation_index: float = MUTATION_INDEX
    """Index eta_m of the mutation."""

    def _begin(self) -> Array:
        self.members = super()._begin()
        self.member_costs = np.full(self.population, np.inf)
        return self.members.copy()

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

    ``parents``, shape (m, d), have ``costs``, shape (m,). ``bounds``: lower and upper bounds, shape (d,).
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


class DifferentialEvolution(AskTell):
    """R. Storn and K. Price, J. Global Optimization 11, 341-359, 1997.

    The schemes are rand/1/bin and best/1/bin, with a scale factor that is drawn in every generation (dither).
    """

    name = "de"
    saved = ("members", "member_costs")
    base: Literal["best", "rand"] = "best"
    """Base vector: the best member, or a random member."""
    scale: tuple[float, float] = (0.5, 1.0)
    """Range of the scale factor F."""
    crossover: float = 0.7
    """CR, the probability that a coordinate comes from the mutant."""

    def _begin(self) -> Array:
        self.members = super()._begin()
        self.member_costs = np.full(self.population, np.inf)
        return self.members.copy()

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
