"""No optimizer is worse than another implementation: a rank test over 20 seeds with the same budget."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

pytest.importorskip("cma", reason="the rivals need the dependency group test")
pytest.importorskip("cmaes", reason="the rivals need the dependency group test")
pytest.importorskip("pymoo", reason="the rivals need the dependency group test")

from oracles.landscapes import HIGH, LANDSCAPES, LOW
from oracles.rival_optimizers import RIVALS
from sigmaswarm.tuning.optimizers import create_optimizer
from support import quickly

POPULATION, BUDGET, SEEDS = 30, 1500, 20
QUICK = "ellipsoid"
SIGNIFICANCE = 0.01  # for each of 20 comparisons; the seeds are fixed
# benchmarks/optimizers.py writes the whole table, with pycma and the simplex (see test_nelder_mead.py).
PAIRS = [
    (name, rival)
    for name, rivals in RIVALS.items()
    for rival in rivals
    if rival != "pycma" and name != "nelder-mead"
]


def ours(name: str, landscape: str, seed: int, budget: int = BUDGET) -> float:
    rng = np.random.default_rng(1000 + seed)  # independent of the other's random numbers
    optimizer = create_optimizer(name, LOW, HIGH, population=POPULATION, budget=budget, rng=rng)
    while len(points := optimizer.ask()):
        optimizer.tell(LANDSCAPES[landscape](points))
    return optimizer.global_cost


@cache
def theirs(rival, landscape: str, budget: int = BUDGET) -> tuple[float, ...]:
    return tuple(rival(LANDSCAPES[landscape], POPULATION, budget, seed) for seed in range(SEEDS))


@pytest.mark.parametrize(
    "landscape",
    quickly([(name,) for name in LANDSCAPES], lambda name: name == QUICK),
)
@pytest.mark.parametrize(("name", "rival"), quickly(PAIRS, lambda _, rival: "pymoo" not in rival))
def test_no_optimizer_is_worse_than_another_implementation(name: str, rival: str, landscape: str):
    budget = BUDGET // 2 if landscape == QUICK else BUDGET
    found = [ours(name, landscape, seed, budget) for seed in range(SEEDS)]
    rivals = theirs(RIVALS[name][rival], landscape, budget)
    worse = mannwhitneyu(found, rivals, alternative="greater").pvalue
    assert worse > SIGNIFICANCE, f"{np.median(np.log10(found)):.2f} against {np.median(np.log10(rivals)):.2f}"
