"""Outliers in custom models: update, likelihood and smoother with a limit of the NIS."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from filters.custom.test_live import inputs, live
from filters.custom.test_sensors import CAR, EXTENDED, SCALING, P, log_of
from sigmaswarm import InputError, Log, Model, Tunable, run_model, smooth_model, tune
from sigmaswarm.filters.custom.run import Runner, run_kernel

ROBUST = replace(CAR, robust=0.95)


def with_outliers(every: int = 7, size: float = 30.0) -> Log:
    log = log_of()
    measurements = log.measurements.copy()
    fixes = np.flatnonzero(~np.isnan(measurements[:, 0]))[3::every]
    measurements[fixes, 0] += size
    return replace(log, measurements=measurements)


def line() -> Model:
    """Return a linear model; a test repeats its filter in plain NumPy."""
    return Model(
        "line",
        states=("x", "v"),
        f=lambda s, dt, u, p: np.array([s[0] + dt * s[1], s[1]]),
        h=lambda s, p: np.array([s[0], s[0] + 0.5 * s[1]]),
        parameters=(Tunable("q", 1e-4, 1.0), Tunable("r", 1e-2, 10.0)),
        process_noise=lambda dt, p: np.array([0.0, p.q * dt]),
        measurement_noise=lambda p: np.array([[p.r, 0.3 * p.r], [0.3 * p.r, p.r]]),
        robust=0.99,
    )


def test_the_limited_update_is_that_of_a_linear_kalman_filter():
    """Compare with K nu limit / NIS, P - K S K^T limit / NIS, and the likelihood that the docstring defines."""
    rng = np.random.default_rng(1)
    time = np.arange(60) / 10
    z = rng.standard_normal((60, 2))
    z[::9] += 40.0
    z[5, 0] = np.nan
    log = Log("line", time, time, z, np.zeros(2), np.eye(2))
    p = {"q": 0.1, "r": 0.5, **SCALING}
    run = run_model(log, line(), p)
    x, c = np.zeros(2), np.eye(2)
    for k in range(60):
        if k:
            f = np.array([[1.0, time[k] - time[k - 1]], [0.0, 1.0]])
            x, c = f @ x, f @ c @ f.T + np.diag([0.0, 0.1 * (time[k] - time[k - 1])])
        there = ~np.isnan(z[k])
        h = np.array([[1.0, 0.0], [1.0, 0.5]])[there]
        r = np.array([[0.5, 0.15], [0.15, 0.5]])[np.ix_(there, there)]
        s, nu = h @ c @ h.T + r, z[k][there] - h @ x
        nis, limit = nu @ np.linalg.solve(s, nu), chi2.ppf(0.99, there.sum())
        share = min(1.0, limit / nis)
        gain = c @ h.T @ np.linalg.inv(s)
        x, c = x + share * gain @ nu, c - share * gain @ s @ gain.T
        tail = nis if nis <= limit else limit * (1 + np.log(nis / limit))
        nll = 0.5 * (tail + np.linalg.slogdet(s)[1] + there.sum() * np.log(2 * np.pi))
        np.testing.assert_allclose(
            [*run.mean[k], run.nis[k], run.nll[k]], [*x, nis, nll], rtol=1e-8, atol=1e-9
        )
        np.testing.assert_allclose(run.covariance[k], c, rtol=1e-8, atol=1e-12)
    assert (run.nis > chi2.ppf(0.99, 2)).sum() > 5


@pytest.mark.parametrize("model", [ROBUST, replace(EXTENDED, robust=0.95)], ids=["ukf", "ekf"])
def test_compiled_and_textbook_agree(model: Model):
    log = with_outliers()
    parameters = P if model.kind == "ekf" else P | SCALING
    runner = Runner(model, [log])
    run = run_kernel(model, runner.kernel, runner.steps[0], parameters, covariances=True)
    textbook = run_kernel(model, None, runner.steps[0], parameters, covariances=True)
    for name in ("mean", "covariance", "nis", "nll"):
        np.testing.assert_allclose(getattr(run, name), getattr(textbook, name), rtol=1e-9, atol=1e-10)
    smoothed = smooth_model(log, model, parameters)
    np.testing.assert_allclose(smoothed.nll, run.nll, rtol=1e-9)


def test_outliers_move_a_robust_filter_less():
    clean, bad = log_of(), with_outliers()
    parameters = P | SCALING
    truth = run_model(clean, CAR, parameters).mean
    off = {
        model.robust: np.abs(run_model(bad, model, parameters).mean - truth)[:, 0].max()
        for model in (CAR, ROBUST)
    }
    assert off[None] > 5.0
    assert off[0.95] < 0.3 * off[None]


def test_a_robust_filter_recovers_from_a_wrong_initial_state():
    """After 5 s of consecutive outliers, fixes get full weight, as in a filter without limit."""
    log = log_of()
    far = replace(log, mean=np.array([100.0, -80.0, 5.0, 2.0]))
    parameters = P | SCALING
    expected = run_model(log, CAR, parameters).mean[-1]
    assert np.abs(run_model(far, CAR, parameters).mean[-1] - expected)[:2].max() < 3.0
    run = run_model(far, ROBUST, parameters)
    assert np.abs(run.mean[log.time < 4][-1] - expected)[0] > 50.0
    assert np.abs(run.mean[-1] - expected)[:2].max() < 20.0


def test_the_live_filter_applies_the_same_limit():
    log = with_outliers(every=1, size=60.0)  # every measurement is an outlier
    expected, model = run_model(log, ROBUST, P | SCALING), ROBUST
    filter, seen = live(model, log), 0
    for t, u in zip(log.time, inputs(log), strict=True):
        while seen < len(log.measurements) and log.measurement_time[seen] <= t:
            if log.measurement_time[seen] >= log.time[0]:
                filter.update(log.measurement_time[seen], log.measurements[seen])
            seen += 1
        filter.predict(t, u)
    assert filter.state.mean.tobytes() == expected.mean[-1].tobytes()
    assert np.diff(expected.mean[-20:, 0]).max() > 10.0  # full weight after 5 s


def test_a_tuning_applies_the_limit():
    log = with_outliers()
    tuned = {
        model.robust: tune(
            [log], model=model, objective="innovation-nll", particles=8, generations=12
        ).parameters
        for model in (CAR, ROBUST)
    }
    assert tuned[0.95]["r"] < 0.3 * tuned[None]["r"]  # without the limit, R grows to explain the outliers
    assert "robust" not in CAR.identity()  # as in files of earlier versions
    assert ROBUST.identity()["sha256"] != CAR.identity()["sha256"]


def test_wrong_probabilities_are_refused():
    for wrong in (99, 1.0, 0.1, "0.99", float("nan")):
        with pytest.raises(InputError, match=r"robust = .* is not a probability"):
            replace(CAR, robust=wrong)
