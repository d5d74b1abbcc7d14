"""CMA-ES, compared with another implementation of the same tutorial, generation by generation."""

import numpy as np
import pytest

from oracles.landscapes import HIGH, LOW, ellipsoid_at_bounds, rotated_ellipsoid, sphere
from sigmaswarm.tuning.optimizers.evolution import CmaEs


@pytest.mark.parametrize("population", [5, 8, 31])
@pytest.mark.parametrize("dimensions", [1, 2, 7])
def test_mean_step_and_covariance_agree_with_another_implementation(population: int, dimensions: int):
    cmaes = pytest.importorskip("cmaes", reason="the oracle needs the dependency group test")
    low, high = np.zeros(dimensions), np.ones(dimensions)
    ours = CmaEs(low, high, population, np.random.default_rng(5), step=0.02)  # stays within the bounds
    oracle = cmaes.CMA(np.full(dimensions, 0.5), 0.02, population_size=population)
    # the oracle's rate is that of the tutorial's first version; the next test checks the current rate
    ours.c_mu, ours.weights = oracle._cmu, oracle._weights
    stretch = np.geomspace(1, 100, dimensions)
    for generation in range(25):
        points = ours.ask()
        assert points.min() > 0 and points.max() < 1
        costs = np.sum(stretch * (points - 0.53) ** 2, axis=1)
        ours.tell(costs)
        oracle._g = generation - 1  # the oracle's h_sigma counts one generation too many
        oracle.tell(list(zip(points, costs.tolist(), strict=True)))
        np.testing.assert_allclose(ours.mean, oracle._mean, rtol=1e-8)
        # the oracle adds 1e-8 to its denominator
        np.testing.assert_allclose(ours.step, oracle._sigma, rtol=1e-6)
        np.testing.assert_allclose(ours.covariance, oracle._C, rtol=1e-5, atol=1e-6 * oracle._C.max())


@pytest.mark.parametrize("population", [8, 31])
@pytest.mark.parametrize("dimensions", [2, 7])
def test_weights_and_rates_agree_with_pycma(population: int, dimensions: int):
    cma = pytest.importorskip("cma", reason="the oracle needs the dependency group test")
    rng = np.random.default_rng(0)
    options = {
        "popsize": population,
        "seed": np.nan,
        "verbose": -9,
        "randn": lambda *s: rng.standard_normal(s),
    }
    theirs = cma.CMAEvolutionStrategy(np.full(dimensions, 0.5), 0.1, options).sp
    ours = CmaEs(np.zeros(dimensions), np.ones(dimensions), population, rng)
    np.testing.assert_allclose([ours.c_one, ours.c_mu], [theirs.c1, theirs.cmu], rtol=1e-12)
    np.testing.assert_allclose(ours.weights, theirs.weights, rtol=1e-9, atol=1e-12)


def test_an_optimum_on_the_bounds_is_found_exactly():
    found = []
    for seed in range(5):
        search = CmaEs(LOW, HIGH, 30, np.random.default_rng(seed))
        for _ in range(100):
            search.tell(ellipsoid_at_bounds(search.ask()))
        found.append(search.global_cost)
        assert np.sum(search.global_best == HIGH) == 5  # exactly, so that the result can report it
    assert np.median(found) < 1e-2


def test_a_converged_search_restarts():
    search = CmaEs(LOW, HIGH, 12, np.random.default_rng(0))
    widths = []
    for _ in range(500):
        search.tell(sphere(search.ask()))
        widths.append(search.step * np.sqrt(np.linalg.eigvalsh(search.covariance)[-1]))
    assert min(widths) < 1e-11
    assert np.any(np.diff(np.log10(widths)) > 10)  # wide again after a restart
    assert search.global_cost < 1e-20  # the best point is kept


def test_it_converges_in_spite_of_failures():
    def half_fails(points: np.ndarray) -> np.ndarray:
        return np.where(points[:, 0] < 0, np.nan, rotated_ellipsoid(points))

    search = CmaEs(LOW, HIGH, 30, np.random.default_rng(0))
    for _ in range(100):
        search.tell(half_fails(search.ask()))
    assert search.global_cost < 100
