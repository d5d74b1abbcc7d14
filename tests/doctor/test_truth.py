"""The truth: a wrong clock is found and repaired; truth shows delay and errors of the fixes."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from sigmaswarm.doctor import evidence
from sigmaswarm.doctor.diagnose import diagnose
from sigmaswarm.doctor.evidence import gather
from sigmaswarm.doctor.repairs import repair
from sigmaswarm.doctor.truth import truth_delay
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.split import clip
from sigmaswarm.simulation.scenarios import simulate
from support import diagonal, some

DRIVES: dict[str, dict[str, Any]] = {
    "urban": {"run": 3, "duration": 120.0, "gps": "white-1m"},
    "rain": {"environment": "rain", "run": 1, "duration": 90.0},
    "slippery": {"environment": "slippery", "run": 2, "duration": 120.0},
}


@cache
def simulated(name: str) -> Drive:
    return simulate("urban", imu_rate=50.0, **DRIVES[name])


def shifted(drive: Drive, seconds: float, *, move: float = 0.0) -> Drive:
    truth = drive.truth
    return replace(drive, truth=replace(truth, time=truth.time + seconds, x=truth.x + move))


@pytest.mark.parametrize(("name", "seconds"), diagonal(DRIVES, [50.0, 3600.0, -18.0]))
def test_a_wrong_clock_of_the_truth_is_found_and_repaired(name: str, seconds: float):
    drive = shifted(simulated(name), seconds)
    diagnosis = diagnose(drive)
    (found,) = (f for f in diagnosis.findings if f.code == "truth-clock")
    offset = float(found.remedy.split("--truth-offset ")[1])
    assert found.severity == "serious" and offset == pytest.approx(-seconds, abs=0.1)
    again = repair(drive, diagnosis)
    np.testing.assert_allclose(again.truth.time, simulated(name).truth.time, atol=0.15)
    assert "truth-clock" not in diagnose(again).codes


@pytest.mark.parametrize("seconds", some([50.0, 18.0, -50.0]))
def test_a_wrong_clock_of_the_truth_is_found_in_a_part_and_with_another_origin(seconds: float):
    whole = simulated("urban")
    part = replace(whole, truth=clip(whole, 20.0, 90.0).truth)
    for drive in (shifted(whole, seconds, move=3e4), shifted(part, seconds)):
        (found,) = (f for f in diagnose(drive).findings if f.code == "truth-clock")
        assert found.repair.values[0] == pytest.approx(-seconds, abs=0.15)


@pytest.mark.parametrize("interval", [3, 5, 8])
def test_a_wrong_clock_of_the_truth_is_found_with_long_intervals_of_the_fixes(interval: int):
    drive = simulated("urban")
    few = replace(drive, gps=drive.gps.select(np.arange(0, len(drive.gps), 5 * interval)))
    position = few.gps.x + 1j * few.gps.y
    for seconds in (10.0, -18.0, 0.0):
        truth = shifted(few, seconds).truth
        delay = truth_delay(few.gps.time, position, truth.time, truth.x + 1j * truth.y)
        assert delay == pytest.approx(seconds, abs=0.15)


@pytest.mark.parametrize(("name", "seconds"), diagonal(DRIVES, [0.0, 0.5, -1.0]))
def test_a_truth_with_the_delay_of_a_receiver_has_no_finding(name: str, seconds: float):
    assert "truth-clock" not in diagnose(shifted(simulated(name), seconds)).codes


@pytest.mark.parametrize("bad", [14.0, 22.0])
def test_a_part_with_bad_fixes_is_not_a_wrong_clock_of_the_truth(bad: float):
    """A delay that leaves out the bad part makes the rest agree, but so do the same fixes without a delay."""
    time, noise = np.arange(0.0, 60.0), 0.1 * np.random.default_rng(0).standard_normal(60)
    errors = noise + np.where((time < bad) & (time % 4 > 1), 40.0, 0.0)
    straight = (12.0 + 0.2j) * time
    assert truth_delay(time, straight + errors, time, straight) is None
    winding = np.cumsum(8.0 + 5.0 * np.sin(time / 7.0) + 3.0 * np.cos(time / 2.6)) + 60j * np.sin(time / 9.0)
    assert truth_delay(time, winding + noise, time + 9.0, winding) == pytest.approx(9.0, abs=0.3)


def test_a_wrong_clock_of_the_fixes_is_not_a_fault_of_the_truth():
    """IMU and truth agree, so only the fixes are shifted."""
    drive = simulated("urban")
    late = replace(drive, gps=replace(drive.gps, time=drive.gps.time + 18.0))
    diagnosis = diagnose(late)
    assert "clock-offset" in diagnosis.codes and "truth-clock" not in diagnosis.codes
    again = repair(late, diagnosis)
    np.testing.assert_allclose(again.gps.time, drive.gps.time, atol=1e-9)
    np.testing.assert_array_equal(again.truth.time, drive.truth.time)


@pytest.mark.parametrize("seconds", some([18.0, -7.3, 1.2, -0.6]))
def test_fixes_and_truth_with_one_clock_move_together(seconds: float):
    """Only the clock of the IMU differs: one cause is one finding."""
    drive = simulated("urban")
    late = replace(drive, imu=replace(drive.imu, time=drive.imu.time + seconds))
    diagnosis = diagnose(late)
    assert "truth-clock" not in diagnosis.codes
    (found,) = (f for f in diagnosis.findings if f.code == "clock-offset")
    assert "the times of fixes and truth" in found.remedy
    again = repair(late, diagnosis)
    moved = again.gps.time - drive.gps.time
    np.testing.assert_allclose(moved, seconds, atol=0.15)
    np.testing.assert_allclose(again.truth.time - drive.truth.time, moved[0], atol=1e-9)
    assert not {"clock-offset", "truth-clock"} & set(diagnose(again).codes)


@pytest.mark.parametrize("seconds", [1.2, -0.6])
def test_a_small_offset_of_the_fixes_does_not_move_a_truth_with_the_clock_of_the_imu(seconds: float):
    drive = simulated("urban")
    late = replace(drive, gps=replace(drive.gps, time=drive.gps.time + seconds))
    again = repair(late, diagnose(late))
    np.testing.assert_allclose(again.gps.time, drive.gps.time, atol=0.15)
    np.testing.assert_array_equal(again.truth.time, drive.truth.time)


def test_the_delay_of_the_truth_is_computed_once(monkeypatch: pytest.MonkeyPatch):
    """An offset of 18.6 s is not called GPS time, neither for fixes nor for truth."""
    calls: list[int] = []
    monkeypatch.setattr(evidence, "truth_delay", lambda *given: calls.append(1) or truth_delay(*given))
    drive = replace(simulated("urban"), name="counted")
    late = replace(drive, gps=replace(drive.gps, time=drive.gps.time + 18.6))
    repair(late, (found := diagnose(late)))
    assert len(calls) == 1 and "clock-offset" in found.codes
    findings = [*found.findings, *diagnose(shifted(drive, 18.6)).findings]
    assert {"clock-offset", "truth-clock"} <= {f.code for f in findings}
    assert not any("ahead of UTC" in f.remedy for f in findings)


def test_three_clocks_are_two_findings():
    drive = shifted(simulated("urban"), 30.0)
    late = replace(drive, gps=replace(drive.gps, time=drive.gps.time + 18.0))
    diagnosis = diagnose(late)
    assert {"clock-offset", "truth-clock"} <= set(diagnosis.codes)
    again = repair(late, diagnosis)
    np.testing.assert_allclose(again.truth.time, simulated("urban").truth.time, atol=0.15)


@pytest.mark.parametrize("moved", [0.0, 0.6])
def test_a_truth_shows_the_delay_of_noisy_fixes(moved: float):
    """The truth has the clock of the IMU or that of the fixes."""
    drive = simulate("urban", run=2, duration=60.0, gps="gnss-ins-sim")
    late = replace(drive, gps=replace(drive.gps, time=drive.gps.time + 0.6))
    blind, clock = gather(replace(late, truth=None)).clock, gather(shifted(late, moved, move=3e4)).clock
    assert clock.std < 0.8 * blind.std
    assert abs(clock.delay - 0.6) < 2 * clock.std
    assert gather(shifted(late, 18.0)).clock == blind  # truth with a wrong clock gives no evidence


def stating(drive: Drive, std: float) -> Drive:
    return replace(
        drive, gps=replace(drive.gps, std_x=np.full(len(drive.gps), std), std_y=np.full(len(drive.gps), std))
    )


def test_a_truth_shows_the_size_of_correlated_errors():
    drive = simulate("urban", run=5, duration=60.0, gps="f9p-rtk")
    assert "gps-noise" not in diagnose(drive).codes  # 0.01 m
    (said,) = (f for f in diagnose(stating(drive, 0.1)).findings if f.code == "gps-noise")
    assert "larger than their errors relative to the truth" in said.what
    assert said.repair is not None and said.repair.values[0] == pytest.approx(0.01, rel=0.2)
    wander = 2.0 * np.sin(2 * np.pi * drive.gps.time / 60.0)
    smooth = replace(drive, gps=replace(drive.gps, x=drive.gps.x + wander, y=drive.gps.y - wander))
    (said,) = (f for f in diagnose(stating(smooth, 0.15)).findings if f.code == "gps-noise")
    assert "smaller than their errors relative to the truth" in said.what and said.repair is None
    x, y = drive.gps.x, drive.gps.y
    own = replace(drive.truth, time=drive.gps.time, x=x, y=y, vx=x, vy=y, theta=0 * x)
    for truth in (None, own, shifted(drive, 18.0).truth):
        assert "gps-noise" not in diagnose(replace(stating(drive, 0.1), truth=truth)).codes
    assert "gps-noise" not in diagnose(shifted(stating(smooth, 2.0), 0.0, move=3e4)).codes


def test_a_truth_without_heading_is_compared_with_the_fixes_too():
    drive = simulated("urban")
    truth, middle = drive.truth, np.mean(drive.imu.time)
    fit = gather(drive).truth_fit
    assert fit is not None
    without = replace(truth, theta=np.full_like(truth.theta, np.nan))
    assert gather(replace(drive, truth=without)).truth_fit == fit
    # Without a heading, the track of an antenna away from the IMU is unknown.
    elsewhere = {"gps_lever_arm_m": (0.01, 0.0)}
    assert gather(replace(drive, truth=without, metadata=elsewhere)).truth_fit is None
    half = replace(truth, theta=np.where(truth.time < middle, truth.theta, np.nan))
    part = gather(replace(drive, truth=half, metadata=elsewhere)).truth_fit
    assert part is not None and part.error == pytest.approx(fit.error, rel=0.2)
