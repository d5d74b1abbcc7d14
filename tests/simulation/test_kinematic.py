"""The plain simulator: its truth is a motion, its sensors measure that motion, with the noise they state."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.filters.dead_reckoning import run_imu_only
from sigmaswarm.simulation.kinematic import G, simulate

EXACT = {"gps_std": 0.0, "accel_std": 0.0, "gyro_std": 0.0, "accel_bias_std": 0.0, "gyro_bias_std": 0.0}
SEEDS = pytest.mark.parametrize("seed", range(4))


@SEEDS
def test_truth_is_a_motion_without_slip(seed: int):
    t = simulate(seed=seed).truth
    middle = slice(1, -1)
    np.testing.assert_allclose(np.gradient(t.x, t.time)[middle], t.vx[middle], atol=0.02)
    np.testing.assert_allclose(np.gradient(t.y, t.time)[middle], t.vy[middle], atol=0.02)
    speed = np.hypot(t.vx, t.vy)
    np.testing.assert_allclose(t.vx, speed * np.cos(t.theta), atol=1e-12)
    np.testing.assert_allclose(t.vy, speed * np.sin(t.theta), atol=1e-12)
    assert 0 <= speed.min() < 10 <= speed.max() < 20


@SEEDS
def test_an_exact_imu_measures_the_truth(seed: int):
    drive = simulate(seed=seed, **EXACT)
    t, imu = drive.truth, drive.imu
    np.testing.assert_array_equal(t.time, imu.time)
    speed = np.hypot(t.vx, t.vy)
    middle = slice(2, -2)
    # all but the few samples at which a car that comes to rest stops braking
    assert np.mean(np.abs(imu.ax - np.gradient(speed, t.time))[middle] > 0.02) < 0.005
    gained = np.append(0, np.cumsum((imu.ax[1:] + imu.ax[:-1]) / 2 * np.diff(t.time)))
    np.testing.assert_allclose(speed[0] + gained, speed, atol=0.1)
    np.testing.assert_allclose(imu.gz[middle], np.gradient(t.theta, t.time)[middle], atol=1e-3)
    np.testing.assert_allclose(imu.ay, speed * imu.gz, atol=1e-9)
    np.testing.assert_array_equal(imu.az, G)
    np.testing.assert_allclose(drive.gps.x, np.interp(drive.gps.time, t.time, t.x), atol=1e-3)
    # and dead reckoning on it, from an exact start, stays on the road
    estimate = run_imu_only(drive)
    end = np.array([t.x[-1], t.y[-1]])
    assert np.hypot(*(estimate.mean[-1, :2] - end)) < 0.02 * 90 * 10


def test_the_noise_is_what_it_says():
    clean, noisy = simulate(duration=200.0, seed=3, **EXACT), simulate(duration=200.0, seed=3)
    np.testing.assert_array_equal(clean.truth.x, noisy.truth.x)  # noise does not change the route
    for name, std, bias_std in (
        ("ax", 0.05, 0.2),
        ("ay", 0.05, 0.2),
        ("az", 0.05, 0.2),
        ("gz", 0.002, 0.003),
    ):
        error = getattr(noisy.imu, name) - getattr(clean.imu, name)
        assert error.std() == pytest.approx(std, rel=0.03)
        assert abs(error.mean()) < 4 * bias_std
        assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.03  # white
    for name in ("x", "y"):
        error = getattr(noisy.gps, name) - getattr(clean.gps, name)
        assert error.std() == pytest.approx(1.0, rel=0.1)
        assert abs(error.mean()) < 0.15
    assert noisy.metadata["accel_noise_density"] == pytest.approx(0.005)
    assert noisy.metadata["gyro_noise_density"] == pytest.approx(0.0002)
    np.testing.assert_array_equal(noisy.gps.std_x, 1.0)


def test_biases_spread_as_they_say():
    biases = []
    for seed in range(60):
        options = EXACT | {"accel_bias_std": 0.2, "gyro_bias_std": 0.003, "duration": 30.0, "imu_rate": 20.0}
        clean = simulate(seed=seed, **(EXACT | {"duration": 30.0, "imu_rate": 20.0})).imu
        imu = simulate(seed=seed, **options).imu
        error = [imu.ax - clean.ax, imu.ay - clean.ay, imu.gz - clean.gz]
        assert max(np.ptp(e) for e in error) < 1e-9  # constant over the drive
        biases.append([e[0] for e in error])
    np.testing.assert_allclose(np.std(biases, axis=0), [0.2, 0.2, 0.003], rtol=0.35)


def test_a_seed_is_a_drive():
    a, b, c = (simulate(seed=s) for s in (5, 5, 6))
    for table in ("imu", "gps", "truth"):
        for name, column in vars(getattr(a, table)).items():
            if column is not None:
                np.testing.assert_array_equal(column, getattr(getattr(b, table), name))
    assert not np.array_equal(a.truth.x, c.truth.x)
    assert (a.name, c.name, simulate(seed=1, name="mine").name) == ("simulated-005", "simulated-006", "mine")


def test_rates_and_duration():
    drive = simulate(duration=45.0, imu_rate=50.0, gps_rate=2.0)
    assert drive.duration == pytest.approx(45.0)
    np.testing.assert_allclose(np.diff(drive.imu.time), 0.02, atol=1e-9)
    np.testing.assert_allclose(np.diff(drive.gps.time), 0.5, atol=1e-9)


@SEEDS
def test_it_can_be_aligned_written_and_read_without_a_warning(seed: int, tmp_path: Path):
    drive = simulate(seed=seed)
    assert initial_state(drive).time < 15
    write_drive(drive, tmp_path / "d")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = read_drive(tmp_path / "d")
    np.testing.assert_array_equal(again.truth.theta, drive.truth.theta)
    assert again.metadata == drive.metadata


def test_routes_have_turns_and_stops():
    drives = [simulate(seed=s) for s in range(8)]
    assert all(np.ptp(np.unwrap(d.truth.theta)) > np.radians(60) for d in drives)
    assert sum(np.hypot(d.truth.vx, d.truth.vy).min() < 0.1 for d in drives) >= 3
