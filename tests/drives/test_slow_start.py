"""Starts of slow vehicles, stated headings, and parts of a split without a start."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from sigmaswarm import (
    AlignmentError,
    DriveError,
    SigmaswarmWarning,
    initial_state,
    read_drive,
    run_filter,
    split_time,
    tune,
    write_drive,
)
from sigmaswarm.drives.drive import Drive, Gps, Imu, Truth
from sigmaswarm.drives.fingerprint import drive_record, fingerprint
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.tables import NO_HEADING
from sigmaswarm.geodesy import wrap_angle
from support import quickly


def robot(speed: float, noise: float = 1.0, seed: int = 0, bias: float = 0.0, length: float = 240.0) -> Drive:
    """Simulate a robot on a winding path from t = 5 s on; tilted accelerometer, fixes at 1 Hz with ``noise`` m."""
    rng, t = np.random.default_rng(seed), np.arange(0, length, 0.02)
    v = speed * np.clip((t - 5) / 3, 0, 1) * (1 + 0.1 * np.sin(t / 9))
    w = 0.08 * np.sin(t / 17 + seed) * (t > 5)
    theta = 1.0 + np.cumsum(w) * 0.02
    x, y = np.cumsum(v * np.cos(theta)) * 0.02, np.cumsum(v * np.sin(theta)) * 0.02
    ax, ay, gz = (rng.normal(0, std, len(t)) for std in (0.05, 0.05, 0.003))
    imu = Imu(t, ax + np.gradient(v, t) + 0.1, ay + v * w, gz + w + bias)
    at = np.arange(0.5, length - 1)
    east, north = (np.interp(at, t, c) + rng.normal(0, noise, len(at)) for c in (x, y))
    truth = Truth(t, x, y, v * np.cos(theta), v * np.sin(theta), theta)
    return Drive("robot", imu, Gps(at, east, north), truth)


def heading_error(drive: Drive) -> tuple[float, float]:
    """Return the heading error of a start and its standard deviation, rad."""
    start = initial_state(drive)
    assert drive.truth
    true = float(np.interp(start.time, drive.truth.time, drive.truth.theta))
    return abs(float(wrap_angle(float(start.mean[4]) - true))), float(np.sqrt(start.covariance[4, 4]))


@pytest.mark.parametrize(
    ("speed", "noise"),
    quickly(
        product((0.3, 0.5, 1.0, 2.5), (0.02, 1.0, 2.0)),
        lambda speed, noise: (speed in (0.3, 1.0)) == (noise == 1.0) and speed < 2.0,
    ),
)
def test_a_slow_robot_starts_within_its_deviation(speed: float, noise: float) -> None:
    for seed in range(3):
        error, std = heading_error(robot(speed, noise, seed, bias=0.005))
        assert error < 3.5 * std < np.radians(45.0)


@pytest.mark.parametrize("stated", ["gps.csv", "drive.toml"])
def test_a_slow_start_includes_stated_errors_that_last(stated: str) -> None:
    """The fixes are smooth, so the fit does not show their error, which turns the start by over 30 deg."""
    drive = robot(0.3, 0.05)
    wander = 2.6 * np.sin(drive.gps.time / 15)
    gps = replace(drive.gps, x=drive.gps.x + 0.5 * wander, y=drive.gps.y - 0.9 * wander)
    accuracy = np.full(len(gps), 2.6)
    about = {} if stated == "gps.csv" else {"gps_std_m": 2.6}
    drive = replace(drive, gps=gps if about else replace(gps, std_x=accuracy, std_y=accuracy), metadata=about)
    error, std = heading_error(drive)
    assert error < 3.5 * std and initial_state(drive).covariance[0, 0] > 2.5**2


@pytest.mark.parametrize("speed", [0.3, 0.4])
def test_a_slow_robot_in_a_small_area_starts(speed: float) -> None:
    """Its fixes are never 10 m apart, but their noise is 2 cm."""
    rng, t = np.random.default_rng(1), np.arange(0, 200, 0.02)
    v = speed * np.clip((t - 5) / 4, 0, 1)
    w = np.where(t % 30 > 24, np.pi / 6, 0.0) * np.where(t // 30 % 2, 1, -1)
    theta = 0.7 + np.cumsum(w) * 0.02
    x, y = np.cumsum(v * np.cos(theta)) * 0.02, np.cumsum(v * np.sin(theta)) * 0.02
    ax, ay, gz = (rng.normal(0, std, len(t)) for std in (0.05, 0.05, 0.002))
    imu = Imu(t, ax + np.gradient(v, t), ay + v * w, gz + w + 0.003)
    east, north = (np.interp(t[5::25], t, c) + rng.normal(0, 0.02, len(t[5::25])) for c in (x, y))
    truth = Truth(t, x, y, v * np.cos(theta), v * np.sin(theta), theta)
    error, std = heading_error(Drive("robot", imu, Gps(t[5::25], east, north), truth))
    assert error < 3 * std < np.radians(10)


def test_a_biased_gyro_does_not_bend_a_long_window() -> None:
    error, std = heading_error(robot(0.3, 0.02, 1, bias=0.02))  # rotates the heading by 69 deg in 60 s
    assert error < np.radians(10.0) and std < np.radians(5.0)


def test_the_record_of_a_drive_states_that_it_is_slow():
    assert drive_record(robot(1.0, length=60.0))["slow"]
    assert "slow" not in drive_record(robot(5.0, length=60.0))


@pytest.mark.parametrize("noise", [0.1, 1.0, 2.0])
def test_a_parked_receiver_is_not_a_slow_vehicle(noise: float) -> None:
    with pytest.raises(AlignmentError, match=r"never travels 20 m .* heading_deg = 90"):
        initial_state(robot(0.0, noise))


@pytest.mark.parametrize(
    ("speed", "seed"), quickly([(0.3, 1), (0.4, 2), (0.5, 3)], lambda speed, _: speed < 0.4)
)
def test_a_slow_robot_is_tuned_end_to_end(speed: float, seed: int) -> None:
    train, test = split_time(robot(speed, 1.0 + 0.5 * (seed % 3), seed, length=420.0), 0.6)
    tuned = tune([train], particles=8, generations=3, seed=1)
    assert np.isfinite(run_filter(test, tuned.parameters).mean).all()


@pytest.mark.parametrize(("stated", "lever"), [(90.0, 0.0), (-45.0, 1.0), (200.0, -0.5)])
def test_a_stated_heading_starts_at_the_first_fix(stated: float, lever: float) -> None:
    drive = robot(0.0)
    drive = replace(drive, metadata={"heading_deg": stated, "gps_lever_arm_m": (lever, 0.0)})
    start = initial_state(drive)
    angle = np.radians(stated)
    assert start.time == drive.gps.time[0]
    assert abs(wrap_angle(float(start.mean[4]) - float(angle))) < 0.01
    antenna = start.mean[:2] + lever * np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(antenna, [drive.gps.x[0], drive.gps.y[0]], atol=0.02)
    assert np.linalg.eigvalsh(start.covariance).min() > 0
    assert fingerprint(drive) != fingerprint(replace(drive, metadata={}))


def test_a_stated_heading_applies_only_to_the_beginning() -> None:
    drive = replace(robot(0.5), metadata={"heading_deg": 30.0})
    assert clip(drive, end=100.0).heading is not None
    assert clip(drive, start=100.0).heading is None


@pytest.mark.parametrize("value", ["361.0", '"north"', "[1.0]", "nan"])
def test_an_impossible_heading_is_refused(tmp_path, value: str) -> None:
    folder = write_drive(robot(0.5, length=60.0), tmp_path / "d")
    about = folder / "drive.toml"
    about.write_text(f"heading_deg = {value}\n" + about.read_text())
    with pytest.raises(DriveError, match="heading_deg"):
        read_drive(folder)


@pytest.mark.parametrize(("at", "part"), [(10.0, "train"), (230.0, "test"), (6.0, "train")])
def test_split_warns_of_a_part_without_a_start(at: float, part: str) -> None:
    with pytest.warns(SigmaswarmWarning, match=f"robot-{part} can't be used as a drive"):
        split_time(robot(1.0, 0.5), at=at)


def test_a_start_takes_the_first_fix_that_has_a_heading() -> None:
    drive = robot(0.5, noise=0.1)
    std = np.full(len(drive.gps.time), np.radians(1.0))
    std[:7] = NO_HEADING
    heading = np.where(std < NO_HEADING, 0.4, 0.0)
    start = initial_state(replace(drive, gps=replace(drive.gps, heading=heading, std_heading=std)))
    assert start.mean[4] == pytest.approx(0.4)
    assert start.time == drive.gps.time[7]
    for rough in (NO_HEADING, 1.0):
        vague = replace(drive.gps, heading=heading, std_heading=np.full_like(std, rough))
        by_travel = initial_state(replace(drive, gps=vague))
        np.testing.assert_array_equal(by_travel.mean, initial_state(drive).mean)
    least = np.radians(10.0)
    stated = initial_state(
        replace(drive, gps=replace(drive.gps, heading=heading, std_heading=np.maximum(std, least)))
    )
    assert stated.covariance[4, 4] == pytest.approx(least**2)


def test_a_heading_that_comes_late_does_not_delay_the_start() -> None:
    drive = robot(8.0, noise=0.1)
    std = np.where(drive.gps.time > 200.0, 0.01, NO_HEADING)
    headed = replace(drive, gps=replace(drive.gps, heading=np.zeros_like(std), std_heading=std))
    assert initial_state(headed).time == initial_state(drive).time < 60.0
