"""`import --show` reads the beginning of a long log, finds all of its tables, and makes no unfounded guesses."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from importing.logs import a_drive
from sigmaswarm.importing.inspection import MAX_SCANNED_ROWS, PREVIEW_ROWS, beginnings, inspect_request
from sigmaswarm.importing.opening import Request
from sigmaswarm.importing.readers.messages import message_log
from sigmaswarm.importing.source import CHUNK, Table


def test_a_long_log_is_read_at_its_beginning_only():
    read = 0

    def stream(topics):
        nonlocal read
        for read in range(1_000_000):
            yield ("/seldom" if read % 1000 == 0 else "/often"), read, SimpleNamespace(value=float(read))

    tables = {
        topic: Table(("received", "value"), "some/msg/Value") for topic in ("/often", "/seldom", "/never")
    }
    rows = beginnings(message_log(Path("log"), tables, stream))
    assert read <= MAX_SCANNED_ROWS + CHUNK
    assert len(rows["/often"]) == PREVIEW_ROWS and len(rows["/seldom"]) > 5 and len(rows["/never"]) == 0


def test_every_file_is_looked_at(tmp_path: Path):
    drive = a_drive()
    many = np.arange(120_000) / 100
    pl.DataFrame({"t": many, "ax": many * 0, "ay": many * 0 + 1, "gz": many * 0}).write_csv(
        tmp_path / "a_imu.csv"
    )
    pl.DataFrame({"t": drive.gps.time, "lat": drive.gps.lat, "lon": drive.gps.lon}).write_csv(
        tmp_path / "gps.csv"
    )
    (tmp_path / "notes.csv").write_text("day,who\nmonday,me\n")
    seen = inspect_request(Request(tmp_path))
    previews = {preview.table: preview for preview in seen.tables}
    assert previews["a_imu.csv"].rate == pytest.approx(100, rel=1e-3)
    assert previews["gps.csv"].rate == pytest.approx(5, rel=1e-3)
    assert previews["notes.csv"].rate is None and previews["notes.csv"].ranges[1].example == "me"
    ranges = {r.column: r for r in previews["gps.csv"].ranges}
    assert ranges["lat"].low == drive.gps.lat.min() and ranges["lat"].high == drive.gps.lat.max()
    assert [part.table for part in seen.recipe.roles["imu"]] == ["a_imu.csv"]


def test_a_map_that_fails_is_a_note(tmp_path: Path):
    pl.DataFrame({"t": [0.0, 1.0], "q": [1.0, 2.0]}).write_csv(tmp_path / "log.csv")
    seen = inspect_request(Request(tmp_path / "log.csv", maps=["wheel=q"]))
    assert any("no column 'wheel'" in note for note in seen.notes)


def test_a_look_has_rows_and_faults(tmp_path: Path):
    """The first rows as they are, and the reasons not to read a column, with the column that they are about."""
    drive, file = a_drive(), tmp_path / "log.csv"
    counts = np.round(np.degrees(drive.imu.gz) * 131)
    columns = {"t": drive.imu.time, "ax": drive.imu.ax, "ay": drive.imu.ay, "gz": counts}
    pl.DataFrame(columns).write_csv(file)
    found = inspect_request(Request(file))
    assert found.rows["log.csv"]["gz"].to_list() == counts[: len(found.rows["log.csv"])].tolist()
    assert {(fault.role, fault.column) for fault in found.faults} == {("imu", "gz")}
