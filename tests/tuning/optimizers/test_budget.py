"""The budget of evaluations, and the local search at the end."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, qmc

from oracles.landscapes import HIGH, LANDSCAPES, LOW
from sigmaswarm.tuning.optimizers import OPTIMIZERS, create_optimizer
from sigmaswarm.tuning.optimizers.asktell import SobolSearch
from support import quickly


def batches(optimizer, cost) -> list[int]:
    sizes = []
    while len(points := optimizer.ask()):
        sizes.append(len(points))
        optimizer.tell(cost(points))
    return sizes


def made(name: str, seed: int = 0, **changes):
    asked = {"population": 30, "budget": 1000, **changes}
    return create_optimizer(name, LOW, HIGH, rng=np.random.default_rng(seed), **asked)


def test_without_a_polish_the_optimizer_is_not_changed():
    bare, budgeted = OPTIMIZERS["pso"](LOW, HIGH, 30, np.random.default_rng(0)), made("pso")
    while len(points := budgeted.ask()) == 30:
        np.testing.assert_array_equal(points, bare.ask())
        costs = LANDSCAPES["Rosenbrock"](points)
        bare.tell(costs)
        budgeted.tell(costs)
    assert len(points) == 1000 % 30  # the last batch is truncated
    assert budgeted.global_cost == bare.global_cost


@pytest.mark.parametrize(
    ("population", "budget", "polish", "whole"), [(30, 1000, 200, 26), (40, 1000, 999, 0)]
)
def test_the_polish_gets_its_share_of_the_budget(population: int, budget: int, polish: int, whole: int):
    optimizer = made("pso", population=population, budget=budget, polish=polish)
    sizes = batches(optimizer, LANDSCAPES["Rosenbrock"])
    assert sum(sizes) == optimizer.spent == budget
    whole = max(whole, 1)  # the polish starts from a known point
    assert sizes[: whole + 1] == [population] * whole + [
        10
    ]  # then the rest of a simplex, from the best point
    assert max(sizes[whole:]) <= 10


def test_the_polish_waits_for_a_finite_cost():
    optimizer, told = made("random", budget=300, polish=200), 0
    while len(points := optimizer.ask()):
        told += len(points)
        failing = told <= 180
        assert len(points) == 30 if told <= 210 else len(points) <= 10
        optimizer.tell(np.full(len(points), np.inf) if failing else LANDSCAPES["sphere"](points))
    assert told == 300


@pytest.mark.long
@pytest.mark.parametrize(
    "landscape", quickly([(name,) for name in LANDSCAPES], lambda name: [*LANDSCAPES].index(name) % 2 == 0)
)
def test_a_polish_improves_the_result(landscape: str):
    found = {}
    for polish in (0, 300):
        found[polish] = []
        for seed in range(12):
            optimizer = made("pso", seed, budget=1500, polish=polish)
            batches(optimizer, LANDSCAPES[landscape])
            found[polish].append(optimizer.global_cost)
    assert mannwhitneyu(found[300], found[0], alternative="less").pvalue < 0.05


def test_sobol_points_agree_with_scipy_and_are_more_even_than_random_points():
    search = SobolSearch(np.zeros(3), np.ones(3), 20, np.random.default_rng(4))
    points = []
    for _ in range(8):
        points.append(search.ask())
        search.tell(np.zeros(20))
    ours = np.concatenate(points)
    seed = int(np.random.default_rng(4).integers(2**63))
    np.testing.assert_array_equal(ours[:128], qmc.Sobol(3, rng=seed).random(128))
    evenly = qmc.discrepancy(ours[:128])
    assert evenly < 0.3 * qmc.discrepancy(np.random.default_rng(0).random((128, 3)))
