"""Inputs that caused a crash in earlier versions, one of each kind: each gives a drive, or one line and exit code 2."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from importing.test_datasets import imu_csv
from sigmaswarm import read_drive
from sigmaswarm.errors import DriveError
from support import SHARED, quickly, some

FOUND = SHARED / "broken" / "inputs"
INPUTS = sorted(FOUND.glob("*/*/in"))
LONGEST = 700
"""Longest message with a long path, in characters."""
needs_inputs = pytest.mark.skipif(not INPUTS, reason=f"the broken inputs are not at {FOUND}")
named = pytest.mark.parametrize("place", some(INPUTS), ids=[f"{p.parts[-3]}-{p.parts[-2]}" for p in INPUTS])
Command = Callable[..., Any]


def log_of(place: Path) -> Path:
    """Return the path of the log: the only entry of the folder, or the folder itself for a dataset."""
    inside = list(place.iterdir())
    return place if len(inside) > 1 or place.parts[-3] == "nclt" else inside[0]


@needs_inputs
@named
@pytest.mark.parametrize("show", quickly([(True,), (False,)], lambda show: not show))
def test_a_drive_or_one_line(sigmaswarm: Command, here: Path, place: Path, show: bool):
    reader, log = place.parts[-3], log_of(place)
    if reader.startswith("drive"):
        line = refusal_of(log)
        assert not line or (line.isprintable() and len(line) < LONGEST)
        return
    form = next(t[7:] for t in (place.parent / "why.txt").read_text().splitlines() if t.startswith("format="))
    arguments = ["import", log, "--format", form]
    if reader in ("ubx", "nmea") or reader.startswith("rtklib"):
        arguments = ["import", imu_csv(here), "--gps", log]
    elif reader == "kitti":
        arguments += ["--gps-from-truth", "5,1"]
    ended = sigmaswarm(*arguments, *(["--show"] if show else ["--out", "drive"]))
    if ended.code == 0:
        assert show or refusal_of(here / "drive") is None
        return
    lines = [line for line in ended.err.splitlines() if not line.startswith("importing")]
    assert ended.code == 2 and len(lines) == 1 and len(lines[0]) < LONGEST, ended.err
    assert lines[0].isprintable() and not (here / "drive").exists()


def refusal_of(folder: Path) -> str | None:
    """Return the message of `read_drive` about a folder; None if the drive is read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read_drive(folder)
        except DriveError as error:
            return str(error)
    return None
