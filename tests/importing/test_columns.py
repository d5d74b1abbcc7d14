"""CSV and Parquet, with guessed and with mapped columns."""

import re
import shutil
from datetime import UTC, datetime
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from importing.logs import EPOCH, a_drive, assert_close, imported
from sigmaswarm import read_drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.names import read_names
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Limits, TableChoice
from support import DRIVES, diagonal, needs_shared, quickly, several, some

DRIVE = a_drive()
G = 9.80665


def foreign_imu(**changed: object) -> pl.DataFrame:
    """The IMU as other loggers write it: ns since 1970, g with the opposite sign, deg/s, axes of their own."""
    imu = DRIVE.imu
    ns = np.round(imu.time * 1e9).astype(np.int64) + EPOCH * 10**9
    columns: dict[str, object] = {
        "stamp": ns,
        "acc x [g]": -imu.ax / G,
        "acc_y": -imu.ay / G,
        "acc_z": -imu.az / G,
        "gyro_z": np.degrees(imu.gz),
    }
    return pl.DataFrame(columns | changed)


def foreign_gps() -> pl.DataFrame:
    gps = DRIVE.gps
    return pl.DataFrame(
        {
            "when": (np.round(gps.time * 1e9).astype("timedelta64[ns]") + np.datetime64(EPOCH, "s")),
            "la": np.round(gps.lat * 1e7),
            "lo": gps.lon,
        }
    )


MAPS = (
    *("ax=-`acc x [g]`*9.80665", "ay=-acc_y*g", "az=-acc_z*g", "gz=radians(gyro_z)"),
    *("imu.t=stamp*1e-9", "gps.t=utc(when)", "gps.lat=la*1e-7", "gps.lon=lo"),
)


@pytest.mark.parametrize("kind", ["csv", "semicolons", "parquet"])
def test_mapped(tmp_path: Path, kind: str):
    for name, table in (("imu", foreign_imu()), ("gps", foreign_gps())):
        if kind == "parquet":
            table.write_parquet(tmp_path / f"{name}.parquet")
        else:
            table.write_csv(tmp_path / f"{name}.csv", separator=";" if kind == "semicolons" else ",")
    suffix = "parquet" if kind == "parquet" else "csv"
    got = imported(tmp_path / f"imu.{suffix}", gps=tmp_path / f"gps.{suffix}", maps=MAPS)
    assert_close(got.drive.imu, DRIVE.imu, "time ax ay az gz", 1e-12)
    assert_close(got.drive.gps, DRIVE.gps, "lat lon", 1e-7)
    assert_close(got.drive.gps, DRIVE.gps, "time", 1e-6)  # utc() goes through a float
    assert got.drive.metadata["time_origin_s"] == EPOCH


def test_a_saved_recipe_does_the_same(tmp_path: Path):
    foreign_imu().write_csv(tmp_path / "imu.csv")
    foreign_gps().write_csv(tmp_path / "gps.csv")
    recipe = Recipe(mount="90", gps_offset_s=0.125, origin=(50.0, 8.0, 0.0), gps_lever_arm_m=(1.0, 0.0, 0.5))
    first = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=MAPS, recipe=recipe)
    first.recipe.save(tmp_path / "recipe.toml")
    loaded = Recipe.load(tmp_path / "recipe.toml")
    assert loaded == first.recipe
    again = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", recipe=loaded)
    assert_close(again.drive.imu, first.drive.imu, "time ax ay az gz", 0)
    assert_close(again.drive.gps, first.drive.gps, "time lat lon x y", 0)
    assert again.drive.metadata["gps_lever_arm_m"] == [1.0, 0.0, 0.5]
    assert again.drive.origin == (50.0, 8.0, 0.0)
    assert_close(
        again.drive.imu, type(DRIVE.imu)(DRIVE.imu.time, -DRIVE.imu.ay, DRIVE.imu.ax, DRIVE.imu.gz), "ax ay"
    )
    np.testing.assert_allclose(again.drive.gps.time, DRIVE.gps.time + 0.125, atol=1e-6)


def test_a_recipe_serves_the_next_days_files_whatever_they_are_called(tmp_path: Path):
    for day in ("monday", "tuesday"):
        foreign_imu().write_csv(tmp_path / f"{day}_imu.csv")
        foreign_gps().write_csv(tmp_path / f"{day}_gps.csv")
    first = imported(tmp_path / "monday_imu.csv", gps=tmp_path / "monday_gps.csv", maps=MAPS)
    next_day = imported(tmp_path / "tuesday_imu.csv", gps=tmp_path / "tuesday_gps.csv", recipe=first.recipe)
    assert_close(next_day.drive.imu, first.drive.imu, "time ax ay az gz", 0)
    assert_close(next_day.drive.gps, first.drive.gps, "time lat lon", 0)


def test_of_a_folder_with_two_days_it_says_which_is_taken(tmp_path: Path):
    for table, role in ((a_drive().imu, "imu"), (a_drive().gps, "gnss")):
        columns = {"t" if c == "time" else c: v for c, v in vars(table).items() if v is not None}
        for day in ("monday", "tuesday"):
            pl.DataFrame(columns).write_csv(tmp_path / f"{role}_{day}.csv")
    said = [note for note in imported(tmp_path).notes if "is used for the" in note]
    assert said == [
        f"{role}_tuesday.csv also has the same columns, but only {role}_monday.csv is used for the {name}; "
        f"import each table as a separate drive, for example with --{name}-table {role}_tuesday.csv"
        for role, name in (("imu", "imu"), ("gnss", "gps"))
    ]


LONG = a_drive(30.0)
NUMBERED = ["imu_{}.csv", "2024-05-01_1{}.csv", "imu ({}).csv"]


@pytest.mark.parametrize(
    ("fixes", "reference"),
    [("gps", "rtk"), ("uwb", "mocap"), ("position", "vicon"), ("beacon", "Total_Station")],
)
def test_of_several_position_sources_the_reference_is_proposed_as_truth(
    tmp_path: Path, fixes: str, reference: str
):
    drive = a_drive(20.0)
    imu, gps, true = drive.imu, drive.gps, drive.truth
    tables = {
        "imu": {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz},
        fixes: {"t": gps.time, "x": gps.x, "y": gps.y},
        reference: {"t": true.time, "x": true.x, "y": true.y, "z": 0 * true.x}
        | ({"qz": np.sin(true.theta / 2), "qw": np.cos(true.theta / 2)} if fixes == "uwb" else {}),
    }
    for name, columns in tables.items():
        pl.DataFrame(columns).write_csv(tmp_path / f"{name}.csv")
    got = imported(tmp_path)
    assert len(got.drive.gps) == len(gps) and got.drive.truth is None
    (said,) = (note for note in got.notes if "also has positions" in note)
    assert said.startswith(f"{reference}.csv also has positions, but only {fixes}.csv is used for the gps")
    role, table = re.search(r"--(truth)-table (\S+) reads", said).groups()
    again = imported(tmp_path, choice=TableChoice({role: table}))
    assert len(again.drive.truth) == len(true) and not any("also has" in note for note in again.notes)


@pytest.mark.parametrize(
    ("fixes", "wheels"), [("gps_rtk", "odom"), ("smartkart_gps", "wheel_odometry"), ("rtk", "odo")]
)
def test_positions_from_wheels_are_not_used_in_place_of_fixes(tmp_path: Path, fixes: str, wheels: str):
    drive = a_drive(20.0)
    imu, gps, true = drive.imu, drive.gps, drive.truth
    tables = {
        "imu": {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz},
        fixes: {"t": gps.time, "x": gps.x, "y": gps.y},
        wheels: {"t": true.time, "x": 1.1 * true.x, "y": 1.1 * true.y, "theta": true.theta},
    }
    for name, columns in tables.items():
        pl.DataFrame(columns).write_csv(tmp_path / f"{name}.csv")
    got = imported(tmp_path)
    assert len(got.drive.gps) == len(gps) and not any(f"{wheels}.csv also" in note for note in got.notes)


@pytest.mark.parametrize("form", ["true_{}", "gt_{}", "{}_truth", "ref_{}", "ground_truth_{}"])
def test_columns_of_a_truth_may_be_named_truth(tmp_path: Path, form: str):
    drive = a_drive(20.0)
    imu, gps, true = drive.imu, drive.gps, drive.truth
    truth = {"x": true.x, "y": true.y, "yaw_deg": np.degrees(true.theta)}
    tables = {
        "imu": {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz},
        "gps": {"t": gps.time, "x": gps.x, "y": gps.y},
        "truth": {"t": true.time, **{form.format(name): values for name, values in truth.items()}},
    }
    for name, columns in tables.items():
        pl.DataFrame(columns).write_csv(tmp_path / f"{name}.csv")
    got = imported(tmp_path).drive.truth
    np.testing.assert_allclose(got.x, true.x, atol=1e-9)
    np.testing.assert_allclose(np.sin(got.theta - true.theta), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "pause"),
    quickly(
        product([*NUMBERED, "x{}.csv without headers"], [0.0, 20.0]),
        lambda name, pause: (name == NUMBERED[1]) == (pause > 0),
    ),
)
def test_files_that_continue_each_other_are_joined(tmp_path: Path, name: str, pause: float):
    columns = {n: getattr(LONG.imu, n) for n in ("time", "ax", "ay", "az", "gx", "gy", "gz")}
    whole, third = pl.DataFrame(columns), len(LONG.imu) // 3
    headers = "without" not in name
    for k in (2, 0, 1):
        part = whole[k * third : (k + 1) * third] if k < 2 else whole[2 * third :]
        later = part.with_columns(time=pl.col("time") + pause * k)
        path = tmp_path / name.partition(" without")[0].format(k if headers else "abc"[k])
        later.write_csv(path, include_header=headers or k == 0)
    fixes = pl.DataFrame({n: getattr(LONG.gps, n) for n in ("time", "lat", "lon")})[::5]  # 1 Hz
    if headers and not pause:
        for k in (1, 0):
            fixes[k * 10 : (k + 1) * 10 if k == 0 else None].write_csv(tmp_path / f"fixes{k}.csv")
    else:
        fixes.write_csv(tmp_path / "fixes.csv")
    got = imported(tmp_path)
    assert pause or len(got.drive.gps) == len(fixes)
    if "imu_" in name:
        packed = shutil.make_archive(f"{tmp_path}-packed", "zip", tmp_path)
        assert len(imported(Path(packed)).drive.imu) == len(got.drive.imu)
    assert len(got.drive.imu) == (third if pause else len(LONG.imu))
    assert any("are joined" in note for note in got.notes) == (not pause)
    if not pause:
        assert_close(got.drive.imu, LONG.imu, "time ax gz", 1e-9)
        assert not any("has no header" in note for note in got.notes)


@pytest.mark.parametrize(
    ("names", "scale", "where"),
    [
        (("Acceleration x (m/s^2)", "Acceleration y (m/s^2)", "Gyroscope z (rad/s)"), (1, 1, 1), "names"),
        (("acc_x_g", "acc_y_g", "gyro_z_dps"), (1 / G, 1 / G, 180 / np.pi), "units in names"),
        (("AccX", "AccY", "yaw_rate"), (1, 1, 1), "small letters"),
        (("acc x in g", "acc y in g", "yaw rate in °/s"), (1 / G, 1 / G, 180 / np.pi), "units after in"),
        (
            ("linear_acceleration.x", "linear_acceleration.y", "angular_velocity.z"),
            (1, 1, 1),
            "message fields",
        ),
    ],
)
def test_guesses_by_names(tmp_path: Path, names: tuple[str, str, str], scale: tuple[float, ...], where: str):
    imu, gps = DRIVE.imu, DRIVE.gps
    table = {
        "time": imu.time,
        names[0]: imu.ax * scale[0],
        names[1]: imu.ay * scale[1],
        names[2]: imu.gz * scale[2],
    }
    pl.DataFrame(table).write_csv(tmp_path / "imu.csv")
    pl.DataFrame({"timestamp_ms": gps.time * 1e3, "Latitude": gps.lat, "lng": gps.lon}).write_csv(
        tmp_path / "gps.csv"
    )
    got = imported(tmp_path)
    assert_close(got.drive.imu, imu, "time ax ay gz", 1e-9)
    assert_close(got.drive.gps, gps, "time lat lon", 1e-9)


@pytest.mark.parametrize(
    ("east", "north"),
    several([("lon_stdev", "lat_stdev"), ("longitude_std_dev", "latitude_std_dev"), ("LonSigma", "LatSigma"),
             ("std_lon", "std_lat"), ("sdE", "sdN"), ("easting_std", "northing_std")]),
)  # fmt: skip
def test_guesses_stated_deviations(tmp_path: Path, east: str, north: str):
    imu, gps = DRIVE.imu, DRIVE.gps
    table = {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}
    pl.DataFrame(table).write_csv(tmp_path / "imu.csv")
    table = {"t": gps.time, "lat": gps.lat, "lon": gps.lon, north: 0.5 * gps.std_y, east: gps.std_x}
    pl.DataFrame(table).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path).drive.gps
    np.testing.assert_allclose(got.std_x, gps.std_x, rtol=1e-9)
    np.testing.assert_allclose(got.std_y, 0.5 * gps.std_y, rtol=1e-9)


@pytest.mark.parametrize(
    ("unit", "factor", "begin"), diagonal([("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)], [0, EPOCH])
)
def test_guesses_the_unit_of_times(tmp_path: Path, unit: str, factor: int, begin: int):
    imu, gps = DRIVE.imu, DRIVE.gps
    for name, time, more in (
        ("imu", imu.time, {"ax": imu.ax, "ay": imu.ay, "gz": imu.gz}),
        ("gps", gps.time, {"lat": gps.lat, "lon": gps.lon}),
    ):
        t = (
            (time + begin) * factor
            if unit == "s"
            else np.round(time * factor).astype(np.int64) + begin * factor
        )
        pl.DataFrame({"t": t, **more}).write_csv(tmp_path / f"{name}.csv")
    got = imported(tmp_path)
    assert_close(got.drive.imu, imu, "time", 1e-3 if unit == "ms" else 1e-6)


@pytest.mark.parametrize(
    ("name", "ticks"),
    several(
        [
            *(
                (name, 1e3)
                for name in ("ts_ms", "boot_ms", "Uptime [ms]", "iTOW_ms", "device_time_ms", "elapsed")
            ),
            *(("time_of_day", 1e3), ("tod_s", 1.0), ("seconds_of_week", 1.0)),
        ]
    ),
)
def test_a_loggers_own_clock_is_the_time_where_there_is_no_other(tmp_path: Path, name: str, ticks: float):
    imu, gps = foreign_imu().drop("stamp"), foreign_gps()
    places = gps.with_columns(lat=pl.col("la") * 1e-7, lon=pl.col("lo")).drop("when", "la", "lo")
    imu.with_columns(pl.Series(name, ticks * DRIVE.imu.time)).write_csv(tmp_path / "imu.csv")
    places.with_columns(pl.Series(name, ticks * DRIVE.gps.time)).write_csv(tmp_path / "gps.csv")
    drive = imported(tmp_path).drive
    np.testing.assert_allclose(np.diff(drive.imu.time), np.diff(DRIVE.imu.time), atol=1e-9)
    imu.with_columns(boot_ms=-1.0).write_csv(tmp_path / "imu.csv")  # what does not run is no clock
    with pytest.raises(InputError, match="no column is recognized as the time of the imu"):
        imported(tmp_path)


def test_an_axis_that_points_down_is_told_unless_the_mounting_is(tmp_path: Path):
    foreign_imu().write_csv(tmp_path / "imu.csv")
    gps = foreign_gps()
    gps.with_columns(lat=pl.col("la") * 1e-7, lon=pl.col("lo")).drop("la", "lo").rename(
        {"when": "time"}
    ).write_csv(tmp_path / "gps.csv")
    assert any("acc_z is negative" in note for note in imported(tmp_path).assumed)
    turned = imported(tmp_path, recipe=Recipe(mount="x=x,y=-y"))
    assert not any("is negative" in note for note in (*turned.notes, *turned.assumed))
    foreign_imu(acc_z=DRIVE.imu.az / G).write_csv(tmp_path / "imu.csv")
    plain = imported(tmp_path)
    assert not any("is negative" in note for note in (*plain.notes, *plain.assumed))


def test_one_table_for_all_with_fixes_repeated(tmp_path: Path):
    """A logger that writes the last fix beside each IMU sample: each fix counts once, when it first appears."""
    imu, gps = DRIVE.imu, DRIVE.gps
    held = np.searchsorted(gps.time, imu.time, side="right") - 1
    rows = held >= 0
    table = {
        "t": imu.time,
        "ax": imu.ax,
        "ay": imu.ay,
        "gz": imu.gz,
        "lat": gps.lat[held],
        "lon": gps.lon[held],
    }
    pl.DataFrame(table).filter(pl.Series(rows)).write_csv(tmp_path / "all.csv")
    got = imported(tmp_path / "all.csv")
    np.testing.assert_allclose(got.drive.gps.lat, gps.lat)
    assert np.all((got.drive.gps.time - gps.time >= 0) & (got.drive.gps.time - gps.time < 0.011))
    assert any("the previous position is repeated" in note for note in got.notes)


def test_one_table_for_all_with_empty_cells(tmp_path: Path):
    imu, gps = DRIVE.imu, DRIVE.gps
    both = pl.concat(
        [
            pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}),
            pl.DataFrame({"t": gps.time, "lat": gps.lat, "lon": gps.lon}),
        ],
        how="diagonal",
    ).sort("t")
    both.write_csv(tmp_path / "all.csv")
    got = imported(tmp_path / "all.csv")
    assert_close(got.drive.imu, imu, "time ax ay gz", 1e-12)
    assert_close(got.drive.gps, gps, "time lat lon", 1e-12)


def test_rows_out_of_order_twice_or_without_values_are_told(tmp_path: Path):
    table = foreign_imu()
    shuffled = pl.concat([table[5:10], table[:5], table[9:], table[20:21].with_columns(acc_y=None)])
    shuffled.write_csv(tmp_path / "imu.csv")
    foreign_gps().write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=MAPS)
    assert_close(got.drive.imu, DRIVE.imu, "time ax gz", 1e-12)
    said = " ".join(got.notes)
    assert "the time decreases at 2 rows" in said and "since the time of the previous row is repeated" in said


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda t: t.with_columns(pl.col("acc_y").cast(pl.String)).with_columns(
            acc_y=pl.when(pl.int_range(pl.len()) == 7).then(pl.lit("oops")).otherwise("acc_y")),
         "row 8 of the data, column acc_y: 'oops' is not a number"),
        (lambda t: t.head(0), "no"),
        (lambda t: t.drop("gyro_z"), "'gyro_z', which the table does not have"),
        (lambda t: t.with_columns(gyro_z=None), "gz"),
        (lambda t: t.head(50), "50 samples are too few"),
        (lambda t: t.with_columns(stamp=pl.col("stamp") - 10**15), "do not overlap"),
    ],
)  # fmt: skip
def test_broken(tmp_path: Path, edit, said: str):
    edit(foreign_imu()).write_csv(tmp_path / "imu.csv")
    foreign_gps().write_csv(tmp_path / "gps.csv")
    with pytest.raises(InputError) as caught:
        imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=MAPS)
    assert said in str(caught.value)


@pytest.mark.parametrize(
    "content", [b"", b"\n", b"a\n1\n", b"t,ax\n1,2,3,4\n5\n", b"\x00\xff\xfe" * 99, b"PAR1cut"]
)
def test_not_a_table(tmp_path: Path, content: bytes):
    (tmp_path / "log.csv").write_bytes(content)
    with pytest.raises(InputError) as caught:
        imported(tmp_path / "log.csv")
    assert "log.csv" in str(caught.value)


@pytest.mark.parametrize(
    "content",
    ["mount = 3", "origin = [1, 2]", "other = 1", "imu = 3", "[[imu]]\nxx = 'a'", "= ="],
)
def test_broken_recipe(tmp_path: Path, content: str):
    (tmp_path / "r.toml").write_text(content)
    with pytest.raises(InputError, match=r"r\.toml"):
        Recipe.load(tmp_path / "r.toml")


@pytest.mark.parametrize("entry", ["ax", "zz=1", "gps.ax=1", "wheel.x=1"])
def test_broken_map(tmp_path: Path, entry: str):
    foreign_imu().write_csv(tmp_path / "imu.csv")
    with pytest.raises(InputError, match="--map"):
        imported(tmp_path / "imu.csv", maps=[entry])


def test_a_log_named_for_the_truth_needs_no_name_that_says_so(tmp_path: Path):
    imu, gps, truth = DRIVE.imu, DRIVE.gps, DRIVE.truth
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}).write_csv(tmp_path / "imu.csv")
    pl.DataFrame({"t": gps.time, "x": gps.x, "y": gps.y}).write_csv(tmp_path / "gps.csv")
    sideways = truth.theta + 0.1  # so that it is not the course
    columns = {"t": truth.time, "x": truth.x, "y": truth.y, "vx": truth.vx, "vy": truth.vy, "theta": sideways}
    pl.DataFrame(columns).write_csv(tmp_path / "track.csv")
    got = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", truth=tmp_path / "track.csv").drive
    assert_close(got.truth, truth, "time x y vx vy", 1e-12)
    np.testing.assert_allclose(got.truth.theta, sideways)
    assert got.frame == "enu"


def test_time_is_of_the_sources_tables(tmp_path: Path):
    foreign_imu().write_csv(tmp_path / "imu.csv")
    pl.DataFrame({"t": DRIVE.gps.time, "lat": DRIVE.gps.lat, "lon": DRIVE.gps.lon}).write_csv(
        tmp_path / "gps.csv"
    )
    maps = [entry for entry in MAPS if not entry.startswith(("imu.t", "gps"))]
    time = f"stamp*1e-9 - {EPOCH}"
    got = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=maps, time=time).drive
    assert_close(got.imu, DRIVE.imu, "time", 1e-6)
    assert_close(got.gps, DRIVE.gps, "time", 1e-12)
    mapped = imported(
        tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=[*maps, f"imu.t={time}"], time="stamp"
    ).drive
    assert_close(mapped.imu, DRIVE.imu, "time", 1e-6)


def test_a_map_without_a_table_is_told_which_table_has_its_columns(tmp_path: Path):
    imu, gps = DRIVE.imu, DRIVE.gps
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "odd": imu.gz}).write_csv(
        tmp_path / "my imu.csv"
    )
    pl.DataFrame({"t": gps.time, "x": gps.x, "y": gps.y}).write_csv(tmp_path / "gps.csv")
    with pytest.raises(
        InputError, match=r"gps.csv, my imu.csv\); choose one for gz with --imu-table 'my imu.csv',"
    ):
        imported(tmp_path, maps=["gz=odd"])
    got = imported(tmp_path, maps=["gz=odd"], choice=TableChoice({"imu": "my imu.csv"})).drive
    assert_close(got.imu, imu, "time ax ay gz")
    with pytest.raises(InputError, match=r"choose one for gz with --imu-table TABLE,"):
        imported(tmp_path, maps=["gz=none"])


@needs_shared
def test_a_real_log_is_mended_as_others_mended_it():
    """dresden as it was recorded: wrong signs, deg/s, pitched by 10.5 degrees; against the mended drive."""
    maps = ["ax=-ax", "ay=-ay", "az=-az"]
    got = imported(DRIVES / "dresden-as-recorded", maps=maps, recipe=Recipe(mount="0,10.5,0")).drive
    wanted = read_drive(DRIVES / "dresden")
    for column, least in (("ax", 0.999), ("ay", 0.999), ("az", 0.999), ("gz", 0.999)):
        a = getattr(got.imu, column)[: len(wanted.imu)]
        b = getattr(wanted.imu, column)[: len(a)]
        assert np.corrcoef(a, b)[0, 1] > least, column
    assert abs(np.median(got.imu.az) - np.median(wanted.imu.az)) < 0.01
    assert any("deg/s" in note for note in imported(DRIVES / "dresden-as-recorded").notes)


def of_loggers(kind: str) -> dict[str, pl.DataFrame]:
    """Tables as programs and sensors write them, with the columns of `DRIVE`; by the name of the file."""
    imu, gps = DRIVE.imu, DRIVE.gps
    row = np.clip(np.searchsorted(gps.time, imu.time, side="right") - 1, 0, None)
    new = np.diff(row, prepend=-1) > 0
    six = {n: getattr(imu, n) for n in ("ax", "ay", "az", "gx", "gy", "gz")}
    held = {"lat": gps.lat[row], "lon": gps.lon[row]}
    once = {n: [v if first else None for v, first in zip(held[n], new, strict=True)] for n in held}
    stamp = [datetime.fromtimestamp(EPOCH + t, UTC) for t in imu.time]

    def named(names: str, of: dict[str, Any]) -> dict[str, Any]:
        return dict(zip(names.split(";"), of.values(), strict=True))

    if kind == "SensorLog":
        log = {
            "loggingTime(txt)": [f"{t:%Y-%m-%d %H:%M:%S.%f} +0000" for t in stamp],
            "loggingSample(N)": np.arange(len(imu)),
            **named("locationLatitude(WGS84);locationLongitude(WGS84)", held),
            **named(
                ";".join(f"accelerometerAcceleration{i}(G)" for i in "XYZ"),
                {n: six[n] / 9.80665 for n in ("ax", "ay", "az")},
            ),
            **named(
                ";".join(f"gyroRotation{i}(rad/s)" for i in "XYZ"), {n: six[n] for n in ("gx", "gy", "gz")}
            ),
        }
        return {"stream.csv": pl.DataFrame(log)}
    if kind == "Xsens":
        whole = {
            n: [getattr(t, n) for t in stamp] for n in ("year", "month", "day", "hour", "minute", "second")
        }
        log = {
            "PacketCounter": np.arange(len(imu)),
            **named("UTC_Year;UTC_Month;UTC_Day;UTC_Hour;UTC_Minute;UTC_Second", whole),
            "UTC_Nano": [1000 * t.microsecond for t in stamp],
            **named("Acc_X;Acc_Y;Acc_Z;Gyr_X;Gyr_Y;Gyr_Z", six),
            **named("Latitude;Longitude", once),
        }
        return {"MT_01.csv": pl.DataFrame(log)}
    if kind == "Xsens without UTC":
        log = {
            "PacketCounter": np.arange(len(imu)),
            "SampleTimeFine": np.round(imu.time * 1e4).astype(int),
            **named("Acc_X;Acc_Y;Acc_Z;Gyr_X;Gyr_Y;Gyr_Z", six),
            **named("Latitude;Longitude", once),
        }
        return {"MT_02.csv": pl.DataFrame(log)}
    if kind == "VectorNav":
        log = {
            "TimeStartup": np.round(imu.time * 1e9).astype(int) + 5 * 10**9,
            **named("Accel.X;Accel.Y;Accel.Z;AngularRate.X;AngularRate.Y;AngularRate.Z", six),
            **named("PosLla.Lat;PosLla.Lon", held),
        }
        return {"vn.csv": pl.DataFrame(log)}
    raise ValueError(kind)


@pytest.mark.parametrize("kind", ["SensorLog", "Xsens", "Xsens without UTC", "VectorNav"])
def test_tables_of_known_loggers_need_no_option(tmp_path: Path, kind: str):
    for name, table in of_loggers(kind).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        table.write_csv(tmp_path / name)
    got = imported(tmp_path).drive
    assert_close(got.imu, DRIVE.imu, "ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, DRIVE.gps, "lat lon", 1e-12)
    np.testing.assert_allclose(np.diff(got.imu.time), np.diff(DRIVE.imu.time), atol=2e-6)
    late = (got.gps.time - got.imu.time[0] - (DRIVE.gps.time - DRIVE.imu.time[0]))[1:]
    assert np.all((late > -1e-5) & (late < 0.011))  # a fix in the IMU's rows has their time


def slow_and_fast(*, with_time: bool = True) -> dict[str, Any]:
    """The six axes and the fixes in the IMU's rows, without a time or with one."""
    imu, row = DRIVE.imu, np.clip(np.searchsorted(DRIVE.gps.time, DRIVE.imu.time, side="right") - 1, 0, None)
    table = {n: getattr(imu, n) for n in ("ax", "ay", "az", "gx", "gy", "gz")}
    table |= {"lat": DRIVE.gps.lat[row], "lon": DRIVE.gps.lon[row]}
    return {"t": imu.time, **table} if with_time else table


def test_columns_of_other_quantities_stay_unused(tmp_path: Path):
    """Each of these was once taken for a position or a rate."""
    plain, zero = slow_and_fast(), 0.0 * DRIVE.imu.time
    others = {"v_lat": zero + 1, "v_long": zero + 2, "LatG": zero, "LongG": zero, "roll_rate": zero + 5}
    others |= {"homePoint.latitude": zero + 3, "b_gx": zero, "acc_g_x": zero, "target_ax": zero}
    pl.DataFrame({"t": plain.pop("t"), **others, **plain}).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv").drive
    assert_close(got.imu, DRIVE.imu, "ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, DRIVE.gps, "lat lon", 1e-12)
    pl.DataFrame({"t": DRIVE.imu.time, **others, "ax": zero, "ay": zero}).write_csv(tmp_path / "log.csv")
    with pytest.raises(InputError, match="the IMU has no column for gz"):
        imported(tmp_path / "log.csv")


def write_two(folder: Path, imu: dict[str, Any], gps: dict[str, Any]) -> None:
    pl.DataFrame(imu).write_csv(folder / "imu.csv")
    pl.DataFrame(gps).write_csv(folder / "ublox.csv")


AXES: dict[str, Any] = {
    "t": DRIVE.imu.time,
    **{n: getattr(DRIVE.imu, n) for n in ["ax", "ay", "az", "gx", "gy", "gz"]},
}
FIXES: dict[str, Any] = {"t": DRIVE.gps.time, "lat": DRIVE.gps.lat, "lon": DRIVE.gps.lon}


@pytest.mark.parametrize("prefix", ["Car.", "vehicle/imu/", "imu_", "log 3: "])
def test_a_devices_name_that_all_columns_share_means_nothing(tmp_path: Path, prefix: str):
    write_two(
        tmp_path, {prefix + n: v for n, v in AXES.items()}, {"gnss/1/" + n: v for n, v in FIXES.items()}
    )
    got = imported(tmp_path).drive
    assert_close(got.imu, DRIVE.imu, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, DRIVE.gps, "time lat lon", 1e-12)


@pytest.mark.parametrize(
    ("prefix", "time"),
    [
        *(("Car.", "time"), ("target_", "target_t"), ("imu.bias.", "imu.bias.t"), ("x", "xt")),
        *((f"{p}.", f"{p}.t") for p in ("est", "cam", "v", "a_b", "gps", "target", "ekf.car")),
    ],
)
def test_other_prefixes_are_no_sensor(tmp_path: Path, prefix: str, time: str):
    """Only some names have the prefix, or it may state another quantity, or is no word of its own."""
    table = pl.DataFrame(slow_and_fast())
    names = {name: time if name == "t" else prefix + name for name in table.columns}
    table.rename(names).write_csv(tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"no IMU samples found|the IMU has no column for"):
        imported(tmp_path / "log.csv")


@pytest.mark.parametrize("prefix", ["Car.", "vehicle/", "log 3: ", "data."])
def test_a_prefix_that_imu_and_places_share_means_nothing(tmp_path: Path, prefix: str):
    table = slow_and_fast() | {"alt": 100 + 0 * DRIVE.imu.time}
    pl.DataFrame({prefix + n: v for n, v in table.items()}).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv").drive
    assert_close(got.imu, DRIVE.imu, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, DRIVE.gps, "lat lon", 1e-12)
    assert got.gps.alt is not None


@pytest.mark.parametrize(
    ("prefix", "names", "outside"),
    diagonal(["Car.", "ekf.", "est."], ["lat lon", "x y"], ["", "t", "ax", "gz"]),
)
def test_places_behind_a_shared_prefix_need_the_imu_and_degrees(
    tmp_path: Path, prefix: str, names: str, outside: str
):
    """A filter's output, truth and positions in meters have such names, too; and one name without the prefix."""
    table = slow_and_fast()
    places = dict(zip(names.split(), (table.pop("lat"), table.pop("lon")), strict=True))
    if (prefix, names, outside) == ("Car.", "lat lon", ""):
        table.pop("gz")
    columns = {(n if n == outside else prefix + n): v for n, v in (table | places).items()}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"no (position fixes|IMU samples) found|the IMU has no column for"):
        imported(tmp_path / "log.csv")


OTHERS = ("ekf.", "acc_", "P.", "sensor/", "gt_", "wp_", "vel_", "Car.", "compass_", "delta_", "v.")


@pytest.mark.parametrize(
    ("prefix", "names"),
    quickly(
        product(OTHERS, ["lat lon", "x y"]),
        lambda prefix, names: (at := OTHERS.index(prefix)) < 5 and (names == "x y") == (at % 2 == 1),
    ),
)
def test_places_need_a_receivers_prefix(tmp_path: Path, prefix: str, names: str):
    """Accelerations, estimates, variances, way points and steps have such names, too."""
    columns = dict(zip(("t", *names.split()), FIXES.values(), strict=True))
    write_two(tmp_path, AXES, {prefix + n: v for n, v in columns.items()})
    with pytest.raises(InputError, match="no position fixes found"):
        imported(tmp_path)


ONES = dict.fromkeys("xyz", np.ones(len(DRIVE.imu)))


@pytest.mark.parametrize(
    "form",
    quickly(
        [
            (form,)
            for form in (
                *("{}_acc", "{}Acc", "gps_a{}", "fix_a{}", "imu2_a{}"),
                *("{}_acc [G]", "ac_{}", "GForce{}", "accSmooth_{}"),
            )
        ],
        lambda form: form in ("{}_acc", "fix_a{}", "ac_{}"),
    ),
)
def test_established_names_go_before_others(tmp_path: Path, form: str):
    """Of accuracies, a receiver's acceleration, a second IMU, a motor's currents, and another app's axes."""
    others = {form.format(i): v for i, v in list(ONES.items())[:2]}
    write_two(tmp_path, others | AXES, FIXES)
    assert_close(imported(tmp_path).drive.imu, DRIVE.imu, "ax ay az gx gy gz", 1e-9)
    write_two(tmp_path, AXES | others, FIXES)
    assert_close(imported(tmp_path).drive.imu, DRIVE.imu, "ax ay az gx gy gz", 1e-9)


def test_axes_come_from_one_family_of_names(tmp_path: Path):
    """The prefix imu1 has two axes only, and a plain name of another axis has no prefix."""
    renamed = {f"imu1_{n}": AXES[n] for n in ("ax", "ay", "gx", "gy", "gz")}
    write_two(tmp_path, {"t": AXES["t"], **renamed, **{f"imu2_a{i}": v for i, v in ONES.items()}}, FIXES)
    got = imported(tmp_path).drive.imu
    assert_close(got, DRIVE.imu, "ax ay gx gy gz", 1e-9)
    assert got.az is None
    plain = {n: AXES[n] for n in ("t", "ax", "ay", "gx", "gy", "gz")}
    write_two(tmp_path, {"imu_az": ONES["z"], **plain}, FIXES)
    assert imported(tmp_path).drive.imu.az is None


@pytest.mark.parametrize(
    ("force", "rate"),
    [
        *(("{}acc", "{}gyro"), ("RAW_IMU.{}acc", "RAW_IMU.{}gyro"), ("accSmooth[{}]", "gyroADC[{}]")),
        *(("Ac{}", "w{}"), ("ac_{}", "gyro_{}"), ("GForce{}", "w{}"), ("{}_acc", "gyro{}")),
    ],
)
def test_names_of_counts_and_of_accuracies_need_a_unit(tmp_path: Path, force: str, rate: str):
    def form(text: str, k: int) -> str:
        return text.format(k if "[" in text else "xyz"[k])

    columns = {form(f, k): AXES[s + "xyz"[k]] for f, s in ((force, "a"), (rate, "g")) for k in range(3)}
    write_two(tmp_path, {"t": AXES["t"], **columns}, FIXES)
    with pytest.raises(InputError, match=r"no IMU samples found|the IMU has no column for"):
        imported(tmp_path)


def test_all_six_names_of_an_mpu6050_are_its_counts(tmp_path: Path):
    counts = {f"Ac{i}": np.round(AXES[f"a{i}"] / G * 16384) for i in "xyz"}
    counts |= {f"Gy{i}": np.round(np.degrees(AXES[f"g{i}"]) * 131) for i in "xyz"}
    write_two(tmp_path, {"t": AXES["t"], **counts}, FIXES)
    with pytest.raises(InputError, match=r"'Acz' contain raw counts.*Acx\*9.80665/16384"):
        imported(tmp_path)


@pytest.mark.parametrize(
    ("name", "scale"), [("vitesse (km/h)", 3.6), ("vitesse", 1.0), ("Geschwindigkeit", 1.0)]
)
def test_a_speed_in_another_language_without_a_unit_is_in_m_per_s(tmp_path: Path, name: str, scale: float):
    write_two(tmp_path, AXES, FIXES | {name: DRIVE.gps.speed * scale})
    got = imported(tmp_path)
    assert_close(got.drive.gps, DRIVE.gps, "speed", 1e-9)
    said = f'{name} is read as m/s; if it is in km/h, write --map "gps.speed={name}/3.6"'
    assert (said in got.notes) == (scale == 1.0)


def test_derivatives_are_no_positions(tmp_path: Path):
    others = {"ẋ": DRIVE.gps.x * 0.1, "ÿ": DRIVE.gps.y * 0.1}
    write_two(tmp_path, AXES, {"t": DRIVE.gps.time, **others, "x": DRIVE.gps.x, "y": DRIVE.gps.y})
    got = imported(tmp_path).drive.gps
    np.testing.assert_allclose(np.diff(got.x), np.diff(DRIVE.gps.x), atol=1e-9)


@pytest.mark.parametrize("name", ["temps", "Chip Time"])
def test_temperatures_and_unset_clocks_are_no_times(tmp_path: Path, name: str):
    write_two(tmp_path, {name: 30 + 0.01 * np.arange(len(DRIVE.imu)), **AXES}, FIXES)
    assert_close(imported(tmp_path).drive.imu, DRIVE.imu, "time", 1e-9)


@pytest.mark.parametrize("scale", [1.0, 1e7])
def test_the_size_of_places_of_mavlink_decides_on_the_unit(tmp_path: Path, scale: float):
    """Some tools convert them to degrees, and then also convert the altitudes and speeds."""
    places = {f"GPS_RAW_INT.{n}": np.round(FIXES[n] * scale, 9) for n in ("lat", "lon")}
    gps = {"t": FIXES["t"], **places, "GPS_RAW_INT.alt": DRIVE.gps.alt, "GPS_RAW_INT.vel": DRIVE.gps.speed}
    write_two(tmp_path, AXES, gps)
    got = imported(tmp_path).drive.gps
    assert_close(got, DRIVE.gps, "lat lon", 1e-7)
    assert got.alt is None
    assert got.speed is None


NAMED = {
    "MAVLink": (
        "SCALED_IMU2.{}acc;SCALED_IMU2.{}gyro;GPS_RAW_INT.lat;GPS_RAW_INT.lon",
        (1000 / G, 1000.0, 1e7, 1e7),
    ),
    "Physics Toolbox": ("gF{};w{};Latitude;Longitude", (1 / G, 1.0, 1.0, 1.0)),
    "blackbox_decode": ("accSmooth[{}] (m/s/s);gyroADC[{}] (deg/s);lat;lon", (1.0, 180 / np.pi, 1.0, 1.0)),
    "German": (
        "Beschleunigung {} [m/s²];Drehrate {} [°/s];Breitengrad;Längengrad",
        (1.0, 180 / np.pi, 1.0, 1.0),
    ),
    "Spanish": ("Aceleración {};Giroscopio {};Latitud;Longitud", (1.0, 1.0, 1.0, 1.0)),
    "RaceChrono": ("{}_acc [G];{}_rate_of_rotation [deg/s];lat;lon", (1 / G, 180 / np.pi, 1.0, 1.0)),
    "two units": ("imu1_a{};imu1_g{};lat;lon", (1.0, 1.0, 1.0, 1.0)),
    "units before axes": ("acc_mg_{};gyro_dps_{};lat;lon", (1000 / G, 180 / np.pi, 1.0, 1.0)),
    "units as words": ("Acc_{}_cms2;Gyro_{}_radpersec;lat;lon", (100.0, 1.0, 1.0, 1.0)),
    "the unit g's": ("Accel {} (g's);Gyro {} (deg/sec);lat;lon", (1 / G, 180 / np.pi, 1.0, 1.0)),
}


@pytest.mark.parametrize("kind", NAMED)
def test_more_names_of_columns(tmp_path: Path, kind: str):
    """A linear acceleration and a second IMU come after the columns that are read."""
    forms, (force, rate, lat, lon) = NAMED[kind][0].split(";"), NAMED[kind][1]
    table, columns = slow_and_fast(), {}
    for form, letter, scale in ((forms[0], "a", force), (forms[1], "g", rate)):
        for k, i in enumerate("xyz"):
            axis = k if "[{}]" in form else i
            columns[form.format(axis)] = table[f"{letter}{i}"] * scale
    places = {forms[2]: np.round(table["lat"] * lat, 8), forms[3]: np.round(table["lon"] * lon, 8)}
    linear = ("ax", "ay", "az") if kind == "Physics Toolbox" else ()
    later = dict.fromkeys((*linear, "imu2_ax", "imu2_gz"), 0.0 * table["ax"])
    pl.DataFrame({"Zeit": table["t"], **columns, **places, **later}).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv")
    assert_close(got.drive.imu, DRIVE.imu, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.drive.gps, DRIVE.gps, "lat lon", 1e-7)
    assert not any("negative" in note for note in got.notes)


def test_the_sign_of_an_axis_without_gravity_means_nothing(tmp_path: Path):
    table = pl.DataFrame(slow_and_fast()).with_columns(
        az=pl.Series(DRIVE.imu.az - np.median(DRIVE.imu.az) - 0.01)
    )
    table.write_csv(tmp_path / "log.csv")
    assert not any("negative" in note for note in imported(tmp_path / "log.csv").notes)


@pytest.mark.parametrize("name", some(["fix", "fix_type", "GPS_fixType", "fixQuality"]))
def test_rows_without_a_fix_are_left_out(tmp_path: Path, name: str):
    imu, gps = DRIVE.imu, DRIVE.gps
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}).write_csv(tmp_path / "imu.csv")
    lost = np.arange(len(gps)) < 5
    lat, kind = gps.lat + np.where(lost, 0.02, 0.0), np.where(lost, 0, 3)
    pl.DataFrame({"t": gps.time, "lat": lat, "lon": gps.lon, name: kind}).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path)
    assert_close(got.drive.gps, gps.select(slice(5, None)), "time lat lon", 1e-12)
    assert any("5 of" in note and "is not true" in note for note in got.notes)
    tenth = np.arange(len(gps)) % 10
    for other, count in (
        (0 * kind, len(gps)),
        (tenth + 1, len(gps)),
        (tenth - 1, len(gps) - np.sum(tenth == 0)),
    ):
        columns = {"t": gps.time, "lat": gps.lat, "lon": gps.lon, name: other}
        pl.DataFrame(columns).write_csv(tmp_path / "gps.csv")
        assert len(imported(tmp_path).drive.gps) == count


@pytest.mark.parametrize("code", [1, 2])
def test_flags_that_are_0_for_good_fixes_are_reported_with_the_way(tmp_path: Path, code: int):
    """Some flags are 1 only for fixed ambiguities; in ROS 0 is a fix, and 2 one with corrections."""
    imu, gps = DRIVE.imu, DRIVE.gps
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}).write_csv(tmp_path / "imu.csv")
    best = np.arange(len(gps)) % 2 == 0
    columns = {"t": gps.time, "lat": gps.lat, "lon": gps.lon, "fix": np.where(best, code, 0)}
    pl.DataFrame(columns).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path)
    assert len(got.drive.gps) == len(gps)
    (said,) = [note for note in got.notes if "fix > 0 is not true for them" in note]
    assert len(imported(tmp_path, maps=[said.split('"')[1]]).drive.gps) == best.sum()


@pytest.mark.parametrize("shift", [0, 1])
def test_flags_in_rows_of_held_positions(tmp_path: Path, shift: int):
    """Flags of new fixes drop the rows that repeat one, but not if they are in other rows than the fixes."""
    imu, gps = DRIVE.imu, DRIVE.gps
    row = np.searchsorted(gps.time, imu.time + 1e-9, side="right") - 1
    new, known = np.diff(row, prepend=-1) > 0, row >= 0
    place = {name: np.where(known, getattr(gps, name)[row], np.nan) for name in ("lat", "lon")}
    columns = {
        "t": imu.time,
        "ax": imu.ax,
        "ay": imu.ay,
        "gz": imu.gz,
        **place,
        "fix": np.roll(new, shift) * 1,
    }
    pl.DataFrame(columns).with_columns(pl.col("lat", "lon").fill_nan(None)).write_csv(tmp_path / "log.csv")
    got = imported(tmp_path / "log.csv").drive.gps
    np.testing.assert_allclose(got.time, imu.time[new], atol=1e-9)


def test_flags_in_rows_without_positions_select_nothing(tmp_path: Path):
    imu, gps = DRIVE.imu, DRIVE.gps
    place = pl.DataFrame({"t": gps.time, "lat": gps.lat, "lon": gps.lon})
    flags = pl.DataFrame({"t": gps.time + 0.003, "fix_type": np.where(gps.time < 2, 0, 3)})
    moves = pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz})
    pl.concat([moves, place, flags], how="diagonal").sort("t").write_csv(tmp_path / "log.csv")
    assert len(imported(tmp_path / "log.csv").drive.gps) == len(gps)


def test_messages_as_ros2_topic_echo_prints_them(tmp_path: Path):
    """Tables of 40 and 18 values without names; a table without the unit quaternion has none."""
    imu, gps = DRIVE.imu, DRIVE.gps
    zeros = [0.0] * 9

    def rows(time: Any, name: str, *columns: Any) -> str:
        stamps = [divmod(round(t * 1e9) + EPOCH * 10**9, 10**9) for t in time.tolist()]
        cells = zip(stamps, *columns, strict=True)
        return "\n".join(",".join(map(str, [*stamp, name, *np.hstack(rest)])) for stamp, *rest in cells)

    rates, forces = (np.column_stack([getattr(imu, letter + i) for i in "xyz"]) for letter in "ga")
    status, place = np.tile([0, 1], (len(gps), 1)), np.column_stack([gps.lat, gps.lon, gps.alt])
    (tmp_path / "fix.csv").write_text(rows(gps.time, "gps", status, place, [[*zeros, 2]] * len(gps)))
    for turn in (0.5, 1.0):
        parts = (
            [[0.0, 0.0, 0.0, turn, *zeros]] * len(imu),
            rates,
            [zeros] * len(imu),
            forces,
            [zeros] * len(imu),
        )
        (tmp_path / "imu.csv").write_text(rows(imu.time, "imu", *parts))
        if turn != 1.0:
            with pytest.raises(InputError, match=r"imu.csv: has no header; its columns are called c1 to c40"):
                imported(tmp_path)
    got = imported(tmp_path).drive
    assert_close(got.imu, imu, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, gps, "time lat lon alt", 1e-9)


@pytest.mark.parametrize(("name", "scale"), [("millis", 1e3), ("timestamp", 1.0), ("t", 1.0)])
def test_a_finer_time_goes_before_six_columns_of_a_date(tmp_path: Path, name: str, scale: float):
    stamp = [datetime.fromtimestamp(EPOCH + t, UTC) for t in DRIVE.imu.time]
    parts = ("year", "month", "day", "hour", "minute", "second")
    dates = {n: [getattr(t, n) for t in stamp] for n in parts}
    table = {**dates, name: np.round(DRIVE.imu.time * scale, 3), **slow_and_fast(with_time=False)}
    pl.DataFrame(table).write_csv(tmp_path / "log.csv")
    result = imported(tmp_path / "log.csv")
    assert (
        result.recipe.roles["imu"][0].columns["t"].split("*")[0] == name
    )  # whole seconds, spread, would agree, too
    got = result.drive.imu.time
    np.testing.assert_allclose(got - got[0], DRIVE.imu.time - DRIVE.imu.time[0], atol=1.1e-3)


def test_accelerations_of_a_receiver_do_not_change_its_unit_of_time(tmp_path: Path):
    imu = pl.DataFrame(slow_and_fast()).drop("lat", "lon")
    imu.write_csv(tmp_path / "imu.csv")
    second = np.arange(0.0, DRIVE.imu.time[-1], 0.5)
    at = {n: np.interp(second, DRIVE.gps.time, getattr(DRIVE.gps, n)) for n in ("lat", "lon")}
    pl.DataFrame({"t": second, **at, "ax": 0 * second, "ay": 0 * second}).write_csv(tmp_path / "gps.csv")
    np.testing.assert_allclose(np.diff(imported(tmp_path).drive.gps.time), 0.5)


def test_tables_in_folders_below_are_named(tmp_path: Path):
    for name in ("imu0", "gps0"):
        (tmp_path / "mav0" / name).mkdir(parents=True)
        (tmp_path / "mav0" / name / "rows.csv").write_text("t,x\n0,1\n")
    with pytest.raises(
        InputError,
        match=r"\(mav0/gps0, mav0/imu0\); import one file, such as .*/mav0/gps0/rows.csv, .* with --gps",
    ):
        imported(tmp_path)


@pytest.mark.parametrize("begin", ["", "mav0"])
def test_a_folder_like_eurocs(tmp_path: Path, begin: str):
    imu, gps = foreign_imu()["stamp"], np.round(DRIVE.gps.time * 1e9).astype(np.int64) + EPOCH * 10**9
    rates = {f"w_RS_S_{i} [rad s^-1]": getattr(DRIVE.imu, f"g{i}") for i in "xyz"}
    forces = {f"a_RS_S_{i} [m s^-2]": getattr(DRIVE.imu, f"a{i}") for i in "xyz"}
    place = {"latitude [deg]": DRIVE.gps.lat, "longitude [deg]": DRIVE.gps.lon}
    tables = {
        "imu0": (imu, rates | forces),
        "gps0": (gps, place),
        "cam0": (gps, {"filename": ["1.png"] * len(gps)}),
    }
    for name, (time, columns) in tables.items():
        (tmp_path / begin / name).mkdir(parents=True)
        pl.DataFrame({"#timestamp [ns]": time, **columns}).write_csv(tmp_path / begin / name / "data.csv")
    got = imported(tmp_path).drive
    assert_close(got.imu, DRIVE.imu, "time ax ay az gx gy gz", 1e-9)
    assert_close(got.gps, DRIVE.gps, "time lat lon", 1e-9)
    with pytest.raises(InputError, match=r"imu0/data.csv: contains more than 100 rows"):
        imported(tmp_path, limits=Limits(rows=100))


@pytest.mark.parametrize("end", [",7", ""])
def test_rows_of_several_kinds_are_refused_with_the_way(tmp_path: Path, end: str):
    rows = [
        f"IMU,{k},1,2,9.8" if k % 10 else f"GPS,{k},50.1,8.2{',100' if end else ','}{end}" for k in range(200)
    ]
    (tmp_path / "log.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(
        InputError, match=r"rows of several kinds \(GPS, IMU\); .* awk .* log.csv, and import"
    ):
        imported(tmp_path / "log.csv")


def test_of_folders_with_whole_logs_the_folder_is_named(tmp_path: Path):
    for day in ("monday", "tuesday"):
        (tmp_path / day).mkdir()
        write_two(tmp_path / day, AXES, FIXES)
    with pytest.raises(InputError, match=r"\(monday, tuesday\); import each log, for example ") as caught:
        imported(tmp_path)
    assert_close(
        imported(Path(str(caught.value).rpartition(" example ")[2])).drive.gps, DRIVE.gps, "lat", 1e-12
    )


def test_folders_of_days_are_not_mixed(tmp_path: Path):
    imu, gps = DRIVE.imu, DRIVE.gps
    tables = {
        "day1": {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz},
        "day2": {"t": gps.time, "x": gps.x},
    }
    for day, table in tables.items():
        (tmp_path / day).mkdir()
        pl.DataFrame(table).write_csv(tmp_path / day / "data.csv")
    with pytest.raises(InputError, match=r"\(day1, day2\); import one"):
        imported(tmp_path)


def test_a_row_without_a_fix_is_no_kind_of_its_own(tmp_path: Path):
    gps = [
        f"A,{t:.2f},{lat:.9f},{lon:.9f}"
        for t, lat, lon in zip(DRIVE.gps.time, DRIVE.gps.lat, DRIVE.gps.lon, strict=True)
    ]
    (tmp_path / "gps.csv").write_text("\n".join([*gps[:3], "V,0.5,,", *gps[3:]]) + "\n")
    imu = pl.DataFrame({a: getattr(DRIVE.imu, a) for a in ("time", "ax", "ay", "gz")})
    imu.write_csv(tmp_path / "imu.csv")
    maps = ["gps.t=c2", "gps.lat=c3", "gps.lon=c4"]
    got = imported(tmp_path / "imu.csv", gps=tmp_path / "gps.csv", maps=maps)
    assert_close(got.drive.gps, DRIVE.gps, "lat lon", 1e-8)


def test_a_short_name_of_the_speed_is_read():
    (name,) = read_names(["spd_kn"])
    assert name.meaning == "speed" and name.unit is not None and name.unit.text == "kn"


def test_a_log_without_a_gyro_is_named(tmp_path: Path):
    imu = DRIVE.imu
    pl.DataFrame({"t": imu.time, "ax": imu.ax, "ay": imu.ay, "az": imu.az}).write_csv(tmp_path / "log.csv")
    with pytest.raises(InputError, match=r"the IMU has no column for gz \(the yaw rate\); .*--map"):
        imported(tmp_path / "log.csv")


def test_a_track_beside_the_tables_is_named(tmp_path: Path):
    imu = DRIVE.imu
    table = {"t": imu.time, "ax": imu.ax, "ay": imu.ay, "gz": imu.gz}
    pl.DataFrame(table).write_csv(tmp_path / "imu.csv")
    (tmp_path / "ride.gpx").write_text("<gpx/>")
    with pytest.raises(
        InputError, match=r"no position fixes .* ride.gpx is not read, since it is a track; .* gpsbabel"
    ):
        imported(tmp_path)
