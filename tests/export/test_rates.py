"""The exported C filter and the live filter detect the standstills of a run for any rate of the IMU."""

import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from exported import build, distance, needs_gcc, replay, tuned
from sigmaswarm.drives import odometer, standstill
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.drives.drive import Drive, Imu
from sigmaswarm.drives.prepared import PreparedDrive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.exports.c99 import replay_rows
from sigmaswarm.filters.live import LiveFilter
from sigmaswarm.filters.parameters import FilterParameters
from sigmaswarm.filters.run import Estimate, run_filter
from sigmaswarm.simulation.scenarios import simulate
from support import DRIVES, needs_shared, quickly

TUNED_AT = 100.0
P = tuned("planar8", "ukf", 1 / TUNED_AT)
RATES = quickly([(rate,) for rate in (10.0, 50.0, 200.0, 1000.0)], lambda rate: rate in (10.0, 200.0))


@cache
def simulated(rate: float) -> Drive:
    """Return a minute of an urban drive with a stop."""
    return simulate("urban", imu_rate=rate, duration=60.0, seed=4)


@cache
def real(times: int) -> Drive:
    """Return a drive with a standstill; samples are interpolated between those of the IMU at 10 Hz."""
    drive = clip(read_drive(DRIVES / "kingston-1"), 620.0, 700.0)
    imu, rng = drive.imu, np.random.default_rng(2)
    k = np.arange(times * (len(imu) - 1) + 1) / times
    values = {
        name: np.interp(k, np.arange(len(imu)), getattr(imu, name)) + 1e-3 * rng.standard_normal(len(k))
        for name in ("ax", "ay", "gz")
    }
    time = np.interp(k, np.arange(len(imu)), imu.time)
    return replace(drive, imu=Imu(time=time, **values), truth=None)


@cache
def run_of(drive: Drive, p: FilterParameters) -> Estimate:
    return run_filter(drive, p, recover=False)


def uses_standstills(drive: Drive, p: FilterParameters) -> bool:
    """Return whether the drive has standstills that change the filter's estimates."""
    without = run_of(drive, replace(p, standstill_noise=None))
    return (
        bool(PreparedDrive(drive).timeline().stands.any())
        and distance(without.mean.copy(), run_of(drive, p).mean) > 1e-3
    )


@needs_gcc
@pytest.mark.parametrize("rate", quickly([(rate,) for rate in RATES], lambda rate: rate == 10.0))
def test_c_equals_the_run_at_any_rate(tmp_path: Path, rate: float):
    drive = simulated(rate)
    assert uses_standstills(drive, P)
    assert distance(replay(build(tmp_path, P), drive).mean, run_of(drive, P).mean) < 1e-9


@needs_shared
@needs_gcc
@pytest.mark.parametrize("times", quickly([(2,), (10,)], lambda times: times == 2))
def test_c_equals_the_run_on_a_real_drive_with_a_faster_imu(tmp_path: Path, times: int):
    drive = real(times)
    p = tuned("planar8", "ukf", times * drive.nominal_interval)
    assert uses_standstills(drive, p)
    assert distance(replay(build(tmp_path, p), drive).mean, run_of(drive, p).mean) < 1e-9


@pytest.mark.parametrize("rate", RATES)
def test_live_equals_the_run_at_any_rate(rate: float):
    drive = simulated(rate)
    assert distance(live_over(drive, P), run_of(drive, P).mean) < 1e-9


def live_over(drive: Drive, p: FilterParameters) -> np.ndarray:
    """Return means of a live filter that uses the tuning's nominal interval, not the drive's."""
    initial = initial_state(drive)
    live = LiveFilter(p, initial, nominal_interval=p.nominal_interval, lever_arm=drive.lever_arm)
    means: list[np.ndarray] = []
    for row in replay_rows(drive).splitlines()[1:]:
        name, t, *z = row.split(",")
        numbers = [float(cell) for cell in z]
        if name == "fix":
            live.update(float(t), numbers[:2], numbers[2:] or None)
        else:
            live.predict(float(t), numbers)
            if float(t) > initial.time:
                means.append(live.state.mean)
    return np.array(means)


@pytest.mark.long
@needs_gcc
def test_fixes_discarded_too_early_are_reported(tmp_path: Path):
    drive = simulate("urban", gps_rate=50.0, duration=60.0, seed=4)
    assert uses_standstills(drive, P)
    small, large = tmp_path / "small", tmp_path / "large"
    done = subprocess.run([build(small, P)], input=replay_rows(drive), capture_output=True, text=True)
    assert "so standstills may be missed; raise INS_GPS_FIXES (64)" in done.stderr
    enough = build(large, P, "-DINS_GPS_FIXES=400")
    assert distance(replay(enough, drive).mean, run_of(drive, P).mean) < 1e-9
    done = subprocess.run([enough], input=replay_rows(drive), capture_output=True, text=True)
    assert done.stderr == ""


@needs_gcc
@pytest.mark.parametrize(
    "flags", quickly([((),), (("-DINS_GPS_FLOAT",),)], lambda flags: not flags), ids=["double", "float"]
)
def test_a_fix_that_is_after_a_sample_only_by_rounding_waits_for_the_next_one(
    tmp_path: Path, flags: tuple[str, ...]
):
    drive = clip(simulated(50.0), 0.0, 25.0)
    at = np.searchsorted(drive.imu.time, drive.gps.time + 1e-6) - 1
    fixes = np.nextafter(drive.imu.time[at], np.inf)  # less than a tick of the clock in a float build
    drive = replace(drive, gps=replace(drive.gps, time=fixes))
    ours = run_filter(drive, P, recover=False).mean
    theirs = replay(build(tmp_path, P, "-DINS_GPS_HISTORY=0", *flags), drive, "planar8").mean
    assert np.abs(np.hypot(*(theirs - ours)[:, :2].T)).max() < 0.01
    early = replace(drive, gps=replace(drive.gps, time=drive.imu.time[at]))
    assert np.hypot(*(run_filter(early, P, recover=False).mean - ours)[:, :2].T).max() > 0.02


def test_a_second_contains_a_whole_number_of_slots_and_blocks():
    for interval in (odometer.INTERVAL, standstill.BLOCK):
        assert 1.0 / round(1.0 / interval) == interval
