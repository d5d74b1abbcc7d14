"""Drives in Parquet: the same bits and checks as in CSV; and drives at URLs."""

import datetime
import warnings
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest

from sigmaswarm.cli.convert import convert
from sigmaswarm.drives.reader import all_drive_locations, drive_folders, read_drive, read_with_warnings
from sigmaswarm.drives.urls import without_secrets
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import DriveError, InputError
from support import assert_same, drive_variants, make_drive


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_drive(make_drive(duration=20.0), tmp_path / "good", form="parquet")


@pytest.mark.parametrize("name", drive_variants())
def test_the_bits_are_those_of_csv(tmp_path: Path, name: str):
    drive = drive_variants()[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        compact = read_drive(write_drive(drive, tmp_path / "a" / "d", form="parquet"))
        plain = read_drive(write_drive(drive, tmp_path / "b" / "d"))
        again = read_drive(write_drive(compact, tmp_path / "c" / "d"))
    assert_same(compact, plain)
    assert_same(again, plain)
    for file in (tmp_path / "b" / "d").iterdir():
        assert file.read_bytes() == (tmp_path / "c" / "d" / file.name).read_bytes()


def test_the_same_drive_gives_the_same_bytes(tmp_path: Path, folder: Path):
    other = write_drive(read_drive(folder), tmp_path / "other" / "good", form="parquet")
    assert {f.name: f.read_bytes() for f in folder.iterdir()} == {
        f.name: f.read_bytes() for f in other.iterdir()
    }


def edited(file: str, change: Callable[[pl.DataFrame], pl.DataFrame]) -> Callable[[Path], object]:
    return lambda folder: change(pl.read_parquet(folder / file)).write_parquet(folder / file)


def cell(file: str, row: int, column: str, value: object) -> Callable[[Path], object]:
    here = pl.int_range(pl.len()) == row - 1
    return edited(
        file, lambda f: f.with_columns(pl.when(here).then(pl.lit(value)).otherwise(column).alias(column))
    )


BROKEN = {
    "nan": (cell("imu.parquet", 12, "ax", float("nan")), "imu.parquet, row 12, column ax: 'nan' is not a finite"),
    "null": (cell("imu.parquet", 7, "gz", None), "imu.parquet, row 7, column gz: '' is empty"),
    "range": (cell("gps.parquet", 3, "x", 2e7), "gps.parquet, row 3, column x: '20000000.0' is outside"),
    "late": (cell("imu.parquet", 5, "t", 0.0), "imu.parquet, row 5, column t: '0.0' is not after 0.03 in row 4"),
    "no column": (edited("imu.parquet", lambda f: f.drop("ay")), "imu.parquet: no column ay, only t, ax"),
    "no rows": (edited("gps.parquet", lambda f: f.head(0)), "gps.parquet contains no rows"),
    "few fixes": (edited("gps.parquet", lambda f: f.head(2)), "gps.parquet: 2 fixes within"),
    "words": (
        edited("imu.parquet", lambda f: f.with_columns(ax=pl.lit("0.1"))),
        "imu.parquet, column ax: contains String, not numbers",
    ),
    "dates": (
        edited("imu.parquet", lambda f: f.with_columns(t=pl.lit(datetime.datetime(2026, 1, 1)))),
        "imu.parquet, column t: contains Datetime",
    ),
    "no parquet": (lambda folder: (folder / "gps.parquet").write_text("t,x,y\n"), "gps.parquet is not a readable"),
    "both": (lambda folder: (folder / "imu.csv").write_text("t\n"), "contains both imu.csv and imu.parquet"),
    "missing": (lambda folder: (folder / "gps.parquet").unlink(), "gps.csv is missing"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_faults_are_reported_as_for_csv(folder: Path, name: str):
    edit, said = BROKEN[name]
    edit(folder)
    with pytest.raises(DriveError) as caught:
        read_drive(folder)
    assert said in str(caught.value)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_integers_and_other_columns_are_handled_as_in_csv(folder: Path):
    edited("imu.parquet", lambda f: f.with_columns(ax=pl.lit(1, dtype=pl.Int32), extra=pl.lit("x")))(folder)
    with pytest.warns(match=r"imu\.parquet: ignoring 'extra'"):
        assert (read_drive(folder).imu.ax == 1.0).all()


def test_folders_of_drives_can_contain_either_format(tmp_path: Path, folder: Path):
    write_drive(make_drive(duration=20.0), tmp_path / "csv")
    assert [path.name for path in drive_folders(tmp_path)] == ["csv", "good"]


def test_a_url_is_read_as_a_folder_is(tmp_path: Path, folder: Path):
    pytest.importorskip("fsspec")
    url = f"file://{tmp_path}"
    assert all_drive_locations([url]) == [f"{url}/good"]
    assert all_drive_locations([f"{url}/good"]) == [f"{url}/good"]
    drive, warned = read_with_warnings(f"{url}/good")
    assert_same(drive, read_drive(folder))
    assert not warned
    cell("imu.parquet", 12, "ax", float("nan"))(folder)
    with pytest.raises(DriveError, match=f"^{url}/good/imu.parquet, row 12, column ax"):
        read_drive(f"{url}/good")


def test_messages_do_not_contain_possible_secrets():
    assert without_secrets("sftp://bob:pass@host/a/b") == "sftp://***@host/a/b"
    assert without_secrets("https://host/a?signature=1") == "https://host/a"
    assert without_secrets("s3://bucket/a") == "s3://bucket/a"
    with pytest.raises(InputError, match=r"^https://host/monday\?\.\.\.: a drive has several files"):
        read_drive("https://host/monday?signature=secret")


def test_convert_does_not_write_into_a_drive(tmp_path: Path, folder: Path):
    other = write_drive(make_drive(duration=20.0), tmp_path / "other")
    with pytest.raises(
        InputError, match="other: is a drive; pass a folder for the converted drives as the last argument"
    ):
        convert(str(folder), str(other))
    convert(str(folder), str(tmp_path / "out"), to="csv")
    assert [f.name for f in (tmp_path / "out").iterdir()] == [read_drive(folder).name]


def test_a_refused_url_gives_one_line():
    fsspec = pytest.importorskip("fsspec")

    class Closed(fsspec.AbstractFileSystem):
        protocol = "closed"

        def info(self, path, **_):
            raise PermissionError(f"403 Forbidden: {path}")

    fsspec.register_implementation("closed", Closed, clobber=True)
    for url, said in {
        "closed://bucket/monday": "can't be read (PermissionError: 403 Forbidden",
        "nowhere://bucket/monday": "can't be read (ValueError: Protocol not known",
        "file:///nowhere/monday": "does not exist",
    }.items():
        with pytest.raises(InputError) as caught:
            read_drive(url)
        assert str(caught.value).startswith(url)
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
