"""Writing: exact bits when read again, reproducible bytes, and no incomplete or lost files."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sigmaswarm.drives import checks, writer
from sigmaswarm.drives.drive import Drive, Gps, Imu, Truth
from sigmaswarm.drives.reader import read_drive
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import DriveError, DriveWarning, InputError
from sigmaswarm.simulation import simulate
from support import DRIVES, assert_same, drive_variants, make_drive, needs_shared


@pytest.mark.parametrize("kind", drive_variants())
def test_round_trip_keeps_every_bit(tmp_path: Path, kind: str):
    drive = drive_variants()[kind]
    assert_same(read_drive(write_drive(drive, tmp_path / "d")), drive)


def test_columns_are_those_of_the_format(tmp_path: Path):
    def header(drive: Drive, file: str) -> str:
        return (write_drive(drive, tmp_path / "d", overwrite=True) / file).read_text().split("\n")[0]

    kinds = drive_variants()
    assert header(kinds["plain"], "imu.csv") == "t,ax,ay,az,gx,gy,gz"
    assert header(kinds["few-imu-columns"], "imu.csv") == "t,ax,ay,gz"
    assert header(kinds["plain"], "gps.csv") == "t,x,y"
    assert header(kinds["degrees"], "gps.csv") == "t,lat,lon,alt"
    assert header(kinds["many-gps-columns"], "gps.csv") == "t,x,y,std_x,std_y,speed,course"
    assert header(kinds["plain"], "truth.csv") == "t,x,y,vx,vy,theta"


finite = st.floats(-1e7, 1e7)
names = st.text(st.characters(codec="utf-8", exclude_characters="/\\\n\0"), min_size=1).filter(
    lambda n: n not in (".", "..")
)


@settings(max_examples=settings.default.max_examples // 3)
@given(finite, finite, st.floats(-1e300, 1e300), names)
def test_round_trip_keeps_any_finite_float_and_any_name(
    tmp_path_factory: pytest.TempPathFactory, a: float, b: float, start: float, name: str
):
    time = np.nextafter(start, np.inf)
    times = [time := np.nextafter(time, np.inf) for _ in range(100)]  # adjacent floats
    n = np.full(100, a)
    n[50] = b
    drive = Drive(
        name if name.strip() else "x", Imu(times, n, n, n), Gps(times, n, n), Truth(times, n, n, n, n, n)
    )
    folder = write_drive(drive, tmp_path_factory.mktemp("any") / "d")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(checks, "remarks_of", lambda *_: [])  # such values are not plausible
        assert_same(read_drive(folder), drive)


def test_the_same_drive_gives_the_same_bytes(tmp_path: Path):
    one, two = (write_drive(drive_variants()["degrees"], tmp_path / k) for k in "ab")
    assert {p.name: p.read_bytes() for p in one.iterdir()} == {p.name: p.read_bytes() for p in two.iterdir()}


def test_a_renamed_copy_has_its_new_name(tmp_path: Path):
    folder = write_drive(make_drive(duration=10.0, name="monday"), tmp_path / "monday")
    assert read_drive(folder).name == "monday"
    assert read_drive(folder.rename(tmp_path / "friday")).name == "friday"
    other = write_drive(make_drive(duration=10.0, name="monday"), tmp_path / "other")
    assert read_drive(other).name == "monday"  # an explicit name is kept


def test_does_not_overwrite_without_permission(tmp_path: Path):
    first, second = (
        make_drive(duration=10.0, name="first"),
        make_drive(duration=10.0, name="second", truth=False),
    )
    folder = tmp_path / "deep" / "er" / "d"
    write_drive(first, folder)
    with pytest.raises(DriveError, match="exists and is not empty; delete it, or specify another folder"):
        write_drive(second, folder)
    assert_same(read_drive(folder), first)
    write_drive(second, folder, overwrite=True)
    assert_same(read_drive(folder), second)  # truth.csv of the first drive is removed
    assert [p.name for p in folder.parent.iterdir()] == ["d"]


def test_never_replaces_a_folder_that_is_not_a_drive(tmp_path: Path):
    drive = make_drive(duration=10.0)
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(
        DriveError, match=r"contains 'thesis.tex', which is not part of a drive; specify another folder"
    ):
        write_drive(drive, tmp_path, overwrite=True)
    with pytest.raises(DriveError, match="is a file; specify another folder"):
        write_drive(drive, tmp_path / "thesis.tex", overwrite=True)
    (tmp_path / "empty").mkdir()
    assert_same(read_drive(write_drive(drive, tmp_path / "empty")), drive)


def test_writes_into_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    write_drive(make_drive(duration=10.0), ".")
    assert (tmp_path / "here" / "imu.csv").exists()


def test_a_failed_write_keeps_the_old_drive_and_leaves_no_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    old = make_drive(duration=10.0, name="old")
    write_drive(old, tmp_path / "d")

    def full(self: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"No space left on device.*free some space"):
        write_drive(make_drive(duration=10.0), tmp_path / "d", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["d"]
    assert_same(read_drive(tmp_path / "d"), old)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"metadata": {"note": None}},
            r"drive.toml: the metadata can't be written as TOML: .*; change this value",
        ),
        ({"frame": "wgs84"}, r"needs gps.lat, gps.lon and origin; set them"),
    ],
)
def test_refuses_values_that_the_files_cannot_contain(tmp_path: Path, change: dict, message: str):
    with pytest.raises(DriveError, match=message):
        write_drive(replace(make_drive(duration=10.0), **change), tmp_path / "d")
    assert not (tmp_path / "d").exists()


@needs_shared
@pytest.mark.parametrize("name", ["dresden", "kingston-1", "comma2k19"])
def test_real_drives_survive_the_round_trip(tmp_path: Path, name: str):
    drive = read_drive(DRIVES / name)
    assert_same(read_drive(write_drive(drive, tmp_path / "d")), drive)


def test_reader_and_writer_agree_on_the_files():
    tables = ("imu", "gps", "odometer", "truth")
    assert {
        "drive.toml",
        *(f"{name}.{form}" for name in tables for form in ("csv", "parquet")),
    } == writer.FILES


def test_reading_does_not_change_the_warning_filters_of_other_threads(tmp_path: Path, monkeypatch):
    def touched(*_, **__):
        raise AssertionError("the filters of warnings belong to all threads")

    drive = simulate("outages", "slippery", seed=5)
    monkeypatch.setattr(warnings, "catch_warnings", touched)
    write_drive(drive, tmp_path / "outages")
    with pytest.warns(DriveWarning, match="gaps"):
        monkeypatch.undo()
        read_drive(tmp_path / "outages")
