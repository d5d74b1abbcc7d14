"""Damaged logs that fuzzers found: no silent loss of data, no endless run, and no crash."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.io import savemat

from fuzzing.check import limited, records_touched
from fuzzing.mutations import ODD_SQL, sql
from importing.bags import messages, write_ros
from importing.logs import ORIGIN, a_drive, imported
from importing.test_datasets import write_comma
from importing.test_phones import gnss_logger, sensor_logger, zipped
from importing.test_px4 import write_ulog
from sigmaswarm import read_drive, write_drive
from sigmaswarm.errors import InputError
from sigmaswarm.importing.formats import open_log
from sigmaswarm.importing.recipe import Recipe
from sigmaswarm.importing.source import Limits
from support import make_drive, quickly


@pytest.mark.parametrize(
    "name", ["elApsedRealtimeNanos", "", "elapsedRealtimeNano", "t", "elapsedRealtimeNanos "]
)
@pytest.mark.parametrize("kind", ["UncalAccel", "UncalGyro"])
def test_a_sensor_without_the_clock_of_the_others_is_refused(kind: str, name: str, tmp_path: Path):
    """All times came from another clock, with a remark about the fixes."""
    log = gnss_logger(tmp_path / "log.txt")
    text = log.read_text()
    head = f"# {kind},utcTimeMillis,elapsedRealtimeNanos,"
    assert head in text
    log.write_text(text.replace(head, head.replace("elapsedRealtimeNanos", name)))
    with pytest.raises(
        InputError, match=rf"log\.txt: the header comment of {kind} lacks the column elapsedRealtimeNanos"
    ):
        imported(log)


@pytest.mark.parametrize("place", [0.0, 1e3, -6.4e6, 1e12, np.nan])
def test_a_broken_first_pose_concerns_no_other(place: float, tmp_path: Path):
    """All velocities and headings were turned to its place."""
    recipe = Recipe(origin=ORIGIN)
    sound = imported(write_comma(tmp_path / "sound"), recipe=recipe).drive.truth
    log = write_comma(tmp_path / "broken")
    file = next(log.rglob("frame_positions"))
    poses = np.load(file)
    poses[0] = place
    with file.open("wb") as opened:
        np.save(opened, poses)
    got = imported(log, recipe=recipe).drive.truth
    assert sound is not None and got is not None
    both, i, j = np.intersect1d(sound.time, got.time, return_indices=True)
    assert len(both) >= len(sound) - 2
    for name in ("vx", "vy", "theta"):
        np.testing.assert_allclose(getattr(got, name)[j][2:], getattr(sound, name)[i][2:], atol=1e-9)


@pytest.mark.parametrize("byte", [b"9", b"\xff", b"\0", b"?", b"z", b"\x80"])
def test_a_broken_ulog_is_not_searched_byte_by_byte(
    byte: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    log = write_ulog(tmp_path / "f.ulg")
    content = log.read_bytes()
    log.write_bytes(content[: len(content) // 2] + byte * (8 << 20))
    with limited(2), pytest.raises(InputError, match=r"f\.ulg: is cut short or broken"):
        imported(log)
    assert not "".join(capfd.readouterr())  # the library prints what it finds


MATRICES: dict[str, tuple[int, int]] = {
    "type of numbers": (257, 127),
    "type of the flags": (225, 255),
    "class of a struct": (144, 5),
    "class of numbers": (224, 5),
    "shape": (252, 5),
    "another type of numbers": (256, 100),
}


@pytest.mark.parametrize("how", MATRICES)
def test_a_broken_matlab_file_does_not_end_the_process(how: str, tmp_path: Path):
    """SciPy's compiled code reads beyond its tables of types."""
    log, drive = tmp_path / "log.mat", a_drive(2.0)
    imu, gps = drive.imu, drive.gps
    force = np.column_stack([imu.ax, imu.ay, imu.az])
    rates = np.column_stack([imu.gx, imu.gy, imu.gz])
    fixes = {"t": gps.time, "lat": gps.lat, "lon": gps.lon}
    content = {"imu": {"t": imu.time, "fb": force, "wb": rates}, "gnss": fixes}
    savemat(log, content)
    data = bytearray(log.read_bytes())
    at, value = MATRICES[how]
    data[at] = value
    log.write_bytes(data)
    with pytest.raises(InputError, match=r"log\.mat: is cut short or broken"), open_log(log):
        pass


@pytest.mark.parametrize(
    ("at", "value"), quickly([(14, 255), (28, 127), (28, 16)], lambda at, value: at == 14 or value == 16)
)
def test_a_broken_parquet_does_not_end_the_process(
    at: int, value: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
):
    """Polars asks for 2 exabytes, or prints a trace and leaves the rows out."""
    log = tmp_path / "log.parquet"
    columns = {name: np.ones(99) for name in ("ax", "ay", "gz", "x", "y")}
    frame = pl.DataFrame({"t": np.arange(99.0), **columns})
    frame.write_parquet(log, compression="uncompressed", statistics=False)
    data = bytearray(log.read_bytes())
    data[at] = value
    log.write_bytes(data)
    with (
        pytest.raises(InputError, match=r"log\.parquet: can't be decoded as a Parquet file"),
        open_log(log),
    ):
        pass
    assert not "".join(capfd.readouterr())


LINES: dict[str, bytes] = {
    "empty lines": b"\n" * 200_000,
    "short lines": b"1\n" * 200_000,
    "one column": b'"1",\n' * 200_000,
}
ENDLESS: dict[str, bytes] = {
    "an endless line": b"9" * (3 << 20),
    "an endless line of cells": b"," * (3 << 20),
    "zeros": bytes(3 << 20),
}
TEXTS = LINES | ENDLESS


@pytest.mark.parametrize(
    ("form", "how"),
    [("zip", how) for how in TEXTS] + [(form, how) for form in ("folder", "csv") for how in LINES],
)
def test_a_text_is_bounded_before_polars_reads_it(form: str, how: str, tmp_path: Path):
    """100 MB in a small zip took 7 GB and 31 s."""
    log = sensor_logger(tmp_path / "export", "ios")
    name = "Gyroscope.csv"
    file = log / name
    file.write_bytes(file.read_bytes() + TEXTS[how])
    log = zipped(log) if form == "zip" else file if form == "csv" else log
    said = rf"{name}.*(is longer than|contains more than 100000 rows)"
    with pytest.raises(InputError, match=said), open_log(log, limits=Limits(rows=100_000)):
        pass


@pytest.mark.parametrize("lines", [b"\n", b"1\n", b"1,1\n", b",,,\n", b"#\n"])
def test_lines_of_a_drive_are_counted_before_they_are_read(
    lines: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("sigmaswarm.drives.table_files.MAX_CELLS", 100_000)
    folder = write_drive(make_drive(duration=20.0), tmp_path / "d")
    with (folder / "imu.csv").open("ab") as file:
        file.write(lines * 100_000)
    with pytest.raises(InputError, match=r"imu\.csv: has \d+ rows of \d columns; the limit is 100000 cells"):
        read_drive(folder)


@pytest.mark.parametrize("names", ["az,gx", "gx,gy", "az,gy", "gy,gz", "ax,ay"])
@pytest.mark.parametrize("new", ["", "  "])
def test_two_columns_without_a_name_are_refused(new: str, names: str, tmp_path: Path):
    folder = write_drive(make_drive(duration=20.0), tmp_path / "d")
    head, rest = (folder / "imu.csv").read_text().split("\n", 1)
    first, second = names.split(",")
    (folder / "imu.csv").write_text(f"{head.replace(first, new).replace(second, '')}\n{rest}")
    with pytest.raises(InputError, match=r"imu\.csv, row 1: column '' appears twice"):
        read_drive(folder)


@pytest.mark.parametrize("value", ODD_SQL)
def test_the_mutation_of_sql_takes_any_value(value: object, tmp_path: Path):
    """A text for the key of a table ended the fuzzer."""
    bag = next(write_ros(tmp_path / "bag", messages(a_drive(1.0))).glob("*.db3"))
    answers = iter(["metadata", "id", value, 1])
    try:
        assert sql(lambda _: next(answers), bag.read_bytes())
    except StopIteration:
        pytest.fail("it draws more")


@pytest.mark.parametrize("line", range(5))
def test_all_comments_of_a_log_are_its_header(line: int):
    """The fuzzer took a damaged name of a column for one damaged record."""
    text = b"".join(b"# %d\n" % k for k in range(6)) + b"UncalGyro,1,2\n" * 9
    rows = text.split(b"\n")
    rows[line] = b"# x"
    assert records_touched("text", text, b"\n".join(rows)) is None
    assert records_touched("text", text, text + b"Fix\n") == 1
