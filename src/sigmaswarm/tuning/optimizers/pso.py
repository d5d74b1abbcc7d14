"""Particle swarm optimization, as in the paper's equations 2 and 3.

J. Kennedy and R. Eberhart, Proc. ICNN 1995; inertia weight: Y. Shi and R. Eberhart, Proc. CEC 1998.
"""

from sigmaswarm.arrays import Array
from sigmaswarm.tuning.optimizers.asktell import Swarm
from sigmaswarm.tuning.options import ACCELERATION, INERTIA


class MovingSwarm(Swarm):
    inertia: float = INERTIA
    cognitive: float = ACCELERATION
    social: float = ACCELERATION

    def _accelerated(self, velocities: Array, positions: Array, best: Array) -> Array:
        """Return the next velocities (eq. 2); ``best`` are the particles' best positions; all shapes are (n, d)."""
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
