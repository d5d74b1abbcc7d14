"""The optimizers.

All optimizers implement the protocol `Optimizer` and are used in the same loop::

    optimizer = create_optimizer("cma-es", low, high, population=30, budget=1500, rng=rng)
    while len(points := optimizer.ask()):
        optimizer.tell(costs_of(points))
    print(optimizer.global_best, optimizer.global_cost)

A custom class needs a constructor and four methods. Pass it to ``tune(drives, optimizer=Halton)``::

    import scipy.stats

    class Halton:
        def __init__(self, low, high, population, rng):
            self.low, self.high, self.population = low, high, population
            self.sequence = scipy.stats.qmc.Halton(len(low), seed=rng)

        def ask(self):
            return self.low + self.sequence.random(self.population) * (self.high - self.low)

        def tell(self, costs):
            pass

        def state(self):
            return {"drawn": self.sequence.num_generated}

        def restore(self, state):
            self.sequence.reset().fast_forward(int(state["drawn"]))
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from sigmaswarm.arrays import Array
from sigmaswarm.errors import InputError
from sigmaswarm.tuning.optimizers.asktell import AskTell, Optimizer, RandomSearch, SobolSearch
from sigmaswarm.tuning.optimizers.bayesian_optimization import BayesianOptimization
from sigmaswarm.tuning.optimizers.budget import Budgeted, NelderMead
from sigmaswarm.tuning.optimizers.evolution import CmaEs, DifferentialEvolution, GeneticAlgorithm
from sigmaswarm.tuning.optimizers.swarms import GeneticSwarm, ParticleSwarm, QuantumSwarm

__all__ = ["OPTIMIZERS", "Optimizer", "create_optimizer"]

_CLASSES: tuple[type[AskTell], ...] = (
    ParticleSwarm, GeneticAlgorithm, GeneticSwarm, DifferentialEvolution, QuantumSwarm, CmaEs, BayesianOptimization,
    NelderMead, RandomSearch, SobolSearch,
)  # fmt: skip
OPTIMIZERS: dict[str, type[AskTell]] = {optimizer.name: optimizer for optimizer in _CLASSES}


def create_optimizer(
    name: str | Callable[..., Optimizer],
    low: Array,
    high: Array,
    *,
    population: int,
    budget: int,
    rng: np.random.Generator,
    **options: Any,
) -> Budgeted:
    """Create an optimizer with a budget of evaluations.

    ``name`` is a name in `OPTIMIZERS`, or a class that implements `Optimizer`. ``low`` and ``high``, shape (d,), are
    bounds in search coordinates. ``population`` is the number of points per batch. The option ``polish`` is the number
    of evaluations reserved for a Nelder-Mead search from the best point. Other options are passed to the optimizer.
    """
    polish = options.pop("polish", 0)
    if isinstance(name, str) and name not in OPTIMIZERS:
        raise InputError(f"optimizer = {name!r} is unknown; choose one of {', '.join(OPTIMIZERS)}")
    if population < 2 or budget < 1 or not 0 <= polish < budget:
        raise InputError(
            f"population = {population}, budget = {budget}, polish = {polish}: "
            "population must be at least 2, budget at least 1, and polish from 0 to less than budget"
        )
    if name == QuantumSwarm.name:
        options = {"generations": max((budget - polish) // population, 1), **options}
    first = (OPTIMIZERS[name] if isinstance(name, str) else name)(low, high, population, rng, **options)
    for method in ("ask", "tell", "state", "restore"):
        if not callable(getattr(first, method, None)):
            raise InputError(f"optimizer = {name} has no method {method}; see sigmaswarm.tuning.optimizers")
    return Budgeted(first, low, high, rng, budget=budget, polish=polish)
