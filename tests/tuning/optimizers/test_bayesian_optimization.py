"""Bayesian optimization: transformation of costs, selection of points, and no side effects."""

import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from sigmaswarm.errors import InputError
from sigmaswarm.tuning import config
from sigmaswarm.tuning.optimizers import create_optimizer
from sigmaswarm.tuning.optimizers.bayesian_optimization import (
    MAX_POINTS,
    NOISE,
    BayesianOptimization,
    Improvement,
    _fitted,
    next_points,
    normalized_costs,
)
from sigmaswarm.tuning.tune import tune
from support import make_drive, require

require("sklearn", "bo needs scikit-learn")
LOW, HIGH = np.array([-5.0, 0.0]), np.array([5.0, 2.0])


def valley(points: np.ndarray) -> np.ndarray:
    """Return a curved valley with its minimum at (1, 1.3); distant costs are in the thousands, and a strip fails."""
    costs = 10 * (points[:, 1] - 1.3 - 0.1 * (points[:, 0] - 1)) ** 2 + np.expm1(
        np.abs(points[:, 0] - 1) ** 1.5
    )
    costs[points[:, 0] < -4.5] = np.nan
    return costs


def lowest(name: str, seed: int, budget: int = 30) -> float:
    optimizer = create_optimizer(
        name, LOW, HIGH, population=8, budget=budget, rng=np.random.default_rng(seed)
    )
    while len(points := optimizer.ask()):
        optimizer.tell(valley(points))
    return optimizer.global_cost


@pytest.mark.long
def test_it_is_better_than_a_quasi_random_search_with_thirty_costs():
    """The costs resemble those of filters: a narrow minimum, costs in the thousands, and failures."""
    ours, even = ([lowest(name, seed) for seed in range(3)] for name in ("bo", "sobol"))
    assert max(ours) < 0.05
    assert max(ours) < 0.3 * min(even)


def naive_improvement(points, costs, length, at):
    """Return the expected improvement, Jones et al. (1998), eq. 15, of a Matern 5/2 process of these lengths."""

    def kernel(a, b):
        r = np.sqrt(5 * (((a[:, None] - b) / length) ** 2).sum(axis=2))
        return (1 + r + r**2 / 3) * np.exp(-r)

    y = (costs - costs.mean()) / costs.std()
    inverse = np.linalg.inv(kernel(points, points) + NOISE * np.eye(len(points)))
    near = kernel(at, points)
    mean = near @ inverse @ y
    std = np.sqrt(np.maximum(1 - np.einsum("ij,jk,ik->i", near, inverse, near), 1e-16))
    z = (y.min() - mean) / std
    return std * (z * norm.cdf(z) + norm.pdf(z))


def data(n: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(4).random((n, 2))
    return points, normalized_costs(valley(LOW + points * (HIGH - LOW)))


def test_the_improvement_follows_its_equation_and_the_gradient_is_its_derivative():
    points, costs = data(14)
    lengths = np.array([0.3, 0.8])
    ours = Improvement(lengths, points, costs)
    at = np.random.default_rng(1).random((40, 2))
    np.testing.assert_allclose(ours(at), naive_improvement(points, costs, lengths, at), rtol=1e-6, atol=1e-12)
    for place in at:
        _, slope = ours.negative_log_improvement(place)
        steps = 1e-6 * np.eye(2)
        by_steps = [
            (ours.negative_log_improvement(place + s)[0] - ours.negative_log_improvement(place - s)[0]) / 2e-6
            for s in steps
        ]
        np.testing.assert_allclose(slope, by_steps, rtol=1e-4, atol=1e-4)


def test_predictions_and_improvements_agree_with_another_package():
    """The package is bayesian-optimization, with the lengths fitted here; it maximizes, so signs are reversed."""
    acquisition = pytest.importorskip(
        "bayes_opt.acquisition", reason="the oracle needs the dependency group test"
    )
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import Matern

    points, costs = data(20)
    lengths = _fitted(points, costs)
    process = GaussianProcessRegressor(Matern(lengths, nu=2.5), alpha=NOISE, normalize_y=True, optimizer=None)
    process.fit(points, -costs)
    expected = acquisition.ExpectedImprovement(xi=0.0)
    expected.y_max = -costs.min()
    at = np.random.default_rng(1).random((40, 2))
    mean, std = process.predict(at, return_std=True)
    ours = Improvement(lengths, points, costs)
    np.testing.assert_allclose([ours.forecast(place) for place in at], -mean, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(ours(at) * ours.scale, expected.base_acq(mean, std), rtol=1e-4, atol=1e-9)


def test_the_next_point_maximizes_the_improvement():
    points, costs = data(14)
    (found,) = next_points(points, costs, 1, (2000, 3), np.random.default_rng(5))
    grid = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, 60)]), axis=2).reshape(-1, 2)
    lengths = _fitted(points, costs)
    best = naive_improvement(points, costs, lengths, grid).max()
    assert naive_improvement(points, costs, lengths, found[None])[0] > 0.999 * best


def test_the_points_of_a_batch_are_distinct():
    batch = next_points(*data(10), 4, (500, 2), np.random.default_rng(5))
    apart = np.linalg.norm(batch[:, None] - batch, axis=2)[np.triu_indices(4, 1)]
    assert apart.min() > 1e-3


@given(
    costs=st.lists(st.integers(-999, 999).map(float) | st.just(np.inf), min_size=1, max_size=30),
    scale=st.sampled_from([2.0**-9, 0.5, 1024.0]),
)
def test_normalized_costs_keep_their_order_and_failures_are_the_worst(costs: list[float], scale: float):
    told = np.array(costs)
    finite = np.isfinite(told)
    if not finite.any():
        return
    found = normalized_costs(told)
    assert np.isfinite(found).all() and found.min() == 0
    assert (np.diff(found[finite][np.argsort(told[finite], kind="stable")]) >= 0).all()
    assert (found[~finite] == found.max()).all()
    np.testing.assert_array_equal(normalized_costs(scale * told), found)  # units have no effect


def test_normalized_costs_are_linear_near_the_best_and_logarithmic_far_away():
    costs = np.array([2.0, 2.1, 2.2, 3.0, 4.0, 1002.0, np.inf])
    above = np.array([0.0, 0.1, 0.2, 1.0, 2.0, 1000.0, 1000.0])
    np.testing.assert_allclose(normalized_costs(costs), np.log(1 + above / 1.0))


def test_of_many_costs_the_best_and_the_latest_are_fitted():
    search = BayesianOptimization(LOW, HIGH, 8, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    search.points, search.costs = rng.uniform(LOW, HIGH, (700, 2)), rng.permutation(np.arange(700.0))
    chosen = search._remembered()
    assert len(chosen) <= MAX_POINTS
    assert set(range(600, 700)) <= set(chosen)
    assert set(range(100)) <= set(search.costs[chosen])


@pytest.mark.long
def test_parallel_searches_keep_the_warning_filters_and_give_the_same_results():
    def found(seed: int) -> float:
        return lowest("bo", seed, budget=14)

    alone = [found(seed) for seed in range(4)]
    before = list(warnings.filters)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(found, range(4))) == alone
    assert warnings.filters == before


def test_a_missing_package_is_reported_with_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path):
    monkeypatch.setattr(config, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs scikit-learn, .* pip install scikit-learn"):
        tune(make_drive(duration=20.0), optimizer="bo", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()
