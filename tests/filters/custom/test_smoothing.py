"""The smoother for custom models, compared with least squares over a whole log, which is not recursive."""

from dataclasses import replace

import numpy as np
import pytest

from custom_models import PARAMETERS, PENDULUM, SCALING, pendulum_log, point_log, point_model
from sigmaswarm import InputError, run_model, smooth_model

Q, R = 0.3, 0.04


def test_for_a_linear_model_it_equals_least_squares_over_the_log():
    log, model = point_log(n=100), point_model()
    names = [t.name for t in model.parameters]
    p = SCALING | dict(zip(names, (Q, R), strict=True))
    found = smooth_model(log, model, p)
    k, values = len(log.time), model.values(p)
    precision, right = np.zeros((2 * k, 2 * k)), np.zeros(2 * k)

    def add(rows: np.ndarray, value: np.ndarray, covariance: np.ndarray) -> None:
        weight = np.linalg.inv(covariance)
        precision[:] += rows.T @ weight @ rows
        right[:] += rows.T @ weight @ value

    def state(i: int, what: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(what), 2 * k))
        rows[:, 2 * i : 2 * i + 2] = what
        return rows

    add(state(0, np.eye(2)), np.array(log.mean), np.array(log.covariance))
    for i, dt in enumerate(np.diff(log.time)):
        moves = np.array([[1.0, dt], [0.0, 1.0]])
        q = np.asarray(model.process_noise(dt, values))
        add(state(i + 1, np.eye(2)) - state(i, moves), np.zeros(2), q if q.ndim == 2 else np.diag(q))
    for t, z in zip(log.measurement_time, log.measurements, strict=True):
        add(state(int(np.searchsorted(log.time, t)), np.eye(1, 2)), z, np.array([[R]]))
    covariance = np.linalg.inv(precision)
    np.testing.assert_allclose(found.mean.ravel(), covariance @ right, rtol=0, atol=1e-6)
    for i in (0, k // 2, k - 1):
        block = covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2]
        np.testing.assert_allclose(found.covariance[i], block, rtol=1e-4, atol=1e-10)


@pytest.mark.parametrize("kind", ["ukf", "ekf"])
def test_the_smoother_is_more_accurate_on_a_pendulum(kind: str):
    log = pendulum_log(duration=8.0)
    model = PENDULUM if kind == "ukf" else replace(PENDULUM, kind=kind)
    p = PARAMETERS if kind == "ukf" else {k: v for k, v in PARAMETERS.items() if k not in SCALING}
    filtered, smoothed = run_model(log, model, p), smooth_model(log, model, p)
    np.testing.assert_allclose(smoothed.mean[-1], filtered.mean[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(smoothed.nll, filtered.nll, rtol=1e-6)
    assert np.mean(smoothed.covariance[:, 1, 1]) < 0.6 * np.mean(filtered.covariance[:, 1, 1])
    assert smoothed.failure is None
    assert np.all(np.abs(smoothed.mean[:, 0]) <= np.pi)


def test_wrong_arguments_and_failures_are_reported():
    log = pendulum_log(duration=3.0)
    with pytest.raises(InputError, match="length"):
        smooth_model(log, PENDULUM, SCALING)
    model = replace(PENDULUM, process_noise=lambda dt, p: np.array([1e-12, -10.0]) * dt)
    found = smooth_model(log, model, PARAMETERS)
    assert found.failure is not None
    assert np.isnan(found.mean[-1]).all()
