"""Quantum-behaved particle swarm optimization.

J. Sun, B. Feng and W. Xu, Particle swarm optimization with particles having quantum behavior, Proc. CEC 2004, 325-331;
J. Sun, W. Xu and B. Feng, A global search strategy of quantum-behaved particle swarm optimization, Proc. IEEE Conf.
Cybernetics and Intelligent Systems 2004, 111-116: the mean of the personal best positions sets the length of a move,
and the contraction-expansion coefficient falls linearly. A particle has no velocity. It is drawn from a
Laplace distribution about a point between its own best position and the swarm's. Coordinates outside the bounds are
drawn again.
"""

import numpy as np

from sigmaswarm.tuning.optimizers.asktell import Array, Swarm

EXPANSION = (0.9, 0.4)
"""The coefficient in the first and in the last generation."""


class QuantumSwarm(Swarm):
    """A swarm whose particles are drawn anew about their attractors in each generation."""

    name = "qpso"
    saved = (*Swarm.saved, "generation")
    generations: int = 50
    """Generations over which the coefficient falls; `create_optimizer` takes those of the budget."""

    def _begin(self) -> Array:
        self.generation = 0
        return super()._begin()

    def _next(self) -> Array:
        self.generation += 1
        first, last = EXPANSION
        expansion = first + (last - first) * min(self.generation / self.generations, 1.0)
        own, u, side = self.rng.random((3, *self.positions.shape))
        attractor = own * self.personal_best + (1 - own) * self.global_best
        length = expansion * np.abs(self.personal_best.mean(axis=0) - self.positions)
        return self._redrawn(attractor - np.where(side < 0.5, length, -length) * np.log1p(-u))
