"""A constant offset between fixes and truth is reported with its size, and each remedy removes it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm import Drive, simulate
from sigmaswarm.drives.alignment import initial_state
from sigmaswarm.scoring.score import score_raw_gps, truth_offset
from support import quickly

SEEDS = quickly([(s,) for s in range(4)], lambda s: s == 0)


def sound(seed: int) -> Drive:
    return simulate("urban", run=seed, duration=90, gps="white-1m")


def moved(drive: Drive, by: complex, arm: complex = 0j) -> Drive:
    """Move the fixes of a drive by m east + i north, and by a lever arm in m forward + i left."""
    heading = np.exp(1j * np.interp(drive.gps.time, drive.truth.time, np.unwrap(drive.truth.theta)))
    off = by + arm * heading
    return replace(drive, gps=replace(drive.gps, x=drive.gps.x + off.real, y=drive.gps.y + off.imag))


def raw_rmse(drive: Drive) -> float:
    return score_raw_gps(drive, initial_state(drive)).position_rmse


@pytest.mark.parametrize("seed", SEEDS)
def test_a_drive_without_fault_has_no_offset(seed: int):
    assert truth_offset(sound(seed)) == ""
    assert truth_offset(replace(sound(seed), truth=None)) == ""


@pytest.mark.parametrize("seed", SEEDS)
def test_an_antenna_away_from_the_imu(seed: int):
    drive = moved(sound(seed), 0j, -1.8 + 0.5j)
    said = truth_offset(drive)
    arm = [float(v) for v in re.findall(r"gps_lever_arm_m = \[(\S+), (\S+), 0.0\]", said)[0]]
    assert arm == pytest.approx([-1.8, 0.5], abs=0.25) and "origin" not in said
    mended = replace(drive, metadata={"gps_lever_arm_m": [*arm, 0.0]})
    assert truth_offset(mended) == ""


@pytest.mark.parametrize("seed", SEEDS)
def test_another_origin(seed: int):
    drive = moved(sound(seed), 1.5 - 1.0j)
    said = truth_offset(drive)
    east, north = (float(v) for v in re.findall(r"add (\S+) and (\S+) m to x and y", said)[0])
    assert (east, north) == pytest.approx((1.5, -1.0), abs=0.25) and "lever_arm" not in said
    truth = replace(drive.truth, x=drive.truth.x + east, y=drive.truth.y + north)
    mended = replace(drive, truth=truth)
    assert truth_offset(mended) == ""
    assert raw_rmse(mended) < 0.8 * raw_rmse(drive)


def test_on_a_straight_road_both_causes_are_possible():
    said = truth_offset(moved(simulate("cruise", gps="white-1m"), 3.0 + 3.0j))
    assert "lever_arm" in said and "origin" in said
