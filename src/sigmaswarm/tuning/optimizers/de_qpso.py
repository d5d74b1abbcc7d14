"""Quantum-behaved particle swarm optimization with moves of differential evolution.

J. Sun, W. Xu and B. Feng, Proc. IEEE Conf. Cybernetics and Intelligent Systems 2004, 111-116. The hybrid follows Y. Fu,
M. Ding, C. Zhou and H. Hu, IEEE Trans. Systems, Man, and Cybernetics: Systems 43, 1451-1465, 2013; here each particle
makes one of the two moves at random, so that a generation is one batch.
"""

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import Swarm

EXPANSION = (1.0, 0.5)
"""Contraction-expansion coefficient at the start and after ``generations``; it falls linearly."""
DIFFERENTIAL, SCALE, CROSSOVER = 0.5, (0.5, 1.0), 0.7
"""Probability of a differential move, range of its scale factor F, and crossover probability CR."""


class QuantumSwarm(Swarm):
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
