"""Particle swarm optimization, as in the paper's equations 2 and 3.

J. Kennedy and R. Eberhart, Particle swarm optimization, Proc. ICNN 1995; inertia weight by Y. Shi and
R. Eberhart, A modified particle swarm optimizer, Proc. CEC 1998.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

INERTIA = 0.7298
"""w: the paper gives none; this is the constriction coefficient of Clerc and Kennedy (2002)."""
ACCELERATION = 1.5
"""c1 = c2, from the paper."""


class ParticleSwarm:
    """A swarm that is asked for positions and told their costs.

    Parameters
    ----------
    low, high : ndarray, shape (d,)
        Bounds of the box, in search coordinates.
    n_particles : int
    rng : numpy.random.Generator
        The only source of chance.
    inertia, cognitive, social : float
        w, c1, c2.
    zero_velocity_at_bounds : bool
        Stop a particle in the coordinates in which the projection moved it.

    Attributes
    ----------
    global_best : ndarray, shape (d,)
    global_cost : float
        ``inf`` until a particle had a finite cost.
    """

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
        self.low, self.high, self.rng = low, high, rng
        self.inertia, self.cognitive, self.social = inertia, cognitive, social
        self.zero_velocity_at_bounds = zero_velocity_at_bounds
        shape = (n_particles, len(low))
        self.positions = rng.uniform(low, high, shape)
        # Half the way to another random place (SPSO 2007): all directions, and none straight out of the box.
        self.velocities = 0.5 * (rng.uniform(low, high, shape) - self.positions)
        self.personal_best = self.positions.copy()
        self.personal_cost = np.full(n_particles, np.inf)
        self.global_best = self.positions[0].copy()
        self.global_cost = np.inf
        self._told = False

    def ask(self) -> Array:
        """The positions whose costs are wanted next, shape (n_particles, d)."""
        if self._told:
            self._move()
            self._told = False
        return self.positions.copy()

    def tell(self, costs: Array) -> None:
        """Take the costs of the last positions, shape (n_particles,); NaN counts as ``inf``."""
        costs = np.where(np.isnan(costs), np.inf, costs)
        better = costs < self.personal_cost
        self.personal_best[better] = self.positions[better]
        self.personal_cost[better] = costs[better]
        leader = int(np.argmin(self.personal_cost))
        if self.personal_cost[leader] < self.global_cost:
            self.global_best = self.personal_best[leader].copy()
            self.global_cost = float(self.personal_cost[leader])
        self._told = True

    def _move(self) -> None:
        r1, r2 = self.rng.random((2, *self.positions.shape))
        self.velocities = (
            self.inertia * self.velocities
            + self.cognitive * r1 * (self.personal_best - self.positions)
            + self.social * r2 * (self.global_best - self.positions)
        )  # (eq. 2)
        wanted = self.positions + self.velocities
        self.positions = np.clip(wanted, self.low, self.high)  # (eq. 3)
        if self.zero_velocity_at_bounds:
            self.velocities[self.positions != wanted] = 0.0

    def state(self) -> dict[str, Any]:
        """All that `restore` needs to go on bit for bit."""
        return {
            "positions": self.positions,
            "velocities": self.velocities,
            "personal_best": self.personal_best,
            "personal_cost": self.personal_cost,
            "global_best": self.global_best,
            "global_cost": self.global_cost,
            "told": self._told,
            "rng": self.rng.bit_generator.state,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a saved `state`."""
        for name in ("positions", "velocities", "personal_best", "personal_cost", "global_best"):
            setattr(self, name, np.array(state[name], dtype=np.float64))
        self.global_cost = float(state["global_cost"])
        self._told = bool(state["told"])
        self.rng.bit_generator.state = state["rng"]
