"""Differential evolution: R. Storn and K. Price, J. Global Optimization 11, 341-359, 1997.

The schemes are rand/1/bin and best/1/bin, with a scale factor that is drawn in every generation (dither).
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import AskTell


class DifferentialEvolution(AskTell):
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
