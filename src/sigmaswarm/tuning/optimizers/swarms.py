"""Swarms: particle swarm optimization, its hybrid with a genetic algorithm, and a quantum-behaved swarm."""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.config import ACCELERATION, INERTIA
from sigmaswarm.tuning.optimizers.asktell import Swarm
from sigmaswarm.tuning.optimizers.evolution import mutated, offspring


class MovingSwarm(Swarm):
    """Particles that move as in the paper's equations 2 and 3.

    J. Kennedy and R. Eberhart, Proc. ICNN 1995; inertia weight: Y. Shi and R. Eberhart, Proc. CEC 1998.
    """

    inertia: float = INERTIA
    cognitive: float = ACCELERATION
    social: float = ACCELERATION

    def _accelerated(self, velocities: Array, positions: Array, best: Array) -> Array:
        """Return the next velocities (eq. 2). ``best`` are the particles' best positions. All shapes are (n, d)."""
        r1, r2 = self.rng.random((2, *positions.shape))
        return (
            self.inertia * velocities
            + self.cognitive * r1 * (best - positions)
            + self.social * r2 * (self.global_best - positions)
        )


class ParticleSwarm(MovingSwarm):
    name = "pso"
    saved = ("velocities", *Swarm.saved)
    zero_velocity_at_bounds: bool = False
    """Stop particles along the coordinates in which they reach a bound."""

    def _begin(self) -> Array:
        positions = super()._begin()
        # Half the vector to another random point (SPSO 2007), so that no initial velocity leads out of the bounds.
        self.velocities = 0.5 * (self._drawn_first() - positions)
        return positions

    def _next(self) -> Array:
        self.velocities = self._accelerated(self.velocities, self.positions, self.personal_best)
        wanted = self.positions + self.velocities  # (eq. 3)
        if self.zero_velocity_at_bounds:
            self.velocities[(wanted < self.low) | (wanted > self.high)] = 0.0
        return wanted


class GeneticSwarm(MovingSwarm):
    """Particle swarm in which children of a genetic algorithm replace the worse half; the better half moves.

    HGAPSO: C.-F. Juang, IEEE Trans. Systems, Man, and Cybernetics B 34, 997-1006, 2004. In contrast to HGAPSO,
    crossover and mutation are those of `GeneticAlgorithm`, and the better half has children before it moves, so that a
    generation is one batch.
    """

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


EXPANSION = (1.0, 0.5)
"""Contraction-expansion coefficient at the start and after ``generations``, between which it falls linearly."""
DIFFERENTIAL, SCALE, CROSSOVER = 0.5, (0.5, 1.0), 0.7
"""Probability of a differential move, range of its scale factor F, and crossover probability CR."""


class QuantumSwarm(Swarm):
    """Quantum-behaved particle swarm optimization with moves of differential evolution.

    J. Sun, W. Xu and B. Feng, Proc. IEEE Conf. Cybernetics and Intelligent Systems 2004, 111-116. The hybrid follows Y.
    Fu, M. Ding, C. Zhou and H. Hu, IEEE Trans. Systems, Man, and Cybernetics: Systems 43, 1451-1465, 2013; here each
    particle makes one of the two moves at random, so that a generation is one batch.
    """

    name = "de-qpso"
    saved = (*Swarm.saved, "generation")
    generations: int = 50
    """Number of generations over which the contraction-expansion coefficient falls."""

    def _begin(self) -> Array:
        self.generation = 0
        return super()._begin()

    def _next(self) -> Array:
        self.generation += 1
        drawn, moved = self._drawn(), self._moved()
        return np.where(self.rng.random((len(drawn), 1)) < DIFFERENTIAL, moved, drawn)

    def _drawn(self) -> Array:
        start, end = EXPANSION
        expansion = start + (end - start) * min(self.generation / self.generations, 1.0)
        share, u, side = self.rng.random((3, *self.positions.shape))
        attractor = share * self.personal_best + (1 - share) * self.global_best
        length = expansion * np.abs(self.personal_best.mean(axis=0) - self.positions)
        return self._redrawn(attractor - np.where(side < 0.5, length, -length) * np.log1p(-u))

    def _moved(self) -> Array:
        n, d = self.positions.shape
        one, other = self.personal_best[self.rng.integers(n, size=(2, n))]
        mutants = self.global_best + self.rng.uniform(*SCALE, (n, 1)) * (one - other)
        return self._redrawn(np.where(self.rng.random((n, d)) < CROSSOVER, mutants, self.personal_best))
