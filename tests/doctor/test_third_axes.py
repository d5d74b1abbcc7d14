"""az, gx and gy: faults are found and repaired, and sound drives cause no finding."""

import warnings
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest

import sigmaswarm
from doctor.faults import THIRD, THIRD_AXES, codes_of
from sigmaswarm import Drive
from support import DRIVES, needs_shared, quickly

SIMULATED = {
    "flat": {"gps": "white-1m", "imu_rate": 50.0},
    "hilly": {"gps": "white-1m", "imu_rate": 50.0, "terrain": "hilly", "vibration": 1.0},
    "slow": {"gps": "white-1m", "imu_rate": 25.0},
}


@cache
def drive_of(name: str) -> Drive:
    """Return a drive; simulated ones have no truth, so their diagnosis takes half the time."""
    if name in SIMULATED:
        return replace(sigmaswarm.simulate("urban", duration=90.0, **SIMULATED[name]), truth=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)
        return sigmaswarm.read_drive(DRIVES / name)


def check(name: str, fault: str) -> None:
    good, plant = drive_of(name), THIRD_AXES[fault][0]
    codes = codes_of(fault, good)
    sick = plant(good)
    found = sigmaswarm.diagnose(sick)
    assert codes <= found.codes
    mended = sigmaswarm.repair(sick, found)
    assert not sigmaswarm.diagnose(mended).codes & (codes | THIRD - {"unseen-tilt"})
    for column in ("gx", "gy", "gz"):
        np.testing.assert_allclose(getattr(mended.imu, column), getattr(good.imu, column), atol=1e-9)
    np.testing.assert_allclose(mended.imu.az, good.imu.az, atol=0.3 if "1.15" in fault else 1e-9)


@pytest.mark.parametrize(
    ("name", "fault"),
    quickly(
        product(["hilly", "slow"], THIRD_AXES),
        lambda name, fault: (name, fault) == ("hilly", "gy reversed"),
    ),
)
def test_a_planted_fault_is_reported_and_repaired(name: str, fault: str):
    check(name, fault)


def test_g_of_the_horizontal_axes_alone_is_repaired_alone():
    good = drive_of("flat")
    sick = replace(good, imu=replace(good.imu, ax=good.imu.ax / 9.80665, ay=good.imu.ay / 9.80665))
    found = sigmaswarm.diagnose(sick)
    assert "accelerometer-unit" in found.codes and not {"accelerometer-up", "mounting-changed"} & found.codes
    mended = sigmaswarm.repair(sick, found)
    for column in ("ax", "ay", "az"):
        np.testing.assert_allclose(getattr(mended.imu, column), getattr(good.imu, column), atol=1e-9)


@pytest.mark.long
@needs_shared
@pytest.mark.parametrize(
    "fault",
    quickly([(f,) for f in THIRD_AXES if f not in ("g", "deg/s")], lambda f: f == "gx, gy swapped"),
)
def test_a_fault_planted_in_a_recording_is_reported_and_repaired(fault: str):
    check("colorado-1", fault)


@pytest.mark.parametrize("name", quickly([(n,) for n in SIMULATED], lambda name: name != "slow"))
def test_a_good_simulated_drive_has_sound_third_axes(name: str):
    assert not sigmaswarm.diagnose(drive_of(name)).codes & THIRD


@pytest.mark.long
@needs_shared
def test_the_raw_log_is_repaired_in_all_axes():
    sick, good = drive_of("dresden-as-recorded"), drive_of("dresden")
    mended = sigmaswarm.repair(sick, sigmaswarm.diagnose(sick))
    assert np.median(mended.imu.az) == pytest.approx(np.median(good.imu.az), abs=0.4)
    assert not sigmaswarm.diagnose(mended).codes & (THIRD - {"unseen-tilt"})
    for column in ("gx", "gy"):
        off = getattr(mended.imu, column) - getattr(good.imu, column)
        assert np.sqrt(np.mean(off**2)) < 0.06


def test_a_straight_road_is_reported_not_to_show_the_roll_rate():
    drive = sigmaswarm.simulate("accelerate", gps="white-1m", vibration=1.0)
    assert "unseen-tilt" in sigmaswarm.diagnose(drive).codes


def test_without_a_third_axis_there_is_no_finding():
    drive = drive_of("flat")
    planar = replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))
    assert not sigmaswarm.diagnose(planar).codes & THIRD


def test_rates_without_relation_to_the_motion_are_not_repaired():
    drive, rng = drive_of("flat"), np.random.default_rng(0)
    dead = {n: 0.01 * rng.standard_normal(len(drive.imu)) for n in ("gx", "gy")}
    found = sigmaswarm.diagnose(replace(drive, imu=replace(drive.imu, **dead)))
    assert "gyro-tilt" not in found.codes
    assert "unseen-tilt" in found.codes
