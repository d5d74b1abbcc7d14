"""Correlated fix errors as states, compared with a separate EKF; textbook form, kernels, live filter, smoother."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from filter_cases import parameters, rough, straying
from oracles.smoother import smooth_textbook
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.events import FIX, LATERAL, STANDSTILL, events_of
from sigmaswarm.drives.prepared import prepare_drive
from sigmaswarm.errors import InputError
from sigmaswarm.exports.check import check_export
from sigmaswarm.exports.targets import export_texts, write_texts
from sigmaswarm.filters.compiled.run import new_cursor
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.kernels import FILTERS
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS, planar8
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.passes import FilterPass, Targets, run_steps, start_passes
from sigmaswarm.filters.run import run_filter, run_innovations, run_textbook
from sigmaswarm.filters.smoothing import smooth
from sigmaswarm.filters.starts import start_of
from sigmaswarm.filters.textbook.car import TextbookCar
from sigmaswarm.filters.textbook.kalman import complex_step
from support import quickly, sparse

ERROR: dict[str, Any] = {"fix_error": 1.3, "fix_error_time": 2.0, "fix_std": 0.8}
ALONG: dict[str, Any] = {"lateral_noise": 0.05, "rear_axle": 1.2, "standstill_noise": 1e-3}
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "constraints": {**ALONG, "tire_slip": 0.004, "velocity_noise": 0.1, "latency": 0.05, "gate": 9.0},
    "weighed": {"accuracy_scale": 0.4, "robust_dof": 4.0},
}
CASES = [
    ("planar8", "ekf", "plain"),
    ("planar8", "ekf", "constraints"),
    ("planar8", "ekf", "weighed"),
    ("planar8", "ukf", "constraints"),
    ("planar5", "ukf", "weighed"),
    ("planar5", "ekf", "constraints"),
    ("tilted12", "ekf", "constraints"),
    ("tilted12", "ekf", "weighed"),
]


def filter_of(
    model: str = "planar8", kind: str = "ekf", option: str = "plain", **more: Any
) -> FilterParameters:
    return parameters(model, **{"kind": kind, **ERROR, **OPTIONS[option], **more})


def test_the_textbook_agrees_with_a_separate_ekf_with_ten_states():
    """The EKF shares only planar8's process with the code; states, start, time constant and every H are repeated."""
    drive = straying()
    p = filter_of(accuracy_scale=0.4, **ALONG)
    line, start = prepare_drive(drive).timeline(), initial_state(drive)
    car = TextbookCar(line, p, start)
    n, lever, h_fix = 10, drive.lever_arm, np.zeros((2, 10))
    x, P = np.zeros(n), np.zeros((n, n))
    x[:8], P[:8, :8] = start_of(start, replace(p, fix_error=None))
    start_variance = 1.3 * 0.8**2
    for i in range(2):
        P[8 + i, 8 + i] += start_variance
        P[i, i] += start_variance
        P[i, 8 + i] = P[8 + i, i] = -start_variance
    flags, at_fix, fixes = events_of(line, {"lateral", "standstill"}).flags, line.start, iter(line.fixes)
    for k in range(1200):
        car.step(k)
        dt, imu = line.dt[k], line.imu(("ax", "ay", "gz"))[k]
        F = np.eye(n)
        F[:8, :8] = complex_step(lambda s, dt=dt, imu=imu: planar8(s, dt, imu), x[:8])
        x[:8] = planar8(x[:8], dt, imu)
        P = F @ P @ F.T
        P[range(8), range(8)] += np.array(p.process_noise) * line.q_scale[k]
        if flags[k] & FIX:
            z = next(fixes)
            phi = np.exp(-(line.end[k] - at_fix) / 2.0)
            at_fix = line.end[k]
            A = np.diag([1.0] * 8 + [phi, phi])
            x, P = A @ x, A @ P @ A.T
            P[[8, 9], [8, 9]] += 1.3 * z[4:6] * (1 - phi**2)
            c, s = np.cos(x[4]), np.sin(x[4])
            h_fix[:, :2] = h_fix[:, 8:] = np.eye(2)
            h_fix[:, 4] = -s * lever[0] - c * lever[1], c * lever[0] - s * lever[1]
            arm = np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]])
            x, P = updated(
                x, P, z[:2] - x[:2] - x[8:] - arm, h_fix, np.diag(p.measurement_noise + 0.4 * z[4:6])
            )
        if flags[k] & LATERAL:
            c, s, h = np.cos(x[4]), np.sin(x[4]), np.zeros((1, n))
            h[0, 2], h[0, 3], h[0, 4], h[0, 7] = -s, c, -c * x[2] - s * x[3], 1.2
            left = c * x[3] - s * x[2] - 1.2 * (imu[2] - x[7])
            x, P = updated(x, P, -np.array([left]), h, np.array([[0.05]]))
        if flags[k] & STANDSTILL:
            x, P = updated(x, P, -x[2:4], np.eye(n)[2:4], 1e-3 * np.eye(2))
            x, P = updated(x, P, imu[2:] - x[7:8], np.eye(n)[7:8], np.radians(0.5) ** 2 * np.eye(1))
        np.testing.assert_allclose(car.filter.mean, x, rtol=0, atol=1e-10)
        np.testing.assert_allclose(car.filter.covariance, P, rtol=0, atol=1e-11 * P.max())
    assert k > 1000 and np.abs(x[8:]).max() > 0.1  # the error states are not zero


def updated(x: np.ndarray, P: np.ndarray, nu: np.ndarray, H: np.ndarray, R: np.ndarray):
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return x + K @ nu, P - K @ H @ P


@pytest.mark.parametrize(("model", "kind", "option"), CASES)
def test_compiled_filter_agrees_with_the_textbook(model: str, kind: str, option: str):
    drive = sparse(straying() if option == "weighed" else rough(), 8)
    p = filter_of(model, kind, option)
    compiled, textbook = run_filter(drive, p, recover=False), run_textbook(drive, p)
    assert compiled.failure is None and textbook.failure is None
    assert compiled.mean.shape[1] == len(MODELS[model].states)  # the result has the model's states only
    assert relative(compiled, textbook) < 1e-9


@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly(CASES[1::2], lambda model, kind, option: model == "planar8"),
)
def test_compiled_smoother_agrees_with_the_textbook(model: str, kind: str, option: str):
    drive = sparse(straying() if option == "weighed" else rough(), 8)
    p = filter_of(model, kind, option)
    assert relative(smooth(drive, p, recover=False), smooth_textbook(drive, p)) < 1e-7


def relative(a: Any, b: Any) -> float:
    """Return the largest difference of means in m, and of covariances relative to their largest element."""
    scale = np.abs(b.covariance).max(axis=(1, 2), keepdims=True)
    return max(np.abs(a.mean - b.mean).max(), (np.abs(a.covariance - b.covariance) / scale).max())


@pytest.mark.parametrize(
    ("model", "option"),
    quickly([("planar8", "constraints"), ("tilted12", "weighed")], lambda model, _: model == "planar8"),
)
def test_live_filter_gives_the_estimates_of_a_run(model: str, option: str):
    drive, p = straying(), filter_of(model, "ekf", option, velocity_noise=None)
    whole, gps, imu = run_filter(drive, p), drive.gps, drive.imu
    live = LiveFilter(
        p,
        whole.initial,
        nominal_interval=drive.nominal_interval,
        lever_arm=[*drive.lever_arm, drive.antenna_height],
    )
    axes, told, fix = [getattr(imu, axis) for axis in MODELS[model].imu], [], 0
    for k, t in enumerate(imu.time):
        while fix < len(gps) and gps.time[fix] <= t:
            live.update(gps.time[fix], (gps.x[fix], gps.y[fix]), std=(gps.std_x[fix], gps.std_y[fix]))
            fix += 1
        live.predict(t, [axis[k] for axis in axes])
        if t > whole.initial.time:
            told.append(live.state)
    means, covariances = (np.array([getattr(s, name) for s in told]) for name in ("mean", "covariance"))
    np.testing.assert_allclose(means[:, :4], whole.mean[:, :4], rtol=0, atol=1e-8)
    np.testing.assert_allclose(covariances, whole.covariance, rtol=1e-6, atol=1e-12)


def test_a_hidden_fix_is_forecast_with_the_decayed_error_and_changes_no_state():
    drive, p = straying(), filter_of()
    ready = prepare_drive(drive)
    hidden = (drive.gps.time > 14.0) & (drive.gps.time < 16.0)
    line = ready.timeline(hidden)
    moved = replace(line, fixes=line.fixes.copy())
    at = np.isin(line.fix_time, drive.gps.time[hidden])
    moved.fixes[at] += 3.0  # the columns of the stated variance, too
    ends = []
    for each in (line, moved):
        drive_pass, array = FilterPass(each, ready.initial, Targets.none(each)), KernelArray([p])
        rows = start_passes([drive_pass], array)[0]
        innovations = np.empty((len(each.fixes), 5))
        run_steps(drive_pass, array, rows, new_cursor(), len(each.dt), innovations=innovations)
        ends.append((rows[: len(FILTERS[p.kernel].states), 0], innovations))
    np.testing.assert_array_equal(ends[0][0], ends[1][0])
    nu, s_xx = ends[1][1][at, 0] - ends[0][1][at, 0], ends[1][1][at, 2] - ends[0][1][at, 2]
    np.testing.assert_allclose(nu, 3.0, atol=1e-9)
    since = line.fix_time[at] - line.fix_time[np.flatnonzero(at)[0] - 1]
    np.testing.assert_allclose(s_xx, 3.0 * 1.3 * (1 - np.exp(-2 * since / 2.0)), rtol=1e-9)


@pytest.mark.parametrize("kind", ["adaptive-ukf", "strong-tracking-ukf", "fuzzy-ukf"])
def test_filter_types_that_adapt_their_noise_reject_it(kind: str):
    with pytest.raises(ValueError, match=f"fix-error can't be combined with {kind}"):
        filter_of(kind=kind)


def wandering(seed: int) -> Drive:
    """Return a drive whose fixes have a Gauss-Markov error of 1 m and 8 s, and white noise of 0.1 m."""
    from support import make_drive

    drive, rng = make_drive(duration=120.0, gps_std=0.1, seed=seed), np.random.default_rng(seed)
    phi = np.exp(-np.diff(drive.gps.time, prepend=drive.gps.time[0] - 100.0) / 8.0)
    error = np.zeros((2, len(drive.gps)))
    for k in range(len(drive.gps)):
        error[:, k] = phi[k] * error[:, k - 1] + rng.normal(0.0, np.sqrt(1 - phi[k] ** 2), 2)
    std = np.ones(len(drive.gps))
    gps = replace(drive.gps, x=drive.gps.x + error[0], y=drive.gps.y + error[1], std_x=std, std_y=std)
    return replace(drive, gps=gps)


def test_it_is_consistent_for_correlated_errors_and_white_noise_is_overconfident():
    q = (1e-8, 1e-8, 1e-5, 1e-5, 1e-7, 1e-9, 1e-9, 1e-11)
    white = FilterParameters(1.0, 0.0, 0.0, q, (0.01, 0.01), "planar8", kind="ekf", bias_std=(0.05, 0.005))
    nees: dict[bool, list[float]] = {False: [], True: []}
    for seed in range(4):
        drive = wandering(seed)
        truth = drive.truth
        assert truth is not None
        for with_error in nees:
            more = {"fix_error": 1.0, "fix_error_time": 8.0} if with_error else {}
            p = replace(white, **more)
            found = run_filter(drive, p)
            off = found.mean[:, :2] - np.column_stack(
                [np.interp(found.time, truth.time, column) for column in (truth.x, truth.y)]
            )
            inverse = np.linalg.inv(found.covariance[:, :2, :2])
            nees[with_error].append(float(np.mean(np.einsum("ki,kij,kj->k", off, inverse, off))))
            nu = run_innovations(drive, p).normalized[:, 0]
            nees[with_error][-1] = nees[with_error][-1] if np.isfinite(nu).all() else np.inf
    assert np.mean(nees[False]) > 20.0
    assert 0.5 < np.mean(nees[True]) < 4.0


@pytest.mark.usefixtures("unoptimized")
@pytest.mark.parametrize(
    ("model", "kind", "option"),
    quickly([CASES[0], CASES[2], CASES[4], CASES[7]], lambda *case: case == CASES[4]),
)
def test_c_library_gives_the_estimates_of_a_run(model: str, kind: str, option: str, tmp_path: Path):
    p = filter_of(model, kind, option, nominal_interval=0.01)
    write_texts(export_texts(p, "c99"), tmp_path, "c99")
    for checked in check_export(tmp_path, p, [straying()]):
        assert checked.double.state < 1e-11
        assert checked.single is not None and checked.single.position < 1e-3


@pytest.mark.parametrize("target", ["filterpy", "robot_localization"])
def test_other_exports_reject_it_with_one_line(target: str):
    with pytest.raises(InputError, match=f"{target} does not support fix-error; tune without fix-error"):
        export_texts(filter_of(nominal_interval=0.01), target)


def test_fix_errors_of_planar5_use_the_rows_of_planar8_s_biases():
    model = FILTERS["planar5+fix-error"]
    assert not model.sensors
    state = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 7.0, 7.0])
    np.testing.assert_array_equal(model.odometer(2.0, 0.5)(state), [2.0])
