"""Evidence at the start about the gyro's bias: its consistency, and its combination with a filter's prior."""

from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives.alignment import InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.gyro_bias import UP, GyroBiasEvidence
from sigmaswarm.filters.compiled.layout import R, state_rows
from sigmaswarm.filters.kernel_array import KernelArray
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.packing import unpack_states
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.starts import starts_of
from sigmaswarm.geodesy import wrap_angle
from support import make_drive

OFF = np.radians([11.0, -7.0, 16.0])
PER_SECOND = (1e-3, 1e-3, 0.05, 0.05, 1e-5, 1e-7, 1e-7, 1e-10, 1e-5, 1e-5, 1e-10, 1e-10)
GOOD_GYRO = 1e-4
"""rad/s: the expected bias of a filter that was tuned on an IMU with almost no bias."""


def biased(drive: Drive, off: np.ndarray) -> Drive:
    imu = drive.imu
    assert imu.gx is not None
    assert imu.gy is not None
    return replace(drive, imu=replace(imu, gx=imu.gx + off[0], gy=imu.gy + off[1], gz=imu.gz + off[2]))


def tuned(model: str, std: float = GOOD_GYRO) -> FilterParameters:
    q = tuple(0.01 * density for density in PER_SECOND[: len(MODELS[model].states)])
    kind = MODELS[model].filter_types[0]
    p = FilterParameters(0.5, 2.0, 0.0, q, (1.0, 1.0), model, kind=kind, nominal_interval=0.01)
    return replace(p, bias_std=(0.1, std))


def started(model: str, start: InitialState, std: float) -> tuple[np.ndarray, np.ndarray]:
    mean, covariance = starts_of([start], MODELS[model], np.array([[0.1, std]]))
    return mean[0, 0], covariance[0, 0]


def heading_error(drive: Drive, start: InitialState, theta: float) -> float:
    truth = drive.truth
    assert truth is not None
    return abs(wrap_angle(float(theta - np.interp(start.time, truth.time, np.unwrap(truth.theta)))))


@pytest.mark.parametrize("off", [np.zeros(3), 0.1 * OFF, OFF], ids=["none", "some", "much"])
def test_its_errors_agree_with_its_covariance(off: np.ndarray):
    wrong = []
    for seed in range(60):
        start = initial_state(biased(make_drive(duration=12.0, seed=seed), off))
        assert start.gyro is not None
        wrong.append((start.gyro.bias - off) / np.sqrt(start.gyro.variance))
    rms = np.sqrt(np.mean(np.square(wrong), axis=0))
    assert np.all(rms[:UP] < 0.1)  # no tilt on this road
    assert 0.2 < rms[UP] < 1.1, rms  # the margin for hidden turns is not used on this road of white noise


def test_a_large_gyro_bias_does_not_rotate_the_start():
    errors, before = [], []
    for seed in range(40):
        drive = biased(make_drive(duration=12.0, seed=seed), OFF)
        start = initial_state(drive)
        mean, covariance = started("tilted12", start, GOOD_GYRO)
        errors.append(heading_error(drive, start, mean[4]) / np.sqrt(covariance[4, 4]))
        before.append(heading_error(drive, start, mean[4]))
        assert np.linalg.eigvalsh(covariance).min() > 0
        np.testing.assert_allclose(mean[[10, 11]], OFF[:2], atol=np.radians(2.0))
    assert np.degrees(np.median(before)) < 6.0  # half of the rotation by the bias in the fitted time is 40
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


def test_a_filter_tuned_for_a_good_gyro_ignores_the_evidence():
    start = initial_state(make_drive(duration=12.0, seed=3))
    for model in ("planar5", "planar8", "tilted12"):
        mean, covariance = started(model, start, 1e-9)
        plain = started(model, replace(start, gyro=None), 1e-9)
        np.testing.assert_allclose(mean, plain[0], rtol=0, atol=1e-4)
        np.testing.assert_allclose(covariance, plain[1], rtol=1e-3, atol=1e-6)


def test_prior_and_evidence_are_combined_like_two_measurements():
    turns, variance, taken = np.array([0.3, -0.2, 4.0, -3.0, -1.6]), np.array([0.02, 0.03, 0.04]) ** 2, 0.05
    seen = GyroBiasEvidence(np.array([0.01, -0.02, 0.06]), variance, taken, turns)
    start = InitialState(np.array([1.0, 2.0, 3.0, 4.0, 0.5]), np.diag([1.0, 1.0, 0.2, 0.2, 1e-3]), 9.0, seen)
    std = 0.03
    mean, covariance = started("planar8", start, std)
    # The (x ... theta, bias) of the alignment alone, then the measurement that the bias is 0 with deviation std.
    joint, P = np.append(start.mean + (0.06 - taken) * turns, 0.06), np.zeros((6, 6))
    P[:5, :5] = start.covariance + variance[UP] * np.outer(turns, turns)
    P[:5, 5] = P[5, :5] = variance[UP] * turns
    P[5, 5] = variance[UP]
    gain = P[:, 5] / (P[5, 5] + std**2)
    joint, P = joint - gain * joint[5], P - np.outer(gain, P[5])
    places = [0, 1, 2, 3, 4, 7]
    np.testing.assert_allclose(
        mean[places], joint, atol=2e-3
    )  # a small difference: a different gyro is not ruled out
    np.testing.assert_allclose(covariance[np.ix_(places, places)], P, rtol=0.03, atol=1e-4)


def test_contradicting_evidence_widens_the_prior_continuously():
    variance = np.full(3, 0.01**2)

    def bias_at(seen: float) -> float:
        start = InitialState(
            np.zeros(5),
            np.eye(5),
            0.0,
            GyroBiasEvidence(np.array([0.0, 0.0, seen]), variance, 0.0, np.zeros(5)),
        )
        return float(started("planar8", start, 1e-4)[0][7])

    assert bias_at(0.03) < 1e-3  # three sigmas: by chance
    assert bias_at(0.06) == pytest.approx(0.06, rel=0.05)  # six sigmas: a different gyro
    steps = np.diff([bias_at(seen) for seen in np.arange(0.0, 0.3, 1e-4)])
    assert np.all(steps > 0)
    assert steps.max() < 1e-3


def test_a_bias_of_one_axis_increases_the_uncertainty_of_all():
    variance = np.full(3, 0.01**2)
    start = InitialState(
        np.zeros(5), np.eye(5), 0.0, GyroBiasEvidence(np.array([0.3, 0.0, 0.03]), variance, 0.0, np.zeros(5))
    )
    mean, covariance = started("tilted12", start, 1e-4)
    assert mean[7] == pytest.approx(0.03, rel=0.01)
    np.testing.assert_allclose(np.diag(covariance)[[7, 10, 11]], 0.01**2, rtol=0.01)
    assert started("planar8", start, 1e-4)[0][7] < 1e-4  # planar8 does not read that axis


def test_jumps_of_the_fixes_are_not_taken_for_a_bias():
    drive = make_drive(duration=12.0, seed=1, gps_std=0.05)
    truth = drive.truth
    assert truth is not None
    aside = np.where(
        drive.gps.time > 3.0, 6.0 * (drive.gps.time - 3.0) ** 2, 0.0
    )  # a path with growing curvature
    drive = replace(drive, gps=replace(drive.gps, x=drive.gps.x + aside))
    start = initial_state(drive)
    assert start.gyro is not None
    assert np.all(np.isfinite(start.gyro.bias))
    assert np.all(np.abs(start.gyro.bias) < 0.5)


def test_columns_have_separate_evidence():
    start = initial_state(biased(make_drive(duration=12.0, seed=2), OFF))
    sets = tuple(tuned("tilted12", std) for std in (1e-4, 1e-2, 0.1))
    rows = KernelArray(sets).start([start], [0.01])[0]
    means, covariances = unpack_states(rows[state_rows("tilted12")], "tilted12")
    for lane, p in enumerate(sets):
        mean, covariance = started("tilted12", start, p.bias_std[1])
        np.testing.assert_allclose(means[lane], mean, atol=1e-12)
        np.testing.assert_allclose(covariances[lane], covariance, atol=1e-15)
        assert rows[R.HEADING, lane] == mean[4]


@pytest.mark.parametrize("model", ["planar8", "tilted12"])
def test_a_filter_tuned_for_a_good_gyro_does_not_diverge_with_a_biased_gyro(model: str):
    drive = biased(make_drive(duration=60.0, seed=4), OFF)
    run = run_filter(drive, tuned(model))
    truth = drive.truth
    assert truth is not None
    assert not run.restarts
    off = np.hypot(
        run.mean[:, 0] - np.interp(run.time, truth.time, truth.x),
        run.mean[:, 1] - np.interp(run.time, truth.time, truth.y),
    )
    assert np.sqrt(np.mean(off**2)) < np.sqrt(2.0)  # the error of the fixes
    without = run_filter(drive, tuned(model), initial=replace(run.initial, gyro=None), recover=False)
    worse = np.hypot(
        without.mean[:, 0] - np.interp(run.time, truth.time, truth.x),
        without.mean[:, 1] - np.interp(run.time, truth.time, truth.y),
    )
    assert np.sqrt(np.mean(worse**2)) > 2.5


@pytest.mark.parametrize("model", ["planar8", "tilted12"])
def test_a_live_filter_is_reset_with_the_evidence_of_the_start_as_a_run_is(model: str):
    drive, p = biased(make_drive(duration=60.0, seed=4), OFF), tuned(model)
    wrong = replace(initial_state(drive), gyro=None)
    run = run_filter(drive, p, initial=wrong)
    assert run.restarts
    live = LiveFilter(p, wrong, nominal_interval=drive.nominal_interval)
    axes = [getattr(drive.imu, axis) for axis in MODELS[model].imu]
    fixes = iter([*zip(drive.gps.time, drive.gps.x, drive.gps.y, strict=True), (np.inf, 0.0, 0.0)])
    fix = next(fixes)
    for time, *imu in zip(drive.imu.time, *axes, strict=True):
        while fix[0] <= time:
            live.update(fix[0], fix[1:])
            fix = next(fixes)
        live.predict(time, imu)
    assert tuple(live.restarts) == run.restarts
    np.testing.assert_allclose(live.state.mean, run.mean[-1], atol=1e-6)
