"""Wrong input of the exported script: one line, exit code 2, and no estimate."""

import re
from pathlib import Path

import pytest

from exported import export_filter, run_alone, tuned
from sigmaswarm.drives.writer import write_drive
from support import make_drive

DRIVE = make_drive(duration=8.0)


def lines_of(path: Path) -> list[str]:
    return path.read_text().splitlines()


def put(path: Path, lines: list[str]) -> None:
    path.write_text("".join(line + "\n" for line in lines))


def with_cell(path: Path, row: int, column: str, cell: str) -> None:
    """Replace a cell; row 1 is the first after the header."""
    lines = lines_of(path)
    cells = lines[row - 1].split(",")
    cells[lines[0].split(",").index(column)] = cell
    put(path, [*lines[: row - 1], ",".join(cells), *lines[row:]])


def exchanged(path: Path, row: int) -> None:
    lines = lines_of(path)
    lines[row - 1], lines[row] = lines[row], lines[row - 1]
    put(path, lines)


FAULTS = {
    "backward times": (lambda d: exchanged(d / "imu.csv", 7), r"imu.csv, row 8, column t: .* is not after "),
    "a time twice": (
        lambda d: put(d / "gps.csv", [*lines_of(d / "gps.csv")[:9], *lines_of(d / "gps.csv")[8:]]),
        r"gps.csv, row 10, column t: .* is not after",
    ),
    "nan": (lambda d: with_cell(d / "imu.csv", 12, "ax", "nan"), r"imu.csv, row 12, column ax: 'nan' is not a finite"),
    "inf": (lambda d: with_cell(d / "gps.csv", 3, "x", "-inf"), r"gps.csv, row 3, column x: '-inf' is not a finite"),
    "text": (lambda d: with_cell(d / "gps.csv", 3, "y", "east"), r"gps.csv, row 3, column y: 'east' is not a finite"),
    "an empty cell": (lambda d: with_cell(d / "imu.csv", 2, "gz", ""), r"imu.csv, row 2, column gz: '' is not"),
    "a short row": (
        lambda d: put(d / "imu.csv", [*lines_of(d / "imu.csv")[:20], "0.5"]),
        r"imu.csv, row 21, column ax: '' is not a finite",
    ),
    "an empty imu.csv": (lambda d: put(d / "imu.csv", []), r"imu.csv: is empty; the header line must name t, ax"),
    "an empty gps.csv": (lambda d: put(d / "gps.csv", []), r"gps.csv: is empty; the header line must name t"),
    "no rows": (lambda d: put(d / "imu.csv", lines_of(d / "imu.csv")[:1]), r"imu.csv: contains no rows"),
    "one row": (lambda d: put(d / "imu.csv", lines_of(d / "imu.csv")[:2]), r"usable fixes \(0 of \d+\)"),
    "one fix": (lambda d: put(d / "gps.csv", lines_of(d / "gps.csv")[:2]), r"usable fixes \(. of 1\)"),
    "no column": (
        lambda d: put(d / "imu.csv", [lines_of(d / "imu.csv")[0].replace("gz", "wz"), *lines_of(d / "imu.csv")[1:]]),
        r"imu.csv: no column gz, only .*wz",
    ),
    "no positions": (
        lambda d: put(d / "gps.csv", [lines_of(d / "gps.csv")[0].replace("x,", "e,"), *lines_of(d / "gps.csv")[1:]]),
        r"gps.csv: no column x",
    ),
    "not UTF-8": (lambda d: (d / "imu.csv").write_bytes(b"t,ax,ay,gz\n\xff\xfe"), r"run_filter.py: .*utf-8"),
    "a missing file": (lambda d: (d / "gps.csv").unlink(), r"gps.csv: No such file"),
    "broken TOML": (lambda d: (d / "drive.toml").write_text("name = \n"), r"drive.toml: can't be used: .*; correct"),
    "a lever arm of text": (
        lambda d: (d / "drive.toml").write_text('frame = "enu"\ngps_lever_arm_m = "front"\n'),
        r"drive.toml: ",
    ),
}  # fmt: skip


@pytest.fixture(scope="module")
def script(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_filter(tuned("planar5", "ukf", 0.01), "filterpy", tmp_path_factory.mktemp("script"))[0]


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_input_causes_one_line(tmp_path: Path, script: Path, fault: str):
    break_it, said = FAULTS[fault]
    folder = write_drive(DRIVE, tmp_path / "drive")
    break_it(folder)
    done = run_alone(script, folder, tmp_path / "e.csv")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr

    assert re.search(said, done.stderr), done.stderr
    assert not (tmp_path / "e.csv").exists()


def test_an_estimate_that_can_not_be_written_causes_one_line(tmp_path: Path, script: Path):
    folder = write_drive(DRIVE, tmp_path / "drive")
    done = run_alone(script, folder, tmp_path / "nowhere" / "e.csv")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "nowhere/e.csv: No such file or directory" in done.stderr


def test_blank_lines_and_spaces_around_names_are_accepted(tmp_path: Path, script: Path):
    folder = write_drive(DRIVE, tmp_path / "drive")
    assert run_alone(script, folder, tmp_path / "before.csv").returncode == 0
    header, *rows = lines_of(folder / "imu.csv")
    put(folder / "imu.csv", [header.replace(",", ", "), *rows[:5], "", *rows[5:]])
    done = run_alone(script, folder, tmp_path / "after.csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "after.csv").read_bytes() == (tmp_path / "before.csv").read_bytes()
