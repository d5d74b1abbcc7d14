"""Several sensors with their own clocks, compared with NumPy filters that delete the absent rows of h, R and z."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm import InputError, Log, Model, SigmaswarmWarning, Tunable, run_model, smooth_model, tune
from sigmaswarm.filters.compiled.custom import _leave_out
from sigmaswarm.filters.custom.run import Runner, run_kernel

RNG = np.random.default_rng(5)
MIXED = np.array([[1.0, 0.3, 0.1, 0.0], [0.3, 1.0, 0.2, 0.1], [0.1, 0.2, 1.0, 0.3], [0.0, 0.1, 0.3, 1.0]])
"""Correlations of the errors. With them, deleting a row differs from giving it a large variance."""


def drive(state, dt, u, p):
    x, y, v, course = state
    return np.array(
        [x + dt * v * np.cos(course), y + dt * v * np.sin(course), v + dt * u[0], course + dt * u[1]]
    )


def seen(state, p):
    """Return position, wheel speed and compass, as many as p.elements states."""
    return np.array([state[0], state[1], 1.02 * state[2], state[3]])[: int(p.elements)]


def noise(p):
    deviation = np.sqrt([p.r, p.r, 0.01, 0.02])
    k = int(p.elements)
    return (MIXED * np.outer(deviation, deviation))[:k, :k].copy()


CAR = Model(
    "car",
    states=("x", "y", "v", "course"),
    f=drive,
    h=seen,
    parameters=(Tunable("q", 1e-4, 1.0), Tunable("r", 1e-2, 10.0), Tunable("elements", 4.0, 4.9, logarithmic=False)),
    process_noise=lambda dt, p: np.array([1e-4, 1e-4, p.q, 1e-3]) * dt,
    measurement_noise=noise,
    angles=("course",),
    measured_angles=(3,),
    scored=("x", "y"),
)  # fmt: skip
WITHOUT_COMPASS = replace(
    CAR,
    parameters=(*CAR.parameters[:2], Tunable("elements", 3.0, 3.9, logarithmic=False)),
    measured_angles=(),
)
"""It has the same functions as CAR, so that no compilation is needed."""
EXTENDED = replace(CAR, kind="ekf")
P = {"q": 0.05, "r": 0.5, "elements": 4.0}
SCALING = {"alpha": 0.8, "beta": 2.0, "kappa": 0.5}


def sensors(duration: float = 6.0) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return a circular drive whose course crosses pi: position 4 Hz, wheel 25 Hz, compass 10 Hz."""
    times = [np.arange(round(duration * rate)) / rate for rate in (4, 25, 10)]
    course = [2.0 + 0.4 * t for t in times]
    place = 12.5 * np.column_stack([np.sin(course[0]) - np.sin(2.0), np.cos(2.0) - np.cos(course[0])])
    return {
        "gps": (times[0], place + 0.7 * RNG.standard_normal(place.shape)),
        "wheel": (times[1], 5.1 + 0.1 * RNG.standard_normal(len(times[1]))),
        "compass": (times[2], (course[2] + 0.1 * RNG.standard_normal(len(times[2])) + np.pi) % (2 * np.pi) - np.pi),
    }  # fmt: skip


def log_of(name: str = "monday", given: dict | None = None) -> Log:
    time = np.arange(300) / 50 + 0.001
    return Log.from_sensors(
        name,
        time,
        sensors() if given is None else given,
        mean=[0.0, 0.0, 5.0, 2.0],
        covariance=np.diag([1.0, 1.0, 0.1, 0.01]),
        inputs=np.column_stack([0.3 * np.sin(time), np.full(300, 0.4)]),
    )


LOG = log_of()


def turned(a):
    return a - 2 * np.pi * np.round(a / (2 * np.pi))


def deleting(log: Log, kind: str) -> tuple[np.ndarray, ...]:
    """Run a filter that deletes rows; return means and covariances at the log's times, and NIS and NLL."""
    p = CAR.record(**P)
    x, c, n, before = np.array(log.mean), np.array(log.covariance), 4, log.time[0]
    gamma2 = SCALING["alpha"] ** 2 * (n + SCALING["kappa"])
    wm = np.full(2 * n + 1, 0.5 / gamma2)
    wm[0] = 1 - n / gamma2
    wc = wm + np.eye(2 * n + 1)[0] * (1 - SCALING["alpha"] ** 2 + SCALING["beta"])

    def points():
        root = np.sqrt(gamma2) * np.linalg.cholesky(c).T
        return np.vstack([x, x + root, x - root])

    means, covariances, costs = [], [], []
    within = (log.measurement_time >= log.time[0]) & (log.measurement_time <= log.time[-1])
    rows = dict(zip(log.measurement_time[within], log.measurements[within], strict=True))
    for t in sorted({*log.time, *rows}):
        dt, before, u = t - before, t, log.inputs[np.searchsorted(log.time, t)]
        if dt > 0 and kind == "ukf":
            moved = np.array([drive(s, dt, u, p) for s in points()])
            x = wm @ moved  # f does not wrap
            c = (wc * (moved - x).T) @ (moved - x) + np.diag(CAR.process_noise(dt, p))
        elif dt > 0:
            sin, cos = np.sin(x[3]), np.cos(x[3])
            jacobian = np.eye(4)
            jacobian[:2, 2:] = dt * np.array([[cos, -x[2] * sin], [sin, x[2] * cos]])
            x = drive(x, dt, u, p)
            c = jacobian @ c @ jacobian.T + np.diag(CAR.process_noise(dt, p))
        if t in rows:
            z = rows[t]
            there = np.flatnonzero(~np.isnan(z))
            r = noise(p)[np.ix_(there, there)]
            if kind == "ukf":
                sigmas = points()
                images = np.array([seen(s, p)[there] for s in sigmas])
                expected = wm @ images
                s = (wc * (images - expected).T) @ (images - expected) + r
                cross = (wc * (sigmas - x).T) @ (images - expected)
            else:
                jacobian = np.diag([1.0, 1.0, 1.02, 1.0])[there]
                expected, cross, s = jacobian @ x, c @ jacobian.T, jacobian @ c @ jacobian.T + r
            nu = z[there] - expected
            nu[there == 3] = turned(nu[there == 3])
            nis = nu @ np.linalg.inv(s) @ nu
            costs.append((nis, 0.5 * (nis + np.log(np.linalg.det(s)) + len(there) * np.log(2 * np.pi))))
            gain = cross @ np.linalg.inv(s)
            x, c = x + gain @ nu, c - gain @ s @ gain.T
        if t in log.time:
            means.append(x)
            covariances.append(c)
    return np.array(means), np.array(covariances), *np.array(costs).T


@pytest.mark.parametrize("case", ["compiled", "textbook", "ekf"])
def test_absent_elements_are_deleted_rows(case: str):
    kind = "ekf" if case == "ekf" else "ukf"
    model, parameters = (EXTENDED, P) if case == "ekf" else (CAR, P | SCALING)
    runner = Runner(model, [LOG])
    assert (runner.kernel is None) == (kind == "ekf")
    kernel = runner.kernel if case == "compiled" else None
    run = run_kernel(model, kernel, runner.steps[0], parameters, covariances=True)
    names = ("mean", "covariance", "nis", "nll")
    for name, expected in zip(names, deleting(LOG, kind), strict=True):
        np.testing.assert_allclose(getattr(run, name), expected, rtol=1e-10, atol=1e-10, err_msg=name)
    patterns = {"".join("01"[int(v)] for v in row) for row in ~np.isnan(LOG.measurements)}
    assert patterns == {"0010", "0001", "0011", "1100", "1101", "1111"}  # all patterns that the test contains
    if case != "compiled":
        smoothed = smooth_model(LOG, model, parameters)
        np.testing.assert_allclose(smoothed.nll, run.nll, rtol=1e-12)
        assert np.mean(smoothed.covariance[:, 0, 0]) < 0.8 * np.mean(run.covariance[:, 0, 0])


@pytest.mark.parametrize("compiled", [True, False])
def test_a_sensor_without_values_is_a_model_without_this_sensor(compiled: bool):
    """The compass has one value, at the last time. Before it, the filter equals that of a model without a compass."""
    given = sensors()
    end = LOG.time[-1]
    with_one = log_of(given=given | {"compass": ([end], [-1.0])})
    without = log_of(given={name: given[name] for name in ("gps", "wheel")})
    runs = []
    for model, log, elements in ((CAR, with_one, 4.0), (WITHOUT_COMPASS, without, 3.0)):
        runner, parameters = Runner(model, [log]), SCALING | P | {"elements": elements}
        assert runner.kernel is not None
        kernel = runner.kernel if compiled else None
        runs.append(run_kernel(model, kernel, runner.steps[0], parameters, covariances=True))
    for name in ("mean", "covariance", "nis", "nll"):
        a, b = (getattr(run, name) for run in runs)
        a, b = a[: len(b)][:-1], b[:-1]
        if compiled:
            assert a.tobytes() == b.tobytes(), name
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-11, err_msg=name)
    assert abs(runs[0].mean[-1, 3] - runs[1].mean[-1, 3]) > 1e-3  # the one value has an effect


def test_only_absent_elements_are_removed_from_an_update():
    """Present elements keep their bits; h may return NaN for an absent element."""
    nu, s, cross = (RNG.standard_normal(shape) for shape in (3, (3, 3), (2, 3)))
    kept = [a.copy() for a in (nu, s, cross)]
    assert _leave_out.py_func(np.array([1.0, -0.0, 1e300]), nu, s, cross) == 3
    assert all(a.tobytes() == b.tobytes() for a, b in zip((nu, s, cross), kept, strict=True))
    nu[1] = s[1] = s[:, 1] = cross[:, 1] = np.nan
    assert _leave_out.py_func(np.array([1.0, np.nan, 2.0]), nu, s, cross) == 2
    np.testing.assert_array_equal(nu, kept[0] * [1, 0, 1])
    np.testing.assert_array_equal(s, kept[1] * np.outer([1, 0, 1], [1, 0, 1]) + np.diag([0, 1, 0]))
    np.testing.assert_array_equal(cross, kept[2] * [1, 0, 1])


# --- Merging of sensors ------------------------------------------------------------------------------------


def test_sensors_are_merged_by_their_times():
    nan = np.nan
    given = {
        "gps": ([0.0, 0.2, 0.4], [[1, 2], [3, nan], [nan, nan]]),  # a table with empty rows
        "wheel": (np.array([0.1, 0.2]), np.array([7, 8])),
    }
    log = Log.from_sensors("a", [0.0, 0.5], given, [0.0], [[1.0]], inputs=[1.0, 2.0], truth={"v": [1, 2]})
    assert log.measurement_time.tolist() == [0.0, 0.1, 0.2]
    np.testing.assert_array_equal(log.measurements, [[1, 2, nan], [nan, nan, 7], [3, nan, 8]])
    assert log.inputs.tolist() == [[1.0], [2.0]]
    assert log.truth["v"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, "sensors must be a mapping of names to"),
        ({"gps": np.zeros(3)}, "sensors['gps'] is not a pair; pass (times, values)"),
        ({"gps": ([0.0, 0.0], [1, 2])}, "times of sensors['gps'][1] = 0 s does not come after 0 s; sort the rows"),
        ({"gps": ([0.0, 0.1], [1])}, "values of sensors['gps'] has shape (1,), but times of sensors['gps'] has 2"),
        ({"gps": ([0.0], [np.inf])}, "values of sensors['gps'][0] is inf; correct the value, or omit the row"),
        ({"gps": ([0.0], [np.nan])}, "sensors['gps'] has no value, only nan; omit this sensor"),
        ({"gps": ([9.0], [1.0])}, "sensors['gps'] has no value within time = 0.001 to 5.981 s; convert"),
        ({"gps": ([1.0], [[1.0, np.nan]])}, "measurements[:, 1] has no value, only nan; omit this sensor"),
    ],
    ids=str,
)  # fmt: skip
def test_a_sensor_that_can_not_be_merged_is_named_in_the_error(given: dict, expected: str):
    others = {"wheel": ([1.0], [2.0])} if given else {}
    with pytest.raises(InputError) as caught:
        log_of(given=given | others)
    print(caught.value)
    assert str(caught.value).startswith(f"log monday: {expected}")


# --- Tuning ------------------------------------------------------------------------------------------------


def test_the_noise_of_several_sensors_is_tuned_and_validated():
    logs = [LOG, log_of("tuesday")]
    options = {"objective": "innovation-nll", "particles": 4, "generations": 3}
    with warnings.catch_warnings():
        warnings.simplefilter("error", SigmaswarmWarning)  # a model that can't be compiled causes a warning
        tuning = tune(logs[0], model=CAR, validation=logs[1], **options)
    costs = [run_model(log, CAR, tuning.parameters).nll.mean() for log in logs]
    assert [tuning.cost, tuning.validation.cost] == costs
    present = np.mean(np.sum(~np.isnan(LOG.measurements[1:]), axis=1))  # some precede the log
    assert tuning.validation.gap == pytest.approx(np.expm1((costs[1] - costs[0]) / present), rel=1e-12)
