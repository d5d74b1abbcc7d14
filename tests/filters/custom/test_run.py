"""Filters of custom models, compared with an exact Kalman filter and the textbook filter; failures."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from custom_models import PARAMETERS, PENDULUM, SCALING, pendulum_log, point_log, point_model
from sigmaswarm import (
    InputError,
    Log,
    Model,
    SigmaswarmWarning,
    Tunable,
    initial_state,
    run_model,
    run_textbook,
)
from sigmaswarm.filters.custom import run as module
from sigmaswarm.filters.custom.run import MAX_DIFFERENCE, Runner, _same, run_kernel
from sigmaswarm.filters.models import planar5
from sigmaswarm.filters.parameters import FilterParameters
from support import diagonal, make_drive, timeline_of

POINT = point_model()
POINT_LOG = point_log(n=250)


def exact_nll(log: Log, q: float, r: float) -> np.ndarray:
    """Compute the NLL of each measurement with a Kalman filter in plain NumPy."""
    x, p = np.array(log.mean), np.array(log.covariance)
    costs, before, rows = (
        [],
        log.time[0],
        dict(zip(log.measurement_time, log.measurements[:, 0], strict=True)),
    )
    for t in log.time:
        dt, before = t - before, t
        f = np.array([[1.0, dt], [0.0, 1.0]])
        x, p = f @ x, f @ p @ f.T + q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        if t in rows:
            nu, s = rows[t] - x[0], p[0, 0] + r
            costs.append(0.5 * (nu**2 / s + np.log(2 * np.pi * s)))
            k = p[:, 0] / s
            x, p = x + k * nu, p - np.outer(k, p[0])
    return np.array(costs)


@pytest.mark.parametrize(
    ("q", "r", "kind"), diagonal([(0.5, 0.3), (20.0, 1e-3), (1e-3, 50.0)], ["ukf", "ekf"])
)
def test_the_likelihood_is_that_of_a_kalman_filter(q: float, r: float, kind: str):
    model = POINT if kind == "ukf" else point_model(kind="ekf")
    parameters = {"q": q, "r": r} | (SCALING if kind == "ukf" else {})
    estimate = run_model(POINT_LOG, model, parameters)
    assert estimate.nll == pytest.approx(exact_nll(POINT_LOG, q, r), rel=1e-9, abs=1e-9)
    assert estimate.failure is None


def both(model: Model, log: Log, parameters: dict, **options):
    runner = Runner(model, [log])
    assert runner.kernel is not None
    return [
        run_kernel(model, kernel, runner.steps[0], parameters, covariances=True)
        for kernel in (runner.kernel, None)
    ]


# A small alpha amplifies rounding errors by 1 / alpha^2
@pytest.mark.parametrize(("case", "alpha"), diagonal(["over the top", "pendulum", "point"], [0.3, 1.0]))
def test_compiled_and_textbook_agree(case: str, alpha: float):
    model, log, parameters = {
        "pendulum": (PENDULUM, pendulum_log(duration=8.0), PARAMETERS),
        "over the top": (PENDULUM, pendulum_log(duration=8.0, start=(0.7, 9.0)), PARAMETERS),
        "point": (POINT, POINT_LOG, SCALING | {"q": 0.5, "r": 0.3}),
    }[case]
    compiled, textbook = both(model, log, parameters | {"alpha": alpha})
    assert compiled.failed == textbook.failed == -1
    for name in ("mean", "covariance", "nis", "nll"):
        a, b = getattr(compiled, name), getattr(textbook, name)
        assert np.isfinite(a).all()
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * max(1.0, np.abs(b).max()), err_msg=name)


@pytest.mark.long
def test_a_car_as_a_custom_model_equals_the_built_in_model():
    """planar5 as a custom `Model` on jittered clocks takes the same steps as `run_textbook`."""
    drive = make_drive(duration=14.0, jitter=0.4, seed=3)
    initial = initial_state(drive)
    line = timeline_of(drive, initial.time)
    model = Model(
        "car",
        states=("x", "y", "vx", "vy", "theta"),
        f=lambda s, dt, u, p: planar5(s, dt, u),
        h=lambda s, p: s[:2],
        parameters=(Tunable("q", 1e-9, 1.0), Tunable("r", 1e-2, 10.0)),
        process_noise=lambda dt, p: np.full(5, p.q) * dt / drive.nominal_interval,
        measurement_noise=lambda p: [p.r, p.r],
        angles=("theta",),
    )
    start = np.searchsorted(drive.imu.time, initial.time, side="right")
    imu = np.column_stack([drive.imu.ax, drive.imu.ay, drive.imu.gz])[start:]
    log = Log(
        "car",
        np.concatenate([[initial.time], drive.imu.time[start:]]),
        line.fix_time,
        line.fixes[:, :2],
        initial.mean,
        initial.covariance,
        inputs=np.concatenate([np.zeros((1, 3)), imu]),
    )
    parameters = SCALING | {"q": 1e-6, "r": 1.0}
    with pytest.warns(
        SigmaswarmWarning, match="can't be compiled"
    ):  # planar5 is plain Python, which Numba does not compile
        estimate = run_model(log, model, parameters)
    car = FilterParameters(0.5, 2.0, 1.0, (1e-6,) * 5, (1.0, 1.0))
    reference = run_textbook(drive, car, initial=initial, heading_first=False)
    np.testing.assert_allclose(estimate.mean[1:], reference.mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(estimate.covariance[1:], reference.covariance, rtol=0, atol=1e-9)


@pytest.mark.parametrize("start", [(0.7, 0.0), (3.0, 0.5), (0.7, 9.0)])
def test_an_angle_may_cross_pi(start):
    """Measurements jump by 2 pi where the true angle does not; the estimate stays accurate."""
    log = pendulum_log(start=start)
    jumps = np.abs(np.diff(log.measurements[:, 0])) > np.pi
    assert jumps.any() == (start != (0.7, 0.0))
    estimate = run_model(log, PENDULUM, PARAMETERS)
    wrong = estimate.mean[:, 0] - log.truth["angle"]
    wrong -= 2 * np.pi * np.round(wrong / (2 * np.pi))
    assert np.sqrt(np.mean(wrong[100:] ** 2)) < 0.02  # better than the measurements
    assert np.abs(estimate.mean[:, 0]).max() <= np.pi
    assert 0.7 < estimate.nis.mean() < 1.3


F, H, Q, R, P, WRAPS, IN_PLACE = range(1, 8)
"""Variants of the pendulum with the same machine code; the first five fail."""


def varied_swing(state, dt, u, p):
    rate = state[1] - 9.81 / p.length * np.sin(state[0]) * dt
    if p.variant == F and u[0] > 3.0:
        rate = np.nan
    angle = state[0] + rate * dt
    if p.variant == WRAPS:
        angle = (angle + np.pi) % (2 * np.pi) - np.pi
    if p.variant == IN_PLACE:
        state[0], state[1] = angle, rate
        return state
    return np.array([angle, 0.0 if p.variant == P else rate])


def varied_noise(dt, p):
    q = -1.0 if p.variant == Q else 0.0 if p.variant == P else p.q_rate
    return np.array([0.0 if p.variant == P else 1e-12, q]) * dt


VARIED = replace(
    PENDULUM,
    f=varied_swing,
    h=lambda state, p: np.array([np.nan if p.variant == H else state[0]]),
    process_noise=varied_noise,
    measurement_noise=lambda p: np.array([-1.0 if p.variant == R else 4e-4]),
    parameters=(*PENDULUM.parameters, Tunable("variant", 0, 7, logarithmic=False)),
)


@pytest.mark.long
def test_a_process_that_wraps_its_angle_gives_the_same_filter():
    log = pendulum_log(duration=8.0, start=(0.7, 9.0))
    plain = run_model(log, PENDULUM, PARAMETERS)
    for run in both(VARIED, log, PARAMETERS | {"variant": WRAPS}):
        assert np.abs(run.mean[:, 0]).max() < 4  # the angle is wrapped
        np.testing.assert_allclose(run.nll, plain.nll, rtol=0, atol=1e-8)


def test_other_bounds_or_noise_need_no_compilation(monkeypatch: pytest.MonkeyPatch):
    log = pendulum_log(duration=2.0)
    expected = run_model(log, PENDULUM, PARAMETERS | {"r_angle": 2 * PARAMETERS["r_angle"]})
    monkeypatch.setattr(module, "build_kernel", lambda *_, **__: pytest.fail("compiled again"))
    other = replace(PENDULUM, measurement_noise=lambda p: np.array([2 * p.r_angle]))
    assert run_model(log, other, PARAMETERS).mean.tobytes() == expected.mean.tobytes()


def test_a_kernel_that_differs_from_the_textbook_is_compiled_again(
    monkeypatch: pytest.MonkeyPatch,
):
    """The kernel can differ if a module variable that its functions read has changed."""
    runner, fits, built = Runner(PENDULUM, [pendulum_log(duration=2.0)]), iter([False, True]), list[str]()
    monkeypatch.setattr(module, "_same", lambda *_: next(fits))
    monkeypatch.setattr(module, "build_kernel", lambda *_, **__: built.append("again") or runner.kernel)
    assert module.kernel_of(replace(PENDULUM), runner.steps[0]) is runner.kernel
    assert built == ["again"]


# --- Functions that can't be compiled --------------------------------------------------------------------


class Strange:
    """A callable that Numba can't compile."""

    def __call__(self, state, dt, u, p):
        return {"next": PENDULUM.f(state, dt, u, p)}["next"]


def test_functions_that_can_not_be_compiled_run_in_python():
    log = pendulum_log(duration=5.0)
    strange = replace(PENDULUM, f=Strange())
    with pytest.warns(SigmaswarmWarning, match=r"pendulum: can't be compiled \(.+\); the textbook") as told:
        slow = run_model(log, strange, PARAMETERS)
    assert len(told) == 1
    assert "\n" not in str(told[0].message)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # the warning is shown once
        again = run_model(log, strange, PARAMETERS)
    fast = run_model(log, PENDULUM, PARAMETERS)
    assert slow.mean.tobytes() == again.mean.tobytes()
    np.testing.assert_allclose(slow.mean, fast.mean, rtol=0, atol=1e-10)
    np.testing.assert_allclose(slow.nll, fast.nll, rtol=0, atol=1e-10)


def test_compiled_functions_may_differ_from_the_textbook_by_rounding_only():
    model = point_model(kind="ekf")
    book = run_kernel(
        model, None, Runner(model, [POINT_LOG]).steps[0], {"q": 0.5, "r": 0.3}, covariances=True
    )
    std = np.sqrt(np.diagonal(book.covariance, axis1=1, axis2=2))
    for off, same in (
        (0.0, True),
        (0.5 * MAX_DIFFERENCE, True),
        (2.0 * MAX_DIFFERENCE, False),
        (np.nan, False),
    ):
        moved = np.where(np.arange(len(std))[:, np.newaxis] == 7, off * std, 0.0)
        assert _same(replace(book, mean=book.mean + moved), book) == same


@pytest.mark.long
def test_a_function_whose_compiled_form_differs_causes_a_warning():
    def f(state, dt, u, p):
        try:
            one = 1.0 / (p.length - p.length)  # Python raises an error; the compiled form returns infinity
        except Exception:
            one = 1.0
        return np.array([state[0] + one * state[1] * dt, state[1]])

    with pytest.warns(
        SigmaswarmWarning, match="the compiled functions and the Python functions return different numbers"
    ):
        estimate = run_model(pendulum_log(duration=2.0), replace(PENDULUM, f=f), PARAMETERS)
    assert estimate.failure is None


@pytest.mark.long
def test_f_may_change_its_argument():
    log = pendulum_log(duration=5.0)
    compiled, textbook = both(VARIED, log, PARAMETERS | {"variant": IN_PLACE})
    expected = run_model(log, PENDULUM, PARAMETERS)
    for run in (compiled, textbook):
        np.testing.assert_allclose(run.covariance, expected.covariance, rtol=0, atol=1e-12)


def test_f_may_not_change_the_log():
    log = pendulum_log(duration=5.0)

    def spoil(state, dt, u, p):
        u -= state[0]
        return state

    with pytest.raises(InputError, match=r"f fails on swing \(ValueError, .*read-only"):
        run_model(
            Log(**(vars(log) | {"inputs": np.ones(len(log.time))})), replace(PENDULUM, f=spoil), PARAMETERS
        )


# --- Failures ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("fault", [F, H, Q, R, P])
def test_a_failure_reports_its_time_and_leaves_nan(fault: int):
    """Each function in turn returns a wrong value; the compiled and the textbook filter fail in the same step."""
    log = pendulum_log(duration=5.0)
    log = Log(**(vars(log) | {"inputs": log.time}))
    parameters = PARAMETERS | {"variant": fault}
    runs = both(VARIED, log, parameters)
    assert runs[0].failed == runs[1].failed >= 0
    for run in runs:
        row = int(np.argmax(np.isnan(run.mean[:, 0])))
        assert np.isnan(run.mean[row:]).all()
        assert np.isfinite(run.mean[:row]).all()
    estimate = run_model(log, VARIED, parameters)
    if fault == F:
        assert log.time[row] == pytest.approx(3.01)
        assert "swing: the filter failed at t = 3.010 s" in estimate.failure
    else:
        assert row < 20
        assert "failed at t = 0." in estimate.failure


@pytest.mark.parametrize("error", [ValueError, ZeroDivisionError])
def test_an_error_in_f_during_a_run_is_a_failure(error):
    def f(state, dt, u, p):
        if state[1] < -1.0:
            raise error("out of range")
        return PENDULUM.f(state, dt, u, p)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SigmaswarmWarning)
        estimate = run_model(pendulum_log(duration=3.0), replace(PENDULUM, f=f), PARAMETERS)
    assert "failed" in estimate.failure


def test_truth_is_not_read():
    log = pendulum_log(duration=3.0)
    blind = run_model(Log(**(vars(log) | {"truth": {}})), PENDULUM, PARAMETERS)
    assert blind.mean.tobytes() == run_model(log, PENDULUM, PARAMETERS).mean.tobytes()
