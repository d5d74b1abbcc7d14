"""A hybrid of genetic algorithm and particle swarm: the better half moves as particles, the worse half is replaced.

HGAPSO: C.-F. Juang, IEEE Trans. Systems, Man, and Cybernetics B 34, 997-1006, 2004. In contrast to HGAPSO, crossover
and mutation are those of `genetic.py`, and the better half has children before it moves, so that a generation is one
batch.
"""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import Swarm
from sigmaswarm.tuning.optimizers.genetic import mutated, offspring
from sigmaswarm.tuning.optimizers.pso import MovingSwarm


class GeneticSwarm(MovingSwarm):
    name = "ga-pso"
    saved = ("velocities", "costs", *Swarm.saved)

    def _begin(self) -> Array:
        positions = super()._begin()
        self.velocities, self.costs = np.zeros_like(positions), self.personal_cost.copy()
        return positions

    def _learn(self, costs: Array) -> None:
        self.costs = costs
        super()._learn(costs)

    def _next(self) -> Array:
        n, bounds = len(self.positions), (self.low, self.high)
        elites = np.argsort(self.costs, kind="stable")[: (n + 1) // 2]
        x, costs, v = self.positions[elites], self.costs[elites], self.velocities[elites]
        best, best_cost = self.personal_best[elites], self.personal_cost[elites]
        v = self._accelerated(v, x, best)
        children = mutated(offspring(x, costs, n - len(elites), bounds, self.rng), bounds, self.rng)
        # a child starts with zero velocity, and its first position is its best position
        self.velocities = np.concatenate([v, np.zeros_like(children)])
        self.personal_best = np.concatenate([best, children])
        self.personal_cost = np.concatenate([best_cost, np.full(len(children), np.inf)])
        return np.concatenate([x + v, children])
