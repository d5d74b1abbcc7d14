"""The simplex, compared with scipy's, point by point; several vertices at a time."""

import numpy as np
import pytest
from scipy.optimize import minimize

from oracles.landscapes import HIGH, LANDSCAPES, LOW, ellipsoid_at_bounds
from sigmaswarm.tuning.optimizers.budget import NelderMead
from support import quickly

BOUNDED = LANDSCAPES | {"at bounds": ellipsoid_at_bounds}


def points_of(search: NelderMead, cost, budget: int) -> np.ndarray:
    points = []
    while len(points) < budget and len(batch := search.ask()):
        points += batch.tolist()
        search.tell(cost(batch))
    return np.array(points[:budget])


@pytest.mark.parametrize("landscape", BOUNDED)
@pytest.mark.parametrize("seed", quickly([(0,), (1,), (2,)], lambda seed: seed == 1))
def test_the_simplex_evaluates_the_points_of_scipy(landscape: str, seed: int):
    cost, budget = BOUNDED[landscape], 600
    search = NelderMead(LOW, HIGH, 30, np.random.default_rng(seed))
    simplex, theirs = search.simplex.copy(), []

    def seen(x: np.ndarray) -> float:
        theirs.append(x.copy())
        return cost(x[np.newaxis])[0]

    options = {"initial_simplex": simplex, "adaptive": True, "maxfev": budget, "xatol": 0, "fatol": 0}
    bounds = list(zip(LOW, HIGH, strict=True))
    minimize(seen, simplex[0], method="Nelder-Mead", bounds=bounds, options=options)
    # rounding errors grow: compare the first points exactly, then the best cost
    ours = points_of(search, cost, budget)
    np.testing.assert_allclose(ours[:200], theirs[:200], rtol=1e-9, atol=1e-9)
    assert search.global_cost == pytest.approx(min(cost(np.array(theirs))), rel=1e-2, abs=1e-9)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_few_dimensions(dimensions: int):
    low, high = np.full(dimensions, -5.0), np.full(dimensions, 5.0)
    search = NelderMead(low, high, 2, np.random.default_rng(0))
    points = points_of(search, lambda x: np.sum((x - 1) ** 2, axis=1), 2000)
    assert len(points) < 2000  # converged
    assert len(search.ask()) == 0
    assert search.global_cost < 1e-20


@pytest.mark.parametrize("parallel", [2, 5])
def test_several_vertices_at_a_time_need_fewer_batches(parallel: int):
    batches = []
    for p in (1, parallel):
        search = NelderMead(LOW, HIGH, 30, np.random.default_rng(1), parallel=p)
        batches.append(0)
        while search.global_cost > 1e-6 and batches[-1] < 2000:
            search.tell(LANDSCAPES["sphere"](search.ask()))
            batches[-1] += 1
    assert batches[1] < 0.9 * batches[0] < 1800


def test_a_known_start_is_not_evaluated_again():
    start = np.full(10, 4.9)  # so near the upper bounds that the simplex must extend downward
    search = NelderMead(LOW, HIGH, 30, np.random.default_rng(0), start=start, start_cost=7.0, size=0.1)
    assert search.global_cost == 7.0
    np.testing.assert_array_equal(search.global_best, start)
    np.testing.assert_allclose(search.ask(), start - np.eye(10))


def test_an_unknown_start_is_evaluated():
    search = NelderMead(LOW, HIGH, 30, np.random.default_rng(0), start=np.zeros(10))
    np.testing.assert_allclose(search.ask(), np.vstack([np.zeros(10), 0.5 * np.eye(10)]))
