"""Clock offsets of seconds are found before axes are checked; a log that begins in reverse is recognized."""

import re
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from scipy.signal import lfilter

import sigmaswarm
from sigmaswarm import Drive, Gps, Imu
from sigmaswarm.doctor.clocks import search_offset
from sigmaswarm.doctor.fixes import Course
from sigmaswarm.doctor.mounting import rotate_imu
from sigmaswarm.doctor.repairs import repair
from sigmaswarm.geodesy import rotation_of
from support import DRIVES, needs_shared, quickly, some


@cache
def drive(duration: float = 100.0) -> Drive:
    """Return a drive without truth, whose diagnosis takes half the time."""
    drive = sigmaswarm.simulate("urban", run=3, duration=duration, gps="white-1m", imu_rate=50)
    return replace(drive, truth=None)


@pytest.mark.parametrize(
    "offset",
    quickly([(s,) for s in (-37.0, -18.0, -6.0, 4.0, 18.0, 33.0)], lambda s: s == 4.0),
)
def test_an_offset_of_seconds_is_found_and_repaired(offset: float):
    late = replace(drive(), gps=replace(drive().gps, time=drive().gps.time + offset))
    found = sigmaswarm.diagnose(late)
    assert [f.code for f in found.findings if f.severity == "serious"] == ["clock-offset"]
    mended = sigmaswarm.repair(late, found)
    exact = abs(offset) == 18  # leap seconds
    assert mended.gps.time[0] == pytest.approx(drive().gps.time[0], abs=1e-6 if exact else 0.2)
    np.testing.assert_array_equal(mended.imu.ax, drive().imu.ax)
    assert not sigmaswarm.diagnose(mended).serious


@pytest.mark.parametrize(
    ("offset", "columns", "factor"),
    quickly(
        [
            (7.0, {"gx": "gx", "gy": "gy", "gz": "gz"}, 0.5),
            (-12.0, {"gx": "gx", "gy": "gy", "gz": "gz"}, -1.6),
            (18.0, {"gx": "gz", "gz": "gx"}, 1.0),
            (-7.5, {"gx": "gz", "gz": "gx"}, -1.0),
        ],
        lambda offset, columns, factor: offset in (7.0, 18.0),
    ),
)
def test_an_offset_and_a_wrong_scale_or_axis_are_both_repaired(
    offset: float, columns: dict[str, str], factor: float
):
    imu = drive().imu
    wrong = {n: getattr(imu, of) * (factor if of == "gz" else abs(factor)) for n, of in columns.items()}
    late = replace(
        drive(), imu=replace(imu, **wrong), gps=replace(drive().gps, time=drive().gps.time + offset)
    )
    mended = repair(late, sigmaswarm.diagnose(late))
    assert mended.gps.time[0] == pytest.approx(drive().gps.time[0], abs=0.2)
    np.testing.assert_allclose(mended.imu.gz, imu.gz, rtol=0.03, atol=1e-9)
    np.testing.assert_allclose(mended.imu.gx, imu.gx, rtol=0.03, atol=1e-9)
    assert not sigmaswarm.diagnose(mended).serious


@pytest.mark.parametrize("offset", [0.3, -0.3])
@pytest.mark.parametrize("run", quickly([(r,) for r in (3, 9, 14, 21)], lambda run: run == 3))
def test_an_offset_of_less_than_a_second_is_found_in_a_minute(run: int, offset: float):
    """With few turns (14, 21) it is a note without a repair."""
    sound = sigmaswarm.simulate(
        "urban", run=run, duration=60.0, imu="adis16465", gps="f9p-rtk", gps_rate=10.0
    )
    late = replace(sound, gps=replace(sound.gps, time=sound.gps.time + offset), truth=None)
    (found,) = (f for f in sigmaswarm.diagnose(late).findings if f.code == "clock-offset")
    size, way = re.findall(r"(0\.\d\d) s (late|early)", found.what)[0]
    assert float(size) == pytest.approx(0.3, abs=0.03) and (way == "late") == (offset > 0)
    assert (found.severity == "note") == (found.repair is None) == (run in (14, 21))


@pytest.mark.long
@pytest.mark.parametrize("offset", [60.0, -90.0, 120.0])
def test_an_offset_beyond_the_search_is_not_reported_as_a_wrong_axis(offset: float):
    sound = drive(150.0)
    late = replace(sound, gps=replace(sound.gps, time=sound.gps.time + offset))
    found = sigmaswarm.diagnose(late)
    assert not {"accelerometer-axes", "accelerometer-sign", "gyro-sign", "mounting"} & found.codes


def swaying(period: float) -> Drive:
    """Simulate alternating turns at falling speed; each turns the car a little further than the one before."""
    rng, t = np.random.default_rng(1), np.arange(0, 90, 0.01)
    speed = 8 + 2 * np.sin(2 * np.pi * t / 23)
    phase = 2 * np.pi * (t / period - 0.00005 * t**2)
    rate = (0.2 + 0.15 * np.sin(t / 9) ** 2) * np.sin(phase)
    position = np.cumsum(speed * np.exp(1j * (0.7 + np.cumsum(rate) * 0.01))) * 0.01
    noise = rng.standard_normal((3, len(t)))
    force = np.gradient(speed, 0.01), speed * rate
    imu = Imu(t, force[0] + 0.05 * noise[0], force[1] + 0.05 * noise[1], rate + 0.002 * noise[2])
    k = slice(None, None, 20)
    x, y = (part[k] + 0.5 * rng.standard_normal(len(t[k])) for part in (position.real, position.imag))
    return Drive("swaying", imu, Gps(t[k], x, y))


@pytest.mark.parametrize("period", quickly([(9.5,), (11.0,), (12.0,)], lambda period: period == 11.0))
def test_turns_that_would_match_with_another_sign_or_a_smaller_offset(period: float):
    """18 s are about one and a half periods, or two."""
    sound = swaying(period)
    late = replace(sound, gps=replace(sound.gps, time=sound.gps.time + 18.0))
    found = {f.code: f for f in sigmaswarm.diagnose(late).findings if f.severity == "serious"}
    assert found.keys() == {"clock-offset"}
    assert "18.0 s late" in found["clock-offset"].what
    assert not sigmaswarm.diagnose(sound).serious


@pytest.mark.parametrize(("slower", "found"), [(0.0, None), (0.0001, 3.0), (0.0003, 3.0)])
def test_an_offset_must_be_clearly_better_than_all_others(slower: float, found: float | None):
    """Turns with a constant period match at every period: another offset explains 0.94 at 0.0001, and 0.7 at 0.0003."""
    t, time = np.arange(0, 120, 0.05), np.arange(10.0, 100.0)
    rate = 0.2 * np.sin(2 * np.pi * (t / 10 - slower * t**2))
    zero, angle = 0 * t, np.interp(time - 3.0, t, np.cumsum(rate) * 0.05)
    drive = Drive("repeating", Imu(t, zero, zero, rate), Gps(time, 0 * time, 0 * time))
    course = Course(time, 0j * time, 0j * time, 0.1, angle, time > 0, 1.0, 3.0)
    assert search_offset(drive, course) == (None if found is None else pytest.approx(found, abs=0.15))


@pytest.mark.long
@needs_shared
@pytest.mark.filterwarnings("ignore::sigmaswarm.errors.DriveWarning")
def test_a_search_that_ends_at_its_initial_value_reports_no_offset():
    """In this minute, no column of the gyro follows the course, and an offset of 0.1 s was reported as serious."""
    drive = sigmaswarm.read_drive(DRIVES / "dresden")
    first = drive.imu.time[0] + 96.0
    assert "clock-offset" not in sigmaswarm.diagnose(sigmaswarm.clip(drive, first, first + 60.0)).codes


def robot(reverse: bool, seed: int, slow: float = 1.0, turn: float = 0.0) -> Drive:
    """Simulate 14 s of driving, a stop, and turns; exact kinematics, white noise (fixes of a slow robot: smaller).

    With ``turn``, rad/s, the robot also turns at first, and its speed changes less later.
    """
    rng, t = np.random.default_rng(seed), np.arange(0, 90, 0.01)
    first = -4.0 if reverse else 4.0
    times = [0, 2, 5, 14, 16, 19, 24, *((53, 56, 59, 87, 90) if turn else (55, 60, 65, 85, 90))]
    speed = np.interp(t, times, [0, 0, first, first, 0, 0, 5, 5, 2, 5, *((5, 0) if turn else (0, 0))])
    rate = np.where(t > 24, (turn or 0.3) * np.sin(2 * np.pi * (t - 24) / (17 if turn else 15)), 0.0)
    rate = (rate + np.where((t > 6) & (t < 13), 0.2 * turn, 0.0)) * np.abs(speed) / 5
    theta = 0.7 + np.cumsum(rate) * 0.01
    speed = slow * speed
    position = np.cumsum(speed * np.exp(1j * theta)) * 0.01
    noise = rng.standard_normal((3, len(t)))
    force = np.gradient(speed, 0.01), speed * rate
    imu = Imu(t, force[0] + 0.05 * noise[0], force[1] + 0.05 * noise[1], rate + 0.002 * noise[2])
    k = slice(None, None, 20)
    x, y = (part[k] + slow**2 * rng.standard_normal(len(t[k])) for part in (position.real, position.imag))
    return Drive("robot", imu, Gps(t[k], x, y))


@pytest.mark.parametrize("seed", quickly([(s,) for s in range(3)], lambda s: s == 0))
@pytest.mark.parametrize("slow", [1.0, 0.25])
def test_a_log_that_begins_in_reverse(seed: int, slow: float):
    found = {f.code: f for f in sigmaswarm.diagnose(robot(True, seed, slow)).findings}
    assert found["reverse-start"].span[1] == pytest.approx(16, abs=2)
    assert f"--at {18 if slow == 1 else 17} --out parts" in found["reverse-start"].remedy
    known = replace(robot(True, seed, slow), metadata={"heading_deg": 40.0})
    assert not {"reverse-start", "heading-offset"} & sigmaswarm.diagnose(known).codes
    assert "reverse-start" not in sigmaswarm.diagnose(robot(False, seed, slow)).codes


@pytest.mark.parametrize(
    ("turn", "seed"), quickly(product((0.3, 0.4, 0.5), (0, 1)), lambda turn, seed: (turn, seed) == (0.4, 0))
)
def test_a_start_in_reverse_before_strong_turns(turn: float, seed: int):
    """The lateral force in turns is far larger than the forward force."""
    drive = robot(True, seed, turn=turn)
    (found,) = (f for f in sigmaswarm.diagnose(drive).findings if f.severity == "serious")
    assert found.code == "reverse-start" and found.cut == pytest.approx(18, abs=2)
    _, rest = sigmaswarm.split_time(drive, at=float(found.cut))
    assert not sigmaswarm.diagnose(rest).serious
    assert not sigmaswarm.diagnose(robot(False, seed, turn=turn)).serious


@pytest.mark.parametrize(
    ("until", "fast", "mount"),
    quickly(
        [(until, fast, (0, 0, 0)) for until, fast in ((45.0, 8.0), (30.0, 8.0), (40.0, 10.0))]
        + [
            (30.0, 8.0, mount) for mount in ((180, 0, 0), (0, 180, 0), (0, 0, 90), (20, -30, 70), (0, 0, 180))
        ],
        lambda until, fast, mount: mount == (180, 0, 0),
    ),
)
def test_a_long_start_in_reverse_is_one_finding(until: float, fast: float, mount: tuple[float, float, float]):
    """The direction of ax and ay relative to the motion changes by 180 deg, but the IMU was not moved."""
    rng, t = np.random.default_rng(60), np.arange(0, 160, 0.02)
    back, on = np.clip(np.minimum((t - 2) / 3, (until - 4 - t) / 3), 0, 1), np.clip((t - until) / 4, 0, 1)
    speed = fast * on * (0.75 + 0.25 * np.sin((t - until) / 6)) - 6.0 * back
    rate = np.where(np.abs(speed) > 0.8, 0.12 * np.sin(t / 9) * np.sign(speed), 0.0)
    theta = 0.7 + np.cumsum(rate) * 0.02
    position = np.cumsum(speed * np.exp(1j * theta)) * 0.02
    noise = rng.standard_normal((6, len(t))) * np.array([[0.05]] * 3 + [[0.002]] * 3)
    force = np.array([np.gradient(speed, 0.02), speed * rate, 0 * t + 9.81])
    imu = Imu(t, *(force + noise[:3])[:2], rate + noise[5], force[2] + noise[2], noise[3], noise[4])
    k = slice(None, None, 10)
    fixes = position[k] + 0.7 * (rng.standard_normal(len(t[k])) + 1j * rng.standard_normal(len(t[k])))
    drive = Drive("robot", rotate_imu(imu, rotation_of(*mount)), Gps(t[k], fixes.real, fixes.imag))
    late = replace(drive, gps=replace(drive.gps, time=drive.gps.time + 18.0))
    found = {f.code for f in sigmaswarm.diagnose(late).findings if f.severity != "note"}
    assert found == {"reverse-start", "clock-offset"}
    if mount == (180, 0, 0):  # a stated heading permits the start, but not signs of single axes
        known = sigmaswarm.diagnose(replace(drive, metadata={"heading_deg": 40.0}))
        assert not any(f.repair for f in known.findings) and "gyro-sign" in known.codes
    (found,) = (f for f in sigmaswarm.diagnose(drive).findings if f.severity != "note")
    assert found.code == "reverse-start" and found.cut == pytest.approx(until, abs=4)
    _, rest = sigmaswarm.split_time(drive, at=float(found.cut))
    codes = sigmaswarm.diagnose(rest).codes
    assert not {"reverse-start", "mounting-changed"} & codes and ("mounting" in codes) == any(mount)


def test_at_walking_speed_no_offset_is_reported():
    rng, time = np.random.default_rng(2), np.arange(0.0, 600.0, 0.02)
    yaw_rate = 0.12 * np.sin(2 * np.pi * time / 45) + 0.08 * np.sin(2 * np.pi * time / 19)
    heading = np.cumsum(yaw_rate) * 0.02
    x, y = (np.cumsum(0.3 * f(heading)) * 0.02 for f in (np.cos, np.sin))
    noise = rng.normal(0.0, [0.05] * 3 + [2e-3] * 3, (len(time), 6)).T
    force = np.array([0 * time, 0.3 * yaw_rate, 0 * time + 9.81, 0 * time, 0 * time, yaw_rate]) + noise
    slow = np.cumsum(rng.normal(0.0, 1e-3, (3000, 2)), axis=0) + rng.normal(0.0, 0.008, (3000, 2))
    gps = Gps(time[::10], x[::10] + slow[:, 0], y[::10] + slow[:, 1])
    found = sigmaswarm.diagnose(Drive("robot", Imu(time, *force), gps))
    assert not [f for f in found.findings if f.code == "clock-offset" and f.severity == "serious"]


@pytest.mark.parametrize("seed", quickly([(s,) for s in range(4)], lambda s: s < 2))
def test_errors_of_a_slow_robot_s_course_are_not_faults_of_its_gyro(seed: int):
    rng, t = np.random.default_rng(seed), np.arange(0.0, 240.0, 0.02)
    rate = np.where(t % 24 < 4, 0.4, 0.0) * np.where(t % 48 < 24, 1, -1)
    heading = np.cumsum(rate) * 0.02
    where = np.cumsum(0.6 * np.exp(1j * heading)) * 0.02
    keep = np.exp(-0.1 / 5.0)
    wander = lfilter([1.0], [1.0, -keep], rng.standard_normal((2, len(t) // 5)) * np.sqrt(1 - keep**2))
    zero = np.zeros(len(t))
    imu = Imu(t, 0.05 * rng.standard_normal(len(t)), 0.6 * rate, rate + 0.004 * rng.standard_normal(len(t)))
    for size, dead, told in ((1.0, False, False), (0.02, True, True)):
        x, y = (
            part[::5] + size * error for part, error in zip((where.real, where.imag), wander, strict=True)
        )
        drive = Drive("robot", replace(imu, gz=zero) if dead else imu, Gps(t[::5], x, y))
        assert told == any("no column of the gyro" in f.what for f in sigmaswarm.diagnose(drive).findings)


@pytest.mark.parametrize("factor", some([0.5, 0.0]))
def test_rates_of_zero_are_not_a_finding(factor: float):
    """Many drivers write 0 for gx and gy of a planar IMU."""
    sound = drive(80.0)
    imu = sound.imu
    zero = replace(imu, gx=0 * imu.gx, gy=0 * imu.gy, gz=factor * imu.gz)
    late = replace(sound, imu=zero, gps=replace(sound.gps, time=sound.gps.time + 18.0))
    assert sigmaswarm.diagnose(late).findings
