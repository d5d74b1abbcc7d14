"""A sensor's clock that runs fast or slow: its rate error is found and repaired."""

from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.repairs import repair
from sigmaswarm.drives.drive import Drive, Odometer
from sigmaswarm.simulation.scenarios import simulate
from support import quickly, some

QUICK = {(0, 0.004), (1, -0.004)}


@cache
def with_truth(run: int) -> Drive:
    return simulate("urban", run=run, duration=400.0, imu_rate=50.0, gps="white-1m")


def simulated(run: int) -> Drive:
    """Return a drive without truth, whose diagnosis takes half the time."""
    return replace(with_truth(run), truth=None)


def stretched(drive: Drive, drift: float) -> Drive:
    begin = drive.imu.time[0]
    return replace(drive, imu=replace(drive.imu, time=begin + (1 + drift) * (drive.imu.time - begin)))


@pytest.mark.parametrize(
    ("run", "drift"),
    quickly(product(range(3), [0.004, -0.004, 0.007]), lambda run, drift: (run, drift) in QUICK),
)
def test_a_fast_or_slow_clock_is_found_and_repaired(run: int, drift: float):
    drive = stretched(simulated(run), drift)
    diagnosis = diagnose(drive)
    (found,) = (f for f in diagnosis.findings if f.code == "clock-drift")
    assert found.severity == "serious" and ("fast" if drift > 0 else "slow") in found.what
    assert "clock-offset" not in diagnosis.codes, "one cause is one finding"
    again = repair(drive, diagnosis)
    left = np.ptp(again.imu.time) / np.ptp(simulated(run).imu.time) - 1
    assert abs(left) < 0.25 * abs(drift)
    assert "clock-drift" not in diagnose(again).codes


@pytest.mark.parametrize("run", some(range(3), 3))
def test_a_correct_clock_has_no_drift(run: int):
    assert "clock-drift" not in diagnose(simulated(run)).codes


def test_few_turns_and_noise_of_five_meters_are_no_drift():
    """The residuals of the windows alone give a drift of 6.9 standard deviations."""
    drive = simulate("urban", run=0, duration=300.0, imu_rate=50.0, gps="gnss-ins-sim")
    assert gather(replace(drive, truth=None)).clock_drift is None


def test_turns_at_falling_speeds_are_no_drift():
    """The delay between heading and course depends on the speed; this alone looks like a drift of 10 deviations."""
    drive = simulate("urban", run=153, duration=120.0, imu="icm-20602", gps="white-1m", vibration=0.0)
    assert gather(replace(drive, truth=None)).clock_drift is None


def test_the_odometer_has_the_clock_of_the_imu():
    sound = with_truth(0)
    drive = stretched(sound, 0.004)
    speed = np.interp(sound.imu.time, sound.truth.time, np.hypot(sound.truth.vx, sound.truth.vy))
    drive = replace(drive, odometer=Odometer(drive.imu.time, speed))
    again = repair(drive, diagnose(drive))
    np.testing.assert_array_equal(again.odometer.time, again.imu.time)
