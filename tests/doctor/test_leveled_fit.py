"""The delay of the fixes, estimated with the tilt of the gyro: more accurate, and consistent with other evidence."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sigmaswarm
from doctor.faults import fixes_late, rolls_reversed
from sigmaswarm import Drive
from sigmaswarm.doctor.clocks import ClockOffset, leveled_delay
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.drives.split import clip
from sigmaswarm.simulation import GPS_GRADES
from support import several, some


@cache
def drive_of(run: int, imu: str) -> Drive:
    """Simulate a hilly drive with 1 m of white noise in the fixes, without truth, which also shows a delay."""
    drive = sigmaswarm.simulate(
        "urban", run=run, imu=imu, gps="white-1m", duration=120.0, terrain="hilly", imu_rate=50.0
    )
    return replace(drive, truth=None)


def planar(drive: Drive) -> Drive:
    return replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))


@pytest.mark.parametrize(("run", "imu"), several([(6, "icm-20602"), (9, "mpu-6050"), (18, "adis16465")], 3))
def test_a_delay_of_a_fifth_of_a_second_is_found_with_a_meter_of_noise(run: int, imu: str):
    for seconds in (0.2, -0.2):
        drive = fixes_late(seconds)(drive_of(run, imu))
        clock, without = gather(drive).clock, gather(planar(drive)).clock
        assert clock.std < without.std
        assert abs(clock.delay - seconds) < 3 * clock.std
        assert "clock-offset" in sigmaswarm.diagnose(drive).codes
    assert "clock-offset" not in sigmaswarm.diagnose(drive_of(run, imu)).codes


@pytest.mark.parametrize("start", some([-0.5, 0.5]))
def test_the_result_does_not_depend_on_the_initial_value(start: float):
    evidence = gather(drive_of(9, "mpu-6050"))
    assert evidence.course
    found = [leveled_delay(evidence.drive, evidence.course, delay) for delay in (0.0, start)]
    np.testing.assert_allclose(*found, atol=0.01)


def test_a_known_lever_arm_is_not_a_delay():
    """In turns, 6 m at 6 m/s look like 1 s."""
    receiver = replace(GPS_GRADES["white-1m"], lever_arm=(6.0, 0.0, 1.0))
    drive = sigmaswarm.simulate("urban", run=9, imu="icm-20602", gps=receiver, duration=120.0, imu_rate=50.0)
    clock = gather(replace(drive, truth=None)).clock
    assert clock.std < 0.06 and abs(clock.delay) < 2 * clock.std


def test_a_wrong_sign_of_the_roll_rate_is_not_a_clock_offset():
    assert "clock-offset" not in sigmaswarm.diagnose(rolls_reversed(drive_of(9, "mpu-6050"))).codes


def test_too_few_windows_or_axes_determine_no_delay():
    drive = drive_of(9, "mpu-6050")
    for part in (planar(drive), clip(drive, drive.imu.time[0], drive.imu.time[0] + 60)):
        course = gather(part).course
        assert course and leveled_delay(part, course, 0.0) is None


def test_an_estimate_replaces_another_one_only_if_it_is_more_accurate_and_agrees():
    clock = ClockOffset(0.0, 0.08, 0.8)
    assert clock.refined(0.1, 0.04) == ClockOffset(0.1, 0.04, 0.8)
    assert clock.refined(0.1, 0.09) is clock
    assert clock.refined(0.3, 0.04) is clock
