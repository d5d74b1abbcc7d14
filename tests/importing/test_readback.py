"""Imported drives can be read: a drive that `read_drive` would reject is not written."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from importing.logs import imported
from sigmaswarm.drives.writer import write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.convert import import_drive
from sigmaswarm.importing.opening import Request

TIME = np.arange(2000) * 0.01


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return table(tmp_path)


def table(folder: Path, **changed: object) -> Path:
    zero = 0 * TIME
    columns = {"t": TIME, "ax": zero, "ay": zero, "gz": zero, "x": 10 * TIME, "y": zero} | changed
    pl.DataFrame(columns).write_csv(folder / "log.csv")
    return folder / "log.csv"


@pytest.mark.parametrize("name", ["a/b", "..", "", ".", "x\ny", " ", "a\\b", "a\0b", "a\ud800b"])
def test_a_name_that_can_not_be_read_back(log: Path, name: str):
    with pytest.raises(InputError, match="name = ") as caught:
        import_drive(Request(log), name)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", ["monday", "日本語 🚗", "run[1]", "a'b\"c", "-o"])
def test_a_name_that_can(log: Path, name: str):
    assert import_drive(Request(log), name).drive.name == name


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"x": 10 * TIME + 2e7}, "gps.csv, row 2, column x: '20000000.0' is outside -1e+07 to 1e+07"),
        ({"y": np.where(TIME == 5.0, -1e9, 0.0)}, "gps.csv, row 502, column y: "),
    ],
)
def test_values_that_can_not_be_read_back(tmp_path: Path, changed: dict[str, np.ndarray], said: str):
    log, out = table(tmp_path, **changed), tmp_path / "out" / "d"
    with pytest.raises(InputError) as caught:
        write_drive(imported(log).drive, out)
    assert str(caught.value).startswith(f"{out}: the drive could not be read back ({said}")
    assert not list(out.parent.iterdir())


def test_what_was_there_stays(tmp_path: Path):
    out = write_drive(imported(table(tmp_path)).drive, tmp_path / "d")
    before = (out / "gps.csv").read_bytes()
    with pytest.raises(InputError, match="could not be read back"):
        write_drive(imported(table(tmp_path, x=10 * TIME + 2e7)).drive, out, overwrite=True)
    assert (out / "gps.csv").read_bytes() == before


def test_far_truth_can_not_be_read_back(tmp_path: Path):
    pl.DataFrame({"t": TIME, "x": 10 * TIME, "y": 0 * TIME + 1e8}).write_csv(tmp_path / "truth.csv")
    with pytest.raises(InputError, match=r"truth\.csv, row 2, column y: '100000000\.0' is outside"):
        write_drive(imported(table(tmp_path), truth=tmp_path / "truth.csv").drive, tmp_path / "d")
