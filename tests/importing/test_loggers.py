"""Layouts of loggers, written from a simulated drive: what is proposed, or named as remedy, makes the drive again."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from sigmaswarm.drives.drive import Drive
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.convert import Request, import_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.source import TableChoice
from sigmaswarm.simulation.scenarios import simulate

G = 9.80665
ORIGIN = (46.0, 7.0, 500.0)
DRIVE = simulate("urban", duration=60.0, imu_rate=50.0, run=2, gps="white-1m")
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
    "in m/s2": ("Linear_Acc_{}2 [m/s^2]", "Gravity {} [m/s^2]", "Gyro2 {} [rad/s]", "XYZ", 1.0),
}


@pytest.mark.parametrize("form", APART)
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


@pytest.mark.parametrize("clock", CLOCKS)
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


NAMES = {
    "flight test": ("Time [s]", "N{} [g]", ("P [deg/s]", "Q [deg/s]", "R [deg/s]"), "Lat [deg]", "Lon [deg]"),
    "drone": ("offsetTime", "IMU(0):accel:{}", "IMU(0):gyro:{}", "GPS(0):Lat", "GPS(0):Long"),
    "survey": ("Zeit [s]", "Acc_Body_{} [g]", "Rate_Body_{} [°/s]", "INS_Lat_Abs [°]", "INS_Long_Abs [°]"),
    "brackets": ("Time(s)", "Acc({})", "Gyro({})", "Latitude", "Longitude"),
    "bus": ("timestamps", "ESP.{}beschl", "ESP.{}rate", "Pos.Latitude", "Pos.Longitude"),
    "elements": ("time", "I.acc[{}]", "I.pqr[{}]", "lat", "lon"),
}
PARTS = {"bus": (("Laengs", "Quer", "Vertikal"), ("Wank", "Nick", "Gier")), "elements": ("012", "012")}


@pytest.mark.parametrize("form", NAMES)
def test_more_names_of_loggers(tmp_path: Path, form: str):
    time, force, rate, lat, lon = NAMES[form]
    scale = (1 / G, np.degrees(1)) if "g]" in force or "IMU" in force else (1.0, 1.0)
    letters = PARTS.get(form, ("XYZ", "XYZ"))
    columns: dict[str, Any] = {time: TIME}
    for k, axis in enumerate("xyz"):
        columns[force.format(letters[0][k])] = IMU[f"a{axis}"] * scale[0]
        columns[rate[k] if isinstance(rate, tuple) else rate.format(letters[1][k])] = (
            IMU[f"g{axis}"] * scale[1]
        )
    write(tmp_path / "log.csv", {**columns, lat: sparse(LAT), lon: sparse(LON)})
    require_same(as_proposed(tmp_path / "log.csv"))
