"""u-blox receivers' UBX streams: NAV-PVT messages, through pyubx2.

u-blox M8 Receiver description, UBX-13003221, 32.17.15 UBX-NAV-PVT: UTC, degrees, mm, mm/s; hAcc and sAcc are
standard deviations as the receiver sees them. Other messages in the stream, NMEA among them, are passed over.
"""

import calendar
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from datetime import date
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any

import numpy as np

from sigmaswarm.errors import InputError
from sigmaswarm.importing.limits import Limits
from sigmaswarm.importing.source import Guess, Part, Rows, Source, first_bytes, library

SYNC = b"\xb5\x62"
NAV_PVT = b"\x01\x07"
COLUMNS = ("t", "lat", "lon", "height", "hAcc", "velE", "velN", "gSpeed", "fixType", "gnssFixOk", "carrSoln")
_HALF = "*1e-3/sqrt(2)"  # hAcc is of the distance, each axis has its share
GUESS = Guess(
    {
        "gps": (
            Part(
                "NAV-PVT",
                {
                    **{"t": "t", "lat": "lat", "lon": "lon", "alt": "height*1e-3"},
                    **{
                        "std_x": f"hAcc{_HALF}",
                        "std_y": f"hAcc{_HALF}",
                        "vx": "velE*1e-3",
                        "vy": "velN*1e-3",
                    },
                    "keep": "gnssFixOk == 1 and fixType >= 2 and fixType <= 4",
                },
            ),
        )
    },
    ("NAV-PVT: times are UTC; the stated horizontal accuracy is split evenly between east and north",),
    fixed="gnssFixOk == 1 and carrSoln == 2",
)


def recognizes(path: Path) -> bool:
    """Whether UBX messages begin in its first bytes, or its name says so."""
    return path.suffix.lower() == ".ubx" or SYNC + NAV_PVT in first_bytes(path, 65536)


@contextmanager
def open_log(path: Path, limits: Limits) -> Generator[Source]:
    """Open a stream; it is decoded when its rows are wanted."""
    pyubx2 = library("pyubx2", "logs")
    if SYNC not in first_bytes(path, 1 << 20):
        raise InputError(f"{path}: holds no UBX messages; name the format with --format")
    remarks: list[str] = []
    yield Rows(path, "NAV-PVT", COLUMNS, lambda: _rows(path, pyubx2, remarks), GUESS, remarks)


def _time(message: Any) -> float:
    """s since 1970; ValueError where the calendar has no such day or the day no such time."""
    day = date(message.year, message.month, message.day)
    if not (message.hour < 24 and message.min < 60 and message.second <= 60):  # 60 is a leap second
        raise ValueError("no time of day")
    clock = (message.hour, message.min, message.second)
    return calendar.timegm((*day.timetuple()[:3], *clock)) + message.nano * 1e-9


def _rows(path: Path, pyubx2: Any, remarks: list[str]) -> Iterator[tuple[tuple[float, ...], float]]:
    """One row a NAV-PVT message with a valid date and time."""
    broken, undated = 0, 0
    with path.open("rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as stream:
        for raw, done in _messages(stream):
            if raw is None:
                broken += 1
                continue
            if raw[2:4] != NAV_PVT:
                continue
            try:
                message = pyubx2.UBXReader.parse(raw)
                dated = message.validDate and message.validTime
                row = (
                    (_time(message), *(float(getattr(message, name)) for name in COLUMNS[1:]))
                    if dated
                    else None
                )
            except Exception:  # of a length or a date that is none
                broken += 1
                continue
            if row is None:
                undated += 1
                continue
            yield row, done
    if broken:
        remarks.append(f"{path.name}: {broken} damaged messages passed over")
    if undated:
        remarks.append(f"{path.name}: {undated} messages without a valid date passed over")


def _messages(stream: mmap) -> Iterator[tuple[bytes | None, float]]:
    """Messages whose checksum is right, and None for damaged bytes between them; each with the share that is done.

    A damaged message may say any length: the next one is looked for right behind its first bytes, not at its end.
    """
    at, damaged = stream.find(SYNC), False
    while at >= 0:
        end = at + 8 + int.from_bytes(stream[at + 4 : at + 6], "little")
        raw = stream[at:end]
        sound = len(raw) == end - at and raw[-2:] == _checksum(raw[2:-2])
        if sound or not damaged:
            yield raw if sound else None, min(end / len(stream), 1.0)
        damaged = not sound
        at = stream.find(SYNC, end if sound else at + len(SYNC))


def _checksum(content: bytes) -> bytes:
    """Fletcher's, in 8 bits: section 32.4 of the description."""
    values = np.frombuffer(content, dtype=np.uint8).astype(np.int64)
    return bytes([int(values.sum()) & 255, int(np.cumsum(values).sum()) & 255])
