"""The windowed regression compared with one dense least squares, and its deviations with repeated draws."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter1d

from sigmaswarm.doctor.windows import moving_mean, regress, windows_of


def problem(rng: np.random.Generator, windows: int = 6, count: int = 20):
    def draw():
        return rng.standard_normal((windows, count)) + 1j * rng.standard_normal((windows, count))

    own = [np.ones((windows, count), dtype=complex), np.tile(np.linspace(-1, 1, count) + 0j, (windows, 1))]
    columns = [draw(), draw()]
    factors = rng.standard_normal((2, windows, 1)) * 10
    noise = 0.1 * draw()
    y = 2.0 * columns[0] - 3.0 * columns[1] + factors[0] * own[0] + 1j * factors[1] * own[1] + noise
    return y, columns, own


def test_the_regression_equals_dense_least_squares():
    y, columns, own = problem(np.random.default_rng(0))
    found = regress(y, columns, own, np.ones(y.shape), rounds=1)
    windows, count = y.shape
    design = [np.concatenate([c.real.ravel(), c.imag.ravel()]) for c in columns]
    for w in range(windows):
        for c in own:
            for unit in (1.0, 1j):
                alone = np.zeros((windows, count), dtype=complex)
                alone[w] = unit * c[w]
                design.append(np.concatenate([alone.real.ravel(), alone.imag.ravel()]))
    target = np.concatenate([y.real.ravel(), y.imag.ravel()])
    dense = np.linalg.lstsq(np.stack(design, axis=1), target, rcond=None)[0]
    np.testing.assert_allclose(found.solution, dense[:2], atol=1e-12)


def test_outliers_are_downweighted():
    y, columns, own = problem(np.random.default_rng(1))
    y[2, 5] += 500.0
    found = regress(y, columns, own, np.ones(y.shape), rounds=5)
    np.testing.assert_allclose(found.solution, [2.0, -3.0], atol=0.1)
    assert found.weight[2, 5] < 1e-3


def test_the_deviations_match_the_true_spread():
    """For independent windows: the variance is doubled, since windows usually overlap."""
    draws = [regress(*(p := problem(np.random.default_rng(s))), np.ones(p[0].shape), 1) for s in range(200)]
    spread = np.std([d.solution for d in draws], axis=0)
    told = np.mean([np.sqrt(np.diag(d.covariance)) for d in draws], axis=0)
    assert np.all(told > 1.2 * spread)
    assert np.all(told < 2.2 * spread)


@pytest.mark.parametrize("gap", [0.0, 30.0])
def test_windows_overlap_by_half_and_contain_no_gap(gap: float):
    time = np.arange(100) * 0.5
    time[50:] += gap
    rows = windows_of(time, np.ones(100, dtype=bool), 10.0)
    assert rows.shape[1] == 20
    assert np.all(np.ptp(time[rows], axis=1) < 13)
    assert len(rows) == (9 if gap == 0 else 8)


@pytest.mark.parametrize("n", [1, 2, 7, 500])
@pytest.mark.parametrize("count", [1, 2, 5, 50])
def test_the_moving_mean_equals_scipy_s(n: int, count: int):
    rows = np.random.default_rng(n).normal(size=(3, n))
    assert moving_mean(rows, count).tobytes() == uniform_filter1d(rows, count, axis=1).tobytes()
