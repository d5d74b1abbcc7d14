"""Truth in the table of the IMU and the fixes, and the options that choose a table of truth."""

import re
import shlex
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import ORIGIN, a_drive, imported
from importing.test_phones import sensor_logger
from sigmaswarm.errors import InputError
from sigmaswarm.geodesy import enu_to_geodetic
from sigmaswarm.importing.source import TableChoice

DRIVE = a_drive()
IMU, GPS, TRUTH = DRIVE.imu, DRIVE.gps, DRIVE.truth
assert TRUTH is not None
AXES = {name: getattr(IMU, name) for name in ("ax", "ay", "gz")}
TRUE = {n: np.interp(IMU.time, TRUTH.time, getattr(TRUTH, n)) for n in ("x", "y")}


def placed(values: dict[str, np.ndarray]) -> pl.DataFrame:
    return pl.DataFrame({"t": GPS.time - IMU.time[0], **values})


def one_table(path: Path, fixes: tuple[str, str], truth: tuple[str, str]) -> Path:
    """Write one row per IMU sample; cells of fixes are empty except in the row of the fix."""
    rows = np.searchsorted(IMU.time, GPS.time).clip(max=len(IMU) - 1)
    cells = {name: np.full(len(IMU), np.nan) for name in fixes}
    for name, column in zip(fixes, (GPS.x, GPS.y), strict=True):
        cells[name][rows] = column
    true = dict(zip(truth, TRUE.values(), strict=True))
    table = pl.DataFrame({"time": IMU.time - IMU.time[0], **AXES, **cells, **true}).fill_nan(None)
    table.write_csv(path)
    return path


@pytest.mark.parametrize(
    ("fixes", "truth"),
    [
        (("gps_x", "gps_y"), ("truth_x", "truth_y")),
        (("gnss_e", "gnss_n"), ("true_x", "true_y")),
        (("x", "y"), ("gt.x", "gt.y")),
        (("gps_x", "gps_y"), ("x_gt", "y_gt")),
        (("gps_x", "gps_y"), ("ground_truth_x", "ground_truth_y")),
        (("gps_x", "gps_y"), ("truth_pos_e", "truth_pos_n")),
    ],
)
def test_prefixes_separate_fixes_and_truth(tmp_path: Path, fixes: tuple[str, str], truth: tuple[str, str]):
    drive = imported(one_table(tmp_path / "log.csv", fixes, truth)).drive
    assert drive.truth is not None
    np.testing.assert_allclose(drive.truth.x, TRUE["x"], atol=1e-6)
    np.testing.assert_allclose(drive.truth.y, TRUE["y"], atol=1e-6)
    assert len(drive.gps) > 0.9 * len(GPS)
    assert np.isin(np.round(drive.gps.x, 9), np.round(GPS.x, 9)).all()


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (("x_ref", "y_ref"), "setpoint"),
        (("ref_x", "ref_y"), "setpoint"),
        (("my_x", "my_y"), "no word for truth"),
    ],
)
def test_other_words_mark_no_truth(tmp_path: Path, names: tuple[str, str], why: str):
    assert imported(one_table(tmp_path / "log.csv", ("gps_x", "gps_y"), names)).drive.truth is None, why


def test_the_note_on_a_possible_setpoint_tells_how_to_read_a_truth(tmp_path: Path):
    path = one_table(tmp_path / "log.csv", ("gps_x", "gps_y"), ("ref_east", "ref_north"))
    (note,) = [note for note in imported(path).notes if "may be setpoints" in note]
    truth = imported(path, maps=shlex.split(note.partition("--map ")[2])).drive.truth
    assert truth is not None
    np.testing.assert_allclose(truth.x, TRUE["x"], atol=1e-6)
    np.testing.assert_allclose(truth.y, TRUE["y"], atol=1e-6)


def test_a_table_of_truth_that_is_not_read_is_named(tmp_path: Path):
    one_table(tmp_path / "log.csv", ("gps_x", "gps_y"), ("u", "v"))
    placed({"u": GPS.x, "v": GPS.y}).write_csv(tmp_path / "truth.csv")
    assert any("truth.csv is not used as truth" in note for note in imported(tmp_path).notes)
    maps = ["truth.t=t", "truth.x=u", "truth.y=v"]
    got = imported(tmp_path, maps=maps, choice=TableChoice({"truth": "truth.csv"}))
    assert got.drive.truth is not None
    assert not any("is not used as truth" in note for note in got.notes)


def test_copies_of_the_fixes_are_no_truth(tmp_path: Path):
    path = one_table(tmp_path / "log.csv", ("gps_x", "gps_y"), ("u", "v"))
    copies = {f"gt_{name}": pl.col(f"gps_{name}").forward_fill() for name in "xy"}
    pl.read_csv(path, infer_schema_length=None).with_columns(**copies).write_csv(path)
    got = imported(path)
    assert got.drive.truth is None
    assert [note for note in got.notes if "gt_x and gt_y are not used as truth" in note]


def test_the_position_of_a_reference_station_is_no_truth(tmp_path: Path):
    path = one_table(tmp_path / "log.csv", ("gps_x", "gps_y"), ("u", "v"))
    station = {f"ref_{name}": pl.lit(value) for name, value in (("x", 10.0), ("y", 20.0))}
    pl.read_csv(path, infer_schema_length=None).with_columns(**station).write_csv(path)
    assert imported(path).drive.truth is None


def test_coordinates_from_the_center_of_the_earth_are_no_meters_east_and_north(tmp_path: Path):
    enu = np.column_stack([GPS.x, GPS.y, np.zeros(len(GPS))])
    lat, lon = np.radians(enu_to_geodetic(enu, ORIGIN)[:, :2].T)
    radius = 6378137 / np.sqrt(1 - 0.00669438 * np.sin(lat) ** 2)
    x, y, z = (
        radius * np.cos(lat) * np.cos(lon),
        radius * np.cos(lat) * np.sin(lon),
        radius * 0.99330562 * np.sin(lat),
    )
    path = tmp_path / "imu.csv"
    pl.DataFrame({"t": IMU.time, **AXES}).write_csv(path)
    pl.DataFrame({"t": GPS.time, "gps_x": x, "gps_y": y, "gps_z": z}).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path).drive.gps
    assert np.ptp(got.x) == pytest.approx(np.ptp(GPS.x), rel=1e-3)
    assert np.ptp(got.y) == pytest.approx(np.ptp(GPS.y), rel=1e-3)


def folder_of(tmp_path: Path, fixes: str, truth: str) -> Path:
    """Write tables of the IMU, of fixes and of truth, of which the last two have the same columns."""
    pl.DataFrame({"t": IMU.time - IMU.time[0], **AXES}).write_csv(tmp_path / "imu.csv")
    placed({"x": GPS.x, "y": GPS.y}).write_csv(tmp_path / fixes)
    true = {n: np.interp(GPS.time, TRUTH.time, getattr(TRUTH, n)) for n in ("x", "y")}
    placed(true).write_csv(tmp_path / truth)
    return tmp_path


@pytest.mark.parametrize(("fixes", "truth"), [("a.csv", "b.csv"), ("b.csv", "a.csv")])
def test_a_chosen_truth_is_not_also_used_as_fixes(tmp_path: Path, fixes: str, truth: str):
    drive = imported(folder_of(tmp_path, fixes, truth), choice=TableChoice({"truth": truth})).drive
    assert drive.truth is not None and len(drive.gps) == len(GPS)
    np.testing.assert_allclose(drive.gps.x, GPS.x, atol=1e-9)
    assert np.std(drive.truth.x - drive.gps.x[: len(drive.truth)]) > 0.3


def refused(source: Path, truth: str) -> Path:
    """Choose a table of truth that the log does not contain; return the log of the proposed --truth."""
    with pytest.raises(InputError, match="has no table") as caught:
        imported(source, choice=TableChoice({"truth": truth}))
    found = re.search(r"write --truth (.*)$", str(caught.value))
    assert found
    (path,) = shlex.split(found[1])
    return Path(path)


def test_a_file_is_refused_as_a_table_and_the_remedy_reads_it(tmp_path: Path):
    folder = folder_of(tmp_path, "gps.csv", "good.csv")
    truth = refused(folder / "imu.csv", "good.csv")
    drive = imported(folder / "imu.csv", gps=folder / "gps.csv", truth=truth).drive
    assert drive.truth is not None and len(drive.truth) == len(GPS)


def test_a_format_with_fixed_tables_does_not_ignore_a_chosen_table(tmp_path: Path):
    folder = sensor_logger(tmp_path / "export", "android")
    (folder / "truth.csv").write_text((folder / "Location.csv").read_text())
    truth = refused(folder, "truth.csv")
    assert imported(folder, truth=truth).drive.truth is not None
    with pytest.raises(InputError, match=r"choose from .*Location\.csv"):
        imported(folder, choice=TableChoice({"truth": "nothing.csv"}))
    drive = imported(folder, choice=TableChoice({"truth": "Location.csv"})).drive
    assert drive.truth is not None
    np.testing.assert_allclose(drive.truth.x[: len(drive.gps)], drive.gps.x, atol=1e-6)


@pytest.mark.parametrize("in_degrees", [False, True])
def test_a_magnetometer_whose_table_has_no_name_is_no_position(tmp_path: Path, in_degrees: bool):
    pl.DataFrame({"t": IMU.time, **AXES}).write_csv(tmp_path / "imu.csv")
    heading = np.interp(IMU.time, TRUTH.time, np.unwrap(TRUTH.theta))
    field = {"x": 22 * np.cos(heading), "y": -22 * np.sin(heading), "z": np.full(len(IMU), -42.0)}
    pl.DataFrame({"t": IMU.time, **field}).write_csv(tmp_path / "m.csv")
    fixes = {"lat": GPS.lat, "lon": GPS.lon} if in_degrees else {"x": GPS.x, "y": GPS.y}
    pl.DataFrame({"t": GPS.time, **fixes}).write_csv(tmp_path / "p.csv")
    got = imported(tmp_path)
    assert np.ptp(got.drive.gps.x) == pytest.approx(np.ptp(GPS.x), rel=1e-3)
    assert not [note for note in got.notes if "m.csv" in note]


@pytest.mark.parametrize("names", ["tx ty tz qx qy qz qw", "x y z qx qy qz qw"])
def test_poses_as_of_tum_are_a_truth(tmp_path: Path, names: str):
    placed({"lat": GPS.lat, "lon": GPS.lon}).write_csv(tmp_path / "gps.csv")
    pl.DataFrame({"t": IMU.time - IMU.time[0], **AXES}).write_csv(tmp_path / "imu.csv")
    zeros = np.zeros(len(IMU))
    rows = np.column_stack([IMU.time - IMU.time[0], TRUE["x"], TRUE["y"], *[zeros] * 4, zeros + 1])
    np.savetxt(tmp_path / "groundtruth.txt", rows, fmt="%.9f", header=f"timestamp {names}")
    truth = imported(tmp_path).drive.truth
    assert truth is not None
    np.testing.assert_allclose(truth.x, TRUE["x"], atol=1e-6)
