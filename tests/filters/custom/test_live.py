"""The live filter of a user's model: equal to a run over the log, also with late measurements."""

from dataclasses import replace

import numpy as np
import pytest

from filters.custom.test_sensors import CAR, EXTENDED, SCALING, P, log_of
from sigmaswarm import InputError, LiveModel, Log, Model, SigmaswarmWarning, run_model

PARAMETERS = P | SCALING
SAME_TIMES = replace(log_of(), time=np.arange(300) / 50)
"""Some measurements have the time of an input."""


def live(model: Model, log: Log, **more) -> LiveModel:
    given = {name: P[name] for name in P} if model.kind == "ekf" else PARAMETERS
    return LiveModel(
        model, given, time=log.time[0], mean=log.mean, covariance=log.covariance, n_inputs=2, **more
    )


def inputs(log: Log) -> np.ndarray:
    assert log.inputs is not None
    return log.inputs


@pytest.mark.parametrize("model", [CAR, EXTENDED], ids=["ukf", "ekf"])
def test_it_equals_a_run_bit_for_bit(model: Model):
    log = log_of() if model.kind == "ekf" else SAME_TIMES
    parameters = P if model.kind == "ekf" else PARAMETERS
    estimate = run_model(log, model, parameters)
    filter, seen = live(model, log), 0
    for k, (t, u) in enumerate(zip(log.time, inputs(log), strict=True)):
        while seen < len(log.measurements) and log.measurement_time[seen] <= t:
            if log.measurement_time[seen] >= log.time[0]:
                assert filter.update(log.measurement_time[seen], log.measurements[seen])
            seen += 1
        filter.predict(t, u)
        if k:
            assert filter.state.mean.tobytes() == estimate.mean[k].tobytes()
            assert filter.state.covariance.tobytes() == estimate.covariance[k].tobytes()
    assert not filter.state.failed


def test_late_measurements_in_any_order_change_nothing():
    log, rng = SAME_TIMES, np.random.default_rng(3)
    estimate = run_model(log, CAR, PARAMETERS)
    usable = log.measurement_time >= log.time[0]
    times, rows = log.measurement_time[usable], log.measurements[usable]
    arrival = times + rng.uniform(0, 0.4, len(times))
    order = np.argsort(arrival)
    filter, seen, late = live(CAR, log, history=0.5), 0, 0
    for t, u in zip(log.time, inputs(log), strict=True):
        filter.predict(t, u)
        while seen < len(order) and arrival[order[seen]] <= t:
            late += times[order[seen]] <= t
            assert filter.update(times[order[seen]], rows[order[seen]])
            seen += 1
    left = order[seen:]
    for i in left:
        assert filter.update(times[i], rows[i])
    assert late > 100
    assert len(left) > 3
    assert filter.too_late == 0
    assert filter.state.mean.tobytes() == estimate.mean[-1].tobytes()


def test_measurements_of_two_sensors_at_one_time_are_combined():
    log = log_of()
    whole = np.array([0.1, -0.2, 5.1, 2.05])
    one, two = live(CAR, log), live(CAR, log)
    one.update(0.01, whole)
    for part in ([0, 1], [2], [3]):
        z = np.full(4, np.nan)
        z[part] = whole[part]
        assert two.update(0.01, z)
        assert not two.update(0.01, z)  # repeated
    for filter in (one, two):
        filter.predict(0.02, [0.1, 0.2])
    assert one.state.mean.tobytes() == two.state.mean.tobytes()
    assert np.abs(one.state.mean - log.mean).max() > 0.01


def test_measurements_that_come_too_late_are_counted():
    log = log_of()
    filter = live(CAR, log, history=0.1)
    for t, u in zip(log.time[:100], inputs(log), strict=False):
        filter.predict(t, u)
    before = filter.state
    z = np.array([0.0, 0.0, 5.0, 2.0])
    assert not filter.update(log.time[99] - 0.13, z)
    assert not filter.update(log.time[0] - 1.0, z)
    assert filter.too_late == 2
    filter.predict(log.time[50], [9.0, 9.0])  # the time does not increase
    assert filter.state.mean.tobytes() == before.mean.tobytes()
    assert filter.update(log.time[99] - 0.09, z)
    assert filter.state.mean.tobytes() != before.mean.tobytes()


def test_a_failed_filter_reports_the_failure():
    log = log_of()
    filter = live(CAR, log)
    filter.predict(0.05, [1e308, 1e308])
    filter.predict(200.0, [0.0, 0.0])
    assert filter.state.failed


def test_wrong_input_is_refused():
    log = log_of()
    filter = live(CAR, log)
    with pytest.raises(InputError, match="inputs has 1 numbers; pass 2"):
        filter.predict(1.0, [0.0])
    with pytest.raises(InputError, match="measurement has 2 numbers; pass 4"):
        filter.update(1.0, [0.0, 0.0])
    with pytest.raises(InputError, match="not finite"):
        filter.update(1.0, [0.0, np.inf, 0.0, 0.0])
    with pytest.raises(InputError, match="not numbers"):
        filter.predict(1.0, ["a", "b"])
    for call in (lambda: filter.predict("noon", [0.0, 0.0]), lambda: filter.update("noon", [0.0] * 4)):
        with pytest.raises(InputError, match="t = 'noon' is not a number"):
            call()
    with pytest.raises(InputError, match="history = -1"):
        live(CAR, log, history=-1)
    with pytest.raises(InputError, match="parameter 'r' is missing"):
        LiveModel(CAR, {"q": 1.0} | SCALING, time=0, mean=log.mean, covariance=log.covariance)
    with pytest.raises(InputError, match="3 values"):
        LiveModel(CAR, PARAMETERS, time=0, mean=[0, 0, 0], covariance=np.eye(3), n_inputs=2)


def test_it_runs_functions_that_cannot_be_compiled():
    log = log_of()

    def h(state, p):
        return np.array([float(str(state[0])), state[1], 1.02 * state[2], state[3]])

    with pytest.warns(SigmaswarmWarning, match="can't be compiled"):
        filter = live(replace(CAR, h=h), log)
    compiled = live(CAR, log)
    for each in (filter, compiled):
        each.update(0.01, [0.1, -0.2, 5.1, 2.05])
        each.predict(0.02, [0.1, 0.2])
    np.testing.assert_allclose(filter.state.mean, compiled.state.mean, rtol=1e-9)
