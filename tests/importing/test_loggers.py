"""Layouts of loggers, written from a simulated drive: the proposed command, or the remedy, restores the drive."""

import datetime
import functools
import json
import operator
import re
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from importing.logs import imported
from sigmaswarm.drives.drive import Drive
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import TableChoice
from sigmaswarm.simulation.scenarios import simulate
from support import diagonal, quickly, several, some

G = 9.80665
ORIGIN = (46.0, 7.0, 500.0)
DRIVE = simulate("urban", duration=40.0, imu_rate=50.0, run=2, gps="white-1m")
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
IMU: dict[str, Any] = {name: np.asarray(getattr(DRIVE.imu, name)) for name in AXES}
TIME, FIXED = DRIVE.imu.time, DRIVE.gps.time
LAT, LON, _ = enu_to_geodetic(np.column_stack([DRIVE.gps.x, DRIVE.gps.y, 0 * FIXED]), ORIGIN).T
NEW = np.searchsorted(TIME, FIXED - 1e-6)  # rows of the IMU with a new fix


def sparse(values: Any) -> pl.Series:
    column = pl.Series([None] * len(TIME), dtype=pl.Float64)
    return column.scatter(NEW.tolist(), np.asarray(values, np.float64))


def write(path: Path, columns: Mapping[str, Any]) -> None:
    path.parent.mkdir(exist_ok=True)
    pl.DataFrame(dict(columns)).write_csv(path)


def as_proposed(path: Path, **options: Any) -> Drive:
    """Import a log as `--show` proposes."""
    seen = inspect_request(Request(path, **options))
    assert seen.works, seen.evidence or seen.notes
    maps = [f"{column}={text}" for column, text in seen.settings.get("maps", {}).items()]
    choice = TableChoice(dict(seen.settings.get("tables", {})))
    return import_drive(replace(Request(path, **options), maps=maps, choice=choice), "log").drive


def require_same(drive: Drive, axes: tuple[str, ...] = AXES) -> None:
    """The axes, and the times and places of the fixes, are those of the simulated drive."""
    begin = drive.imu.time[0]
    assert len(drive.imu) == len(TIME)
    for name in axes:
        np.testing.assert_allclose(getattr(drive.imu, name), IMU[name], atol=2e-3, err_msg=name)
    assert abs(len(drive.gps) - len(FIXED)) < 3
    assert drive.origin is not None
    lat, lon, _ = enu_to_geodetic(
        np.column_stack([drive.gps.x, drive.gps.y, 0 * drive.gps.x]), drive.origin
    ).T
    place = np.searchsorted(FIXED, drive.gps.time - begin + TIME[0] - 0.05)
    np.testing.assert_allclose(lat, LAT[place], rtol=0, atol=2e-6)
    np.testing.assert_allclose(lon, LON[place], rtol=0, atol=2e-6)


GRAVITY = np.array([0.0, 0.0, -1.0])
# Names of the acceleration without gravity, of gravity and of the rates, and the factor to m/s2
APART = {
    "Apple": ("userAcceleration{}", "gravity{}", "rotationRate{}", "XYZ", 1 / G),
    "with units": ("user_acc_{}(G)", "gravity_{}(G)", "rotation_rate_{}(radians/s)", "xyz", 1 / G),
    "of known names": ("acc_{}", "grav_{}", "gyro_{}", "xyz", -1.0),
    "of known names, in g": ("acc_{}", "gra_{}", "gyro_{}", "xyz", -1 / G),
    "in m/s2": ("Linear_Acc_{}2 [m/s^2]", "Gravity {} [m/s^2]", "Gyro2 {} [rad/s]", "XYZ", 1.0),
}


@pytest.mark.parametrize("form", some(APART))
def test_acceleration_without_gravity_and_gravity_are_added(tmp_path: Path, form: str):
    """Attitude angles are no rates, although a yaw has the name of one."""
    free, down, rate, letters, factor = APART[form]
    columns: dict[str, Any] = {"time": TIME, "roll": 0.01 * np.sin(TIME), "yaw": 0.3 * np.sin(TIME / 9)}
    for k, (letter, axis) in enumerate(zip(letters, "xyz", strict=True)):
        columns[free.format(letter)] = -IMU[f"a{axis}"] * factor - GRAVITY[k] * (G * factor)
        columns[down.format(letter)] = np.full(len(TIME), GRAVITY[k] * G * factor)
        columns[rate.format(letter)] = IMU[f"g{axis}"]
    write(tmp_path / "log" / "motion.csv", columns)
    write(tmp_path / "log" / "location.csv", {"time": FIXED, "latitude": LAT, "longitude": LON})
    require_same(as_proposed(tmp_path / "log"))


WORDS = {"a": "accel", "g": "gyro"}
# Times of IMU and fixes in rows of their own, and a clock of all rows
CLOCKS = {
    "host": ("host_time", "imu_time", "gps_time"),
    "receive": ("__time", "/imu/data/header/stamp", "/gps/fix/header/stamp"),
    "none": ("", "imu_t", "gps_t"),
    "date": ("time_ms", "imu_stamp", "utc_time"),
}


@pytest.mark.parametrize("clock", some(CLOCKS))
def test_the_time_of_fixes_is_filled_in_the_rows_of_fixes(tmp_path: Path, clock: str):
    both, of_imu, of_fixes = CLOCKS[clock]
    scale = 1e3 if both == "time_ms" else 1.0
    imu = {of_imu: 100 + TIME, **{f"/imu/data/{WORDS[n[0]]}_{n[1]}": v for n, v in IMU.items()}}
    frames = [pl.DataFrame({"row": TIME, both or "unused": (100 + TIME) * scale, **imu})]
    fixes = {of_fixes: 100 + FIXED, "/gps/fix/latitude": LAT, "/gps/fix/longitude": LON}
    frames.append(pl.DataFrame({"row": FIXED + 1e-3, both or "unused": (100 + FIXED) * scale, **fixes}))
    rows = pl.concat(frames, how="diagonal").sort("row").drop("row", *["unused"] * (not both))
    rows.write_csv(tmp_path / "log.csv")
    require_same(as_proposed(tmp_path / "log.csv"))


def test_a_stamp_of_only_the_fixes_does_not_replace_the_clock_of_all_rows(tmp_path: Path):
    whole, rest = np.divmod(FIXED, 1)
    stamp = {"sec": sparse(whole + 1.7e9), "nanosec": sparse(np.round(rest * 1e9))}
    stamps = {f"/fix/header/stamp/{name}": values.cast(pl.Int64) for name, values in stamp.items()}
    fixes = {"/fix/latitude": sparse(LAT), "/fix/longitude": sparse(LON)}
    write(tmp_path / "log.csv", {"__time": TIME, **IMU, **stamps, **fixes})
    require_same(as_proposed(tmp_path / "log.csv"))


NAMES = {
    "flight test": ("Time [s]", "N{} [g]", ("P [deg/s]", "Q [deg/s]", "R [deg/s]"), "Lat [deg]", "Lon [deg]"),
    "drone": ("offsetTime", "IMU(0):accel:{}", "IMU(0):gyro:{}", "GPS(0):Lat", "GPS(0):Long"),
    "survey": ("Zeit [s]", "Acc_Body_{} [g]", "Rate_Body_{} [°/s]", "INS_Lat_Abs [°]", "INS_Long_Abs [°]"),
    "brackets": ("Time(s)", "Acc({})", "Gyro({})", "Latitude", "Longitude"),
    "race": ("time", "GForce{}", "Gyro{}", "Latitude", "Longitude"),
    "bus": ("timestamps", "ESP.{}beschl", "ESP.{}rate", "Pos.Latitude", "Pos.Longitude"),
    "elements": ("time", "I.acc[{}]", "I.pqr[{}]", "lat", "lon"),
    "sketch": ("timestamp_unix", "mpu_a{}", "mpu_g{}", "gps_lat", "gps_lon"),
    "unknown prefix": ("time", "bosch_a{}", "bosch_w{}", "gps_lat", "gps_lon"),
    "letters of turns": ("time", "imu_a{}", ("gyro_r", "gyro_p", "gyro_y"), "lat", "lon"),
    "letters of rates": ("t", "a{}", ("p", "q", "r"), "lat", "lon"),
    "only units": ("Zeit [s]", "S{} [mg]", "R{} [°/s]", "P1 [°]", "P2 [°]"),
    "only units, exchanged": ("Zeit [s]", "S{} [mg]", "R{} [°/s]", "P2 [°]", "P1 [°]"),
}
PARTS = {"bus": (("Laengs", "Quer", "Vertikal"), ("Wank", "Nick", "Gier")), "elements": ("012", "012")}


QUICK = ("flight test", "bus", "elements", "only units, exchanged")


@pytest.mark.parametrize(("form",), quickly(((name,) for name in NAMES), lambda form: form in QUICK))
def test_more_names_of_loggers(tmp_path: Path, form: str):
    time, force, rate, lat, lon = NAMES[form]
    scale = (1 / G, np.degrees(1)) if any(word in force for word in ("g]", "IMU", "GForce")) else (1.0, 1.0)
    scale = (1e3 / G, scale[1]) if "[mg]" in force else scale
    letters = PARTS.get(form, ("xyz", "xyz") if "_" in force else ("XYZ", "XYZ"))
    columns: dict[str, Any] = {time: TIME}
    for k, axis in enumerate("xyz"):
        columns[force.format(letters[0][k])] = IMU[f"a{axis}"] * scale[0]
        columns[rate[k] if isinstance(rate, tuple) else rate.format(letters[1][k])] = (
            IMU[f"g{axis}"] * scale[1]
        )
    places = {lat: sparse(LAT), lon: sparse(LON)}
    write(tmp_path / "log.csv", columns | dict(sorted(places.items()) if "P1" in lon else places.items()))
    require_same(as_proposed(tmp_path / "log.csv"))


def numbers(k: int) -> list[str]:
    return [f"{values[k]:.6f}" for values in IMU.values()]


Line = Callable[[float, list[str]], str]
# The lines of the IMU and of the fixes
LINES: dict[str, tuple[Line, Line]] = {
    "words": (
        lambda t, v: ",".join(["IMU", f"{t:.3f}", *v]),
        lambda t, v: ",".join(["GPS", f"{t:.3f}", *v, "500.0"]),
    ),
    "marks": (
        lambda t, v: ",".join(["$VNIMU", f"{t:.3f}", *v, "28.1"]),
        lambda t, v: ",".join(["$VNGPS", f"{t:.3f}", *v, "500.0", "12"]),
    ),
    "checksums": (
        lambda t, v: ",".join(["$IMU", f"{t:.3f}", *v]) + "*5A",
        lambda t, v: ",".join(["$GPS", f"{t:.3f}", *v, "500.0"]) + "*1f",
    ),
    "numbers below a header": (
        lambda t, v: ";".join(["1", f"{t:.3f}", *v]),
        lambda t, v: ";".join(["geo", f"{t:.3f}", *v, "500.0", "3.5"]),
    ),
    "marks below other kinds": (
        lambda t, v: ",".join(["$IMU", f"{t:.3f}", *v]),
        lambda t, v: ",".join(["$GNSS", f"{t:.3f}", *v, "500.0", "3.5"]),
    ),
    "colons": (
        lambda t, v: "\t".join([f"IMUN:{t * 1e9:.0f}", *v]),
        lambda t, v: "\t".join([f"GNSS:{t * 1e9:.0f}", *v]),
    ),
    "numbers after a time": (
        lambda t, v: ";".join([f"{t:.3f}", "1", *v]),
        lambda t, v: ";".join([f"{t:.3f}", "16", *v, "500.0", "3.5"]),
    ),
}


def run(command: str, folder: Path) -> None:
    subprocess.run(["bash", "-c", command], cwd=folder, check=True)


@pytest.mark.parametrize("form", some(LINES))
def test_rows_of_several_kinds_are_separated_by_the_named_command(tmp_path: Path, form: str):
    imu, fix = LINES[form]
    lines = [(t, imu(t + 5, numbers(k))) for k, t in enumerate(TIME.tolist())]
    fixes = zip(FIXED.tolist(), LAT, LON, strict=True)
    lines += [(t + 1e-3, fix(t + 5, [f"{lat:.9f}", f"{lon:.9f}"])) for t, lat, lon in fixes]
    log = tmp_path / "my log.txt"
    heads = {"numbers below a header": "info;time;text\n"}
    heads["words"] = "% made by a logger\n% ACC;t;x\n"
    heads["marks below other kinds"] = "$COL,IMU,t,ax,ay,az\n$COL,GNSS,t,lat,lon,alt,acc\n$DATA\n"
    log.write_text(heads.get(form, "") + "\n".join(line for _, line in sorted(lines)) + "\n")
    with pytest.raises(InputError, match="rows of several kinds") as caught:
        imported(log)
    found = re.search(r"run: (.*), and import the folder kinds$", str(caught.value))
    assert found is not None
    run(found[1], tmp_path)
    require_same(as_proposed(tmp_path / "kinds"))


@pytest.mark.parametrize(("flags", "place"), diagonal(["01", "VA", "13", "123", "ny"], [0, 1]))
def test_shorter_rows_without_a_fix_are_not_another_kind(tmp_path: Path, place: int, flags: str):
    """A flag states whether the cells of the fix follow."""
    fixes = dict(zip(NEW.tolist(), zip(LAT, LON, strict=True), strict=True))
    rows: list[str] = []
    for k, t in enumerate(TIME.tolist()):
        begin = [f"{t:.3f}"]
        begin.insert(place, flags[1 + int(t) % (len(flags) - 1)] if k in fixes else flags[0])
        rows.append(",".join([*begin, *numbers(k), *(f"{v:.9f}" for v in fixes.get(k, ()))]))
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    require_same(as_proposed(tmp_path / "log.csv"))


@pytest.mark.parametrize(("kinds", "place"), diagonal(["12", "FG", "nm"], [0, 1]))
def test_numbered_sensors_are_not_rows_without_a_fix(tmp_path: Path, place: int, kinds: str):
    """The rates are in the range of the accelerations, and their rows are shorter."""
    rows: list[str] = []
    for k, t in enumerate(TIME.tolist()):
        free = [f"{IMU['ax'][k]:.5f}", f"{IMU['ay'][k]:.5f}", f"{IMU['az'][k] - G:.5f}", "0.1"]
        for kind, values in zip(kinds, ([f"{IMU[n][k]:.5f}" for n in AXES[3:]], free), strict=True):
            begin = [f"{t:.3f}"]
            begin.insert(place, kind)
            rows.append(",".join([*begin, *values]))
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(InputError, match=r"rows of several kinds .*awk"):
        imported(tmp_path / "log.csv")


def test_rows_with_only_a_time_and_a_flag_are_not_another_kind(tmp_path: Path):
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    fixes = zip(FIXED.tolist(), LAT, LON, strict=True)
    rows = [f"{t:.3f},1,{lat:.9f},{lon:.9f}\n{t + 0.1:.3f},0\n" for t, lat, lon in fixes]
    (tmp_path / "log" / "gps.csv").write_text("".join(rows))
    require_same(as_proposed(tmp_path / "log"))


def sentence(t: float, lat: float, lon: float) -> str:
    places = f"{int(lat):02d}{lat % 1 * 60:08.5f},N,{int(lon):03d}{lon % 1 * 60:08.5f},E"
    body = f"GNRMC,1000{t:05.2f},A,{places},,,140525,,,A"
    return f"${body}*{functools.reduce(operator.xor, body.encode()):02X}"


@pytest.mark.parametrize("row", some(["IMU,{:.3f},{}", "{:.3f};{}", "{:.3f} {}"]))
def test_rows_between_sentences_are_separated_by_the_named_command(tmp_path: Path, row: str):
    lines = [(t, row.format(t, row[-3].join(numbers(k)))) for k, t in enumerate(TIME.tolist())]
    fixes = zip(FIXED.tolist(), LAT, LON, strict=True)
    lines += [(t + 1e-3, sentence(t, lat, lon)) for t, lat, lon in fixes if t < 59.9]
    (tmp_path / "my log.txt").write_text("\n".join(line for _, line in sorted(lines)) + "\n")
    with pytest.raises(InputError, match="between the NMEA sentences") as caught:
        imported(tmp_path / "my log.txt")
    found = re.search(r"with: (grep .*), and import imu.csv with --gps '(.*?)'", str(caught.value))
    assert found is not None
    run(found[1], tmp_path)
    begin = 1_747_216_800 + TIME[0]  # the counter of the rows is not UTC
    maps = inspect_request(Request(tmp_path / "imu.csv", gps=tmp_path / found[2])).settings["maps"]
    options = [f"{column}={text}" for column, text in maps.items()]
    recipe = Recipe(gps_offset_s=float(-begin))
    require_same(imported(tmp_path / "imu.csv", gps=tmp_path / found[2], maps=options, recipe=recipe).drive)


DEGREES = {
    "seconds": ("lat_deg lat_min lat_sec", "lon_deg lon_min lon_sec", 1),
    "minutes": ("LatDeg LatMin", "LonDeg LonMin", 1),
    "indicators": (
        "GPS_Latitude_Degree GPS_Latitude_Minutes",
        "GPS_Longitude_Degree GPS_Longitude_Minutes",
        1,
    ),
    "south": (
        "Latitude (deg)|Latitude (min)|Latitude (sec)",
        "Longitude (deg)|Longitude (min)|Longitude (sec)",
        -1,
    ),
}


@pytest.mark.parametrize("form", DEGREES)
def test_degrees_minutes_and_seconds_in_columns_are_added(tmp_path: Path, form: str):
    *heads, sign = DEGREES[form]
    columns: dict[str, Any] = {"t": FIXED}
    for head, value in zip(heads, (LAT, LON), strict=True):
        names = head.split("|" if "|" in head else " ")
        parts = [np.floor(value) * sign, np.floor(value % 1 * 60), value * 3600 % 60]
        parts = parts if len(names) == 3 else [parts[0], value % 1 * 60]
        columns |= dict(zip(names, parts, strict=True))
    west = -1 if form == "indicators" else sign
    columns |= {"GPS_IndicatorNS": "N", "GPS_IndicatorEW": "W"} if form == "indicators" else {}
    write(tmp_path / "log" / "gps.csv", columns)
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    drive = imported(tmp_path / "log").drive
    assert drive.origin is not None
    assert drive.origin[:2] == pytest.approx((sign * LAT[0], west * LON[0]), abs=1e-9)
    apart = np.hypot(drive.gps.x - drive.gps.x[0], drive.gps.y - drive.gps.y[0])
    right = np.hypot(DRIVE.gps.x - DRIVE.gps.x[0], DRIVE.gps.y - DRIVE.gps.y[0])
    np.testing.assert_allclose(apart, right, atol=0.05)


@pytest.mark.parametrize("first", [False, True])
def test_whole_degrees_have_priority_over_degrees_and_minutes_without_sign(tmp_path: Path, first: bool):
    parts: dict[str, Any] = {}
    for name, value in (("lat", LAT), ("lon", LON)):
        parts |= {f"{name}_deg": np.floor(value), f"{name}_min": value % 1 * 60}
    whole = {"latitude": LAT, "longitude": -LON}
    write(tmp_path / "log" / "gps.csv", {"t": FIXED, **(whole | parts if first else parts | whole)})
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    drive = imported(tmp_path / "log").drive
    assert drive.origin is not None
    assert drive.origin[:2] == pytest.approx((LAT[0], -LON[0]), abs=1e-9)


@pytest.mark.parametrize("name", ["log.txt", "log.log", "imu.csv"])
@pytest.mark.parametrize(
    ("text", "way"),
    [
        (
            "header: \n  seq: 1\n  stamp: \n    secs: 5\nangular_velocity: \n  x: 0.1\n---\n",
            "ros2 topic echo --csv",
        ),
        ("2025-05-14 09:58:31.02: IMU {TimeUS : 9000000, I : 0, GyrX : 0.1, AccX : 0.2}\n", r"\.bin"),
        ("(1747216711.010000) can0 123#0011223344556677\n", "DBC"),
    ],
    ids=["topics", "dataflash", "frames"],
)
def test_printed_messages_are_named(tmp_path: Path, name: str, text: str, way: str):
    (tmp_path / name).write_text(text * 50)
    with pytest.raises(InputError, match=rf"can't be imported, since it is .*{way}"):
        imported(tmp_path / name)


CLOCKS_OF_TABLES = {
    "time of week": ("tow (s)", 200_000.0, "gps_time", "2025-05-14T08:00:00Z"),
    "host": ("host_time", 1.7e9, "utc", "2025-05-14T08:00:00Z"),
    "boot": ("uptime_ms", 5e3, "time", 1.7e9),
}


@pytest.mark.parametrize("clock", CLOCKS_OF_TABLES)
def test_tables_whose_usual_times_do_not_overlap_are_read_on_a_clock_of_both(tmp_path: Path, clock: str):
    column, begin, other, first = CLOCKS_OF_TABLES[clock]
    scale = 1e3 if column.endswith("ms") else 1.0
    own = 300.0 + TIME if clock == "boot" else None
    write(
        tmp_path / "imu.csv",
        {
            "t" if own is not None else "row": TIME if own is None else own,
            column: begin + TIME * scale,
            **IMU,
        },
    )
    start = pl.Series([first]).str.to_datetime() if isinstance(first, str) else None
    stamps = (
        FIXED + first if start is None else [start[0] + datetime.timedelta(seconds=t) for t in FIXED.tolist()]
    )
    write(tmp_path / "gps.csv", {other: stamps, column: begin + FIXED * scale, "lat": LAT, "lon": LON})
    got = imported(tmp_path)
    require_same(got.drive)
    assert any("do not overlap" in note for note in got.notes)


@pytest.mark.parametrize("factor", some([1e-3 * np.pi / 180, np.pi / 180 / 131, 1e-3]))
def test_biases_of_a_cheap_gyro_do_not_change_its_unit(tmp_path: Path, factor: float):
    """Of intervals with various durations, the angles of an axis with a bias of 15 deg/s resemble the durations."""
    drive = simulate("urban", run=3, duration=150.0, imu_rate=50.0, gps="white-1m", gps_rate=1.0)
    imu, gps = drive.imu, drive.gps
    assert imu.az is not None and imu.gx is not None and imu.gy is not None
    biased = {"gx": imu.gx + 0.25, "gy": imu.gy - 0.3, "gz": imu.gz + 0.28}
    lat, lon, _ = enu_to_geodetic(np.column_stack([gps.x, gps.y, 0 * gps.x]), ORIGIN).T
    rates = {n: np.round(v / factor) for n, v in biased.items()}
    write(tmp_path / "log" / "imu.csv", {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "az": imu.az, **rates})
    write(tmp_path / "log" / "gps.csv", {"t": gps.time, "lat": lat, "lon": lon})
    with pytest.raises(InputError, match="the turns of the path show that the unit") as caught:
        imported(tmp_path / "log")
    maps = [re.findall(r'"([^"]+)"', part) for part in str(caught.value).split("--map ")[1:]]
    found = [imported(tmp_path / "log", maps=options).drive.imu.gz for options in maps]
    assert min(np.abs(gz - biased["gz"]).max() for gz in found) < factor


@pytest.mark.parametrize("scale", [3.6, 1.94384, 1000.0])
def test_a_speed_without_unit_is_compared_with_noisy_fixes_at_a_high_rate(tmp_path: Path, scale: float):
    time = np.arange(0, 60, 0.1)
    rng = np.random.default_rng(1)
    east, north = (np.interp(time, DRIVE.truth.time, v) for v in (DRIVE.truth.x, DRIVE.truth.y))
    speed = np.interp(time, DRIVE.truth.time, np.hypot(DRIVE.truth.vx, DRIVE.truth.vy))
    places = np.column_stack([east, north, 0 * time]) + rng.normal(0, 1.0, (len(time), 3))
    lat, lon, _ = enu_to_geodetic(places, ORIGIN).T
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    write(tmp_path / "log" / "gps.csv", {"t": time, "lat": lat, "lon": lon, "speed": speed * scale})
    got = imported(tmp_path / "log")
    assert got.drive.gps.speed is None
    assert any("speed is" in note and "times that computed from the positions" in note for note in got.notes)


@pytest.mark.parametrize("invalid", [slice(0, 80), slice(None, None, 20), slice(None)])
def test_a_speed_of_minus_1_is_invalid(tmp_path: Path, invalid: slice):
    speed = np.interp(FIXED, DRIVE.truth.time, np.hypot(DRIVE.truth.vx, DRIVE.truth.vy))
    course = 90 - np.degrees(np.interp(FIXED, DRIVE.truth.time, np.unwrap(DRIVE.truth.theta)))
    speed[invalid], course[invalid] = -1, -1
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    fixes = {"t": FIXED, "latitude": LAT, "longitude": LON, "speed": speed, "course": course % 360}
    write(tmp_path / "log" / "location.csv", fixes)
    got = imported(tmp_path / "log")
    missing = int(np.count_nonzero(speed == -1))
    assert f"{missing} values of speed are left out, since -1 is a placeholder" in " ".join(got.notes)
    few = missing <= 0.1 * len(speed)
    assert (got.drive.gps.speed is not None) == few
    assert len(got.drive.gps) == len(FIXED) - few * missing


@pytest.mark.parametrize("clock", ["ms", "week"])
def test_rates_behind_a_magnetic_field_and_a_time_in_three_columns_are_found_by_values(
    tmp_path: Path, clock: str
):
    heading = np.interp(TIME, DRIVE.truth.time, DRIVE.truth.theta)
    field = zip(20 * np.cos(heading) + 2, -20 * np.sin(heading), np.full(len(TIME), -43.0), strict=True)
    fixes = np.searchsorted(FIXED, TIME + 1e-9, side="right") - 1
    rows: list[str] = []
    for k, (t, b) in enumerate(zip((TIME - TIME[0]).tolist(), field, strict=True)):
        time = (
            f"{t * 1000:.0f}"
            if clock == "ms"
            else f"2394 {200000 + int(t + 1e-6)} {t % 1 * (t % 1 < 0.9999):.4f}"
        )
        cells = [f"{IMU[n][k]:.5f}" for n in AXES]
        place = f"{LAT[fixes[k]]:.9f} {LON[fixes[k]]:.9f}" if fixes[k] >= 0 else "0 0"
        rows.append(" ".join([time, *cells[:3], *(f"{v:.2f}" for v in b), *cells[3:], place]))
    (tmp_path / "log.txt").write_text("\n".join(rows) + "\n")
    require_same(as_proposed(tmp_path / "log.txt"))


ROWS = np.arange(len(TIME))
SECONDS = np.floor(TIME + 1e-6)
FRACTIONS = np.maximum(np.round(TIME - SECONDS, 6), 0.0)
# The columns before those of the IMU, and the time that is proposed
BEFORE: dict[str, tuple[list[Any], str]] = {
    "counter and throttle": ([ROWS, 0.9 * np.abs(np.sin(ROWS * 1e-3)), TIME], "c3"),
    "laps and their fractions": ([TIME, SECONDS // 20, np.round(TIME % 20 / 20.01, 6)], "c1"),
    "fractions behind a counter": ([ROWS, SECONDS + 200_000, FRACTIONS], "c2 + c3"),
    "fractions behind a week": ([ROWS, 0 * ROWS + 2394, SECONDS, FRACTIONS], "gps_time(c2, c3 + c4)"),
}


@pytest.mark.parametrize("form", some(BEFORE))
def test_only_fractions_that_begin_again_with_each_second_belong_to_the_time(tmp_path: Path, form: str):
    columns, time = BEFORE[form]
    places = [np.interp(TIME, FIXED, values) for values in (LAT, LON)]
    table = {f"c{k}": values for k, values in enumerate([*columns, *IMU.values(), *places], 1)}
    pl.DataFrame(table).write_csv(tmp_path / "log.csv", include_header=False)
    maps = inspect_request(Request(tmp_path / "log.csv")).settings["maps"]
    assert {maps["imu.t"], maps["gps.t"]} == {time}


@pytest.mark.parametrize("week", [False, True])
def test_a_dilution_of_precision_is_not_a_fraction_of_a_second(tmp_path: Path, week: bool):
    (tmp_path / "log").mkdir()
    slow = np.arange(0, len(FIXED), round(1 / (FIXED[1] - FIXED[0])))
    dilution = np.round(0.8 + 0.15 * np.sin(slow / 35), 2)
    for name, time, columns in (
        ("imu", TIME, [*IMU.values()]),
        ("gps", np.round(FIXED[slow]).astype(int), [dilution, LAT[slow], LON[slow]]),
    ):
        values = [*[np.full(len(time), 2394)] * week, 345_600 + time, *columns]
        table = {f"c{k}": v for k, v in enumerate(values)}
        pl.DataFrame(table).write_csv(tmp_path / "log" / f"{name}.csv", include_header=False)
    maps = inspect_request(Request(tmp_path / "log")).settings["maps"]
    assert maps["gps.t"] == ("gps_time(c1, c2)" if week else "c1")


@pytest.mark.parametrize(
    ("more", "fixes"), diagonal(["", "1,", "acc,", "1;"], ["without names", "with names", "unclear"])
)
def test_headers_of_separate_tables_without_names_are_written_by_the_named_command(
    tmp_path: Path, more: str, fixes: str
):
    """The command works in any folder. Near the equator or Greenwich the values show no position."""
    away = 6.5 if fixes == "unclear" else 0.0
    tables = {
        "a's": (TIME, AXES[:3], IMU),
        "b": (TIME, AXES[3:], IMU),
        "c": (FIXED, ("lat", "lon"), {"lat": LAT, "lon": LON - away}),
    }
    folder, mark = tmp_path / "my log", more[-1:] or ","
    folder.mkdir()
    for name, (time, columns, values) in tables.items():
        rows = [
            f"{more}{t:.3f}{mark}" + mark.join(f"{values[n][k]:.9f}" for n in columns)
            for k, t in enumerate(time.tolist())
        ]
        if name == "c" and fixes == "with names":
            rows.insert(0, mark.join([*["kind"] * bool(more), "t", *columns]))
        (folder / f"{name}.txt").write_text("\n".join(rows) + "\n")
    with pytest.raises(InputError, match="no IMU samples") as caught:
        imported(folder)
    found = re.search(
        r"suggest: (\(.*\))(; copy c.txt to .*)?, and import the folder '(.*?)'", str(caught.value)
    )
    assert found is not None and (fixes == "unclear") == (found[2] is not None)
    run(found[1], tmp_path)
    if fixes == "unclear":
        header = ",".join([*["kind"] * bool(more), "t", "lat", "lon"])
        (folder / "named" / "c.txt").write_text(f"{header}\n{(folder / 'c.txt').read_text()}")
    drive = imported(Path(found[3])).drive
    require_same(
        replace(drive, origin=(drive.origin[0], drive.origin[1] + away, 0.0)) if drive.origin else drive
    )


@pytest.mark.parametrize(
    "names", some([("Time IMU (s)", "Time GPS (s)"), ("Time", "Time"), ("t_imu", "gps_time")])
)
def test_tables_that_were_pasted_side_by_side_have_a_time_each(tmp_path: Path, names: tuple[str, str]):
    rows = [",".join([names[0], *IMU, "", names[1], "lat", "lon"])]
    for k, t in enumerate(TIME.tolist()):
        fix = f"{FIXED[k]:.3f},{LAT[k]:.9f},{LON[k]:.9f}" if k < len(FIXED) else ",,"
        rows.append(f"{t:.3f},{','.join(numbers(k))},,{fix}")
    (tmp_path / "both.csv").write_text("\n".join(rows) + "\n")
    require_same(imported(tmp_path / "both.csv").drive)


@pytest.mark.parametrize(
    ("force", "rate", "up"), diagonal([(16384, 131), (8192, 65.5), (4096, 32.8)], [1, -1])
)
def test_counts_that_were_written_without_a_sign_are_refused_and_the_remedy_helps(
    tmp_path: Path, force: float, rate: float, up: int
):
    """Gravity on a negative axis is far from -1."""
    signs = {n: up if n in ("ay", "az", "gy", "gz") else 1 for n in AXES}
    per = {n: force / 9.80665 if n[0] == "a" else np.degrees(rate) for n in AXES}
    words = {n: np.round(signs[n] * IMU[n] * per[n]).astype(int) % 65536 for n in AXES}
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **words})
    write(tmp_path / "log" / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    with pytest.raises(InputError, match="raw counts") as caught:
        imported(tmp_path / "log")
    maps = dict(re.findall(r'"imu\.([ag][xyz])=([^"]+)"', str(caught.value)))
    assert all(f"where({n} > 32767, {n} - 65536, {n})" in maps[n] for n in AXES)
    assert f"*9.80665/{force}" in maps["az"]
    options, mount = [f"imu.{n}={text}" for n, text in maps.items()], "x=x,y=-y,z=-z" if up < 0 else ""
    got = imported(tmp_path / "log", maps=options, recipe=Recipe(mount=mount)).drive
    for name in AXES:
        np.testing.assert_allclose(getattr(got.imu, name), IMU[name], atol=0.6 / per[name], err_msg=name)


@pytest.mark.parametrize("scale", [1.0, 1 / 9.80665])
def test_zeros_of_a_failed_bus_are_no_samples(tmp_path: Path, scale: float):
    failed = np.random.default_rng(0).random(len(TIME)) < 0.03
    write(
        tmp_path / "log" / "imu.csv",
        {
            "t": TIME,
            **{n: np.where(failed, 0.0, v * (scale if n[0] == "a" else 1.0)) for n, v in IMU.items()},
        },
    )
    write(tmp_path / "log" / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    got = imported(tmp_path / "log")
    np.testing.assert_allclose(got.drive.imu.time, TIME[~failed], atol=1e-3)
    assert f"{failed.sum()} values of ax are left out, since 0 is a placeholder" in " ".join(got.notes)


def test_zeros_of_a_log_without_gravity_are_samples(tmp_path: Path):
    """Linear accelerations are exactly 0 at rest, and the magnitude of noise in three axes is seldom near 0."""
    rng, rest = np.random.default_rng(0), np.random.default_rng(1).random(len(TIME)) < 0.1
    linear = {n: np.where(rest, 0.0, rng.normal(0.0, 0.5, len(TIME))) for n in ("ax", "ay", "az")}
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU, **linear})
    write(tmp_path / "log" / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    got = imported(tmp_path / "log")
    assert len(got.drive.imu) == len(TIME) and "0 is a placeholder" not in " ".join(got.notes)


@pytest.mark.parametrize(("ahead", "both"), [(3600.0, True), (8e8, False), (5e4, True)])
def test_a_clock_that_is_set_while_it_runs_makes_two_recordings(tmp_path: Path, ahead: float, both: bool):
    """Summer time begins, or the first fix sets the clock."""
    for name, time, columns in (("imu", TIME, IMU), ("gps", FIXED, {"lat": LAT, "lon": LON})):
        used = (time >= 0) if name == "imu" or both else (time >= 20)
        write(
            tmp_path / "log" / f"{name}.csv",
            {"t": (1e9 + time + ahead * (time >= 20))[used], **{n: v[used] for n, v in columns.items()}},
        )
    with pytest.raises(InputError, match=rf"the clock jumps by {ahead:.0f} s at row .* --part 1 to --part 2"):
        imported(tmp_path / "log")
    got = imported(tmp_path / "log", part=2).drive
    assert len(got.imu) == np.count_nonzero(TIME >= 20) and len(got.gps) == np.count_nonzero(FIXED >= 20)


@pytest.mark.parametrize("part", [1, 2, 3])
def test_fixes_with_fewer_pauses_than_the_imu_are_those_of_its_recording(tmp_path: Path, part: int):
    """The receiver had no fix during the second of three recordings."""
    for name, time, columns in (("imu", TIME, IMU), ("gps", FIXED, {"lat": LAT, "lon": LON})):
        used = (time < 9) | (time >= 16) if name == "gps" else time >= 0
        clock = time + 7200.0 * (time >= 10) + 7200.0 * (time >= 15)
        write(
            tmp_path / "log" / f"{name}.csv", {"t": clock[used], **{n: v[used] for n, v in columns.items()}}
        )
    if part == 2:
        with pytest.raises(InputError, match="0 fixes within the IMU's time span, t = 7210 to"):
            imported(tmp_path / "log", part=part)
        return
    got = imported(tmp_path / "log", part=part).drive.gps
    clock = FIXED[FIXED < 9] if part == 1 else FIXED[FIXED >= 16] + 14400.0
    np.testing.assert_allclose(got.time, clock, atol=1e-9)


@pytest.mark.parametrize(("decimals", "said"), [(2, "1112 m"), (3, "111 m"), (4, "11 m")])
def test_degrees_with_few_decimals_are_reported(tmp_path: Path, decimals: int, said: str):
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    places = {"lat": np.round(LAT + 0.0349, decimals), "lon": np.round(LON, decimals)}
    write(tmp_path / "log" / "gps.csv", {"t": FIXED, **places})
    try:
        heard = " ".join(imported(tmp_path / "log").notes)
    except InputError as error:
        heard = str(error)
    assert f"at most {decimals} decimals, so their resolution is {said}" in heard


def test_whole_degrees_next_to_unknown_minutes_are_not_called_coarse(tmp_path: Path):
    write(tmp_path / "log" / "imu.csv", {"t": TIME, **IMU})
    places = {"lat": np.floor(LAT), "lat2": LAT % 1 * 60, "lon": np.floor(LON), "lon2": LON % 1 * 60}
    write(tmp_path / "log" / "gps.csv", {"t": FIXED, **places})
    try:
        heard = " ".join(imported(tmp_path / "log").notes)
    except InputError as error:
        heard = str(error)
    assert "decimals" not in heard


@pytest.mark.parametrize(("scale", "rate"), [(1e6, 50), (1e4, 50), (1e6, 10)])
def test_the_fine_time_of_xsens_and_movella(tmp_path: Path, scale: float, rate: int):
    every = slice(None, None, 50 // rate)
    imu = {
        "SampleTimeFine": np.round((TIME[every] + 7) * scale).astype(int),
        **{n: v[every] for n, v in IMU.items()},
    }
    write(tmp_path / "log" / "imu.csv", imu)
    write(tmp_path / "log" / "gps.csv", {"t": FIXED + 7, "lat": LAT, "lon": LON})
    assert np.median(np.diff(imported(tmp_path / "log").drive.imu.time)) == pytest.approx(1 / rate)


INCREMENTS = {
    "units": ("DeltaVel {} (m/s)", "DeltaTheta.{} (deg)", "XYZ", 1 / 50, np.degrees(1 / 50)),
    "words": ("delta_velocity_{}", "delta_angle_{}", "xyz", 1 / 50, 1 / 50),
    "short": ("dv{}", "dtheta{}", "xyz", 1 / 50, 1 / 50),
}


@pytest.mark.parametrize("form", some(INCREMENTS))
def test_increments_are_multiplied_by_the_rate(tmp_path: Path, form: str):
    velocity, angle, letters, *scale = INCREMENTS[form]
    columns: dict[str, Any] = {"time_s": TIME, "lat": sparse(LAT), "lon": sparse(LON)}
    for letter, axis in zip(letters, "xyz", strict=True):
        columns[velocity.format(letter)] = IMU[f"a{axis}"] * scale[0]
        columns[angle.format(letter)] = IMU[f"g{axis}"] * scale[1]
    write(tmp_path / "log.csv", columns)
    require_same(as_proposed(tmp_path / "log.csv"))


@pytest.mark.parametrize(
    ("name", "values"), several([("I", (0, 1)), ("sensor", ("front", "rear")), ("id", (7, 5, 6))])
)
def test_of_alternating_imus_the_first_is_read(tmp_path: Path, name: str, values: tuple[Any, ...]):
    first = pl.DataFrame({"t": TIME, **IMU})
    others = [first.with_columns(pl.exclude("t") + 0.1 * k) for k in range(len(values))]
    ordered = sorted(values)
    frames = [
        rows.with_columns(pl.lit(v).alias(name), row=pl.int_range(pl.len()))
        for v, rows in zip(ordered, others, strict=True)
    ]
    pl.concat(frames).sort("row", maintain_order=True).drop("row").write_csv(tmp_path / "imu.csv")
    write(tmp_path / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    require_same(as_proposed(tmp_path))
    (said,) = [n for n in imported(tmp_path).notes if "several IMUs alternate" in n]
    option = re.search(r'--map "(imu.keep=.*)"', said)
    assert option is not None
    assert abs(np.median(imported(tmp_path, maps=[option[1]]).drive.imu.az - IMU["az"]) - 0.1) < 1e-6


def test_an_id_of_laps_is_no_number_of_an_imu(tmp_path: Path):
    laps = np.arange(len(TIME)) // 700
    write(tmp_path / "log.csv", {"t": TIME, "id": laps, **IMU, "lat": sparse(LAT), "lon": sparse(LON)})
    require_same(as_proposed(tmp_path / "log.csv"))


Tables = dict[str, dict[str, Any]]
NAMED = {f"a{a}": f"linear_acceleration.{a}" for a in "xyz"} | {
    f"g{a}": f"angular_velocity.{a}" for a in "xyz"
}
FOLDERS: dict[str, Tables] = {
    "Spanish": {
        "acelerómetro": {"hora": TIME, **dict(zip("xyz", [IMU[f"a{a}"] for a in "xyz"], strict=True))},
        "giróscopo": {"hora": TIME, **dict(zip("xyz", [IMU[f"g{a}"] for a in "xyz"], strict=True))},
        "gps": {"hora": FIXED, "latitud": LAT, "longitud": LON},
    },
    "an IMU without time": {"imu": IMU, "gps": {"t": FIXED, "lat": LAT, "lon": LON}},
    "signs of a phone": {
        "imu": {"t": TIME}
        | {f"acc_{a}": -IMU[f"a{a}"] / G for a in "xyz"}
        | {f"rot_{a}": IMU[f"g{a}"] for a in "xyz"},
        "gps": {"t": FIXED, "lat": LAT, "lon": LON},
    },
}


@pytest.mark.parametrize(("form", "suffix"), diagonal(FOLDERS, ["csv", "jsonl"]))
def test_folders_of_loggers(tmp_path: Path, form: str, suffix: str):
    for name, columns in FOLDERS[form].items():
        frame = pl.DataFrame(columns)
        if suffix == "csv":
            frame.write_csv(tmp_path / f"{name}.csv")
        else:
            frame.write_ndjson(tmp_path / f"{name}.jsonl")
            (tmp_path / "about.json").write_text('{"device": "phone", "rate": 50}')
    require_same(as_proposed(tmp_path))


def test_an_unnamed_index_of_dates_is_the_time(tmp_path: Path):
    for name, time, columns in (("imu", TIME, IMU), ("gps", FIXED, {"lat": LAT, "lon": LON})):
        dates = pl.Series(np.round((time + 1.7e9) * 1e6).astype(np.int64)).cast(pl.Datetime("us"))
        pl.DataFrame({"__index_level_0__": dates, **columns}).write_parquet(tmp_path / f"{name}.parquet")
    require_same(as_proposed(tmp_path))


@pytest.mark.parametrize("name", ["odometry-gps", "odom"])
def test_a_pose_is_a_fix_only_in_a_table_named_after_a_receiver(tmp_path: Path, name: str):
    write(tmp_path / "imu.csv", {"t": TIME} | {NAMED[n]: v for n, v in IMU.items()})
    place = {
        f"pose.pose.position.{a}": v
        for a, v in zip("xyz", (DRIVE.gps.x, DRIVE.gps.y, 0 * FIXED), strict=True)
    }
    write(tmp_path / f"{name}.csv", {"t": FIXED, **place})
    if name == "odom":
        with pytest.raises(InputError, match="no position fixes"):
            imported(tmp_path)
    else:
        np.testing.assert_allclose(np.diff(as_proposed(tmp_path).gps.x), np.diff(DRIVE.gps.x), atol=1e-6)


def test_columns_of_a_receiver_precede_those_of_others(tmp_path: Path):
    """Speed and position of other sources, and the course and the heading, are in the same table."""
    assert DRIVE.truth is not None
    east, north = (np.interp(FIXED, DRIVE.truth.time, v) for v in (DRIVE.truth.vx, DRIVE.truth.vy))
    course, speed = np.degrees(np.arctan2(east, north)) % 360, np.hypot(east, north)
    other = {"lat": sparse(LAT + 0.01), "lon": sparse(LON), "speed_kmh": sparse(0 * FIXED + 7)}
    of_gps = {"gps_lat": sparse(LAT), "gps_lon": sparse(LON), "gps_speed_kmh": sparse(3.6 * speed)}
    turned = {"cog": sparse(course), "heading": sparse(course + 2)}
    write(tmp_path / "log.csv", {"t": TIME, **IMU, **other, **of_gps, **turned})
    drive = as_proposed(tmp_path / "log.csv")
    require_same(drive)
    assert drive.gps.speed is not None and drive.gps.course is not None and drive.gps.heading is not None
    np.testing.assert_allclose(drive.gps.speed, speed[: len(drive.gps)], atol=1e-6)
    np.testing.assert_allclose(
        np.degrees(np.angle(np.exp(1j * (drive.gps.course - drive.gps.heading)))), 2, atol=1e-6
    )


def test_an_accuracy_that_contradicts_the_fixes_is_not_proposed(tmp_path: Path):
    write(
        tmp_path / "log.csv",
        {"t": TIME, **IMU, "lat": sparse(LAT), "lon": sparse(LON), "hAcc": sparse(0 * FIXED + 900.0)},
    )
    assert "std_x" not in inspect_request(Request(tmp_path / "log.csv")).proposal


def test_accelerations_in_mg_that_were_mapped_by_hand_get_the_factor_of_mg(tmp_path: Path):
    forces = {f"S{a} [mg]": 985 * IMU[f"a{a}"] / G for a in "xyz"}
    write(
        tmp_path / "log.csv",
        {
            "t": TIME,
            **forces,
            **{f"g{a}": IMU[f"g{a}"] for a in "xyz"},
            "lat": sparse(LAT),
            "lon": sparse(LON),
        },
    )
    maps = ["imu.t=t", *(f"a{a}=`S{a} [mg]`" for a in "xyz"), *(f"g{a}=g{a}" for a in "xyz")]
    with pytest.raises(InputError, match=r'"imu.az=`Sz \[mg\]`\*0.00980665"'):
        imported(tmp_path / "log.csv", maps=maps)


@pytest.mark.parametrize("between", some(["\t", "; ", " | ", ", "]))
def test_numbers_with_names_are_separated_by_the_named_command(tmp_path: Path, between: str):
    cells = {"t": TIME, **IMU, "lat": np.interp(TIME, FIXED, LAT), "lon": np.interp(TIME, FIXED, LON)}
    rows = (
        between.join(f"{n}:{v:.9f}" for n, v in zip(cells, row, strict=True))
        for row in zip(*cells.values(), strict=True)
    )
    (tmp_path / "serial.log").write_text("\n".join(rows) + "\n")
    with pytest.raises(InputError, match="cells contain names") as caught:
        imported(tmp_path / "serial.log")
    run(str(caught.value).partition("for example with: ")[2], tmp_path)
    assert len(imported(tmp_path / "new.csv").drive.imu) == len(TIME)


@pytest.mark.parametrize("both", [0, 7])
def test_sensors_in_separate_rows_of_a_table_are_joined(tmp_path: Path, both: int):
    """The gyro has rows of its own, 3 ms after those of the accelerometer; ``both`` rows also have accelerations."""
    rates, forces = (pl.DataFrame({"t": TIME, **{n: IMU[n] for n in AXES if n[0] == kind}}) for kind in "ga")
    rates = rates.with_columns(
        t=pl.when(pl.int_range(pl.len()) < both).then("t").otherwise(pl.col("t") + 3e-3)
    )
    fixes = pl.DataFrame({"t": FIXED + 5e-3, "lat": LAT, "lon": LON})
    rows = forces.join(rates, on="t", how="full", coalesce=True)
    pl.concat([rows, fixes], how="diagonal").sort("t").write_csv(tmp_path / "log.csv")
    drive = as_proposed(tmp_path / "log.csv")
    assert len(drive.imu) >= len(TIME) - 1 and abs(len(drive.gps) - len(FIXED)) < 3
    for name in ("ax", "gz"):
        exact = np.interp(drive.imu.time, TIME + 3e-3 * (name[0] == "g"), IMU[name])
        assert np.median(np.abs(getattr(drive.imu, name) - exact)) < 0.02 * np.std(IMU[name])


@pytest.mark.parametrize("names", some(["{}-axis", "{}_value", "Value {}"], 3))
def test_axes_of_tables_that_are_named_after_a_sensor(tmp_path: Path, names: str):
    """The dates of the accelerometer's table have an unknown format, so another column is the time."""
    for kind, word, unit in (("a", "Accelerometer", "g"), ("g", "Gyroscope", "deg/s")):
        axes = {
            f"{names.format(i)} ({unit})": IMU[f"{kind}{i}"] / (G if kind == "a" else np.pi / 180)
            for i in "xyz"
        }
        dates = [f"2024-05-01T12.{int(s) // 60:02d}.{s % 60:06.3f}" for s in TIME]
        times = {"timestamp (+0200)": dates, "epoc (ms)": np.round((TIME + 1.7e9) * 1e3).astype(np.int64)}
        write(tmp_path / f"MetaWear_{word}_50.000Hz_1.7.3.csv", times | axes)
    write(tmp_path / "location.csv", {"time": FIXED + 1.7e9, "latitude": LAT, "longitude": LON})
    require_same(as_proposed(tmp_path))


@pytest.mark.parametrize("first", some(['"sep=\t"', "sep=\t"]))
def test_a_row_of_units_below_unknown_names(tmp_path: Path, first: str):
    names = [
        "Shimmer_9DA1_Timestamp_Unix_CAL",
        *(f"Shimmer_9DA1_{w}_{i}_CAL" for w in ("Accel_LN", "Gyro") for i in "XYZ"),
    ]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]
    values = [(1.7e9 + TIME) * 1e3, *(IMU[n] * (180 / np.pi if n[0] == "g" else 1.0) for n in AXES)]
    rows = ["\t".join(f"{v:.6f}" for v in row) for row in zip(*values, strict=True)]
    (tmp_path / "imu.csv").write_text("\n".join([first, "\t".join(names), "\t".join(units), *rows]) + "\n")
    write(tmp_path / "gps.csv", {"time": FIXED + 1.7e9, "lat": LAT, "lon": LON})
    require_same(as_proposed(tmp_path))


@pytest.mark.parametrize("suffix", some([".dat", ".asc"]))
def test_a_folder_of_tables_of_another_suffix(tmp_path: Path, suffix: str):
    tables = {"imu": {"t": TIME, **IMU}, "gps": {"t": FIXED, "lat": LAT, "lon": LON}}
    for name, columns in tables.items():
        np.savetxt(tmp_path / (name + suffix), np.column_stack([*columns.values()]), header=" ".join(columns))
    require_same(as_proposed(tmp_path))


def test_zero_bytes_around_a_cell_mean_nothing(tmp_path: Path):
    write(tmp_path / "imu.csv", {"t": TIME, **IMU})
    lines = (tmp_path / "imu.csv").read_text().splitlines()
    text = "\n".join([*lines[:900], "\0" * 40 + lines[900], *lines[901:]])
    (tmp_path / "imu.csv").write_text(text + "\0" * 400)
    write(tmp_path / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    require_same(as_proposed(tmp_path))


def test_padded_counts_get_the_scale_that_gravity_shows(tmp_path: Path):
    """One family of names goes before another: axisRate has only one axis."""
    counts = {f"accSmooth[{k}]": np.round(IMU[f"a{i}"] / G * 2048) for k, i in enumerate("xyz")}
    counts |= {f"gyroADC[{k}]": np.round(np.degrees(IMU[f"g{i}"]) * 16.4) for k, i in enumerate("xyz")}
    columns = {"time (us)": np.round(TIME * 1e6), "axisRate[0]": 0 * TIME, **counts}
    cells = [[f"{int(v):>9}" for v in values] for values in columns.values()]
    cells += [["" if v is None else f"{v:.8f}" for v in sparse(p)] for p in (LAT, LON)]
    lines = [", ".join(row) for row in zip(*cells, strict=True)]
    (tmp_path / "LOG1.csv").write_text("\n".join([", ".join([*columns, "lat", "lon"]), *lines]) + "\n")
    maps = inspect_request(Request(tmp_path / "LOG1.csv")).settings["maps"]
    assert maps["imu.az"] == "`accSmooth[2]`*9.80665/2048" and "gyroADC[0]" in maps["imu.gx"]


def test_fixes_in_the_rows_of_an_imu_have_its_time(tmp_path: Path):
    columns = {"TimeGroup.TimeStartup": np.round(TIME * 1e9).astype(np.int64)}
    columns |= {f"ImuGroup.Accel.{i}": IMU[f"a{i.lower()}"] for i in "XYZ"}
    columns |= {f"ImuGroup.AngularRate.{i}": IMU[f"g{i.lower()}"] for i in "XYZ"}
    place = {"GnssGroup.PosLla.Lat": sparse(LAT), "GnssGroup.PosLla.Lon": sparse(LON)}
    write(tmp_path / "vn.csv", columns | {n: v.fill_null(strategy="forward") for n, v in place.items()})
    require_same(as_proposed(tmp_path / "vn.csv"))


@pytest.mark.parametrize("name", some(["gps_id", "I", "receiver"], 3))
def test_of_alternating_receivers_the_first_is_read(tmp_path: Path, name: str):
    write(tmp_path / "imu.csv", {"t": TIME, **IMU})
    numbers = [np.full(len(FIXED), k) for k in (0, 1)]
    frames = [
        pl.DataFrame({"t": FIXED + 0.03 * k[0], name: k, "lat": LAT + 2e-5 * k, "lon": LON}) for k in numbers
    ]
    pl.concat(frames).sort("t").write_csv(tmp_path / "gps.csv")
    require_same(as_proposed(tmp_path))
    assert any("several receivers alternate" in note for note in imported(tmp_path).notes)


def test_codes_of_an_imu_in_rows_of_equal_length_are_kinds(tmp_path: Path):
    """The remedies lead to the drive: separate files, and headers for them."""
    rows = [
        (t, f"{t:.3f},{code},{','.join(f'{v:.9f}' for v in values)}")
        for code, letter in (("ACC", "a"), ("GYR", "g"))
        for t, values in zip(TIME, np.column_stack([IMU[f"{letter}{i}"] for i in "xyz"]), strict=True)
    ]
    rows += [
        (t + 1e-3, f"{t + 1e-3:.3f},GPS,{a:.9f},{o:.9f},500.0")
        for t, a, o in zip(FIXED, LAT, LON, strict=True)
    ]
    (tmp_path / "log.csv").write_text("\n".join(row for _, row in sorted(rows)) + "\n")
    with pytest.raises(InputError, match="rows of several kinds") as caught:
        imported(tmp_path / "log.csv")
    run(str(caught.value).partition("run: ")[2].partition(", and import")[0], tmp_path)
    with pytest.raises(InputError, match="add the headers") as caught:
        imported(tmp_path / "kinds")
    run(str(caught.value).partition("suggest: ")[2].partition(", and import")[0], tmp_path)
    require_same(as_proposed(tmp_path / "kinds" / "named"))


def test_sentences_of_a_board_are_separated_by_the_named_command(tmp_path: Path):
    lines, place = [], dict(zip(NEW.tolist(), range(len(NEW)), strict=True))
    for k, row in enumerate(np.column_stack([TIME * 1e3, *IMU.values()])):
        lines.append("$PIMU," + ",".join(f"{v:.6f}" for v in row) + "*2F")
        if k in place:
            lines.append(
                f"$GPRMC,1000{place[k] // 5:02d}.{place[k] % 5 * 2}0,A,4600.0,N,00700.0,E,1.0,2.0,010524,,,A*00"
            )
    (tmp_path / "log.nmea").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"sentences \$PIMU may be IMU samples") as caught:
        imported(tmp_path / "log.nmea")
    run(str(caught.value).partition("with: ")[2].partition(", and import")[0], tmp_path)
    got = pl.read_csv(tmp_path / "imu.csv", has_header=False).to_numpy()
    np.testing.assert_allclose(got[:, 1:], np.column_stack([*IMU.values()]), atol=1e-6)


def test_a_truth_that_is_named_with_gps_is_read_as_fixes(tmp_path: Path):
    write(tmp_path / "imu" / "imu.csv", {"t": TIME, **IMU})
    write(tmp_path / "ground_truth.csv", {"t": FIXED, "lat": LAT, "lon": LON, "yaw": 0 * FIXED})
    require_same(as_proposed(tmp_path / "imu", gps=tmp_path / "ground_truth.csv"))


@pytest.mark.parametrize("name", ["ax", "gz"])
def test_a_sensor_at_half_the_rate_is_interpolated(tmp_path: Path, name: str):
    """The table has its values in every second row, next to those of the other sensor."""
    rows = pl.DataFrame({"t": TIME, **IMU}).with_row_index("row")
    slow = [pl.when(pl.col("row") % 2 == 0).then(pl.col(n)).alias(n) for n in AXES if n[0] == name[0]]
    fixes = {"lat": sparse(LAT), "lon": sparse(LON)}
    rows.with_columns(*slow).drop("row").with_columns(**fixes).write_csv(tmp_path / "log.csv")
    drive = imported(tmp_path / "log.csv").drive
    assert len(drive.imu) >= len(TIME) - 1 and drive.imu.az is not None
    error = np.abs(getattr(drive.imu, name) - np.interp(drive.imu.time, TIME, IMU[name]))
    assert np.median(error) < 0.05 * np.std(IMU[name])


def test_an_optional_axis_of_a_part_of_a_log_leaves_no_row_out(tmp_path: Path):
    az = pl.Series(IMU["az"]).set(pl.int_range(len(TIME), eager=True) < len(TIME) // 2, None)
    write(tmp_path / "log.csv", {"t": TIME, **IMU, "az": az, "lat": sparse(LAT), "lon": sparse(LON)})
    drive = imported(tmp_path / "log.csv").drive
    assert len(drive.imu) == len(TIME) and drive.imu.az is None


def test_angles_of_the_attitude_are_no_rates(tmp_path: Path):
    angles = {"roll": 0 * TIME, "pitch": 0 * TIME, "yaw": np.degrees(np.cumsum(IMU["gz"]) / 50)}
    forces = {n: IMU[n] for n in AXES[:3]}
    write(tmp_path / "log.csv", {"t": TIME, **angles, **forces, "lat": sparse(LAT), "lon": sparse(LON)})
    seen = inspect_request(Request(tmp_path / "log.csv"))
    assert not seen.works and "yaw" not in seen.proposal


NAMES_OF_AXES = {
    "raw": ("ax_raw ay_raw az_raw gx_raw gy_raw gz_raw", "lat lon"),
    "capitals": ("ACCX ACCY ACCZ GYROX GYROY GYROZ", "GPSLAT GPSLON"),
    "an acronym": ("AccX AccY AccZ GyroX GyroY GyroZ", "GPSLat GPSLong"),
    "glued words": ("longacc latacc vertacc rollrate pitchrate yawrate", "latitude longitude"),
}


@pytest.mark.parametrize("form", some(NAMES_OF_AXES))
def test_other_spellings_of_axes_and_places(tmp_path: Path, form: str):
    axes, place = (names.split() for names in NAMES_OF_AXES[form])
    cells = dict(zip([*axes, *place], [*IMU.values(), sparse(LAT), sparse(LON)], strict=True))
    write(tmp_path / "log.csv", {"t": TIME, **cells})
    require_same(as_proposed(tmp_path / "log.csv"))


@pytest.mark.parametrize("cell", some(["\\N", "-", "#N/A", "--", "NULL"]))
def test_marks_of_empty_cells(tmp_path: Path, cell: str):
    fixes = {
        n: [cell if v is None else f"{v:.9f}" for v in sparse(p)] for n, p in (("lat", LAT), ("lon", LON))
    }
    write(tmp_path / "log.csv", {"t": TIME, **IMU, **fixes})
    require_same(as_proposed(tmp_path / "log.csv"))


def test_two_stamps_of_single_precision_show_no_rate(tmp_path: Path):
    write(tmp_path / "imu.csv", {"t": (1714557605 + TIME).astype(np.float32).astype(np.float64), **IMU})
    write(tmp_path / "gps.csv", {"t": 1714557605 + FIXED, "lat": LAT, "lon": LON})
    with pytest.raises(InputError, match=r'times of the imu are too coarse.*row/100" for 100 Hz'):
        imported(tmp_path)


@pytest.mark.parametrize("kind", ["gap", "scattered"])
def test_rows_in_which_the_gyro_has_no_value_are_left_out(tmp_path: Path, kind: str):
    """A gyro with missing values is no slower sensor, whose samples could be interpolated."""
    imu, gps = DRIVE.imu, DRIVE.gps
    middle = float(np.mean(imu.time))
    gone = np.abs(imu.time - middle) < 0.35 * np.ptp(imu.time)
    if kind == "scattered":
        gone = np.random.default_rng(0).uniform(size=len(imu.time)) < 0.35
    table = pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": np.where(gone, np.nan, imu.gz)})
    table.with_columns(pl.col("gz").fill_nan(None)).write_csv(tmp_path / "imu.csv")
    pl.DataFrame({"t": gps.time, "x": gps.x, "y": gps.y}).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path)
    np.testing.assert_allclose(
        got.drive.imu.time, imu.time[~gone] - imu.time[0] + got.drive.imu.time[0], atol=1e-6
    )
    assert any("since a cell is empty" in note for note in got.notes)


def test_settings_in_a_json_file_do_not_hide_tables(tmp_path: Path):
    pl.DataFrame({"t": DRIVE.imu.time, "ax": DRIVE.imu.ax, "ay": DRIVE.imu.ay, "gz": DRIVE.imu.gz}).write_csv(
        tmp_path / "imu.dat"
    )
    pl.DataFrame({"t": DRIVE.gps.time, "x": DRIVE.gps.x, "y": DRIVE.gps.y}).write_csv(tmp_path / "gps.dat")
    (tmp_path / "settings.json").write_text('{"device": "x", "rate": 100}')
    assert len(imported(tmp_path).drive.imu) == len(DRIVE.imu)


def test_next_to_an_axis_down_a_lateral_axis_points_to_the_right(tmp_path: Path):
    names = {"x": "Forward", "y": "Lateral", "z": "Down"}
    axes = {
        f"{'Accel' if n[0] == 'a' else 'AngRate'}{names[n[1]]} ({'m/s²' if n[0] == 'a' else 'rad/s'})": v
        * (n[1] == "x" or -1)
        for n, v in IMU.items()
    }
    write(tmp_path / "log.csv", {"Time (s)": TIME, **axes, "lat": sparse(LAT), "lon": sparse(LON)})
    require_same(as_proposed(tmp_path / "log.csv"))


def test_a_racelogic_file_is_converted_by_the_named_command(tmp_path: Path):
    """Latitude and longitude are in minutes, and the longitude is positive to the west."""
    heads = ["time", "lat", "long", *(f"X{n}" for n in AXES)]
    places = [np.interp(TIME, FIXED, v) * factor for v, factor in ((LAT, 60), (LON, -60))]
    rows = np.column_stack([TIME + 10, *places, *IMU.values()])
    lines = [
        "File created on 01/05/2024",
        "",
        "[header]",
        "time",
        "",
        "[column names]",
        " ".join(heads),
        "",
        "[data]",
    ]
    lines += [" ".join(f"{v:+.9f}" for v in row) for row in rows]
    for name in ("run.vbo", "run.txt"):
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        with pytest.raises(InputError, match="since it is a Racelogic file") as caught:
            imported(tmp_path / name)
    run(str(caught.value).partition("in degrees: ")[2].replace("FILE", "run.txt"), tmp_path)
    maps = [f"{n}=X{n}" for n in AXES]
    got = imported(tmp_path / "new.txt", maps=maps).drive
    assert got.origin is not None and got.origin[:2] == pytest.approx((LAT[0], LON[0]), abs=1e-4)


@pytest.mark.parametrize("form", ["{{'x': {}, 'y': {}, 'z': {}}}", '{{""x"": {}, ""y"": {}, ""z"": {}}}'])
def test_cells_with_an_object_are_split_by_the_named_command(tmp_path: Path, form: str):
    cells = {
        name: [form.format(*(f"{IMU[k + i][n]:.6f}" for i in "xyz")) for n in range(len(TIME))]
        for name, k in (("acc", "a"), ("gyro", "g"))
    }
    rows = [f'{t:.3f},"{a}","{g}"' for t, a, g in zip(TIME, cells["acc"], cells["gyro"], strict=True)]
    (tmp_path / "imu.csv").write_text("\n".join(["t,acc,gyro", *rows]) + "\n")
    write(tmp_path / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    with pytest.raises(InputError, match="cells contain several numbers") as caught:
        imported(tmp_path)
    run(str(caught.value).partition("for example with: ")[2].partition("; or specify")[0], tmp_path)
    require_same(imported(tmp_path / "new.csv", gps=tmp_path / "gps.csv").drive)


@pytest.mark.parametrize("comma", [False, True])
def test_units_in_cells_are_removed_by_the_named_command(tmp_path: Path, *, comma: bool):
    cells = {n: [f"{x:.6f} {'m/s²' if n[0] == 'a' else 'rad/s'}" for x in v] for n, v in IMU.items()}
    cells = {n: [c.replace(".", ",") if comma else c for c in v] for n, v in cells.items()}
    write(tmp_path / "log.csv", {"t": TIME, **cells, "lat": sparse(LAT), "lon": sparse(LON)})
    with pytest.raises(InputError, match="has a unit; write the units to the header") as caught:
        imported(tmp_path / "log.csv")
    run(str(caught.value).partition("for example with: ")[2], tmp_path)
    require_same(imported(tmp_path / "new.csv").drive)


@pytest.mark.parametrize("accuracy", [False, True])
def test_accelerations_with_the_sign_of_gravity_are_proposed_in_the_axes_of_a_car(
    tmp_path: Path, *, accuracy: bool
):
    """Of a phone, x points to the right and y forward; a proposal of the accuracy does not hide the sign."""
    turned = {"x": ("y", -1), "y": ("x", 1), "z": ("z", 1)}
    axes = {f"accelerometerAcceleration{i.upper()}(G)": -s * IMU[f"a{k}"] / G for i, (k, s) in turned.items()}
    axes |= {f"gyroRotation{i.upper()}(rad/s)": s * IMU[f"g{k}"] for i, (k, s) in turned.items()}
    place = {"locationLatitude(WGS84)": sparse(LAT), "locationLongitude(WGS84)": sparse(LON)}
    place |= {"locationHorizontalAccuracy(m)": sparse(0 * FIXED + 1.5)} if accuracy else {}
    write(tmp_path / "log.csv", {"timestamp": TIME, **axes, **place})
    require_same(as_proposed(tmp_path / "log.csv"))
    maps = [
        f"{n}={text}" for n, text in inspect_request(Request(tmp_path / "log.csv")).settings["maps"].items()
    ]
    got = imported(tmp_path / "log.csv", maps=maps)
    assert not any("z axis points down" in note for note in (*got.notes, *got.assumed))


def test_of_a_receiver_the_clock_that_overlaps_with_the_imu_is_read(tmp_path: Path):
    start = datetime.datetime(2024, 5, 1, 10, tzinfo=datetime.UTC)
    dates = [start + datetime.timedelta(seconds=round(t, 3)) for t in FIXED.tolist()]
    parts = {n: [getattr(d, n) for d in dates] for n in ("year", "month", "day", "hour", "minute", "second")}
    nano = [d.microsecond * 1000 for d in dates]
    fixes = {
        "iTOW": np.round((295_218 + FIXED) * 1e3).astype(int),
        **parts,
        "nano": nano,
        "lat": LAT,
        "lon": LON,
    }
    write(tmp_path / "gps.csv", fixes | {"hAcc": 0 * FIXED + 1500})
    write(tmp_path / "imu.csv", {"t": start.timestamp() + TIME, **IMU})
    require_same(imported(tmp_path).drive)


def test_an_accuracy_without_a_unit_is_not_proposed_unchecked(tmp_path: Path):
    write(tmp_path / "gps.csv", {"t": 5e8 + FIXED, "lat": LAT, "lon": LON, "hAcc": 0 * FIXED + 1500})
    write(tmp_path / "imu.csv", {"t": TIME, **IMU})
    seen = inspect_request(Request(tmp_path))
    assert not seen.proposal and not seen.works
    assert any("do not overlap" in note for note in seen.notes)


def test_a_complete_imu_goes_before_accelerations_and_rates_of_another_source(tmp_path: Path):
    """A filter's log also has the accelerations east and north, and a car's log the yaw rate of the bus."""
    others = {
        "Ax": 9 * IMU["ax"],
        "Ay": 9 * IMU["ay"],
        "Az": IMU["az"] - G,
        "yaw_rate_dps": np.degrees(IMU["gz"]) + 2,
    }
    own = {f"imu_{n}": v for n, v in IMU.items()}
    write(tmp_path / "log.csv", {"time_s": TIME, **others, **own, "lat": sparse(LAT), "lon": sparse(LON)})
    require_same(imported(tmp_path / "log.csv").drive)


@pytest.mark.parametrize("body", [False, True])
def test_accelerations_in_the_axes_of_the_earth_are_not_proposed(tmp_path: Path, *, body: bool):
    earth = {f"FreeAcc_{i}": IMU[f"a{i.lower()}"] for i in "XYZ"} | {
        f"acc_{i}_world": IMU[f"a{i}"] for i in "xyz"
    }
    earth |= {f"acc_{i}_body": IMU[f"a{i}"] for i in "xyz"} if body else {}
    rates = {f"Gyr_{i}": np.degrees(IMU[f"g{i.lower()}"]) for i in "XYZ"}
    write(tmp_path / "log.csv", {"t": TIME, **earth, **rates, "lat": sparse(LAT), "lon": sparse(LON)})
    with pytest.raises(InputError, match="in the axes of the earth can't be used; log those of the sensor"):
        imported(tmp_path / "log.csv")
    proposal = inspect_request(Request(tmp_path / "log.csv")).proposal
    assert "Free" not in proposal and "world" not in proposal
    if body:
        require_same(as_proposed(tmp_path / "log.csv"))


@pytest.mark.parametrize(
    "names", ["hour minute second millisecond", "Hour Min Sec ms", "gps_hr gps_min gps_sec gps_ms"]
)
def test_a_time_of_day_in_columns(tmp_path: Path, names: str):
    """Without hours and minutes, the seconds would restart in each minute."""
    whole = np.floor(TIME + 1e-6) + 36_030
    parts = [
        whole // 3600,
        whole // 60 % 60,
        whole % 60,
        np.round((TIME - np.floor(TIME + 1e-6)) * 1e3) % 1000,
    ]
    clock = {n: v.astype(int) for n, v in zip(names.split(), parts, strict=True)}
    write(tmp_path / "log.csv", clock | IMU | {"lat": sparse(LAT), "lon": sparse(LON)})
    drive = imported(tmp_path / "log.csv").drive
    assert drive.imu.time[0] == pytest.approx(36_030 + TIME[0], abs=1e-6)
    require_same(drive)


def test_a_flag_is_no_axis_and_an_angle_no_rate_of_a_suggested_header(tmp_path: Path):
    """Files of phones: a flag before the accelerations, and filtered accelerations before the attitude."""
    forces = [IMU[n] / G for n in AXES[:3]]
    angles = [0.1 * np.sin(TIME), 0.1 * np.cos(TIME), np.cumsum(IMU["gz"]) / 50]
    rows = np.column_stack([TIME, 0 * TIME + 1, *forces, *(0.99 * f for f in forces), *angles])
    np.savetxt(tmp_path / "acc.txt", rows, fmt="%.5f")
    np.savetxt(tmp_path / "gps.txt", np.column_stack([FIXED, LAT, LON]), fmt="%.9f")
    with pytest.raises(InputError, match="no IMU samples") as caught:
        imported(tmp_path)
    assert "write headers" not in str(caught.value)
    seen = inspect_request(Request(tmp_path))
    assert "az=c5*9.80665" in seen.proposal and "unseen-yaw" in seen.evidence


NAMED_LIKE_OTHERS: dict[str, Callable[[str], str]] = {
    "not down": lambda axis: f"{'acc' if axis[0] == 'a' else 'gyro'}_{axis[1]}_downsampled",
    "a topic of the earth": lambda axis: (
        f"/world/imu/{'acceleration' if axis[0] == 'a' else 'gyro'}/{axis[1]}"
    ),
    "a device of the earth": lambda axis: f"global_imu.{'acc' if axis[0] == 'a' else 'gyro'}.{axis[1]}",
}


@pytest.mark.parametrize("form", NAMED_LIKE_OTHERS)
def test_words_within_words_and_names_of_topics_do_not_change_axes(tmp_path: Path, form: str):
    axes = {NAMED_LIKE_OTHERS[form](axis): values for axis, values in IMU.items()}
    write(tmp_path / "log.csv", {"t": TIME, **axes, "lat": sparse(LAT), "lon": sparse(LON)})
    require_same(as_proposed(tmp_path / "log.csv"))


@pytest.mark.parametrize(
    "about",
    [
        {"device": {"model": "x", "os": "y"}, "settings": {"rate": 50, "unit": "si"}},
        {"acc_bias": [0.0, 0.0, 0.1], "gyro_bias": [0.0, 0.0, 0.2]},
        {"x": functools.reduce(lambda inner, _: {"x": inner}, range(600), {"a": 1})},
    ],
    ids=["settings", "biases", "deep"],
)
def test_settings_next_to_tables_are_no_columns(tmp_path: Path, about: dict[str, Any]):
    imu = pl.DataFrame({"t": TIME, **IMU}).to_dicts()
    gps = pl.DataFrame({"t": FIXED, "lat": LAT, "lon": LON}).to_dicts()
    (tmp_path / "log.json").write_text(json.dumps({**about, "imu": imu, "gps": gps}))
    require_same(imported(tmp_path / "log.json").drive)


def test_a_counter_of_milliseconds_is_no_fraction_of_a_second(tmp_path: Path):
    whole = np.floor(TIME)
    clock = {"ms": np.round(TIME * 1000), "hour": 9 + 0 * TIME, "minute": whole // 60, "second": whole % 60}
    write(tmp_path / "log.csv", {**clock, **IMU, "lat": sparse(LAT), "lon": sparse(LON)})
    got = imported(tmp_path / "log.csv").drive.imu.time
    np.testing.assert_allclose(np.diff(got), np.diff(TIME), atol=1e-6)


def test_names_in_a_comment_are_known_to_maps(tmp_path: Path):
    rows = np.column_stack([TIME, *IMU.values()])
    np.savetxt(tmp_path / "imu.csv", rows, header="tick a0 a1 a2 w0 w1 w2")
    write(tmp_path / "gps.csv", {"t": FIXED, "lat": LAT, "lon": LON})
    names = ("tick", "a0", "a1", "a2", "w0", "w1", "w2")
    maps = [f"imu.{column}={name}" for column, name in zip(("t", *AXES), names, strict=True)]
    request = Request(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=maps)
    np.testing.assert_allclose(import_drive(request, "log").drive.imu.ay, IMU["ay"])
