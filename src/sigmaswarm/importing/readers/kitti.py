"""KITTI raw: text files of the OXTS RT3003, synchronized (10 Hz) or not (100 Hz).

A drive has one file of 30 numbers per sample, and a file of times. ``dataformat.txt`` of the data set states meanings,
units and signs (A. Geiger et al., "Vision meets Robotics: The KITTI Dataset", IJRR 2013): x forward, y left, z up, yaw
from east.
"""

import re
import warnings
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import polars as pl

from sigmaswarm.errors import InputError
from sigmaswarm.importing.source import Guess, Limits, Log, Part, log_of_frames
from sigmaswarm.wording import printable

COLUMNS = (
    *("lat", "lon", "alt", "roll", "pitch", "yaw", "vn", "ve", "vf", "vl", "vu"),
    *("ax", "ay", "az", "af", "al", "au", "wx", "wy", "wz", "wf", "wl", "wu"),
    *("pos_accuracy", "vel_accuracy", "navstat", "numsats", "posmode", "velmode", "orimode"),
)
TABLE = "oxts"
_PLACE = {"t": "stamp*1e-9", "lat": "lat", "lon": "lon", "alt": "alt"}
_IMU = {"t": "stamp*1e-9", "ax": "ax", "ay": "ay", "az": "az", "gx": "wx", "gy": "wy", "gz": "wz"}
GUESS = Guess(
    {
        "imu": (Part(TABLE, _IMU),),
        "gps": (Part(TABLE, _PLACE),),
        "truth": (Part(TABLE, _PLACE | {"vx": "ve", "vy": "vn", "theta": "yaw"}),),
    },
    (
        "KITTI has no separate receiver: fixes and truth are the same RTK/INS solution; for a realistic test, make "
        "noisy fixes with --gps-from-truth",
        "the angular rates of the OXTS unit lag its yaw by about 0.06 s; docs/importing.md shows how to correct their "
        "times",
    ),
    metadata={"licence": "CC BY-NC-SA 3.0", "dataset": "KITTI raw"},
)


def _oxts(path: Path) -> Path:
    return path if path.name == "oxts" else path / "oxts"


def recognizes(path: Path) -> bool:
    return (_oxts(path) / "timestamps.txt").is_file() and (_oxts(path) / "data").is_dir()


def open_log(path: Path, limits: Limits, stack: ExitStack) -> Log:
    folder = _oxts(path)
    if not recognizes(path):
        raise InputError(
            f"{path}: is not a drive of KITTI raw; specify the folder that contains oxts/timestamps.txt and oxts/data"
        )
    stamps = _stamps(folder / "timestamps.txt")
    files = sorted((folder / "data").glob("*.txt"))
    if not files:
        raise InputError(f"{folder / 'data'}: contains no text files; unpack the drive again")
    rows = np.array([_numbers(file, len(stamps)) for file in files])
    times = stamps[rows[:, 0].astype(np.int64)]
    frame = pl.DataFrame({"stamp": times, **dict(zip(COLUMNS, rows.T[1:], strict=True))})
    lost = np.iinfo(np.int64).min  # NaT: a sample with an empty line has no time
    frame = frame.with_columns(pl.col("stamp").replace(lost, None))
    return log_of_frames(path, {TABLE: frame}, "OXTS RT3003", lambda _: GUESS)


def _stamps(path: Path) -> np.ndarray:
    """Return the time of each line, ns; the line of a lost sample may be empty."""
    stamps = [line.strip() or "NaT" for line in path.read_text("utf-8", "replace").splitlines()]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)  # NumPy warns of a time zone, which it drops
            times = np.array(stamps, dtype="datetime64[ns]")
            days = np.array([text[:10] for text in stamps], dtype="datetime64[D]")
    except (ValueError, UserWarning) as error:
        raise InputError(f"{path}: {printable(error, 160)}; unpack the drive again") from None
    if not len(times):
        raise InputError(f"{path} is empty; unpack the drive again")
    if np.any(times.astype("datetime64[D]") != days, where=~np.isnat(days)):  # 64 bits overflowed
        raise InputError(f"{path}: contains a date outside the years 1678 to 2262; unpack the drive again")
    return times.astype(np.int64)


def _numbers(path: Path, count: int) -> list[float]:
    """Return the index of a sample, which is the name of its file, and the values of the sample."""
    cells = path.read_text("utf-8", "replace").split()
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        numbers = []
    if len(numbers) != len(COLUMNS):
        raise InputError(
            f"{path}: contains {len(cells)} cells, not {len(COLUMNS)} numbers; unpack the drive again"
        )
    if not re.fullmatch(r"[0-9]{1,18}", path.stem) or int(path.stem) >= count:
        raise InputError(
            f"{path}: timestamps.txt has {count} lines, but no line for this file; unpack the drive again"
        )
    return [int(path.stem), *numbers]
