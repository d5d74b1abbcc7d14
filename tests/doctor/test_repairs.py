"""What is mended is as good as the original: the planted fault is gone, and the numbers agree."""

import warnings
from functools import cache

import numpy as np
import pytest

import sigmaswarm
from doctor.faults import FAULTS, MORE
from sigmaswarm import Drive
from support import DRIVES, needs_shared

MENDABLE = [fault for fault in [*FAULTS, *MORE] if fault != "gaps"]
ROUGH = {"gravity": 0.6, "15 deg": 0.1}
"""m/s2 RMS by which ax, ay may differ from the original. Of a tilt only the constant is taken off, the sensor's own
bias with it; an angle is found to about 2 deg."""


@cache
def drive_of(name: str) -> Drive:
    if name == "simulated":
        return sigmaswarm.simulate("urban", gps="white-1m")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)
        return sigmaswarm.read_drive(DRIVES / name)


def check(name: str, fault: str) -> None:
    good, (plant, codes) = drive_of(name), (FAULTS | MORE)[fault]
    sick = plant(good)
    mended = sigmaswarm.repair(sick, sigmaswarm.diagnose(sick))
    left = sigmaswarm.diagnose(mended)
    assert not left.serious
    assert not {finding.code for finding in left.findings if finding.severity != "note"} & codes
    for column in ("ax", "ay"):
        off = getattr(mended.imu, column) - getattr(good.imu, column)
        assert np.sqrt(np.mean(off**2)) < ROUGH.get(fault, 1e-9)
    np.testing.assert_allclose(mended.imu.gz, good.imu.gz, atol=0.05 if fault == "gravity" else 1e-12)
    if mended.gps.std_x is not None and fault.startswith("stated"):
        assert np.median(mended.gps.std_x) == pytest.approx(1.0, rel=0.1)
    if "late" in fault or "early" in fault:
        assert mended.gps.time[0] == pytest.approx(good.gps.time[0], abs=0.1)
    if fault == "outliers":
        kept = np.isin(good.gps.time, mended.gps.time)
        np.testing.assert_array_equal(mended.gps.x, good.gps.x[kept])
        assert kept.mean() == pytest.approx(0.98, abs=0.005)


@pytest.mark.parametrize("fault", MENDABLE)
def test_a_mended_simulated_drive(fault: str):
    check("simulated", fault)


@needs_shared
@pytest.mark.parametrize("fault", [fault for fault in MENDABLE if "0.2 s" not in fault])
def test_a_mended_recording(fault: str):
    check("kitti-09-30-0033", fault)


def test_two_faults_at_once():
    good = drive_of("simulated")
    sick = FAULTS["g"][0](FAULTS["axes-swapped"][0](FAULTS["deg/s"][0](good)))
    found = sigmaswarm.diagnose(sick)
    assert {"accelerometer-unit", "accelerometer-axes", "gyro-unit"} <= found.codes
    mended = sigmaswarm.repair(sick, found)
    np.testing.assert_allclose(mended.imu.ax, good.imu.ax, atol=1e-9)
    np.testing.assert_allclose(mended.imu.ay, good.imu.ay, atol=1e-9)
    np.testing.assert_allclose(mended.imu.gz, good.imu.gz, atol=1e-12)
    assert set(mended.metadata["repaired"]) == {"accelerometer-unit", "accelerometer-axes", "gyro-unit"}


def test_nothing_to_mend_changes_nothing():
    drive = drive_of("simulated")
    assert sigmaswarm.repair(drive, sigmaswarm.diagnose(drive)) is drive


@needs_shared
def test_the_log_as_it_came_ends_up_about_like_the_mended_one():
    sick, good = drive_of("dresden-as-recorded"), drive_of("dresden")
    mended = sigmaswarm.repair(sick, sigmaswarm.diagnose(sick))
    for column, limit in (("ax", 0.35), ("ay", 0.5), ("gz", 0.02)):
        off = getattr(mended.imu, column) - getattr(good.imu, column)  # the same samples, moved in time there
        assert np.sqrt(np.mean(off**2)) < limit
