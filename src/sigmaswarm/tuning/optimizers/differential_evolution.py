"""Differential evolution: trial points from differences between members of the population.

R. Storn and K. Price, Differential evolution, J. Global Optimization 11, 341-359, 1997: the schemes rand/1/bin
and best/1/bin, with a scale factor redrawn in every generation (dither). Each trial replaces its own parent
if it is not worse. Trials that leave the box are put back at random in the coordinates in which they left it.
"""

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.tuning.optimizers.asktell import Array, AskTell

Indices = NDArray[np.intp]


class DifferentialEvolution(AskTell):
    """A population whose trials replace their parents where they cost less.

    Parameters
    ----------
    low, high, population, rng
        As for every `Optimizer`.
    base : {"best", "rand"}
        Base vector: the best member, or a random one.
    scale : (float, float)
        F is drawn from this range, once a generation.
    crossover : float
        CR, the chance of a coordinate to come from the mutant.
    """

    saved: ClassVar = ("members", "member_costs")

    def __init__(
        self,
        low: Array,
        high: Array,
        population: int,
        rng: np.random.Generator,
        *,
        base: Literal["best", "rand"] = "best",
        scale: tuple[float, float] = (0.5, 1.0),
        crossover: float = 0.7,
    ) -> None:
        super().__init__(low, high, rng.uniform(low, high, (population, len(low))), rng)
        self.base, self.scale, self.crossover = base, scale, crossover
        self.members = self.positions.copy()
        self.member_costs = np.full(population, np.inf)

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
        crossed[np.arange(n), self.rng.integers(d, size=n)] = True  # at least one coordinate changes
        trials = np.where(crossed, mutants, x)
        outside = (trials < self.low) | (trials > self.high)
        return np.where(outside, self.rng.uniform(self.low, self.high, (n, d)), trials)

    def _others(self) -> tuple[Indices, Indices, Indices]:
        """Three different other members for each member; of fewer than four members some serve twice."""
        n = len(self.members)
        order = self.rng.random((n, n))
        np.fill_diagonal(order, 2.0)  # the member itself comes last
        ranked = np.argsort(order, axis=1)
        return ranked[:, 0], ranked[:, 1 % n], ranked[:, 2 % n]
