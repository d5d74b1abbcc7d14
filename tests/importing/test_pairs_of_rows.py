"""Tables in which several rows, or one text, contain a fix: GGA and RMC with the same time; POINT (lon lat)."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import EPOCH, a_drive, assert_close, imported

DRIVE = a_drive()
IMU, GPS = DRIVE.imu, DRIVE.gps
COURSE = (90 - np.degrees(GPS.course)) % 360


def imu_table(folder: Path) -> None:
    axes = {name: getattr(IMU, name) for name in ("ax", "ay", "az", "gx", "gy", "gz")}
    pl.DataFrame({"t": IMU.time + EPOCH, **axes}).write_csv(folder / "imu.csv")


@pytest.mark.parametrize("order", ["gga first", "rmc first"])
@pytest.mark.parametrize("digits", [9, 5], ids=["same position", "rounded position"])
def test_two_rows_of_a_fix_are_joined(tmp_path: Path, order: str, digits: int):
    imu_table(tmp_path)
    row = pl.DataFrame({"time": GPS.time + EPOCH, "row": range(len(GPS))})
    gga = row.with_columns(type=pl.lit("GGA"), lat=GPS.lat, lon=GPS.lon, alt=GPS.alt)
    rmc = row.with_columns(
        type=pl.lit("RMC"),
        lat=np.round(GPS.lat, digits if order == "gga first" else 9),
        lon=np.round(GPS.lon, digits if order == "gga first" else 9),
        speed=GPS.speed,
        course=COURSE,
    )
    if order == "rmc first":
        gga = gga.with_columns(pl.col("lat", "lon").round(digits))
    pair = [gga, rmc] if order == "gga first" else [rmc, gga]
    both = pl.concat(pair, how="diagonal").sort("row", maintain_order=True).drop("row")
    both.write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path).drive.gps
    assert_close(got, GPS, "lat lon", 1e-8)
    assert_close(got, GPS, "alt speed", 1e-6)
    assert np.abs(np.exp(1j * got.course) - np.exp(1j * GPS.course)).max() < 1e-6


def test_two_receivers_are_not_one(tmp_path: Path):
    """Rows with the same time and positions 5 m apart are two measurements, although only one has an altitude."""
    imu_table(tmp_path)
    row = pl.DataFrame({"time": GPS.time + EPOCH, "row": range(len(GPS))})
    first = row.with_columns(receiver=pl.lit("a"), lat=GPS.lat, lon=GPS.lon, alt=GPS.alt)
    second = row.with_columns(receiver=pl.lit("b"), lat=GPS.lat + 5e-5, lon=GPS.lon)
    both = pl.concat([first, second], how="diagonal").sort("row", maintain_order=True).drop("row")
    both.write_csv(tmp_path / "gps.csv")
    assert not [note for note in imported(tmp_path).notes if "the previous position is repeated" in note]


@pytest.mark.parametrize("column", ["geom", "position"])
@pytest.mark.parametrize("form", ["POINT ({} {})", "POINT({} {})", "SRID=4326;POINT Z ({} {} 100.0)"])
def test_points_in_well_known_text(tmp_path: Path, column: str, form: str):
    imu_table(tmp_path)
    points = [
        form.format(repr(float(lon)), repr(float(lat))) for lat, lon in zip(GPS.lat, GPS.lon, strict=True)
    ]
    pl.DataFrame({"t": GPS.time + EPOCH, column: points}).write_csv(tmp_path / "gps.csv")
    assert_close(imported(tmp_path).drive.gps, GPS, "lat lon", 1e-9)


def test_points_in_meters_and_a_row_without_a_point(tmp_path: Path):
    imu_table(tmp_path)
    points: list[str | None] = [
        f"POINT ({x + 5e5!r} {y + 5e6!r})" for x, y in zip(GPS.x.tolist(), GPS.y.tolist(), strict=True)
    ]
    points[0] = None
    pl.DataFrame({"t": GPS.time + EPOCH, "geom": points}).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path).drive.gps
    assert len(got) == len(GPS) - 1
    np.testing.assert_allclose(np.diff(got.x), np.diff(GPS.x[1:]), atol=1e-6)


@pytest.mark.parametrize("scale", [1.0, 0.25, 0.02])
def test_points_of_a_small_site_are_no_degrees(tmp_path: Path, scale: float):
    imu_table(tmp_path)
    x, y = scale * GPS.x + 3, scale * GPS.y + 2
    points = [f"POINT ({east!r} {north!r})" for east, north in zip(x.tolist(), y.tolist(), strict=True)]
    pl.DataFrame({"t": GPS.time + EPOCH, "geom": points}).write_csv(tmp_path / "gps.csv")
    np.testing.assert_allclose(np.diff(imported(tmp_path).drive.gps.x), np.diff(x), atol=1e-6)


@pytest.mark.parametrize("empty", ["POINT EMPTY", "POINT Z EMPTY", "POINT (NaN NaN)"])
def test_a_log_may_begin_without_a_point(tmp_path: Path, empty: str):
    imu_table(tmp_path)
    points = [
        f"POINT Z ({lon!r} {lat!r} 9.5)" for lat, lon in zip(GPS.lat.tolist(), GPS.lon.tolist(), strict=True)
    ]
    pl.DataFrame({"t": GPS.time + EPOCH, "geom": [empty, empty, *points[2:]]}).write_csv(tmp_path / "gps.csv")
    got = imported(tmp_path)
    np.testing.assert_allclose(got.drive.gps.lat, GPS.lat[2:], rtol=0, atol=1e-9)
    assert not [note for note in got.notes if "several numbers" in note]


@pytest.mark.parametrize(
    ("column", "read"), [("gt_geom", True), ("ground_truth_point", True), ("geom_gt", False)]
)
def test_points_of_a_truth_are_no_fixes(tmp_path: Path, column: str, read: bool):
    imu_table(tmp_path)
    points = [
        f"POINT ({lon!r} {lat + 1e-4!r})" for lat, lon in zip(GPS.lat.tolist(), GPS.lon.tolist(), strict=True)
    ]
    fixes = {"gps_lat": GPS.lat, "gps_lon": GPS.lon}
    pl.DataFrame({"t": GPS.time + EPOCH, **fixes, column: points}).write_csv(tmp_path / "gps.csv")
    drive = imported(tmp_path).drive
    assert_close(drive.gps, GPS, "lat lon", 1e-9)
    assert (drive.truth is not None) == read
