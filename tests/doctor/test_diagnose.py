"""Findings of the doctor on sound drives, and on the same drives with one planted fault."""

import re
import warnings
from dataclasses import replace
from functools import cache
from itertools import product
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import sigmaswarm
from doctor.faults import FAULTS, MORE, THIRD, codes_of, fixes_late
from sigmaswarm import Diagnosis, Drive, Gps, Imu, split_time
from sigmaswarm.doctor import diagnose
from sigmaswarm.doctor.checks import gyro
from sigmaswarm.doctor.checks.timing import clock_jumps
from sigmaswarm.doctor.evidence import Evidence
from sigmaswarm.doctor.fixes import mark_jumps
from sigmaswarm.doctor.repairs import repair
from sigmaswarm.doctor.yaw_fit import Yaw, YawFit, yaw_of
from sigmaswarm.drives.split import clip
from sigmaswarm.simulation.gps import with_outliers
from sigmaswarm.tuning.defaults import default_filter_options
from support import DRIVES, limited_memory, make_drive, needs_shared, quickly, some

MEMS = {
    "icm-20602": {"imu": "icm-20602", "gps": "ublox-m8", "imu_rate": 50.0},
    "mpu-6050": {"imu": "mpu-6050", "gps": "white-1m", "imu_rate": 50.0},
    "slow": {"imu": "icm-20602", "gps": "white-1m", "imu_rate": 25.0, "gps_rate": 2.0},
}
"""Simulated city drives."""
REAL = ["kitti-09-30-0033", "kitti-09-26-0101", "kitti-09-26-0022", "colorado-1", "kingston-1", "comma2k19"]


@cache
def simulated(name: str, duration: float = 60.0) -> Drive:
    """Return a drive without truth, whose diagnosis takes half the time."""
    return replace(sigmaswarm.simulate("urban", duration=duration, **MEMS[name]), truth=None)


@cache
def recorded(name: str) -> Drive:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", sigmaswarm.SigmaswarmWarning)  # gaps of 0.1 s
        return sigmaswarm.read_drive(DRIVES / name)


def serious(diagnosis: Diagnosis) -> list[str]:
    return [finding.code for finding in diagnosis.findings if finding.severity == "serious"]


@pytest.mark.parametrize("missing", some([25.0, 2.0]))
def test_fixes_in_a_gap_of_the_imu_are_not_outliers(missing: float):
    """A window of fixes can lie inside the gap, where the IMU's path is a straight line."""
    drive = simulated("icm-20602", 180.0)
    inside = (drive.imu.time > 80.0) & (drive.imu.time < 80.0 + missing)
    found = sigmaswarm.diagnose(replace(drive, imu=drive.imu.select(~inside)))
    assert "imu-gap" in found.codes
    assert "gps-outliers" not in found.codes


@pytest.mark.parametrize(("before", "after"), [(0.0, 0.0), (1.0, 2.0)])
def test_a_pause_of_the_logger_is_not_also_a_gap_of_the_fixes(before: float, after: float):
    drive = simulated("icm-20602")
    kept = (drive.imu.time <= 25.0) | (drive.imu.time >= 31.0)
    seen = (drive.gps.time <= 25.0 - before) | (drive.gps.time >= 31.0 + after)
    paused = replace(drive, imu=drive.imu.select(kept), gps=drive.gps.select(seen))
    codes = sigmaswarm.diagnose(paused).codes
    assert "imu-gap" in codes and "gps-gap" not in codes
    outage = seen & ((drive.gps.time < 40.0) | (drive.gps.time > 45.0))
    (gap,) = [
        f.what
        for f in sigmaswarm.diagnose(replace(paused, gps=drive.gps.select(outage))).findings
        if f.code == "gps-gap"
    ]
    assert gap.startswith("there is a gap of 5")


def test_one_circle_does_not_show_the_scale_of_the_gyro():
    rng, t, rate = np.random.default_rng(0), np.arange(0, 60, 0.01), 0.26
    noise = 0.01 * rng.standard_normal((3, len(t)))
    imu = Imu(t, noise[0], 2.5 * rate + noise[1], np.full(len(t), rate) + noise[2])
    at = np.exp(1j * (rate * t[::100] - np.pi / 2)) * 2.5 / rate + 0.1 * rng.standard_normal((60, 2)) @ [
        1,
        1j,
    ]
    found = sigmaswarm.diagnose(Drive("circle", imu, Gps(t[::100], at.real, at.imag)))
    (yaw,) = (finding.what for finding in found.findings if finding.code == "unseen-yaw")
    assert "turns at a nearly constant rate" in yaw


@pytest.mark.parametrize(
    ("name", "fault"), quickly(product(MEMS, [*FAULTS, *MORE]), lambda *case: case == ("icm-20602", "gaps"))
)
def test_a_planted_fault_is_reported(name: str, fault: str):
    """`test_repairs` also checks the findings that can be repaired."""
    plant, good = (FAULTS | MORE)[fault][0], simulated(name, 180.0)
    codes, found = codes_of(fault, good), sigmaswarm.diagnose(plant(good))
    if name == "slow" and fault == "0.2 s late":
        codes = set()  # not visible at 2 Hz with 1 m of noise
    assert codes <= found.codes
    assert set(serious(found)) <= codes  # no other serious finding
    if fault == "0.2 s late" and codes:
        (late,) = (f for f in found.findings if f.code == "clock-offset")
        assert late.severity == "warning" and "accurately, which doctor --fix checks" in late.remedy


@needs_shared
@pytest.mark.parametrize(
    "name",
    quickly(
        [(name,) for name in (*REAL, "kitti-09-30-0034", "kitti-09-30-0018", "dresden")],
        lambda name: name == "comma2k19",
    ),
)
def test_a_good_recording_has_no_serious_finding(name: str):
    found = sigmaswarm.diagnose(recorded(name))
    assert serious(found) == []
    if recorded(name).imu.az is not None:
        assert not found.codes & THIRD


@needs_shared
@pytest.mark.parametrize("begin", [876.0, 1219.0, 2022.0])
def test_a_lane_change_in_a_city_shows_no_factor_of_the_gyro(begin: float):
    """The course seems to be -1.3, 1.4 and 1.6 times the integral of gz."""
    window = clip(recorded("kingston-1"), begin, begin + 60.0)
    found = sigmaswarm.diagnose(window)
    assert "unseen-yaw" in found.codes and serious(found) == []
    reversed_gyro = replace(window, imu=replace(window.imu, gz=-window.imu.gz))
    assert serious(sigmaswarm.diagnose(reversed_gyro)) == []


@needs_shared
@pytest.mark.parametrize(
    ("name", "begin"),
    [
        ("kingston-1", 219.1),  # the car stands, and the fixes repeat to a millimeter: rotation, tilt
        ("kingston-1", 253.79),  # it moves for four seconds: gravity of 131 m/s2
        ("kingston-1", 705.29),  # wrong fixes: an offset of 22 s with an arbitrary factor
        ("kingston-1", 670.89),  # wrong fixes in a part that a delay of the truth leaves out
        ("kingston-1", 1730.2),  # starts and stops determine no axis, but an offset of 1.3 s
        ("kingston-1", 1836.19),  # a rotation that the leftward acceleration contradicts
        ("kingston-1", 1847.0),  # a rotation that only the forward acceleration shows
        ("kingston-1", 2102.79),  # an offset of 4.5 standard deviations
        pytest.param("dresden", 8.0, marks=pytest.mark.long),  # an offset of 1.3 standard deviations
    ],
)
def test_a_part_of_a_good_recording_has_no_serious_finding(name: str, begin: float):
    part = clip(recorded(name), begin, begin + 60.0)
    found = sigmaswarm.diagnose(part if begin == 670.89 else replace(part, truth=None))
    assert serious(found) == []


def test_a_vehicle_at_rest_with_quiet_fixes_has_no_axes():
    """Fixes that repeat to a tenth of a millimeter, and slowly move by 4 cm, do not show a motion."""
    rng, time, fix = np.random.default_rng(0), np.arange(0.0, 60.0, 0.1), np.arange(0.0, 60.0)
    ax, ay, gz = rng.normal(0.0, 0.05, (3, 600))
    x, y = rng.normal(0.0, 1e-4, (2, 60)) + np.outer([0.02, 0.008], np.tanh((fix - 30.0) / 3.0))
    found = sigmaswarm.diagnose(Drive("still", Imu(time, ax, ay, 0.01 * gz), Gps(fix, x, y)))
    assert "unseen-motion" in found.codes and serious(found) == []


@pytest.mark.parametrize(
    ("sensors", "maneuver"),
    quickly(
        product(MEMS, ["cruise", "turns", "accelerate", "brake", "outages", "urban"]),
        lambda *case: case == ("mpu-6050", "turns"),
    ),
)
def test_a_good_simulated_drive_has_no_serious_finding(maneuver: str, sensors: str):
    drive = sigmaswarm.simulate(maneuver, run=1, **MEMS[sensors])
    assert serious(sigmaswarm.diagnose(drive)) == []


@pytest.mark.long
@needs_shared
def test_the_faults_of_the_raw_log_are_found():
    """Its README: accelerations of the wrong sign, deg/s, pitch 10.5 deg, 0.65 s late, velocity 0.45 s later."""
    found = {
        finding.code: finding for finding in sigmaswarm.diagnose(recorded("dresden-as-recorded")).findings
    }
    assert {"accelerometer-sign", "gyro-unit", "mounting", "clock-offset"} == {
        code for code, finding in found.items() if finding.severity == "serious"
    }
    assert "gyro-sign" not in found
    assert found["clock-offset"].repair.values[0] == pytest.approx(-0.65, abs=0.15)
    pitch = -np.degrees(np.arcsin(found["mounting"].repair.values[6]))
    assert abs(pitch) == pytest.approx(10.5, abs=2.0)
    assert "velocity-delay" in found
    assert "uneven" in found["imu-rate"].what


def diagnosed_without_cache(drive: Drive) -> Diagnosis:
    """Diagnose without the cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diagnose, "_cache", {})
        return sigmaswarm.diagnose(drive)


@pytest.mark.long
def test_the_same_drive_gives_the_same_findings():
    drive = FAULTS["15 deg"][0](simulated("icm-20602"))
    assert diagnosed_without_cache(drive) == diagnosed_without_cache(drive)


def test_the_diagnosis_does_not_use_truth():
    drive = make_drive(duration=20.0, imu_rate=50.0)
    assert diagnosed_without_cache(replace(drive, truth=None)) == diagnosed_without_cache(drive)


def test_a_standing_car_is_reported_as_uninformative():
    drive = make_drive(duration=30.0, gps_std=0.5)
    rng = np.random.default_rng(0)
    gps = replace(drive.gps, x=rng.standard_normal(len(drive.gps)), y=rng.standard_normal(len(drive.gps)))
    still = np.zeros(len(drive.imu))
    found = sigmaswarm.diagnose(
        replace(drive, gps=gps, imu=replace(drive.imu, ax=still, ay=still, gz=still + 1e-3))
    )
    (unseen,) = (f for f in found.findings if f.code == "unseen-motion")
    assert re.match(r"the fixes show no motion above [12]\.\d m/s, so heading", unseen.what)
    assert serious(found) == []


def test_a_straight_road_is_reported_not_to_show_the_sign_of_yaw():
    found = sigmaswarm.diagnose(sigmaswarm.simulate("cruise", gps="white-1m", imu_rate=50.0))
    assert {"unseen-yaw", "unseen-ay"} <= found.codes


def slow_turns(imu_rate: float = 100.0, gps_rate: float = 1.0) -> Drive:
    """Simulate 8 m/s straight on, with two right-angle turns at 2 m/s; exact except for 1 m of noise in the fixes."""
    step = 1e-3
    t = np.arange(0.0, 100.0, step)
    speed, rate = np.full_like(t, 8.0), np.zeros_like(t)
    for middle, sign in ((30.0, 1.0), (70.0, -1.0)):
        speed -= 6.0 * np.exp(-(((t - middle) / 6.0) ** 4))
        rate += sign * np.radians(90) / 6.0 * (np.abs(t - middle) < 3.0)
    theta = np.cumsum(rate) * step
    position = np.cumsum(speed * np.exp(1j * theta)) * step
    at, fix = np.arange(0.0, 99.9, 1 / imu_rate), np.arange(0.37, 99.5, 1 / gps_rate)
    columns = {"ax": np.gradient(speed, step), "ay": speed * rate, "gz": rate}
    imu = Imu(at, **{n: np.interp(at, t, v) for n, v in columns.items()})
    x, y = np.interp(fix, t, position.real), np.interp(fix, t, position.imag)
    noise = np.random.default_rng(0).standard_normal((2, len(fix)))
    return Drive("slow-turns", imu, Gps(fix, x + noise[0], y + noise[1]))


@pytest.mark.parametrize("seconds", [0.0, 4.0])
def test_slow_turns_are_reported_as_indistinguishable_from_a_bias(seconds: float):
    found = {f.code: f for f in sigmaswarm.diagnose(fixes_late(seconds)(slow_turns())).findings}
    said = found["unseen-yaw"].what
    assert "hardly turns" not in said
    assert "only while the car is faster than 3.0 m/s" in said
    assert "deg. Slower turns can't be distinguished from a gyro bias" in said


@pytest.mark.parametrize(
    ("course_change", "std", "share", "known"),
    [
        (0.035, 0.19, 0.3, False),
        (0.035, 0.1, 0.3, True),
        (0.06, 0.19, 0.3, False),
        (0.11, 0.19, 0.3, True),
        (0.002, 0.19, 0.7, True),
    ],
)
def test_a_swaying_car_hardly_contradicts_the_gyro_s_sign(
    course_change: float, std: float, share: float, known: bool
):
    """One minute of a real motorway drive, and one in a city, gave -1.3 +- 0.2 times the correct yaw rate."""
    fit = YawFit("gz", -1.3, std, share, 0.0, 0.1, course_change, -1.3)
    imu = simulated("icm-20602").imu
    assert yaw_of(fit, imu).known == known
    assert yaw_of(replace(fit, gain=1.3), imu).known


def test_a_gain_that_depends_on_the_delay_is_no_scale_error():
    """Slow turns after a standstill: a recording's correct gyro had a gain of 1.67 at a delay of 1.1 s."""
    imu, fit = simulated("icm-20602").imu, YawFit("gz", 1.67, 0.014, 0.98, 1.06, 0.13, 0.29, 1.04)
    assert not yaw_of(fit, imu).known
    assert not yaw_of(replace(fit, gain=1.37, undelayed=1.3), imu).known
    assert yaw_of(replace(fit, undelayed=1.6), imu).factor == 1.67


@pytest.mark.parametrize(
    "scale",
    quickly([(s,) for s in (0.25, 0.5, 0.6, 2.0, -2.0, 0.8, 1.25)], lambda scale: scale in (0.25, -2.0, 0.8)),
)
def test_a_wrong_scale_of_the_gyro_is_reported_with_its_factor_and_repaired(scale: float):
    drive = simulated("icm-20602", 90.0)
    rates = {n: v for n in ("gx", "gy", "gz") if (v := getattr(drive.imu, n)) is not None}
    scaled = replace(drive, imu=replace(drive.imu, **{n: scale * v for n, v in rates.items()}))
    found = sigmaswarm.diagnose(scaled)
    (one,) = (f for f in found.findings if f.code == "gyro-scale")
    far = bool(abs(np.log2(abs(scale))) > 0.5)
    assert serious(found) == ["gyro-scale"] * far + ["gyro-sign"] * (scale < 0)
    factor = float(one.remedy.rpartition(" ")[2])
    assert factor == pytest.approx(1 / abs(scale), rel=0.05)
    assert f"the turns of the car are {factor:.3g} times those that the gyro measures" in one.what
    fixed = sigmaswarm.repair(scaled, found)
    assert "withheld" not in fixed.metadata
    np.testing.assert_allclose(fixed.imu.gz, drive.imu.gz, rtol=0.05)
    assert not {"gyro-scale", "gyro-sign", "unseen-yaw"} & sigmaswarm.diagnose(fixed).codes


@pytest.mark.parametrize(
    ("scale", "gps"),
    quickly(
        product((0.5, 1.25, 2.0, 57.3), ("white-1m", "ublox-m8")),
        lambda *case: case == (2.0, "white-1m"),
    ),
)
def test_a_wrong_scale_of_gz_alone_is_repaired_in_gz_alone(scale: float, gps: str):
    """On a hilly road, the roll angle of gravity shows that gx and gy are correct."""
    drive = sigmaswarm.simulate("urban", run=1, duration=150, gps=gps, terrain="hilly", vibration=True)
    drive = replace(drive, truth=None)
    for names in (["gz"], ["gx", "gy", "gz"])[: 1 if scale == 1.25 else 2]:
        wrong = replace(drive, imu=replace(drive.imu, **{n: scale * getattr(drive.imu, n) for n in names}))
        fixed = repair(wrong, sigmaswarm.diagnose(wrong)).imu
        for name in ("gx", "gy", "gz"):
            np.testing.assert_allclose(getattr(fixed, name), getattr(drive.imu, name), rtol=0.04)


@pytest.mark.parametrize(
    ("scales", "error", "alone"),
    [
        ((0.5, 0.5), 0.2, True),
        ((0.5, 0.5), 0.3, False),
        ((0.5, 1.0), 0.2, False),
        ((1.0, 0.5), 0.2, False),
        ((0.5, 0.2), 0.2, False),
    ],
)
def test_the_roll_of_gravity_shows_the_scale_of_gx_over_two_times(
    monkeypatch: pytest.MonkeyPatch, scales: tuple[float, float], error: float, alone: bool
):
    """In rates times 2, a correct gx has a scale of 0.5 in changes within 1 s and within 2 s."""
    fits = {
        lag: [(np.array([scale, 0.0]), np.array([error * scale, 1.0]))]
        for lag, scale in zip((1.0, 2.0), scales, strict=True)
    }
    read = np.zeros((3, 5)), np.zeros((3, 5))
    monkeypatch.setattr(gyro, "_force_and_rates", lambda evidence: read)
    monkeypatch.setattr(gyro, "_regressions", lambda time, force, rates, lag, *_: fits[lag])
    time = np.arange(5.0)
    course = SimpleNamespace(time=time, velocity=time, moving=time > 0)
    drive = SimpleNamespace(imu=SimpleNamespace(time=time))
    evidence = SimpleNamespace(course=course, yaw=Yaw("gz", 2.0, True), yaw_fit=None, drive=drive)
    assert gyro._only_yaw_is_wrong(cast(Evidence, evidence)) == alone


@pytest.mark.parametrize("scale", [180 / np.pi, 2.0])
def test_a_scale_of_all_rates_is_repaired_in_all_on_a_flat_road(scale: float):
    """On a flat road, the body rolls in turns, which looks like a roll rate with a different wrong scale."""
    drive = sigmaswarm.simulate("urban", run=1, duration=150, gps="white-1m", imu_rate=50)
    drive = replace(drive, truth=None)
    rates = {name: getattr(drive.imu, name) for name in ("gx", "gy", "gz")}
    wrong = replace(drive, imu=replace(drive.imu, **{name: scale * rate for name, rate in rates.items()}))
    fixed = repair(wrong, sigmaswarm.diagnose(wrong)).imu
    for name, rate in rates.items():
        np.testing.assert_allclose(getattr(fixed, name), rate, rtol=0.04)


def test_the_rate_about_a_tilted_axis_has_no_wrong_scale():
    """An IMU on its edge measures half of the yaw rate."""
    drive = simulated("icm-20602", 90.0)
    assert drive.imu.az is not None
    imu = replace(drive.imu, ax=drive.imu.ax + 8.5, az=drive.imu.az / 2, gz=drive.imu.gz / 2)
    assert "gyro-scale" not in sigmaswarm.diagnose(replace(drive, imu=imu)).codes


def test_a_gyro_that_does_not_follow_the_course_is_no_straight_road():
    drive = simulated("icm-20602")
    rng = np.random.default_rng(0)
    still = {n: 0.01 * rng.standard_normal(len(drive.imu)) for n in ("gx", "gy", "gz")}
    found = {f.code: f for f in sigmaswarm.diagnose(replace(drive, imu=replace(drive.imu, **still))).findings}
    assert "no column of the gyro follows it" in found["unseen-yaw"].what
    assert "Slower turns" not in found["unseen-yaw"].what


@pytest.mark.parametrize(
    ("maneuver", "runs"),
    quickly(
        [("turns", 1), ("cruise", 1), *product(["turns", "urban", "cruise"], [8])],
        lambda _, runs: runs < 8,
    ),
)
def test_an_offset_of_the_smallest_visible_size_is_detected(maneuver: str, runs: int):
    """Many short drives, both signs: at least 90% of the offsets are detected, and 90% of the intervals contain 0."""
    asked = seen = 0
    held = []
    length = 50.0 if maneuver == "urban" else None
    for run in range(runs):
        drive = sigmaswarm.simulate(maneuver, run=run, duration=length, **MEMS["mpu-6050"])
        clean = sigmaswarm.diagnose(drive)
        size = clean.visible_clock_offset
        if "clock-offset" in clean.codes:
            continue
        (note,) = [f for f in clean.findings if f.code == "unseen-clock"]
        if size is None:
            assert "no clock offset between IMU and GPS can be detected" in note.what
            continue
        assert f"only a clock offset above {size:.2f} s" in note.what
        low, high = map(
            float, re.findall(r"delay of the fixes is (\S+) to (\S+) s .95% interval", note.what)[0]
        )
        held.append(low <= 0.0 <= high)
        for sign in (1, -1):
            asked += 1
            seen += "clock-offset" in sigmaswarm.diagnose(fixes_late(sign * size)(drive)).codes
    print(f"{maneuver}: {seen} of {asked}")
    assert seen >= 0.9 * asked and sum(held) >= 0.9 * len(held)
    assert asked == (0 if maneuver == "cruise" else 2 * runs)  # on a straight road, no offset is visible


def test_a_short_drive_with_few_turns_reports_what_it_does_not_show():
    found = sigmaswarm.diagnose(fixes_late(0.3)(slow_turns(gps_rate=5.0)))
    if "clock-offset" not in found.codes:
        assert found.visible_clock_offset is not None
        assert found.visible_clock_offset > 0.3
    assert found.to_dict()["visible_clock_offset_s"] == found.visible_clock_offset


@pytest.mark.long
def test_gravity_on_a_wrong_axis():
    imu = simulated("icm-20602").imu
    drive = replace(simulated("icm-20602"), imu=replace(imu, ax=imu.az, az=imu.ax))
    assert "gravity-axis" in sigmaswarm.diagnose(drive).codes


@pytest.mark.long
def test_the_yaw_rate_in_another_column():
    imu = simulated("icm-20602").imu
    drive = replace(simulated("icm-20602"), imu=replace(imu, gz=imu.gx, gx=imu.gz))
    found = sigmaswarm.diagnose(drive)
    assert "gyro-axis" in found.codes
    assert serious(sigmaswarm.diagnose(sigmaswarm.repair(drive, found))) == []


@pytest.mark.parametrize("count", [0, 1, 9])
def test_few_fixes_are_not_reported_as_jumps(count: int):
    """If positions hardly change, one of them is left; this caused a traceback."""
    assert not mark_jumps(np.arange(float(count)), np.zeros(count, complex)).any()


@pytest.mark.parametrize(
    ("course", "factor"),
    quickly(
        [(lambda c: np.degrees(np.pi / 2 - c) % 360, 3.6), (np.degrees, 1.0), (np.degrees, 1000.0)],
        lambda course, factor: factor == 3.6,
    ),
)
def test_a_receiver_with_its_own_convention(course, factor: float):
    drive = simulated("icm-20602")
    gps = replace(drive.gps, course=course(drive.gps.course), speed=factor * drive.gps.speed)
    drive = replace(drive, gps=gps)
    found = sigmaswarm.diagnose(drive)
    assert set(serious(found)) == {"course-convention"} | ({"speed-unit"} if factor != 1 else set())
    mended = sigmaswarm.repair(drive, found)
    assert serious(sigmaswarm.diagnose(mended)) == []
    np.testing.assert_allclose(np.exp(1j * mended.gps.course), np.exp(1j * simulated("icm-20602").gps.course))


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_in_another_unit(unit: str, factor: float):
    drive = make_drive(duration=60.0)
    spoiled = replace(drive, imu=replace(drive.imu, time=drive.imu.time * factor))
    (finding,) = sigmaswarm.diagnose(spoiled).findings
    assert (finding.code, finding.severity, finding.where) == ("time-unit", "serious", "imu.csv, t")
    assert f"in {unit}" in finding.what


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_in_another_unit_in_both_files(unit: str, factor: float):
    drive = make_drive(duration=60.0)
    imu, gps = (replace(t, time=t.time * factor) for t in (drive.imu, drive.gps))
    (finding,) = sigmaswarm.diagnose(replace(drive, imu=imu, gps=gps)).findings
    assert (finding.code, finding.severity, finding.where) == ("time-unit", "serious", "imu.csv, gps.csv, t")
    assert f"in {unit} in both files" in finding.what


def test_a_corrupt_last_time():
    drive = make_drive(duration=60.0)
    imu, gps = (replace(t, time=np.append(t.time[:-1], 4e9)) for t in (drive.imu, drive.gps))
    with limited_memory():
        found = sigmaswarm.diagnose(replace(drive, imu=imu, gps=gps)).findings
    assert [(f.code, f.severity) for f in found] == [("time-jump", "serious")] * 2
    assert [f.where for f in found] == ["imu.csv, t", "gps.csv, t"]
    (alone,) = sigmaswarm.diagnose(replace(drive, imu=imu)).findings
    assert (alone.code, alone.where) == ("time-jump", "imu.csv, t")


@pytest.mark.long
def test_a_log_whose_fixes_end_early_has_correct_units():
    drive = make_drive(duration=60.0)
    short = replace(drive, gps=drive.gps.select(drive.gps.time < 6.0))
    assert "time-unit" not in [f.code for f in sigmaswarm.diagnose(short).findings]


def test_too_short_a_drive_is_an_error():
    drive = make_drive(duration=10.0)
    with pytest.raises(sigmaswarm.DriveError, match="too few"):
        sigmaswarm.diagnose(replace(drive, gps=drive.gps.select(slice(0, 5))))


def states(drive: Drive, std: np.ndarray) -> Drive:
    return replace(drive, gps=replace(drive.gps, std_x=std, std_y=std))


def found_of(drive: Drive, code: str) -> str:
    """Return the text of a finding; empty if there is no such finding."""
    return next((f.what for f in sigmaswarm.diagnose(drive).findings if f.code == code), "")


@pytest.mark.parametrize(
    ("stated", "code", "severity", "repaired"),
    [
        (None, "gps-noise", "note", None),
        (0.2, "gps-noise", "warning", 1.0),
        (0.8, "", "", None),
        (2.0, "", "", None),
        (4.5, "gps-noise", "note", None),
    ],
)
def test_a_stated_deviation_is_compared_with_the_scatter(
    stated: float | None, code: str, severity: str, repaired: float | None
):
    """A larger stated value is kept: the fixes of a smoothing receiver scatter less than their error."""
    drive = simulated("mpu-6050")  # 1 m of white noise
    silent = replace(drive, gps=replace(drive.gps, std_x=None, std_y=None), metadata={})
    own = silent if stated is None else replace(silent, metadata={"gps_std_m": stated})
    found = [f for f in sigmaswarm.diagnose(own).findings if f.code == "gps-noise"]
    assert [(f.code, f.severity) for f in found] == [(code, severity)] * bool(code)
    for finding in found:
        shown = re.findall(r"scatter \(?(?:by )?([\d.]+) m", finding.what)
        assert float(shown[0]) == pytest.approx(1.0, rel=0.2)
        assert ("takes R from this value" in finding.what) == (stated is not None)
        assert ("keep this value" in finding.remedy) == (stated == 4.5)
        assert (finding.repair is not None) == (repaired is not None)
    if repaired:
        assert repair(own, sigmaswarm.diagnose(own)).metadata["gps_std_m"] == pytest.approx(repaired, rel=0.2)


@pytest.mark.long
def test_correlated_errors_are_detected_from_stated_deviations_and_scatter():
    drive = simulated("mpu-6050")  # 1 m of white noise
    n = len(drive.gps)
    assert not found_of(drive, "gps-correlated")
    assert not found_of(states(drive, np.full(n, 2.0)), "gps-correlated")
    said = found_of(states(drive, np.full(n, 3.0)), "gps-correlated")
    assert "3 m is stated. Averaging hardly reduces correlated errors" in said
    assert "or their stated standard deviation is too large" in said
    assert found_of(
        states(drive, np.full(n, 9.0)), "gps-noise"
    )  # the white noise is far smaller, so the statement is wrong
    assert not found_of(states(drive, np.full(n, 9.0)), "gps-correlated")


def test_a_stated_deviation_far_below_the_scatter_is_reported():
    drive = sigmaswarm.simulate("urban", run=5, imu="mpu-6050", gps="f9p-rtk", duration=60.0)
    n = len(drive.gps)
    assert not found_of(drive, "gps-noise")  # 0.01 m
    assert not found_of(states(drive, np.full(n, 0.0035)), "gps-noise")  # the noise can be motion
    said = re.search(
        r"smaller than .* scatter \((.*) m per axis", found_of(states(drive, np.full(n, 0.001)), "gps-noise")
    )
    assert said
    assert float(said[1]) == pytest.approx(0.01, rel=0.2)


def test_the_options_follow_from_the_log():
    drive = simulated("mpu-6050")
    n, rng = len(drive.gps), np.random.default_rng(0)
    six = "tune uses --model tilted12 --use lateral standstill robust, since "
    tilts = "the IMU has az, gx and gy, which distinguish slopes from acceleration"
    assert found_of(drive, "use") == six + tilts
    planar = replace(drive, imu=replace(drive.imu, az=None, gx=None, gy=None))
    assert found_of(planar, "use") == "tune uses --model planar8 --use lateral standstill robust"
    varied = states(drive, rng.uniform(0.5, 2.0, n))
    assert found_of(varied, "use").startswith(
        "tune uses --model tilted12 --use lateral standstill accuracy robust, since the receiver's standard deviations"
    )
    # A receiver with speed, course and correlated errors, and truth
    velocity = sigmaswarm.simulate("urban", duration=60.0, **MEMS["icm-20602"])
    few = ". With 250 or more training fixes, tune also uses fix-error"
    lasting = f"{few}, since the scatter from fix to fix is well below the receiver's standard deviation"
    lasting += ", so the fix errors are probably correlated"
    may = ". To add velocity (speed and course of the receiver), write --use "
    may += "lateral standstill robust fix-error velocity"
    assert found_of(velocity, "use") == six + tilts + lasting + may
    level = replace(velocity, imu=replace(velocity.imu, az=None, gx=None, gy=None))
    assert "fix-error" not in found_of(level, "use"), "with truth, only tilted12 uses it"
    velocity = replace(velocity, truth=None)
    assert found_of(velocity, "use") == six + tilts + lasting + may
    part = clip(velocity, end=float(velocity.gps.time[200]))
    assert few in found_of(part, "use") and "since the scatter" not in found_of(part, "use")
    assert velocity.gps.speed is not None
    knots = replace(velocity, gps=replace(velocity.gps, speed=velocity.gps.speed / 0.514444))
    assert found_of(knots, "use") == six + tilts + lasting
    x = drive.gps.x.copy()
    x[200] += 40.0
    outlier = replace(drive, gps=replace(drive.gps, x=x))
    assert found_of(outlier, "use") == f"{six}1 fix lies far from the path, and {tilts}"
    for std in (8.0, 30.0):
        blind = states(replace(drive, truth=None), np.full(n, std))
        assert found_of(blind, "use") == six + tilts + (lasting if n >= 250 else few)


@pytest.mark.parametrize("n", [249, 250])
def test_tune_adds_fix_error_with_the_stated_number_of_fixes_on_a_part_too(n: int):
    whole = simulated("icm-20602")
    part = clip(whole, end=float(whole.gps.time[n]))
    stated = [re.search(r"With (\d+) or more training fixes", found_of(d, "use")) for d in (whole, part)]
    assert all(
        s and (n >= int(s[1])) == ("fix-error" in default_filter_options({}, [part])[0]["use"])
        for s in stated
    )


@pytest.mark.long
@needs_shared
def test_a_velocity_that_fits_better_later_is_not_recommended():
    whole = recorded("dresden")
    assert "speed and course lag the positions in the same rows by 0.55 s" in (
        found_of(whole, "velocity-delay") or ""
    )
    (finding,) = (f for f in sigmaswarm.diagnose(whole).findings if f.code == "velocity-delay")
    assert finding.severity == "note" and "The default filter does not use speed and course" in finding.what
    rest = split_time(whole, 0.7)[1]  # not enough data for a warning
    for drive in (whole, rest):
        assert "velocity" not in (found_of(drive, "use") or "")
    assert not found_of(rest, "velocity-delay")


@pytest.mark.parametrize("every", some([5, 1]))  # 1 Hz and 5 Hz
def test_multipath_is_reported_unless_the_receiver_states_it(every: int):
    drive = sigmaswarm.simulate("urban", run=1, duration=120.0, gps="white-1m", imu="icm-20602")
    true = [np.interp(drive.gps.time, drive.truth.time, v) for v in (drive.truth.x, drive.truth.y)]
    rng, time = np.random.default_rng(0), drive.gps.time - drive.imu.time[0]
    std = np.where((time > 40) & (time < 80), 1.0, 0.05)
    x, y = (v + std * rng.standard_normal(len(v)) for v in true)
    drive, plain = replace(drive, truth=None), replace(drive.gps, x=x, y=y, std_x=None, std_y=None)
    stated = replace(plain, std_x=std, std_y=std)
    calm = replace(plain, x=true[0] + (x - true[0]) / std, y=true[1] + (y - true[1]) / std)
    found = [
        {
            f.code: f
            for f in sigmaswarm.diagnose(replace(drive, gps=gps.select(slice(None, None, every)))).findings
        }
        for gps in (plain, stated, calm)
    ]
    assert ["gps-disturbed" in codes for codes in found] == [True, False, False]
    start, end = (t - drive.imu.time[0] for t in found[0]["gps-disturbed"].span)
    assert 30 < start < 46 and 74 < end < 90
    assert found[0]["gps-disturbed"].severity == "warning"


@pytest.mark.long
@needs_shared
def test_a_receiver_in_a_city():
    kingston = recorded("kingston-1")
    asked = "--model planar8 --use lateral standstill accuracy robust, since"
    assert found_of(kingston, "use").startswith(f"tune uses {asked}")
    assert "2.6 m is stated" in found_of(kingston, "gps-correlated")
    assert found_of(kingston, "gps-repeats").startswith("18 fixes")


@pytest.mark.long
@needs_shared
@pytest.mark.parametrize(
    ("name", "seed"),
    quickly(
        product(["colorado-1", "kingston-1"], range(4)),
        lambda name, seed: (name, seed) == ("kingston-1", 0),
    ),
)
def test_the_sign_of_the_gyro_is_found_despite_outliers(name: str, seed: int):
    drive = with_outliers(recorded(name), np.random.default_rng(seed))
    for sign in (1, -1):
        found = sigmaswarm.diagnose(replace(drive, imu=replace(drive.imu, gz=sign * drive.imu.gz)))
        assert ("gyro-sign" in serious(found)) == (sign < 0)


@pytest.mark.parametrize("jumped", [True, False])
def test_a_jump_of_the_clock_is_distinguished_from_a_pause_of_the_logger(jumped: bool):
    """Both sensors have a gap of 1.3 s: either the car went on (a pause), or no time has passed (a jump)."""
    drive = simulated("mpu-6050")
    gps, imu = drive.gps, drive.imu
    speed = np.hypot(np.diff(gps.x), np.diff(gps.y)) / np.diff(gps.time)
    steady = np.convolve(speed, np.ones(25) / 25, "same")
    begin = float(gps.time[int(np.argmax(steady))]) + 0.05

    def later(time: np.ndarray) -> np.ndarray:
        return np.where(time > begin, time + 1.3, time)

    if jumped:
        imu, gps = replace(imu, time=later(imu.time)), replace(gps, time=later(gps.time))
    else:
        imu, gps = (t.select((t.time <= begin) | (t.time > begin + 1.3)) for t in (imu, gps))
    found = {f.code: f for f in sigmaswarm.diagnose(replace(drive, imu=imu, gps=gps)).findings}
    code, other = ("clock-jump", "logger-pause") if jumped else ("logger-pause", "clock-jump")
    assert other not in found
    assert ": for 1.3 s after t = " in found[code].what
    assert found[code].span[0] == pytest.approx(begin, abs=0.05)
    assert {"clock-jump", "logger-pause"}.isdisjoint(sigmaswarm.diagnose(drive).codes)


@pytest.mark.parametrize("jumped", [True, False])
@pytest.mark.parametrize("every", [1, 5])  # fixes at 5 Hz and at 1 Hz
def test_a_gap_at_any_time_is_not_reported_as_a_jump(jumped: bool, every: int):
    """With white errors of 1 m, the distance of two fixes gives a wrong speed, as on a KITTI drive."""
    drive = simulated("icm-20602", 180.0)
    drive = replace(drive, gps=drive.gps.select(np.arange(len(drive.gps)) % every == 0))
    named = wrong = 0
    for begin in np.arange(12.03, drive.gps.time[-1] - 12, 1.0):
        imu, gps = (
            replace(t, time=np.where(t.time > begin, t.time + 1.6, t.time))
            if jumped
            else t.select((t.time <= begin) | (t.time > begin + 1.6))
            for t in (drive.imu, drive.gps)
        )
        for found in clock_jumps(imu.time, gps):
            unsure = "does not distinguish" in found.what
            named += not unsure
            wrong += not unsure and (found.code == "clock-jump") != jumped
    assert wrong == 0
    assert named >= 20


@pytest.mark.long
@needs_shared
def test_a_pause_in_a_real_log_is_not_a_jump():
    found = sigmaswarm.diagnose(recorded("kitti-09-30-0018")).codes
    assert "logger-pause" in found
    assert "clock-jump" not in found


def test_a_cached_diagnosis_requires_equal_numbers_and_name(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(diagnose, "CACHE_SIZE", 32)
    monkeypatch.setattr(diagnose, "_cache", {})
    drive = make_drive(duration=30.0, imu_rate=50.0)
    found = sigmaswarm.diagnose(drive)
    assert sigmaswarm.diagnose(drive) is found
    assert sigmaswarm.diagnose(replace(drive, name="other")).drive == "other"
    stated = replace(drive, metadata={**drive.metadata, "gps_std_m": 50.0})  # not in any column
    assert sigmaswarm.diagnose(stated).findings != found.findings
    turned = replace(drive, imu=replace(drive.imu, gz=-drive.imu.gz))
    assert "gyro-sign" in sigmaswarm.diagnose(turned).codes - found.codes
    assert sigmaswarm.diagnose(drive) == found
    assert len(diagnose._cache) == 4  # one per different drive
    diagnose._cache.update({("filler", str(k)): found for k in range(diagnose.CACHE_SIZE)})
    sigmaswarm.diagnose(replace(drive, name="last"))
    assert len(diagnose._cache) == diagnose.CACHE_SIZE
    assert ("filler", str(diagnose.CACHE_SIZE - 1)) in diagnose._cache  # the oldest are removed


def test_positions_in_another_unit_are_not_called_a_fault_of_the_accelerometer():
    """Web Mercator scales the fixes; the accelerometer still measures gravity."""
    drive = simulated("icm-20602", 90.0)
    stretched = replace(drive, gps=replace(drive.gps, x=1.5 * drive.gps.x, y=1.5 * drive.gps.y))
    weak = replace(drive, imu=replace(drive.imu, ax=drive.imu.ax / 1.6))
    for sick, named in ((stretched, True), (weak, False)):
        found = [f for f in sigmaswarm.diagnose(sick).findings if f.code == "accelerometer-scale"]
        assert found and all(("projection of the positions" in f.remedy) == named for f in found)


@pytest.mark.parametrize(("sense", "scale"), [(1.0, 0.84), (-1.0, 1.2)])
def test_a_scale_of_the_gyro_is_also_visible_in_whole_turns(sense: float, scale: float):
    """In circles, changes within a window may be caused by slip; a wrong scale is also visible in whole turns."""
    rng, t = np.random.default_rng(1), np.arange(0, 100, 0.02)
    rate = sense * (0.25 + 0.1 * np.sin(2 * np.pi * t / 13))
    place = np.cumsum(5.0 * np.exp(1j * np.cumsum(rate) * 0.02)) * 0.02
    noise = 0.02 * rng.standard_normal((3, len(t)))
    fixes = place[::10] + 0.1 * (rng.standard_normal(500) + 1j * rng.standard_normal(500))
    for gz, faulty in ((0.25 * sense + (rate - 0.25 * sense) / scale, False), (rate / scale, True)):
        imu = Imu(t, noise[0], 5.0 * rate + noise[1], gz + 0.1 * noise[2])
        found = found_of(Drive("circles", imu, Gps(t[::10], fixes.real, fixes.imag)), "gyro-scale")
        assert bool(found) == faulty, found


@pytest.mark.long
@pytest.mark.parametrize(
    ("speed", "radius"), quickly([(8, 20), (2, 3), (20, -100)], lambda speed, radius: speed == 8)
)
def test_steady_circles_show_no_gravity_no_unit_and_no_rotation(speed: float, radius: float):
    rng, t = np.random.default_rng(0), np.arange(0, 100, 0.02)
    noise = 0.03 * rng.standard_normal((6, len(t)))
    force = np.array([0 * t, 0 * t + speed**2 / radius, 0 * t + 9.81]) + noise[:3]
    gyro = np.array([0 * t, 0 * t, 0 * t + speed / radius]) + 0.1 * noise[3:]
    fixes = radius * np.exp(1j * speed / radius * t[::10]) + 0.5 * (rng.standard_normal((2, 500)).T @ [1, 1j])
    imu = Imu(t, *force[:2], gyro[2], az=force[2], gx=gyro[0], gy=gyro[1])
    found = sigmaswarm.diagnose(Drive("circle", imu, Gps(t[::10], fixes.real, fixes.imag)))
    assert {f.code for f in found.findings if f.severity != "note"} <= {"unseen-yaw", "no-start"}


def circle(speed: float, rate: float, *, noise: float, turned_by: float, ahead: float) -> Drive:
    """Simulate 90 s on a circle: m/s, rad/s, noise of the fixes (m), rotation about z (deg), lever arm (m)."""
    rng, t = np.random.default_rng(1), np.arange(0, 90, 0.025)
    heading = np.exp(1j * rate * t)
    place = (speed / (1j * rate) + ahead) * heading
    force = 1j * speed * rate * np.exp(-1j * turned_by) + 0.1 * (rng.standard_normal((2, len(t))).T @ [1, 1j])
    gyro = 0.003 * rng.standard_normal((3, len(t))) + np.array([0.0, 0.0, rate])[:, None]
    up = 9.81 + 0.1 * rng.standard_normal(len(t))
    imu = Imu(t, force.real, force.imag, gyro[2], az=up, gx=gyro[0], gy=gyro[1])
    fixes = place[::40] + noise * (rng.standard_normal((2, 90)).T @ [1, 1j])
    return Drive("circle", imu, Gps(t[::40], fixes.real, fixes.imag))


@pytest.mark.parametrize(
    ("speed", "rate", "others"),
    quickly(
        [
            (speed, rate, others)
            for speed in (1.0, 2.5, 8.0)
            for rate, *others in ((0.1, 0.05, 0.05, 0.4), (-0.5, 0.3, -0.07, -0.8))
        ],
        lambda speed, rate, _: (speed, rate) in ((1.0, 0.1), (8.0, -0.5)),
    ),
)
def test_on_a_circle_at_constant_speed_no_delay_of_the_fixes_is_noted(
    speed: float, rate: float, others: list[float]
):
    """On a circle, a delay, a rotation about z and a lever arm can't be distinguished."""
    noise, turned_by, ahead = others
    drive = circle(speed, rate, noise=noise, turned_by=turned_by, ahead=ahead)
    found = {f.code: f for f in sigmaswarm.diagnose(drive).findings}
    assert "clock-offset" not in found
    assert "no clock offset between IMU and GPS can be detected" in found["unseen-clock"].what


@needs_shared
def test_no_delay_is_proposed_for_a_recording_in_circles():
    source = DRIVES.parent / "cases/data/ros1-own-message/Circles.bag"
    drive = sigmaswarm.import_log(source, say=lambda _: None, mount="x=x,y=-y")
    assert "clock-offset" not in sigmaswarm.diagnose(drive).codes
