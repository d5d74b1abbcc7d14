"""Plots for inspection: the IMU agrees with the fixes on a sound drive, and the plots show each planted fault."""

from dataclasses import replace

import numpy as np
import pytest

import sigmaswarm
from sigmaswarm.doctor.agreements import FINDINGS, Agreement, agreements, shown_by
from sigmaswarm.drives.drive import Drive, Gps, Imu
from support import make_drive

DRIVE = make_drive(duration=60.0, gps_rate=5.0, seed=3, name="monday")


def off(drive: Drive, key: str) -> float:
    """Return the RMS difference between measured and expected values of the first pair."""
    (found,) = [a for a in agreements(drive) if a.key == key]
    return _off(found)


def _off(found: Agreement) -> float:
    (time, values), *_ = found.measured.values()
    (at, expected), *_ = found.expected.values()
    return float(np.sqrt(np.nanmean((np.interp(at, time, values) - expected) ** 2)))


def with_imu(**columns: np.ndarray) -> Drive:
    return replace(DRIVE, imu=replace(DRIVE.imu, **columns))


@pytest.mark.parametrize(
    ("key", "most", "spoiled"),
    [
        ("turning", 3.0, {"gz": -DRIVE.imu.gz}),
        ("turning", 3.0, {"gz": np.degrees(DRIVE.imu.gz)}),
        ("forward", 0.7, {"ax": -DRIVE.imu.ax}),
        ("sideways", 0.5, {"ay": -DRIVE.imu.ay}),
        ("gravity", 2.0, {"ax": DRIVE.imu.ax + 9.8}),
    ],
)
def test_a_fault_increases_the_difference(key: str, most: float, spoiled: dict[str, np.ndarray]):
    assert off(DRIVE, key) < most
    assert off(with_imu(**spoiled), key) > 2 * most


def test_pieces_of_the_course_are_shifted_to_the_gyro():
    """A stop hides whole turns of the course: the pieces are shifted to the gyro's angle, and its drift is removed."""
    assert off(with_imu(gz=DRIVE.imu.gz + 0.01), "turning") == pytest.approx(off(DRIVE, "turning"), abs=0.2)


@pytest.mark.parametrize(("sign", "shown"), [(1.0, False), (-1.0, True)])
def test_a_wrong_sign_is_visible_in_circles(sign: float, shown: bool):
    """A constant rate of the wrong sign is not taken for a bias."""
    time, at, rate = np.arange(0.0, 60.0, 0.02), np.arange(0.0, 60.0), 0.3
    imu = Imu(time, 0 * time, 0 * time + 3 * rate, 0 * time + sign * rate)
    drive = Drive("circles", imu, Gps(at, 10 * np.sin(rate * at), 10 * (1 - np.cos(rate * at))))
    assert (off(drive, "turning") > 90.0) == shown


def test_a_short_drive_has_the_plots_that_it_supports():
    short = sigmaswarm.clip(DRIVE, 0.0, 1.2)
    assert [a.key for a in agreements(short)] == ["gravity", "timing"]


def test_every_finding_has_a_plot():
    assert shown_by("gyro-sign") == shown_by("clock-offset") == "turning"
    assert shown_by("mounting-changed") == "gravity"
    assert shown_by("gps-outliers") == ""
    assert {a.key for a in agreements(DRIVE)} <= set(FINDINGS)
