"""Evidence at the start about roll, pitch and accelerometer biases, and its use by filters."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sigmaswarm.drives.alignment import MAX_DURATION, InitialState, initial_state
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.tilt_evidence import FORWARD_STD, GRAVITY, MEAN_SPEED, TURN, TiltEvidence
from sigmaswarm.filters.divergence import align_stream
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.models import MODELS
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import run_filter
from sigmaswarm.filters.starts import starts_of
from support import make_drive

SLOPE = np.array([0.05, -0.03])  # rad about east and north
ROLLING, PERIOD = 0.04, 4.0  # amplitude of the body's roll, rad, and its period, s
SEEDS = 30


def attitude(drive: Drive, slope: np.ndarray, rolling: float) -> Rotation:
    truth = drive.truth
    assert truth is not None
    on_slope = Rotation.from_rotvec([*slope, 0.0]) * Rotation.from_rotvec(
        np.outer(np.unwrap(truth.theta), [0.0, 0.0, 1.0])
    )
    roll = rolling * np.sin(2 * np.pi * truth.time / PERIOD)
    return on_slope * Rotation.from_rotvec(np.outer(roll, [1.0, 0.0, 0.0]))


@cache
def inclined(
    seed: int, slope: tuple[float, float] = (0.0, 0.0), rolling: float = 0.0, duration: float = 12.0
) -> Drive:
    """Simulate a drive over an inclined plane by a car with a rolling body; the IMU measures its force and rates."""
    drive = make_drive(duration=duration, seed=seed)
    body, imu = attitude(drive, np.array(slope), rolling), drive.imu
    flat = Rotation.from_rotvec(np.outer(np.unwrap(drive.truth.theta), [0.0, 0.0, 1.0]))  # pyright: ignore
    inertial = flat.apply(np.column_stack([imu.ax, imu.ay, np.zeros(len(imu))]))
    force = body.inv().apply(inertial + np.array([0.0, 0.0, GRAVITY]))
    rates = (body[:-1].inv() * body[1:]).as_rotvec() / np.diff(imu.time)[:, np.newaxis]
    gx, gy, gz = np.vstack([rates[:1], rates]).T
    return replace(
        drive, imu=replace(imu, ax=force[:, 0], ay=force[:, 1], az=force[:, 2], gx=gx, gy=gy, gz=gz)
    )


def started(start: InitialState, accel: float = 1e-4, gyro: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    mean, covariance = starts_of([start], MODELS["tilted12"], np.array([[accel, gyro, 0.0]]))
    return mean[0, 0], covariance[0, 0]


def tilts(drive: Drive, time: float, slope: tuple[float, float], rolling: float) -> np.ndarray:
    """Return roll and pitch, rad."""
    k = int(np.searchsorted(drive.imu.time, time))
    _, pitch, roll = attitude(drive, np.array(slope), rolling)[k].as_euler("ZYX")
    return np.array([roll, pitch])


@pytest.mark.parametrize(
    ("slope", "rolling"), [(tuple(SLOPE), 0.0), ((0.0, 0.0), ROLLING), (tuple(SLOPE), ROLLING)]
)
def test_errors_of_tilts_agree_with_their_covariance(slope: tuple[float, float], rolling: float):
    off, sigmas, before = [], [], []
    for seed in range(SEEDS):
        drive = inclined(seed, slope, rolling)
        start = initial_state(drive)
        mean, covariance = started(start)
        theta = mean[4]
        axes = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
        variance = np.diag(axes @ covariance[8:10, 8:10] @ axes.T)
        truth = tilts(drive, start.time, slope, rolling)
        off.append(mean[8:10] - truth)
        before.append(truth)
        sigmas.append(off[-1] / np.sqrt(variance))
    rms, level = (np.sqrt(np.mean(np.square(each), axis=0)) for each in (off, before))
    assert rms[0] < 0.01  # rad; without the evidence 0.03 to 0.05
    assert rms[1] < max(0.9 * level[1], 0.02)  # fixes with 1 m of noise determine the slope less accurately
    assert np.all(np.sqrt(np.mean(np.square(sigmas), axis=0)) < 1.3)


def test_priors_separate_a_bias_from_a_tilt():
    """On a level road with accelerometer biases: the smaller the expected tilt, the larger the estimated bias."""
    drive = make_drive(duration=12.0, seed=3, gps_std=0.0)
    imu = replace(drive.imu, ax=drive.imu.ax + 0.3, ay=drive.imu.ay - 0.2)
    start = initial_state(replace(drive, imu=imu))
    np.testing.assert_allclose(started(start, accel=10.0)[0][5:7], [0.3, -0.2], atol=0.02)
    mean, covariance = started(start, accel=0.5)
    roll = np.zeros(12)
    roll[8:10] = np.cos(mean[4]), np.sin(mean[4])
    assert covariance[6] @ roll < -0.9 * np.sqrt(covariance[6, 6] * (roll @ covariance @ roll))
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_a_bias_of_the_yaw_rate_is_not_a_lateral_force():
    drive = make_drive(duration=12.0, seed=5, gps_std=0.1)
    imu = drive.imu
    off = initial_state(replace(drive, imu=replace(imu, gz=imu.gz + 0.4)))
    plain, biased = started(initial_state(drive), gyro=0.3)[0], started(off, gyro=0.3)[0]
    assert off.gyro is not None
    assert abs(off.gyro.taken) > 0.3
    np.testing.assert_allclose(biased[8:10], plain[8:10], atol=0.01)  # 0.4 rad/s at 12 m/s look like 0.5 rad


def test_the_update_is_that_of_a_joint_gaussian():
    """One vector of all unknowns: the start for a given force, the change of the force, and the other states."""
    rng = np.random.default_rng(0)
    change = rng.normal(size=5)
    force, variance, turn, drift, speed, assumed = (
        [0.4, -0.3],
        [0.05, 0.01],
        0.9 - 0.2j,
        2.0 + 0.5j,
        12.0,
        0.25,
    )
    parts = turn.real, turn.imag, drift.real, drift.imag
    seen = TiltEvidence(np.array([*force, *variance, *parts, speed, assumed, 0.03, *change]))
    apart = rng.normal(size=(5, 5))
    apart = apart @ apart.T + np.eye(5)
    mean = np.array([1.0, 2.0, 3.0, 4.0, 0.7])
    start = InitialState(mean, apart + 0.03 * np.outer(change, change), 9.0, tilt=seen)
    found, covariance = started(start, accel=0.3, gyro=0.02)
    # 0 to 4: the start with the assumed force; 5 to 11: the other states; 12: the change of the force
    prior = np.zeros((13, 13))
    prior[:5, :5] = apart
    tilt = np.radians(3.0)
    prior[range(5, 13), range(5, 13)] = np.square([0.3, 0.3, 0.02, tilt, tilt, 0.02, 0.02, FORWARD_STD])
    forward, left = np.zeros(13), np.zeros(13)
    lean = np.zeros(13, np.complex128)  # mean tilt, roll + i pitch
    lean[8:10] = turn * np.exp(-0.7j) * np.array([1.0, 1j])
    lean[10:12] = drift * np.array([1.0, 1j])
    forward[[5, 12]] = left[6] = 1.0
    forward, left = forward - GRAVITY * lean.imag, left + GRAVITY * lean.real
    left[7] = -speed
    h = np.array([forward, left])
    gain = prior @ h.T @ np.linalg.inv(h @ prior @ h.T + np.diag(variance))
    posterior, P = gain @ force, prior - gain @ h @ prior
    to_states = np.eye(13)[:12]
    to_states[:5] += np.outer(change, forward)
    expected = to_states @ posterior
    expected[:5] += mean - assumed * change
    e = (expected[8] + 1j * expected[9]) * np.exp(-1j * expected[4])
    expected[8:10] = e.real, e.imag
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(covariance, to_states @ P @ to_states.T, rtol=0, atol=1e-12)


def test_a_stream_gives_the_same_evidence_as_the_drive():
    drive = inclined(1, tuple(SLOPE), ROLLING)
    start, imu = initial_state(drive), drive.imu
    assert start.tilt is not None
    assert imu.gx is not None
    assert imu.gy is not None
    until, fixes = imu.time <= start.time + 0.01, drive.gps.time <= start.time
    samples = np.column_stack([imu.time, imu.ax, imu.ay, imu.gz, imu.gx, imu.gy])[until]
    gps = np.column_stack([drive.gps.time, drive.gps.x, drive.gps.y])[fixes]
    for known in (0.0, 0.1):
        shifted = samples + np.array([0.0, 0.0, 0.0, known, 0.0, 0.0])
        found = align_stream(shifted, gps, np.zeros(2), known)
        assert found is not None
        assert found.tilt is not None
        expected = np.array(start.tilt.numbers)
        expected[1] -= start.tilt.numbers[MEAN_SPEED] * known
        np.testing.assert_allclose(found.tilt.numbers, expected, atol=1e-6)


def test_starts_without_evidence_are_level():
    drive = inclined(2, tuple(SLOPE))
    assert initial_state(replace(drive, imu=replace(drive.imu, gx=None, gy=None))).tilt is None
    assert initial_state(replace(drive, metadata={"heading_deg": 0.0})).tilt is None
    start = initial_state(drive)
    mean, covariance = started(replace(start, tilt=None))
    assert not mean[[5, 6, 8, 9]].any()
    both = [replace(start, tilt=None), start]
    means, _ = starts_of(both, MODELS["tilted12"], np.array([[1e-4, 1e-4, 0.0]]))
    np.testing.assert_array_equal(means[0, 0], mean)
    np.testing.assert_array_equal(means[1, 0], started(start)[0])
    del covariance


@pytest.mark.parametrize("live", [False, True])
def test_a_diverged_filter_is_reset_with_the_tilts(live: bool):
    slope = 0.06, -0.04
    drive = inclined(3, slope, duration=40.0)
    q = tuple(
        0.01 * density
        for density in (1e-3, 1e-3, 0.05, 0.05, 1e-5, 1e-7, 1e-7, 1e-10, 1e-5, 1e-5, 1e-10, 1e-10)
    )
    p = FilterParameters(0.5, 2.0, 0.0, q, (1.0, 1.0), "tilted12", kind="ekf", nominal_interval=0.01)
    p = replace(p, bias_std=(1e-3, 1e-4))
    wrong = initial_state(drive)
    wrong = replace(
        wrong, mean=wrong.mean + np.array([0.0, 0.0, 0.0, 0.0, 2.5]), covariance=1e-6 * np.eye(5), tilt=None
    )
    estimate = run_filter(drive, p, initial=wrong)
    (restart,) = estimate.restarts
    if live:
        imu, fixes = drive.imu, zip(drive.gps.time, drive.gps.x, drive.gps.y, strict=True)
        filters, fix = LiveFilter(p, wrong, nominal_interval=0.01), next(fixes)
        columns = [imu.ax, imu.ay, imu.az, imu.gx, imu.gy, imu.gz]
        for t, axes in zip(imu.time, np.column_stack(columns), strict=True):  # pyright: ignore
            while fix[0] <= t:
                filters.update(fix[0], fix[1:])
                fix = next(fixes)
            filters.predict(t, axes)
            if t >= restart:
                break
        assert filters.restarts == [restart]
        mean = filters.state.mean
    else:
        mean = estimate.mean[np.searchsorted(estimate.time, restart)]
    truth = tilts(drive, restart, slope, 0.0)
    assert abs(truth[0]) > 0.03
    assert abs(mean[8] - truth[0]) < 0.012


def test_coefficients_of_the_mean_tilt_equal_integrals():
    """Uses a fine grid instead of the fixes."""
    drive = inclined(10)
    start, truth = initial_state(drive), drive.truth
    assert start.tilt is not None
    assert truth is not None
    first = drive.gps.time[drive.gps.time >= start.time - MAX_DURATION][0]
    grid = np.linspace(first, start.time, 5000)
    dt, theta = grid[1] - grid[0], np.interp(grid, truth.time, np.unwrap(truth.theta))
    assert np.ptp(theta) > 0.5
    direction = np.exp(1j * (theta - theta[-1]))
    until_end = np.cumsum(direction[::-1])[::-1] * dt
    turn, drift = start.tilt.numbers[TURN:MEAN_SPEED].view(np.complex128)
    assert turn == pytest.approx(np.mean(1 / direction), abs=5e-3)
    assert drift == pytest.approx(np.mean(until_end / direction), abs=0.02)
    speed = np.interp(grid, truth.time, np.hypot(truth.vx, truth.vy))
    assert start.tilt.numbers[MEAN_SPEED] == pytest.approx(np.mean(speed), abs=0.5)
