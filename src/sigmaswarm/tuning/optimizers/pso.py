"""Particle swarm optimization, as in the paper's equations 2 and 3.

J. Kennedy and R. Eberhart, Particle swarm optimization, Proc. ICNN 1995; inertia weight by Y. Shi and
R. Eberhart, A modified particle swarm optimizer, Proc. CEC 1998.
"""

from typing import ClassVar

import numpy as np

from sigmaswarm.tuning.optimizers.asktell import Array, AskTell
from sigmaswarm.tuning.options import ACCELERATION, INERTIA


class ParticleSwarm(AskTell):
    """A swarm whose particles move by the costs of their positions.

    Parameters
    ----------
    low, high, population, rng
        As for every `Optimizer`.
    inertia, cognitive, social : float
        w, c1, c2.
    zero_velocity_at_bounds : bool
        Stop a particle in the coordinates in which the projection moved it.
    """

    saved: ClassVar = ("velocities", "personal_best", "personal_cost")

    def __init__(
        self,
        low: Array,
        high: Array,
        n_particles: int,
        rng: np.random.Generator,
        *,
        inertia: float = INERTIA,
        cognitive: float = ACCELERATION,
        social: float = ACCELERATION,
        zero_velocity_at_bounds: bool = False,
    ) -> None:
        self.inertia, self.cognitive, self.social = inertia, cognitive, social
        self.zero_velocity_at_bounds = zero_velocity_at_bounds
        super().__init__(low, high, rng.uniform(low, high, (n_particles, len(low))), rng)
        # Half the way to another random place (SPSO 2007): all directions, and none straight out of the box.
        self.velocities = 0.5 * (rng.uniform(low, high, self.positions.shape) - self.positions)
        self.personal_best = self.positions.copy()
        self.personal_cost = np.full(n_particles, np.inf)

    def _learn(self, costs: Array) -> None:
        better = costs < self.personal_cost
        self.personal_best[better] = self.positions[better]
        self.personal_cost[better] = costs[better]

    def _next(self) -> Array:
        r1, r2 = self.rng.random((2, *self.positions.shape))
        self.velocities = (
            self.inertia * self.velocities
            + self.cognitive * r1 * (self.personal_best - self.positions)
            + self.social * r2 * (self.global_best - self.positions)
        )  # (eq. 2)
        wanted = self.positions + self.velocities  # (eq. 3)
        if self.zero_velocity_at_bounds:
            self.velocities[(wanted < self.low) | (wanted > self.high)] = 0.0
        return wanted
