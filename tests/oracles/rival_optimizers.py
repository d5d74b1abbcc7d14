"""Other implementations of the algorithms with the same bounds, batch and budget; functions return the lowest cost."""

import cma
import cmaes
import numpy as np
from pymoo.algorithms.soo.nonconvex.ga import GA
from pymoo.core.problem import Problem
from pymoo.optimize import minimize as pymoo_minimize
from scipy.optimize import differential_evolution, minimize

from oracles.landscapes import DIMENSIONS, HIGH, LOW
from oracles.particle_swarm import by_equations

FIRST_STEP, EDGE = 0.3, 0.05  # of CMA-ES and of the simplex, relative to the widths of the bounds


def equations(cost, population: int, budget: int, seed: int) -> float:
    """PSO in loops."""
    *_, (_, _, _, best) = by_equations(cost, LOW, HIGH, population, seed, budget // population)
    return best


def pymoo_ga(cost, population: int, budget: int, seed: int) -> float:
    class Landscape(Problem):
        def __init__(self) -> None:
            super().__init__(n_var=DIMENSIONS, n_obj=1, xl=LOW, xu=HIGH)

        def _evaluate(self, x, out, *args, **kwargs) -> None:
            out["F"] = cost(x)

    # pymoo ignores a seed of 0
    return float(
        pymoo_minimize(
            Landscape(), GA(pop_size=population), ("n_gen", budget // population), seed=seed + 1
        ).F[0]
    )


def scipy_de(cost, population: int, budget: int, seed: int) -> float:
    rng = np.random.default_rng(seed)
    result = differential_evolution(
        lambda x: cost(x.T),
        list(zip(LOW, HIGH, strict=True)),
        init=rng.uniform(LOW, HIGH, (population, DIMENSIONS)),
        maxiter=budget // population - 1,
        rng=rng,
        polish=False,
        tol=0,
        vectorized=True,
        updating="deferred",
    )
    return float(result.fun)


def pycma(cost, population: int, budget: int, seed: int) -> float:
    rng = np.random.default_rng(seed)
    options = {
        "bounds": [0, 1],
        "popsize": population,
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan,  # other values would seed NumPy's global generator
        "verbose": -9,
    }
    search = cma.CMAEvolutionStrategy(np.full(DIMENSIONS, 0.5), FIRST_STEP, options)
    best = np.inf
    for _ in range(budget // population):
        points = search.ask()
        costs = cost(LOW + np.array(points) * (HIGH - LOW))
        search.tell(points, costs.tolist())
        best = min(best, costs.min())
    return best


def cmaes_package(cost, population: int, budget: int, seed: int) -> float:
    unit = np.tile([0.0, 1.0], (DIMENSIONS, 1))
    search = cmaes.CMA(
        np.full(DIMENSIONS, 0.5), FIRST_STEP, bounds=unit, population_size=population, seed=seed
    )
    best = np.inf
    for _ in range(budget // population):
        points = [search.ask() for _ in range(population)]
        costs = cost(LOW + np.array(points) * (HIGH - LOW))
        search.tell(list(zip(points, costs.tolist(), strict=True)))
        best = min(best, costs.min())
    return best


def scipy_nelder_mead(cost, population: int, budget: int, seed: int) -> float:
    start = np.random.default_rng(seed).uniform(LOW, HIGH)
    steps = np.where(start + EDGE * (HIGH - LOW) > HIGH, -EDGE, EDGE) * (HIGH - LOW)
    options = {
        "initial_simplex": np.vstack([start, start + np.diag(steps)]),
        "adaptive": True,
        "maxfev": budget,
        "xatol": 0,
        "fatol": 0,
    }
    bounds = list(zip(LOW, HIGH, strict=True))
    result = minimize(
        lambda x: cost(x[np.newaxis])[0], start, method="Nelder-Mead", bounds=bounds, options=options
    )
    return float(result.fun)


RIVALS = {
    "pso": {"equations 2 and 3 in loops": equations},
    "ga": {"pymoo": pymoo_ga},
    "ga-pso": {"PSO in loops": equations, "pymoo's GA": pymoo_ga},
    "de": {"scipy": scipy_de},
    "cma-es": {"cmaes": cmaes_package, "pycma": pycma},
    "nelder-mead": {"scipy": scipy_nelder_mead},
}
