"""The table odometer.csv of a drive: reading, checks, writing, clipping, and its part of the fingerprint."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sigmaswarm import DriveError, Odometer, clip, read_drive, split_time, write_drive
from sigmaswarm.drives.fingerprint import fingerprint
from sigmaswarm.drives.tables import RECORDS
from support import make_drive

TIME = np.arange(0.003, 12.0, 0.012)
DRIVE = replace(make_drive(duration=12.0), odometer=Odometer(TIME, 8.0 + np.sin(TIME)))


def test_round_trip(tmp_path: Path):
    again = read_drive(write_drive(DRIVE, tmp_path / "drive"))
    assert again.odometer is not None
    assert DRIVE.odometer is not None
    np.testing.assert_array_equal(again.odometer.time, DRIVE.odometer.time)
    np.testing.assert_array_equal(again.odometer.speed, DRIVE.odometer.speed)
    assert (tmp_path / "drive" / "odometer.csv").read_text().splitlines()[0] == "t,speed"
    write_drive(replace(DRIVE, odometer=None), tmp_path / "drive", overwrite=True)
    assert read_drive(tmp_path / "drive").odometer is None


def test_clipping_and_splitting():
    part = clip(DRIVE, 3.0, 5.0)
    assert part.odometer is not None
    assert 3.0 <= part.odometer.time[0] < 3.012 and 4.988 <= part.odometer.time[-1] < 5.0
    train, test = split_time(DRIVE, 0.5)
    assert train.odometer is not None and test.odometer is not None and DRIVE.odometer is not None
    assert len(train.odometer) + len(test.odometer) == len(DRIVE.odometer)
    early = replace(DRIVE, odometer=DRIVE.odometer.select(DRIVE.odometer.time < 2.0))
    assert clip(early, 5.0, 8.0).odometer is None


def test_fingerprint():
    bare = replace(DRIVE, odometer=None)
    assert DRIVE.odometer is not None
    slower = replace(DRIVE, odometer=replace(DRIVE.odometer, speed=0.99 * DRIVE.odometer.speed))
    assert len({fingerprint(drive) for drive in (bare, DRIVE, slower)}) == 3


@pytest.mark.parametrize("name", RECORDS)
def test_fingerprint_depends_on_every_column_of_every_table(name: str):
    table = DRIVE.tables[name]
    columns = [column for column, values in vars(table).items() if values is not None]
    changed = [replace(table, **{column: vars(table)[column] + 1.0}) for column in columns]
    drives = (DRIVE, *(replace(DRIVE, **{name: each}) for each in changed))
    assert len({fingerprint(drive) for drive in drives}) == len(columns) + 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,v\n0.1,3\n", "no column speed"),
        ("t,speed\n0.1,3\n0.1,4\n", "row 3, column t: '0.1' is not after 0.1 in row 2"),
        ("t,speed\n0.1,3\n0.2,nan\n", "row 3, column speed: 'nan' is not a finite number"),
        ("t,speed\n", "contains no rows"),
    ],
)
def test_an_invalid_table_gives_one_line(tmp_path: Path, text: str, said: str):
    folder = write_drive(DRIVE, tmp_path / "drive")
    (folder / "odometer.csv").write_text(text)
    with pytest.raises(DriveError) as refused:
        read_drive(folder)
    assert said in str(refused.value) and "odometer.csv" in str(refused.value)
    assert "\n" not in str(refused.value)
