"""Maps and tables are well formed for every name of a drive."""

import csv
import io
import json
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import polars as pl
import pytest

from sigmaswarm import read_drive, write_drive
from sigmaswarm.exports.maps import MAPS
from sigmaswarm.exports.trajectory import time_origin_of
from support import make_drive

NAMES = [
    "a]]>b",
    "<b>&amp;\"'",
    "a\x01\x1b[31m\x7fb",
    "\ufffe\uffff",
    "\ud800 half a pair \udcff",
    "*/ ??/ \\",
    "a,b;c\td",
    'a"b\'c"""',
    "\u202eright to left\u2028",
    "",
    "🚗" * 300,
    "\r",
    "{}@NAME@%s$x",
    "--> <![CDATA[ <?xml?>",
]
PLACES = np.array([[51.0, 13.0], [51.001, 13.001], [51.002, 13.002]])
READS = {
    ".gpx": lambda path: ElementTree.parse(path),
    ".kml": lambda path: ElementTree.parse(path),
    ".geojson": lambda path: json.loads(path.read_bytes(), parse_constant=lambda name: pytest.fail(name)),
}


@pytest.mark.parametrize("form", MAPS)
@pytest.mark.parametrize("name", NAMES, ids=ascii)
def test_a_map_can_be_read(form: str, name: str, tmp_path: Path):
    for start in (0.0, 1.7e9):
        MAPS[form](start + np.arange(3.0), PLACES, tmp_path / f"a{form}", name)
        READS[form](tmp_path / f"a{form}")
    if form == ".gpx" and name.isprintable() and name:
        found = READS[form](tmp_path / "a.gpx").getroot().findtext(".//{*}name")
        assert found == name


@pytest.mark.parametrize("form", MAPS)
@pytest.mark.parametrize("start", [1e12, 1e200, 1e308, np.nan, np.inf, -np.inf, -1e300])
def test_a_map_of_a_clock_without_a_date(form: str, start: float, tmp_path: Path):
    MAPS[form](start + np.arange(3.0), PLACES, tmp_path / f"a{form}", "a")
    READS[form](tmp_path / f"a{form}")


@pytest.mark.parametrize("origin", ["1e300", "nan", "inf", '"text"', "[1]", "9" * 400, "true"])
def test_a_clock_in_drive_toml_that_is_no_time(origin: str, tmp_path: Path):
    folder = write_drive(make_drive(duration=20.0), tmp_path / "d")
    with (folder / "drive.toml").open("a") as file:
        file.write(f"time_origin_s = {origin}\n")
    assert time_origin_of(read_drive(folder)) in (0.0, 1.0)


@pytest.mark.parametrize(
    "name", [name for name in NAMES if name.strip() and "/" not in name and "\ud800" not in name]
)
def test_a_drive_of_that_name_is_read_back(name: str, tmp_path: Path):
    if len(name.encode()) > 255 or "\\" in name:
        pytest.skip("names no folder")
    drive = make_drive(duration=20.0, name=name)
    folder = write_drive(drive, tmp_path / "d")
    assert tomllib.loads((folder / "drive.toml").read_text())["name"] == name
    assert read_drive(folder).name == name
    text = pl.DataFrame({"drive": [name], "x": [1.0]}).write_csv()
    assert list(csv.reader(io.StringIO(text, newline="")))[1] == [name, "1.0"]
