"""Plausibility checks: every planted fault is reported, and a sound drive causes no warning."""

from dataclasses import replace

import numpy as np
import pytest

from sigmaswarm.drives import checks
from sigmaswarm.drives.checks import GRAVITY, remarks_of, shortage_of
from sigmaswarm.drives.drive import Drive
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.split import clip
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import SigmaswarmWarning
from support import DRIVES, limited_memory, make_drive, needs_shared

DEGREES = 180 / np.pi


def imu_with(drive: Drive, **columns: np.ndarray | None) -> Drive:
    return replace(drive, imu=replace(drive.imu, **columns))


def without(drive: Drive, table: str, start: float, end: float) -> Drive:
    """Return the drive without the rows of a table in [start, end)."""
    rows = getattr(drive, table)
    return replace(drive, **{table: rows.select((rows.time < start) | (rows.time >= end))})


def warnings_of(drive: Drive) -> list[str]:
    return [str(remark) for remark in remarks_of(drive.imu, drive.gps, drive.truth)]


def only(drive: Drive) -> str:
    """Return the only warning of the drive."""
    (message,) = warnings_of(drive)
    assert len(message.splitlines()) == 1
    return message


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("gps_std", [0.0, 1.0, 4.0])
def test_a_sound_drive_raises_no_warning(seed: int, gps_std: float):
    drive = make_drive(seed=seed, gps_std=gps_std, jitter=0.4)
    assert warnings_of(drive) == []
    assert warnings_of(imu_with(drive, az=None)) == []
    assert warnings_of(imu_with(drive, az=None, gz=drive.imu.gz + 0.05, ax=drive.imu.ax + 0.5)) == []


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("bias", [0.0, 0.05])
def test_a_straight_cruise_gives_no_warning_about_units(noise: float, bias: float):
    t = np.arange(6000) * 0.01
    white = np.random.default_rng(0).standard_normal
    drive = make_drive()
    drive = imu_with(
        drive, time=t, ax=0 * t, ay=0 * t, az=None, gx=None, gy=None, gz=bias + noise * white(6000)
    )
    gps = replace(drive.gps, x=12 * drive.gps.time + white(len(drive.gps)), y=white(len(drive.gps)))
    assert warnings_of(replace(drive, gps=gps, truth=None)) == []
    exact = replace(drive.gps, x=12 * drive.gps.time, y=0 * drive.gps.time)
    assert warnings_of(replace(drive, gps=exact, truth=None)) == []


@pytest.mark.parametrize("seed", range(6))
def test_degrees_per_second(seed: int):
    drive = make_drive(seed=seed)
    message = only(imu_with(drive, gz=drive.imu.gz * DEGREES))
    assert "imu.csv: the integral of column gz" in message
    assert "deg/s; multiply gx, gy, gz by pi/180" in message


def test_degrees_per_second_without_information_in_the_fixes():
    drive = make_drive(gps_std=0.0)
    slow = replace(drive.gps, x=drive.gps.x / 20, y=drive.gps.y / 20)
    drive = replace(drive, gps=slow, truth=None)
    assert warnings_of(drive) == []
    assert "deg/s" in only(imu_with(drive, gz=drive.imu.gz * DEGREES))


def in_g(drive: Drive) -> Drive:
    imu = drive.imu
    az = None if imu.az is None else imu.az / GRAVITY
    return imu_with(drive, ax=imu.ax / GRAVITY, ay=imu.ay / GRAVITY, az=az)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("sign", [1, -1])
def test_accelerations_in_g(seed: int, sign: int):
    drive = in_g(make_drive(seed=seed))
    drive = imu_with(drive, ax=sign * drive.imu.ax)
    assert "column az has a median of 1.00, as if az were in g; multiply ax, ay, az by 9.80665" in only(drive)
    assert "column ax" in only(imu_with(drive, az=None))
    assert "as if ax were in g; multiply ax, ay by 9.80665" in only(imu_with(drive, az=None))


@pytest.mark.parametrize("level", ["ax", "ay"])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("has_az", [True, False])
def test_exchanged_axes(level: str, sign: int, has_az: bool):
    drive = make_drive()
    exchanged = {level: sign * drive.imu.az, "az": getattr(drive.imu, level) if has_az else None}
    messages = warnings_of(imu_with(drive, **exchanged))
    assert (
        f"imu.csv: column {level} has a median of {sign * GRAVITY:.2f} m/s2, which is gravity and must be in az"
        in messages[0]
    )
    assert "to x forward, y left, z up: import with --mount auto" in messages[0]
    messages = warnings_of(imu_with(drive, **{level: sign * 10 * drive.imu.az}))
    assert "m/s2, which exceeds gravity; check the unit of ax, ay, az" in messages[0]


@pytest.mark.parametrize(
    ("az", "said"),
    [
        (-9.8, "the specific force at rest is +9.8 m/s2 if z points up"),
        (0.0, "+9.8 is expected"),
        (32.2, "+9.8 is expected"),
    ],
)
def test_wrong_gravity(az: float, said: str):
    drive = make_drive()
    message = only(imu_with(drive, az=np.full(len(drive.imu), az)))
    assert f"imu.csv: column az has a median of {az:.2f}" in message
    assert said in message


def test_gaps_in_each_file():
    drive = make_drive(duration=60.0, truth=True)
    one = without(drive, "imu", 20.0, 20.5)
    message = only(without(one, "imu", 40.0, 41.5))
    assert (
        "imu.csv: there are 2 gaps; the longest lasts 1.51 s after t = 39.99 s (usual interval 0.010 s)"
        in message
    )
    assert (
        "uses the mean of the samples before and after the gap, and increases the covariance of the state"
        in message
    )
    assert "imu.csv: there is a gap of 0.51 s after t = 19.99 s" in only(one)
    assert "gps.csv: there is a gap of 3.20 s after t = 9.90 s (usual interval 0.200 s)" in only(
        without(drive, "gps", 10.0, 13.0)
    )
    assert "truth.csv: there is a gap of 3.01 s" in only(without(drive, "truth", 10.0, 13.0))


def test_gaps_of_a_drive_are_reported_in_one_sentence():
    paused = without(
        without(without(make_drive(), "imu", 10.0, 13.0), "gps", 10.0, 13.0), "truth", 10.0, 13.0
    )
    message = only(without(paused, "gps", 20.0, 24.0))
    for file in ("imu", "gps", "truth"):
        assert message.count(f"{file}.csv: there is a gap") == 1
    assert message.endswith("if the car maneuvered during the gap, split the drive")
    assert "gps.csv" not in only(paused)  # the logger paused: only the gap of the IMU is reported


@pytest.mark.parametrize(("table", "length"), [("imu", 0.085), ("gps", 1.7), ("truth", 1.9)])
def test_short_gaps_are_not_reported(table: str, length: float):
    assert warnings_of(without(make_drive(), table, 30.0, 30.0 + length)) == []


@pytest.mark.parametrize(
    ("begin", "end", "ends"),
    [
        (12.0, 58.0, "up to 12 s before its first sample and up to 2 s after its last sample"),
        (0.0, 30.0, "up to 30 s after its last sample"),
    ],
)
def test_fixes_outside_of_the_imus_time_are_counted(begin: float, end: float, ends: str):
    whole = make_drive()
    drive = without(without(whole, "imu", -1.0, begin), "imu", end, 99.0)
    gps, imu = whole.gps.time, drive.imu.time
    count, n = np.count_nonzero((gps < imu[0]) | (gps > imu[-1])), len(gps)
    assert only(drive) == (
        f"gps.csv: {count} of {n} fixes lie outside of the IMU's time span, {ends}, and are not used; no action is "
        "needed if the receiver recorded longer than the IMU; otherwise convert both to one clock"
    )


@pytest.mark.parametrize(
    ("begin", "end", "said"), [(12.0, 99.0, "first 12 s"), (15.0, 40.0, "first 15 s and last 20 s")]
)
def test_long_parts_of_the_imu_without_fixes_are_named(begin: float, end: float, said: str):
    drive = without(without(make_drive(), "gps", -1.0, begin), "gps", end, 99.0)
    assert only(drive).startswith(
        f"imu.csv: there are no fixes during the IMU's {said}; a filter starts after the first"
    )


def test_short_ends_with_one_sensor_are_not_reported():
    drive = make_drive()
    for table in ("imu", "gps"):
        assert warnings_of(without(without(drive, table, -1.0, 9.5), table, 51.0, 99.0)) == []
    long = make_drive(duration=240.0)
    assert warnings_of(without(long, "gps", -1.0, 23.5)) == []  # a cold start of the receiver


def test_the_reader_passes_the_warnings_on_with_the_path(tmp_path):
    drive = in_g(without(make_drive(), "imu", 20.0, 20.5))
    folder = write_drive(drive, tmp_path / "d")
    with pytest.warns(SigmaswarmWarning) as caught:
        read_drive(folder)
    assert [str(w.message).split(": ")[0] for w in caught] == [f"{folder}/imu.csv"] * 2
    assert {w.filename for w in caught} == {__file__}


def test_shortage():
    drive = make_drive(duration=20.0)

    def shortage(end: float) -> str | None:
        part = clip(drive, end=end)
        return shortage_of(part.imu, part.gps)

    assert shortage(np.inf) is None
    assert "99 samples are too few" in str(shortage(0.985))
    assert "9 fixes" in str(shortage(1.8))
    assert len(clip(drive, end=2.0).gps) == 10
    assert shortage(2.0) is None


@needs_shared
def test_the_log_as_recorded_shows_its_faults():
    with pytest.warns(SigmaswarmWarning) as caught:
        read_drive(DRIVES / "dresden-as-recorded")
    messages = sorted(str(w.message) for w in caught)
    assert len(messages) == 2
    assert "column az has a median of -9.61" in messages[0]
    assert "the integral of column gz exceeds the changes of course, as if gz were in deg/s" in messages[1]


@needs_shared
@pytest.mark.parametrize("name", ["kitti-09-30-0018", "kitti-09-26-0022", "kitti-09-26-0101"])
def test_sound_drives_have_warnings_only_about_real_gaps(name: str):
    with pytest.warns(SigmaswarmWarning) as caught:
        drive = read_drive(DRIVES / name)
    (message,) = [str(w.message) for w in caught]
    assert f" {np.diff(drive.imu.time).max():.2f} s after t" in message


@needs_shared
@pytest.mark.filterwarnings("ignore::sigmaswarm.errors.SigmaswarmWarning")
@pytest.mark.parametrize(
    "path", sorted(p for p in DRIVES.glob("*") if p.is_dir() and "as-rec" not in p.name), ids=lambda p: p.name
)
def test_wrong_units_are_found_in_every_real_drive(path):
    drive = read_drive(path)
    assert any("deg/s" in m for m in warnings_of(imu_with(drive, gz=drive.imu.gz * DEGREES)))
    assert any("in g" in m for m in warnings_of(in_g(drive)))
    assert any("in g" in m for m in warnings_of(imu_with(in_g(drive), az=None)))
    assert not any("in g" in m for m in warnings_of(imu_with(drive, az=None)))


UNITS = [("ms", 1e3), ("us", 1e6), ("ns", 1e9)]


def with_times(drive: Drive, change) -> Drive:
    tables = {name: getattr(drive, name) for name in ("imu", "gps", "truth")}
    return replace(drive, **{n: replace(t, time=change(t.time)) for n, t in tables.items() if t is not None})


@pytest.mark.parametrize(("unit", "factor"), UNITS)
@pytest.mark.parametrize("rates", [{}, {"imu_rate": 10.0, "gps_rate": 1.0}, {"imu_rate": 1000.0}])
def test_times_in_another_unit_in_both_files(unit: str, factor: float, rates: dict[str, float]):
    """With times in ns, a grid over the length of the log took 80 s and 5 GB."""
    message = only(with_times(make_drive(**rates), lambda t: factor * t))
    assert message.startswith("imu.csv, gps.csv: ")
    assert f"as if t were in {unit} in both files" in message


@pytest.mark.parametrize("rates", [{"imu_rate": 2.0, "gps_rate": 1.0}, {"imu_rate": 10.0, "gps_rate": 0.05}])
def test_slow_sensors_give_no_warning_about_units(rates: dict[str, float]):
    drive = make_drive(duration=400.0, **rates)
    assert not any(r.code == "time-unit" for r in remarks_of(drive.imu, drive.gps, drive.truth))


@pytest.mark.parametrize("last", [1e9, 4e9, 1.8e18])
def test_a_corrupt_last_time_costs_no_memory(last: float):
    drive = with_times(make_drive(), lambda t: np.append(t[:-1], last))
    with limited_memory():
        messages = warnings_of(drive)
    assert [m[:18] for m in messages] == ["imu.csv: column t ", "gps.csv: column t "]
    assert f"jumps by {last - 60:.4g} s after t = 5" in messages[0]


def test_a_clock_that_is_set_during_the_log():
    messages = warnings_of(with_times(make_drive(), lambda t: np.where(t < 30, t, t + 1.7e9)))
    assert len(messages) == 2
    assert all("jumps by 1.7e+09 s after t = 29." in m for m in messages)


def test_windows_without_fixes_are_omitted():
    """Compared with the definition: one knot every 5 s from the first common time on."""
    drive = without(make_drive(jitter=0.4), "gps", 21.0, 38.0)
    velocity, integral, turn = checks._seen_by_fixes(drive.imu, drive.gps, drive.imu.gz)
    knots = np.arange(drive.gps.time[0], drive.imu.time[-1], 5.0)
    held = [np.any((drive.gps.time >= k) & (drive.gps.time < k + 5)) for k in knots[:-1]]
    assert 0 < np.count_nonzero(held) == len(velocity) < len(held)
    position = np.interp(knots, drive.gps.time, drive.gps.x + 1j * drive.gps.y)
    np.testing.assert_allclose(velocity, (np.diff(position) / 5)[held], atol=1e-9)
    assert integral.shape == turn.shape == (len(velocity) - 1,)
