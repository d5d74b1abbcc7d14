"""Drives from arrays and data frames: the same numbers as from files, and one clear line for each fault."""

import numpy as np
import pandas as pd
import polars as pl
import pytest

import sigmaswarm
from sigmaswarm import Drive, DriveError, read_drive, simulate, write_drive


@pytest.fixture(scope="module")
def drive() -> Drive:
    return simulate("urban", duration=30, gps="white-1m")


def tables(drive: Drive) -> dict[str, dict[str, np.ndarray]]:
    imu, gps, truth = drive.imu, drive.gps, drive.truth
    assert truth
    return {
        "imu": {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz},
        "gps": {"t": gps.time, "x": gps.x, "y": gps.y},
        "truth": {"t": truth.time} | {c: getattr(truth, c) for c in ("x", "y", "vx", "vy", "theta")},
    }


def dated(times: np.ndarray, unit: str = "ns") -> np.ndarray:
    start = np.datetime64("2026-03-04T05:06:07", "ns")
    return (start + np.round(times * 1e9).astype("timedelta64[ns]")).astype(f"datetime64[{unit}]")


@pytest.mark.parametrize("frame", [dict, pd.DataFrame, pl.DataFrame])
def test_every_type_of_frame_gives_the_same_numbers(drive: Drive, frame: type) -> None:
    made = Drive.from_frames(**{name: frame(table) for name, table in tables(drive).items()})
    for name, table in tables(drive).items():
        for column, values in table.items():
            found = getattr(getattr(made, name), "time" if column == "t" else column)
            np.testing.assert_array_equal(found, values)
    assert made.frame == "enu"
    assert made.origin is None


@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Vienna"])
@pytest.mark.parametrize("place", ["t", "time", "index"])
def test_dates_are_seconds_since_the_first_sample(drive: Drive, zone: str | None, place: str) -> None:
    frames = {}
    for name, table in tables(drive).items():
        frames[name] = pd.DataFrame({"time" if k == "t" else k: v for k, v in table.items()})
        at = pd.Series(dated(table["t"]))
        frames[name]["time"] = at if zone is None else at.dt.tz_localize("UTC").dt.tz_convert(zone)
        if place == "index":
            frames[name] = frames[name].set_index("time").rename_axis(None)
        elif place == "t":
            frames[name] = frames[name].rename(columns={"time": "t"})
    made = Drive.from_frames(**frames)
    np.testing.assert_allclose(made.gps.time, drive.gps.time - drive.imu.time[0], atol=1e-9)
    start = np.datetime64("2026-03-04T05:06:07", "ns").astype(np.int64) * 1e-9 + drive.imu.time[0]
    assert made.metadata["time_origin_s"] == pytest.approx(start, abs=1e-6)


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_dates_of_polars(drive: Drive, unit: str) -> None:
    frames = {
        name: pl.DataFrame(table | {"t": dated(table["t"], unit)}) for name, table in tables(drive).items()
    }
    made = Drive.from_frames(**frames)
    np.testing.assert_allclose(made.imu.time, drive.imu.time - drive.imu.time[0], atol=2e-9)


def test_degrees_give_the_same_positions_as_in_a_file(drive: Drive, tmp_path) -> None:
    given = tables(drive)
    lat, lon = 48 + drive.gps.y / 111_000, 16 + drive.gps.x / 74_000
    gps = {"t": drive.gps.time, "lat": lat, "lon": lon}
    made = Drive.from_arrays(given["imu"], gps, name="vienna")
    write_drive(made, tmp_path / "vienna")
    read = read_drive(tmp_path / "vienna")
    np.testing.assert_array_equal(made.gps.x, read.gps.x)
    assert made.origin == read.origin == (lat[0], lon[0], 0.0)


def test_custom_column_names(drive: Drive) -> None:
    given = tables(drive)
    imu = pd.DataFrame(given["imu"]).rename(columns={"ax": "acc_x", "t": "stamp"})
    made = Drive.from_frames(imu, pl.DataFrame(given["gps"]), columns={"acc_x": "ax", "stamp": "t"})
    np.testing.assert_array_equal(made.imu.ax, drive.imu.ax)


def changed(table: dict[str, np.ndarray], column: str, row: int, value: float) -> dict[str, np.ndarray]:
    values = table[column].copy()
    values[row] = value
    return table | {column: values}


FAULTS = {
    "nan": (lambda t: {"imu": changed(t["imu"], "ax", 7, np.nan)}, ["imu", "column ax", "row 7", "dropna"]),
    "infinite": (lambda t: {"gps": changed(t["gps"], "y", 3, np.inf)}, ["gps", "column y", "row 3"]),
    "not-a-time": (
        lambda t: {
            k: pd.DataFrame(v | {"t": pd.Series(dated(v["t"])).where(lambda s: s.index != 4)})
            for k, v in t.items()
        },
        ["imu", "column t", "row 4"],
    ),
    "shuffled": (lambda t: {"imu": {k: v[::-1] for k, v in t["imu"].items()}}, ["imu, row 1", "sort"]),
    "repeated": (lambda t: {"gps": changed(t["gps"], "t", 5, t["gps"]["t"][4])}, ["gps, row 5", "repeated"]),
    "text": (
        lambda t: {"imu": t["imu"] | {"ay": t["imu"]["ay"].astype(str)}},
        ["imu", "column ay", "float64"],
    ),
    "missing": (lambda t: {"imu": {k: v for k, v in t["imu"].items() if k != "gz"}}, ["imu", "no column gz"]),
    "length": (lambda t: {"imu": t["imu"] | {"ax": t["imu"]["ax"][1:]}}, ["imu", "'ax'", "shape"]),
    "two-clocks": (lambda t: {"imu": t["imu"] | {"t": dated(t["imu"]["t"])}}, ["gps", "dates"]),
    "degrees": (
        lambda t: {"gps": {"t": t["gps"]["t"], "lat": t["gps"]["x"] + 95, "lon": t["gps"]["y"]}},
        ["gps, row 0, column lat"],
    ),
    "path": (lambda t: {"imu": "imu.csv"}, ["imu is a path", "read_drive"]),
    "nothing": (lambda t: {"gps": 3.0}, ["gps is a float"]),
    "apart": (lambda t: {"gps": t["gps"] | {"t": t["gps"]["t"] + 1000}}, ["do not overlap"]),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_one_line_that_names_table_column_and_row(drive: Drive, fault: str) -> None:
    spoil, parts = FAULTS[fault]
    given = tables(drive)
    given.pop("truth")
    with pytest.raises(DriveError) as caught:
        Drive.from_arrays(**given | spoil(given))
    message = str(caught.value)
    assert "\n" not in message
    for part in parts:
        assert part in message


def test_unknown_columns_warn(drive: Drive) -> None:
    given = tables(drive)
    with pytest.warns(sigmaswarm.SigmaswarmWarning, match="ignoring 'mag_x'"):
        Drive.from_frames(given["imu"] | {"mag_x": given["imu"]["ax"]}, given["gps"])
