"""A path names one file, also if it contains characters of patterns, a home folder or a link."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from importing.logs import a_drive, imported
from importing.test_datasets import write_nclt
from importing.test_phones import phyphox
from sigmaswarm import read_drive, write_drive
from sigmaswarm.importing.inspection import inspect_request
from sigmaswarm.importing.opening import Request
from support import make_drive

NAMES = ("run[1]", "run*", "run?", "{run1,run2}", "2024-05 [rain]", "a#b%20c")


@pytest.mark.parametrize("name", NAMES)
def test_a_drive_is_read_from_the_folder_that_is_named(tmp_path: Path, name: str):
    write_drive(make_drive(duration=20, seed=1), tmp_path / "run1")
    other = make_drive(duration=30, seed=2, name=name)
    write_drive(other, tmp_path / name)
    np.testing.assert_array_equal(read_drive(tmp_path / name).imu.ax, other.imu.ax)


def test_a_folder_called_tilde_is_no_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    write_drive(make_drive(duration=20, seed=1), tmp_path / "home" / "d")
    write_drive(make_drive(duration=20, seed=2), tmp_path / "~" / "d")
    wanted = make_drive(duration=20, seed=2).imu.ax
    np.testing.assert_array_equal(read_drive(Path("~") / "d").imu.ax, wanted)
    np.testing.assert_array_equal(imported(Path("~") / "d").drive.imu.ax, wanted)


@pytest.mark.parametrize(("name", "suffix"), [*((name, "csv") for name in NAMES), (NAMES[0], "parquet")])
def test_a_table_is_read_from_the_file_that_is_named(tmp_path: Path, name: str, suffix: str):
    import polars as pl

    for i, file in enumerate(("run1", name)):
        drive = make_drive(duration=20, seed=i, gps_rate=100.0)
        table = pl.DataFrame(
            {"t": drive.imu.time, "ax": drive.imu.ax, "ay": drive.imu.ay, "gz": drive.imu.gz}
        )
        table = table.with_columns(x=10 * pl.col("t"), y=2 * pl.col("t"))
        write = table.write_csv if suffix == "csv" else table.write_parquet
        write(tmp_path / f"{file}.{suffix}")
    got = imported(tmp_path / f"{name}.{suffix}").drive
    np.testing.assert_array_equal(got.imu.ax, make_drive(duration=20, seed=1, gps_rate=100.0).imu.ax)


@pytest.mark.parametrize("write", [write_nclt, phyphox])
def test_a_folder_of_tables_is_read_from_the_folder_that_is_named(tmp_path: Path, write):
    (tmp_path / "log1").mkdir()
    log = write(tmp_path / "log1" / "x" if write is phyphox else tmp_path / "log1")
    shutil.move(log, tmp_path / "log[1]")
    assert len(imported(tmp_path / "log[1]").drive.imu) == len(a_drive().imu)
    assert inspect_request(Request(tmp_path / "log[1]")).tables


def test_every_table_is_opened_by_its_name():
    """Polars takes paths for patterns unless it is told not to: wherever a table is read, it is."""
    source = Path(__file__).parents[2] / "src"
    for file in source.rglob("*.py"):
        for call in re.findall(r"pl\.(?:read|scan)_(?:csv|parquet|ipc|ndjson)\(\s*([^)]*)", file.read_text()):
            assert "glob=False" in call or "**one_file(" in call, f"{file}: {call}"
